"""What README.md says is what the program does."""

import importlib.util
import re
from pathlib import Path

import fastcollide as fc
import pytest
from fastcollide import cli

ROOT = Path(__file__).parent.parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_table_of_parameters_is_that_of_the_program():
    spec = importlib.util.spec_from_file_location("update_readme", ROOT / "tools" / "update_readme.py")
    update_readme = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(update_readme)
    assert update_readme.updated(README) == README


@pytest.mark.parametrize("name", re.findall(r"\]\(([^)#]+)\)", README))
def test_links_lead_somewhere(name):
    assert (ROOT / name).exists()


def test_the_python_example_runs(capsys):
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    example = example.replace("20_000", "200").replace("frames=600", "frames=5")
    names = {}
    exec(example, names)
    assert names["x"].shape == (200, 3)
    assert len(names["contacts"]) == names["world"].contact_count()
    assert capsys.readouterr().out.splitlines()[-1] == f"{names['world'].state_hash():016x}"
    assert names["fc"] is fc


def test_the_scene_runs_and_ends_as_expected(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```toml\n(.*?)```", README, flags=re.DOTALL)
    Path("scene.toml").write_text(example, encoding="utf-8")
    assert cli.main(["run", "scene.toml", "--frames", "30", "--no-video", "--export-every", "0"]) == 0
