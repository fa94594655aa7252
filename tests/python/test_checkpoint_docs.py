"""What docs/checkpoints.md shows runs as it stands."""

import re
import zipfile
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest
from fastcollide import cli

TEXT = (Path(__file__).parent.parent.parent / "docs" / "checkpoints.md").read_text(encoding="utf-8")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_the_python_example():
    (example,) = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
    exec(compile(example, "docs/checkpoints.md", "exec"), {})
    with np.load("pile.fcw") as file:
        assert len(file["position"]) == 1000


def test_the_commands(capsys):
    (example,) = re.findall(r"```sh\n(.*?)```", TEXT, flags=re.DOTALL)
    commands = [line.split()[1:] for line in example.splitlines()]
    assert [command[0] for command in commands] == ["run", "resume"]
    small = {"2000": "20", "300": "60"}
    for command in commands:
        more = ["--no-video"] if command[0] == "run" else []
        assert cli.main([*(small.get(word, word) for word in command), *more]) == 0
    assert Path("pile", "checkpoint_00000050.fcw").is_file()


def test_bytes_for_each_sphere():
    def sizes(count, friction):
        """Of the arrays of spheres, and of those of contacts for each contact, without the headers of 128 bytes."""
        world = fc.World(device="cpu")
        world.add(fc.random_spheres(count, friction=friction))
        world.step()
        world.save("size.fcw")
        with zipfile.ZipFile("size.fcw") as archive:
            blocks = {info.filename: info.file_size - 128 for info in archive.infolist() if ".npy" in info.filename}
        contacts = sum(size for name, size in blocks.items() if name.startswith("contact_"))
        known = blocks.get("contact_owner.npy", 4) / 4
        return (sum(blocks.values()) - contacts) / count, contacts / known

    (smooth, _), (rough, contact) = sizes(10_000, 0.0), sizes(10_000, 0.5)
    text = TEXT.replace("\n", " ")
    assert f"{smooth:g} bytes for each sphere ({rough:g} with spin and friction" in text
    assert f"{contact:g} for each contact that remembers" in text
