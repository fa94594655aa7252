"""What docs/files.md shows runs as it stands."""

import re
import shlex
from pathlib import Path

import pytest
from fastcollide import cli
from fastcollide.settings import PARAMETERS

ROOT = Path(__file__).parent.parent.parent
TEXT = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")

pytestmark = pytest.mark.usefixtures("folder")


def test_commands_and_the_python_example(capsys):
    for library in ("gsd", "h5py", "pyarrow", "av"):
        pytest.importorskip(library)
    (example,) = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
    commands = [line for block in re.findall(r"```sh\n(.*?)```", TEXT, flags=re.DOTALL) for line in block.splitlines()]
    assert len(commands) == 5
    small = {"2000": "60", "500": "60", "300": "120", "120": "20"}
    smaller = ["--width", "128", "--height", "64", "--device", "cpu"]
    for command in commands:
        assert command.startswith("fastcollide ")
        words = shlex.split(command)[1:]
        assert cli.main([*(small.get(word, word) for word in words), *smaller]) == 0
    assert {path.name for path in Path("pile").iterdir()} >= {"run.gsd", "run.vtkhdf", "ledger.parquet", "run.json"}
    assert Path("pile.mp4").is_file()
    assert Path("compare.mp4").is_file()
    capsys.readouterr()
    exec(compile(example, "docs/files.md", "exec"), {})
    shown = capsys.readouterr().out.splitlines()
    assert shown[0] == "60 2.0 ((-10.0, -10.0, 0.0), (10.0, 10.0, 20.0)) 60"
    assert len(shown) == 2 + 5 + 1


def test_options_are_those_of_the_program():
    known = {parameter.option for parameter in PARAMETERS.values()} | {"--label", "--kills", "--help", "--device"}
    assert set(re.findall(r"--[a-z][a-z-]+", TEXT)) <= known


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
