"""Scenes: the program that runs, checks and starts them, and those of this project."""

import re
import subprocess
import sys
from pathlib import Path

import fastcollide as fc
import pytest
from fastcollide.scene import load_scene
from fastcollide.scene_schema import (
    ExpectTable,
    GivenTable,
    OutputTable,
    RandomTable,
    RunTable,
    SceneFile,
    SphereExpectation,
    WorldTable,
)
from fastcollide.scene_text import new_scene
from small_scene import SCENES, SMALL, load

pytestmark = pytest.mark.usefixtures("folder")


# --- The program ---


def test_a_run_of_a_scene_is_that_of_its_options(program):
    Path("small.toml").write_text(SMALL)
    code, output, errors = program("run", "small.toml", "--set", "world.drag=0")
    options = ["--particles", 80, "--bounds", -2, -2, 0, 2, 2, 3, "--frames", 20, "--drag", 0, "--no-video"]
    _, other, _ = program("run", *options, "--export-every", 0)

    assert (code, errors) == (0, "")
    assert re.search(r"state hash +(\w+)", output)[1] == re.search(r"state hash +(\w+)", other)[1]
    assert Path("small/ledger.csv").is_file()


@pytest.mark.parametrize("solver", ["substep", "reference"])
def test_what_would_be_safe_can_be_typed_beside_the_scene(program, solver):
    """What the summary says of fast spheres makes its line go away."""
    Path("fast.toml").write_text(f"""
        [world]
        boundary = "open"
        gravity = [0, 0, 0]
        solver = "{solver}"

        [[spheres]]
        kind = "given"
        position = [[0, 0, 5]]
        velocity = [0, 0, 300]
        radius = 0.1
    """)
    run = ["run", "fast.toml", "--frames", 6, "--no-video", "--export-every", 0]

    advice = re.search(rf"in a {'frame' if solver == 'reference' else 'substep'}, .*; safe: (.*)", program(*run)[1])[1]

    assert len(advice.split(" or ")) == (1 if solver == "reference" else 2)
    for words in advice.split(" or "):
        code, output, errors = program(*run, *words.split())
        assert (code, errors) == (0, "")
        assert "fast spheres" not in output


def test_options_of_the_run_go_before_the_scene(program):
    Path("small.toml").write_text(SMALL)

    code, output, _ = program("run", "small.toml", "--frames", 6, "--output", "else where", "--export-every", 3)

    assert code == 0
    assert sorted(path.name for path in Path("else where").iterdir()) == [
        "frame_00000003.txt",
        "frame_00000006.txt",
        "ledger.csv",
        "run.json",
    ]
    assert "for 6 frames" in output
    assert load(SMALL, "output.color_range=[0.0, 1.5]", "output.report=true").settings.report


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "small.toml", "--particles", "3"], "particles: found it beside a scene; allowed: --set"),
        (["run", "--set", "run.frames=3"], "--set: found without a scene"),
        (["run", "nowhere.toml"], "nowhere.toml"),
        (["scene", "check"], "Missing argument"),
    ],
)
def test_bad_usage(program, arguments, message):
    Path("small.toml").write_text(SMALL)

    code, output, errors = program(*arguments)

    assert (code, output) == (2, "")
    assert message in errors
    assert errors.count("\n") == 1


def test_a_new_scene_has_every_key_with_its_default(program):
    code, output, _ = program("scene", "new", "mine.toml")
    text = Path("mine.toml").read_text(encoding="utf-8")
    scene = load_scene(Path("mine.toml"))

    assert code == 0
    assert str(Path("mine.toml").resolve()) in output
    assert text == new_scene()
    assert scene.file.world == WorldTable()
    assert scene.file.run == RunTable()
    assert scene.file.output == OutputTable()
    assert scene.file.spheres == [RandomTable(kind="random", count=2000)]
    for table in (WorldTable, RandomTable, GivenTable, RunTable, OutputTable, ExpectTable, SphereExpectation):
        for name in table.model_fields:
            assert re.search(rf"^(# )?(\[\[expect\.)?{name}( =|\]\])", text, re.MULTILINE), name
    assert max(map(len, text.splitlines())) <= 120


def test_a_new_scene_replaces_no_file(program):
    Path("mine.toml").write_text("mine")

    code, _, errors = program("scene", "new", "mine.toml")

    assert code == 1
    assert errors == "fastcollide: mine.toml: File exists\n"
    assert Path("mine.toml").read_text() == "mine"


def test_check_tells_what_a_scene_is(program):
    Path("small.toml").write_text(SMALL)
    Path("bad.toml").write_text("[run]\nframes = 0")

    code, output, errors = program("scene", "check", "small.toml", "bad.toml", "small.toml", "--set", "run.fps=40")

    assert code == 2
    assert output == "small.toml: fine, 80 spheres for 0.5 s\n" * 2
    assert "bad.toml:2: run.frames: found 0" in errors


def test_pydantic_is_loaded_for_scenes_alone():
    code = "import fastcollide.cli, sys; sys.exit('pydantic' in sys.modules or 'matplotlib' in sys.modules)"

    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# --- The scenes of this project ---


def test_there_are_the_report_s_five_and_more():
    names = {path.stem for path in SCENES.glob("*.toml")}

    assert names >= {f"report_{count}" for count in (2000, 5000, 10000, 20000, 40000)}
    assert names >= {"dam_break", "elastic_gas", "newtons_cradle", "million"}


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
def test_a_scene_of_this_project_is_whole(path):
    scene = load_scene(path)

    assert scene.file.title
    assert scene.file.expect != ExpectTable()
    assert isinstance(scene.file, SceneFile)
    if scene.file.spheres[0].kind == "given" or scene.file.spheres[0].count < 50_000:
        assert len(scene.create_world(device="cpu")) > 0
    match = re.fullmatch(r"report_(\d+)", path.stem)
    if match:
        assert scene.file.spheres[0].count == int(match[1])
        assert scene.file.world.drag == fc.drag_from_damping(0.999, 60)


@pytest.mark.parametrize(("name", "frames"), [("newtons_cradle", 1200), ("elastic_gas", 60)])
def test_quick_scenes_end_as_expected(program, device, name, frames):
    code, output, errors = program(
        *["run", SCENES / f"{name}.toml", "--device", device, "--frames", frames, "--no-video", "--export-every", 0]
    )

    assert (code, errors) == (0, "")
    assert output.count("\nexpected") >= 2


def test_an_elastic_gas_that_loses_something_is_found(program):
    code, _, errors = program(
        *["run", SCENES / "elastic_gas.toml", "--frames", 60, "--no-video", "--export-every", 0],
        *["--set", "spheres.0.restitution=[0.999,0.999]"],
    )

    assert code == 1
    assert "expect.motion_ratio" in errors
