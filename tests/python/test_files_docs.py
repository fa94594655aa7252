"""What docs/files.md says of sizes is so. Its examples run in test_docs_examples.py."""

import re
from pathlib import Path

import pytest
from fastcollide import cli

TEXT = (Path(__file__).parent.parent.parent / "docs" / "files.md").read_text(encoding="utf-8")

pytestmark = pytest.mark.usefixtures("folder")


def test_bytes_for_each_sphere():
    pytest.importorskip("gsd")
    pytest.importorskip("h5py")
    row = next(line for line in TEXT.splitlines() if line.startswith("| bytes"))
    claims = {"gsd": {}, "vtkhdf": {}}
    text, gsd, vtkhdf = (cell.strip() for cell in row.split("|")[2:5])
    for name, cell in (("gsd", gsd), ("vtkhdf", vtkhdf)):
        claims[name][0.0], claims[name][0.3] = map(int, re.fullmatch(r"(\d+), with spin (\d+)", cell).groups())
    for friction in (0.0, 0.3):
        sizes = {}
        for frames in (2, 4):
            files = [word for name in claims for word in ("--trajectory", f"{frames}.{name}")]
            run = ["run", "--particles", "2000", "--no-video", "--device", "cpu", "--export-every", "1", *files]
            run += ["--frames", str(frames), "--friction", str(friction), "--output", str(frames)]
            assert cli.main(run) == 0
            sizes[frames] = {name: Path(f"{frames}.{name}").stat().st_size for name in claims}
        for name, claim in claims.items():
            found = (sizes[4][name] - sizes[2][name]) / 2 / 2000
            assert found == pytest.approx(claim[friction], abs=1.0), name
    assert Path("4/frame_00000004.txt").stat().st_size / 2000 == pytest.approx(int(text), rel=0.05)
