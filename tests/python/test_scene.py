"""Scenes: what a file may hold, what its faults are called, what it makes and what it expects."""

import inspect
import json
import re
import signal
import subprocess
import sys
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest
from fastcollide.errors import SceneError
from fastcollide.expectations import check_end, measure_start
from fastcollide.scene import load_scene
from fastcollide.scene_program import run_scene_and_report
from fastcollide.scene_schema import (
    ExpectTable,
    GivenTable,
    LatticeTable,
    OutputTable,
    RandomTable,
    RunTable,
    SceneFile,
    SphereExpectation,
    WorldTable,
)
from fastcollide.scene_text import new_scene, scene_schema
from fastcollide.settings import PARAMETERS
from fastcollide.toml_lines import line_of

pytestmark = pytest.mark.usefixtures("folder")

SCENES = Path(__file__).parent.parent.parent / "scenes"
SMALL = """
[world]
bounds = [[-2, -2, 0], [2, 2, 3]]

[[spheres]]
kind = "random"
count = 80

[run]
frames = 20
device = "cpu"
threads = 1

[output]
make_video = false
export_every = 0
"""


def load(text=SMALL, *overrides):
    path = Path("small.toml")
    path.write_text(text, encoding="utf-8")
    return load_scene(path, overrides)


def messages(text, *overrides):
    with pytest.raises(SceneError) as error:
        load(text, *overrides).create_world()
    return list(error.value.messages)


# --- Names and defaults ---


@pytest.mark.parametrize(
    ("table", "function", "without"),
    [
        (WorldTable, fc.World.__init__, {"self", "device", "threads", "method", "block_size"}),
        (RandomTable, fc.random_spheres, {"device", "bounds"}),
        (LatticeTable, fc.lattice_spheres, {"device", "bounds"}),
    ],
)
def test_keys_and_defaults_are_the_arguments_of_python(table, function, without):
    arguments = {name: p.default for name, p in inspect.signature(function).parameters.items() if name not in without}
    keys = {
        name: field
        for name, field in table.model_fields.items()
        if name not in ("kind", "bounds" * (table != WorldTable))
    }

    assert set(keys) == set(arguments)
    for name, field in keys.items():
        if not field.is_required():
            assert field.default == arguments[name], name


def test_spheres_one_by_one_have_the_arguments_of_add():
    arguments = set(inspect.signature(fc.World.add).parameters) - {"self", "spheres"}

    assert set(GivenTable.model_fields) - {"kind"} == arguments


def test_run_and_output_have_the_options_of_run():
    keys = (set(RunTable.model_fields) | set(OutputTable.model_fields)) - {"folder"} | {"output"}
    scene = {
        "particles",
        "gravity",
        "damping",
        "drag",
        "floor_restitution",
        "wall_friction",
        "rolling_friction",
        "bounds",
        "boundary",
        "seed",
    }
    scene |= {"radius", "speed", "restitution", "friction", "density", "solver", "iterations", "cell_size"}

    assert keys == set(PARAMETERS) - scene


def test_an_empty_scene_is_that_of_python_s_defaults():
    scene = load('[[spheres]]\nkind = "random"\ncount = 50')
    world = fc.World()
    world.add(fc.random_spheres(50))
    made = scene.create_world()
    for each in (world, made):
        each.step(3)

    assert made.state_hash() == world.state_hash()
    assert (scene.settings.frames, scene.settings.fps) == (600, 60)
    assert (scene.settings.output, scene.settings.video) == (Path("small"), Path("small/video.mp4"))


# --- What a file makes ---


@pytest.mark.parametrize(
    "change",
    [
        "world.bounds=[[-2,-2,0],[2,2,3.5]]",
        'world.boundary=["periodic", "wall", "wall"]',
        "world.gravity=[0,0,-1.6]",
        "world.gravity=[1,0,-9.8]",
        "world.drag=0.5",
        "world.floor_restitution=0.1",
        "world.wall_friction=0.4",
        "world.rolling_friction=0.2",
        "world.solver=reference",
        "world.iterations=3",
        "spheres[0].count=81",
        "spheres[0].kind=lattice",
        "spheres[0].bounds=[[-1.9,-2,0],[2,2,3]]",
        "spheres[0].seed=7",
        "spheres[0].radius=[0.1,0.2]",
        "spheres[0].speed=[1,2,3]",
        "spheres[0].restitution=[0.1,0.2]",
        "spheres[0].density=900",
        "spheres[0].friction=0.3",
        "run.frames=21",
        "run.fps=50",
    ],
)
def test_each_key_reaches_the_state(change):
    # Without friction nothing rolls.
    rough = ["spheres[0].friction=0.2"] if "rolling" in change else []

    def last_hash(*overrides):
        # Small enough for a lattice.
        scene = load(SMALL, "spheres[0].radius=[0.1,0.25]", *rough, *overrides)
        world = scene.create_world()
        world.step(scene.settings.frames, scene.settings.dt)
        return world.state_hash()

    assert last_hash(change) != last_hash()


@pytest.mark.parametrize(
    ("key", "value", "field", "expected"),
    [
        ("device", '"cpu"', "device", "cpu"),
        ("threads", "2", "threads", 2),
    ],
)
def test_run_keys_reach_the_settings(key, value, field, expected):
    assert getattr(load(SMALL, f"run.{key}={value}").settings, field) == expected


@pytest.mark.parametrize(
    ("key", "value", "field", "expected"),
    [
        ("folder", '"a/b"', "output", Path("a/b")),
        ("export_every", "7", "export_every", 7),
        ("ledger_every", "3", "ledger_every", 3),
        ("report", "true", "report", True),
        ("make_video", "true", "make_video", True),
        ("video", '"x.mp4"', "video", Path("x.mp4")),
        ("still", '"x.png"', "still", Path("x.png")),
        ("video_fps", "20", "video_fps", 20),
        ("width", "640", "width", 640),
        ("height", "360", "height", 360),
        ("supersampling", "1", "supersampling", 1),
        ("color_by", '"id"', "color_by", "id"),
        ("color_range", "[0, 2.5]", "color_range", (0, 2.5)),
        ("color_map", '"tide"', "color_map", "tide"),
        ("camera", '"top"', "camera", "top"),
        ("quality", "10", "quality", 10),
    ],
)
def test_output_keys_reach_the_settings(key, value, field, expected):
    assert getattr(load(SMALL, f"output.{key}={value}").settings, field) == expected


def test_spheres_one_by_one():
    scene = load("""
        [[spheres]]
        kind = "given"
        position = [[0, 0, 5], [1, 0, 5]]
        radius = [0.2, 0.3]
        velocity = [[1, 2, 3], [4, 5, 6]]
        spin = [0, 0, 1]
        mass = 2
        restitution = 0.25
        friction = [0.5, 0.75]

        [[spheres]]
        kind = "given"
        position = [[3, 0, 5]]
        radius = 0.5
        density = 100
    """)
    world = scene.create_world()

    assert fc.to_numpy(world.positions).tolist() == [[0, 0, 5], [1, 0, 5], [3, 0, 5]]
    assert fc.to_numpy(world.radii).tolist() == pytest.approx([0.2, 0.3, 0.5])
    assert fc.to_numpy(world.velocities).tolist() == [[1, 2, 3], [4, 5, 6], [0, 0, 0]]
    assert fc.to_numpy(world.spins).tolist() == [[0, 0, 1], [0, 0, 1], [0, 0, 0]]
    assert fc.to_numpy(world.masses).tolist() == pytest.approx([2, 2, 100 * 4 / 3 * np.pi * 0.5**3])
    assert fc.to_numpy(world.restitutions).tolist() == pytest.approx([0.25, 0.25, 0.6])
    assert fc.to_numpy(world.frictions).tolist() == [0.5, 0.75, 0]


def test_a_lattice_fills_its_bounds_from_below_without_overlap():
    bounds = ((0, 0, 0), (6, 3, 9))
    spheres = fc.lattice_spheres(500, bounds, radius=(0.1, 0.2), speed=(1, 1, 1), friction=0.5)
    random = fc.random_spheres(500, bounds, radius=(0.1, 0.2), speed=(1, 1, 1), friction=0.5)

    for field in ("velocity", "radius", "mass", "restitution", "friction"):
        assert np.array_equal(getattr(spheres, field), getattr(random, field))
    world = fc.World(bounds)
    world.add(spheres)
    assert world.contact_count() == 0
    assert (spheres.position > 0.2).all()
    assert (spheres.position < np.array(bounds[1]) - 0.2).all()
    assert (np.diff(spheres.position[:, 2]) >= 0).all()
    assert len(np.unique(spheres.position[:, 2])) > 5
    with pytest.raises(
        fc.InvalidValue, match=r"radius: found 0.4 for 500 spheres in these bounds; allowed: at most 0\.3"
    ):
        fc.lattice_spheres(500, bounds, radius=(0.1, 0.4))


# --- Faults ---


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[world]\nbounds = 3  #!", "world.bounds: found 3; allowed: two corners, [[x, y, z], [x, y, z]]"),
        ("[world]\nbounds = [[0, 0, 0], [1, 1, nan]]  #!", "world.bounds[1][2]: found NaN; allowed: two corners"),
        ("[world]\nbounds = [[0, 0], [1, 1, 1]]  #!", "world.bounds[0]: found [0, 0]; allowed: two corners"),
        (
            "[world]\ngravty = [0, 0, 1]  #!",
            'world.gravty: found a key that does not exist; did you mean "gravity"?; allowed: bounds',
        ),
        ('[world]\ngravity = [0, 0, "down"]  #!', 'world.gravity[2]: found "down"; allowed: three finite numbers'),
        ("[world]\ngravity = [0, 0]  #!", "world.gravity: found [0, 0]; allowed: three finite numbers"),
        ("[world]\ndrag = -1  #!", "world.drag: found -1; allowed: a number from 0 to 10000 1/s"),
        ("[world]\ndrag = true  #!", "world.drag: found true; allowed: a number from 0 to 10000 1/s"),
        ('[world]\ndrag = "1"  #!', 'world.drag: found "1"; allowed: a number'),
        ("[world]\ndrag = inf  #!", "world.drag: found Infinity; allowed: a number"),
        ('[world]\nboundary = "closed"  #!', 'world.boundary: found "closed"; allowed: "wall", "periodic" or "open"'),
        ('[world]\nboundary = ["wall", "open", "x"]  #!', 'world.boundary[2]: found "x"; allowed: "wall"'),
        ('[world]\nsolver = "magic"  #!', 'world.solver: found "magic"; allowed: substep, reference'),
        ("[world]\niterations = 2.5  #!", "world.iterations: found 2.5; allowed: a whole number from 1 to 1,000"),
        ('[[spheres]]\nkind = "blob"  #!', 'spheres[0].kind: found "blob"; allowed: "random", "lattice", "given"'),
        ("[[spheres]]  #!\ncount = 5", 'spheres[0].kind: found nothing; allowed: "random"'),
        ('[[spheres]]  #!\nkind = "random"', "spheres[0].count: found nothing; allowed: a whole number from 1"),
        ('[[spheres]]\nkind = "random"\ncount = 0  #!', "spheres[0].count: found 0; allowed: a whole number"),
        (
            '[[spheres]]\nkind = "lattice"\ncount = 1\nradius = [0.1, -1]  #!',
            "spheres[0].radius[1]: found -1; allowed: two numbers above 0 m",
        ),
        (
            '[[spheres]]\nkind = "given"\nradius = [1, "b"]  #!\nposition = [[0, 0, 0]]',
            'spheres[0].radius[1]: found "b"; allowed: a number above 0, one for all or a list',
        ),
        ("[spheres]  #!\ncount = 5", 'spheres: found {"count": 5}; allowed: tables [[spheres]]'),
        ("[run]\nframes = 0  #!", "run.frames: found 0"),
        ('[run]\ndevice = "gpu"  #!', 'run.device: found "gpu"; allowed: auto, cpu, cuda, or cuda: and a number'),
        (
            '[[spheres]]\nkind = "given"\nradius = 1\nposition = [[0, 0, 0]]\nvelocity = [1, "b", 2]  #!',
            'spheres[0].velocity[1]: found "b"; allowed: [x, y, z], one for all or a list',
        ),
        (
            '[[spheres]]\nkind = "given"\nradius = 1\nposition = [[0, 0, 0]]\nvelocity = [[1, 2, 3], [1, 2, "b"]]  #!',
            'spheres[0].velocity[1][2]: found "b"; allowed: [x, y, z], one for all or a list',
        ),
        ("[output]\nwidth = 1281  #!", "output.width: found 1281; allowed: an even whole number"),
        ('[output]\nvideo = "a.avi"  #!', "output.video: found a.avi; allowed: a path that ends in .mp4"),
        ("[output]\nvideo_fps = 61  #!", "output.video_fps: found 61; allowed: at most fps, which is 60"),
        ("[output]\ncolor_range = [1, 1]  #!", "output.color_range: found 1 1; allowed: the lower value first"),
        ("[output]\nreport = 1  #!", "output.report: found 1; allowed: true or false"),
        ("[expect]\nrms_speed = 3  #!", "expect.rms_speed: found 3; allowed: { min = number"),
        ("[expect]\nrms_speed = {}  #!", "expect.rms_speed: found {}; allowed: { min = number"),
        ("[expect]\nrms_speed = { min = 2, max = 1 }  #!", "expect.rms_speed: found {"),
        ('[expect]\nstate_hash = "xyz"  #!', 'expect.state_hash: found "xyz"; allowed: 16 digits'),
        ("[[expect.sphere]]  #!\nvelocity = [0, 0, 0]", "expect.sphere[0].id: found nothing; allowed: a whole number"),
        ("[world]\nx =   #!", "found no valid TOML: "),
    ],
)
def test_a_fault_is_told_by_line_key_and_what_is_allowed(text, message):
    """The line at fault is marked with #!."""
    spheres = "" if "spheres]" in text else '\n[[spheres]]\nkind = "random"\ncount = 5\n'
    text = "# a scene\n\n" + text + spheres
    (found,) = messages(text)

    line = text[: text.index("#!")].count("\n") + 1
    assert found.startswith(f"small.toml:{line}: "), found
    assert message in found


def test_all_faults_are_told_in_the_order_of_the_file():
    found = messages(SMALL.replace("count = 80", "count = 0").replace("threads = 1", "threads = 0\nfps = 0"))

    assert [re.match(r"small\.toml:(\d+): ([\w.\[\]]+): found 0", message).groups() for message in found] == [
        ("7", "spheres[0].count"),
        ("12", "run.threads"),
        ("13", "run.fps"),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('kind = "random"\ncount = 2\nradius = [0.4, 0.1]', "spheres[0].radius"),
        ('kind = "random"\ncount = 2\nradius = [3, 12]', "spheres[0].radius"),
        ('kind = "lattice"\ncount = 20000\nradius = [0.1, 3]', "spheres[0].radius: found 3 for 20,000 spheres"),
        ('kind = "given"\nposition = [[0, 0, 99]]\nradius = 1', "spheres[0].position"),
        ('kind = "given"\nposition = [[0, 0, 9]]\nradius = [1, 2]', "spheres[0].radius: found an array of shape (2,)"),
        (
            'kind = "given"\nposition = [[0, 0, 9]]\nradius = 1\nmass = 1\ndensity = 1',
            "spheres[0].density: found beside mass",
        ),
    ],
)
def test_what_the_engine_refuses_is_told_the_same_way(text, message):
    (found,) = messages("[[spheres]]\n" + text)

    assert re.match(r"small\.toml:\d: ", found)
    assert found.split(": ", 1)[1].startswith(message)


def test_a_box_that_the_engine_refuses():
    (found,) = messages(SMALL.replace("[2, 2, 3]", "[2, 2, -3]"))

    assert found.startswith("small.toml:3: world.bounds")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("world.drag=-1", "--set world.drag=-1: world.drag: found -1; allowed: a number from 0"),
        ("world.gravity=[0,0", '--set world.gravity=[0,0: world.gravity: found "[0,0"; allowed: three'),
        ("world.grav=1", "--set world.grav=1: world.grav: found a key that does not exist"),
        ("spheres[0].count=x", '--set spheres[0].count=x: spheres[0].count: found "x"'),
        ("spheres[3].count=1", "--set spheres[3].count: found no such place"),
        ("run.frames.x=1", "--set run.frames.x: found no such place"),
        ("world", "--set world: found no key and value; allowed: key=value"),
        ("=1", "--set =1: found no key and value"),
        ("output.video_fps=100", "--set output.video_fps=100: output.video_fps: found 100"),
        ("world.bounds=[[0,0,0],[1,1,-1]]", "--set world.bounds=[[0,0,0],[1,1,-1]]: world.bounds"),
    ],
)
def test_a_wrong_override_is_named_in_place_of_the_file(override, message):
    (found,) = messages(SMALL, override)

    assert found.startswith(message)


def test_the_program_tells_faults_and_writes_nothing(program, folder):
    Path("bad.toml").write_text(SMALL.replace("count = 80", "count = 0\nseed = -1"))

    for command in (["run"], ["scene", "check"]):
        code, output, errors = program(*command, "bad.toml")
        assert (code, output) == (2, "")
        assert errors.count("\n") == 2
        assert all(line.startswith("fastcollide: bad.toml:") for line in errors.splitlines())
    assert [path.name for path in folder.iterdir()] == ["bad.toml"]


@pytest.mark.parametrize("content", [b"\xff\xfe", b"\x00", b""])
def test_a_file_that_is_none(program, content):
    Path("bad.toml").write_bytes(content)

    code, _, errors = program("run", "bad.toml")

    assert code == 2
    assert errors.startswith("fastcollide: bad.toml")
    assert errors.count("\n") == 1


TOML = """a = 1  #1
[t]  #2
b = [  #3
  1,  # a = 3
  2,
]
s = '''
c = 7
'''
in = { x = 1 }  #4
dotted.y = 2  #5

[[list]]
c = 1  #6

[[list]]  #7
c = 2  #8

[deep.er]  #0
d = "# c = 4"  #9

[deep.er.mid.last]
"""


@pytest.mark.parametrize(
    ("place", "mark"),
    [
        (("a",), 1),
        (("t", "nothing"), 2),
        (("t", "b"), 3),
        (("t", "b", 1), 3),
        (("t", "in", "x"), 4),
        (("t", "dotted", "y"), 5),
        (("list", 0, "c"), 6),
        (("list", 1), 7),
        (("list", 1, "nothing"), 7),
        (("list", 1, "c"), 8),
        (("deep", "er", "d"), 9),
        (("deep", "er", "mid", "nothing"), 0),
    ],
)
def test_the_line_of_a_key(place, mark):
    assert line_of(TOML, place) == TOML[: TOML.index(f"#{mark}")].count("\n") + 1


def test_what_is_not_in_the_file_has_no_line():
    assert line_of(TOML, ("nothing", "x")) is None
    assert line_of(TOML, ()) is None


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


# --- The schema for editors ---


def test_the_committed_schema_is_that_of_the_program(program):
    assert (SCENES / "scene.schema.json").read_text(encoding="utf-8") == scene_schema()
    assert program("scene", "schema")[1] == scene_schema()


def test_the_schema_says_the_same_as_the_program():
    jsonschema = pytest.importorskip("jsonschema")
    tomlkit = pytest.importorskip("tomlkit")
    validator = jsonschema.Draft202012Validator(json.loads(scene_schema()))
    validator.check_schema(validator.schema)

    for path in SCENES.glob("*.toml"):
        assert not list(validator.iter_errors(tomlkit.parse(path.read_text(encoding="utf-8")).unwrap())), path
    for wrong in ("[world]\ndrag = -1", "[run]\nframes = 2.5", "[world]\nx = 1", '[run]\ndevice = "gpu"'):
        document = tomlkit.parse(wrong + '\n[[spheres]]\nkind = "random"\ncount = 5').unwrap()
        assert list(validator.iter_errors(document)), wrong


# --- Expectations ---


def end_of(expect, frames=20):
    """The outcomes of the small scene, by name, and its world."""
    scene = load(SMALL + "\n[expect]\n" + expect, "world.gravity=[1, 0, -9.8]", "spheres[0].friction=0.3")
    world = scene.create_world()
    start = measure_start(world)
    with fc.LedgerWriter("ledger.csv") as ledger:
        for _ in range(frames):
            ledger.add(world)
            world.step(1)
        ledger.add(world)
    outcomes = check_end(scene.file.expect, world, start, fc.read_ledger("ledger.csv"))
    return {outcome.name: outcome for outcome in outcomes}, world, fc.read_ledger("ledger.csv")


RANGES = [name for name, field in ExpectTable.model_fields.items() if "Range" in str(field.annotation)]


def mean_overlap(world):
    contacts, radii = world.contacts(), fc.to_numpy(world.radii)
    smaller = np.minimum(radii[contacts.first], radii[contacts.second])
    return np.mean(-contacts.gap.astype(float) / smaller)


def figure(name, world, ledger):
    """The same figure, from its meaning and the ledger."""
    x, r = fc.to_numpy(world.positions).astype(float), fc.to_numpy(world.radii).astype(float)
    v, m = fc.to_numpy(world.velocities).astype(float), fc.to_numpy(world.masses).astype(float)
    motion = ledger["kinetic_J"] + ledger["rotational_J"]
    if name[:-2] in ("center", "lowest", "highest"):
        axis = "xyz".index(name[-1])
        along, each = x[:, axis], {"lowest": -r, "highest": r}.get(name[:-2], 0)
        return {"center": (m * along).sum() / m.sum(), "lowest": min(along + each), "highest": max(along + each)}[
            name[:-2]
        ]
    speed = np.sqrt((v**2).sum(axis=1))
    start = load(SMALL, "spheres[0].friction=0.3").create_world()
    v0 = np.sqrt((fc.to_numpy(start.velocities).astype(float) ** 2).sum(axis=1))
    momentum = np.array([ledger[f"momentum_{axis}_Ns"] for axis in "xyz"])
    return {
        "rms_speed": np.sqrt(np.mean(speed**2)),
        "max_speed": speed.max(),
        "contacts": ledger["contacts"][-1],
        "max_overlap": ledger["max_overlap_m"][-1],
        "mean_overlap": mean_overlap(world),
        "escaped": 0,
        "energy_ratio": ledger["total_J"][-1] / ledger["total_J"][0],
        "motion_ratio": motion[-1] / motion[0],
        "largest_energy_gain": max(0, *np.diff(ledger["total_J"])) / ledger["total_J"][0],
        "momentum_change": np.linalg.norm(momentum[:, -1] - momentum[:, 0]) / (m.sum() * np.sqrt(np.mean(v0**2))),
    }[name]


@pytest.mark.parametrize("name", RANGES)
def test_a_range_holds_just_around_the_figure_and_not_beside_it(name):
    _, world, ledger = end_of("")
    value = float(figure(name, world, ledger))
    step = max(abs(value) * 1e-9, 1e-12)
    cases = {
        f"{{ min = {value - step!r}, max = {value + step!r} }}": True,
        f"{{ min = {value + step!r} }}": False,
        f"{{ max = {value - step!r} }}": False,
        f"{{ min = {value - step!r} }}": True,
        f"{{ max = {value + step!r} }}": True,
    }
    for words, is_good in cases.items():
        (outcome,) = end_of(f"{name} = {words}")[0].values()
        assert outcome.name == name
        assert outcome.is_good == is_good, (words, outcome)


def test_escaped_counts_spheres_outside_an_open_box():
    scene = load(SMALL + "\n[expect]\nescaped = { max = 0 }", "world.boundary=open", "run.frames=200")
    world = scene.create_world()
    start = measure_start(world)
    world.step(200)
    (outcome,) = check_end(scene.file.expect, world, start, None)

    assert (outcome.found, outcome.is_good) == ("80", False)


def test_what_has_no_meaning_is_not_met():
    # No gravity, all at rest: no energy to compare with. And no ledger.
    text = SMALL + "\n[expect]\n" + "\n".join(f"{name} = {{ min = -1e300 }}" for name in RANGES)
    scene = load(text, "world.gravity=[0,0,0]", "spheres[0].speed=[0,0,0]")
    world = scene.create_world()
    unmet = {
        outcome.name
        for outcome in check_end(scene.file.expect, world, measure_start(world), None)
        if not outcome.is_good
    }

    assert unmet == {"energy_ratio", "motion_ratio", "largest_energy_gain", "momentum_change"}


def test_the_state_hash():
    _, world, _ = end_of("")
    right = f"{world.state_hash():016x}"
    wrong = f"{world.state_hash() ^ 1:016x}"

    assert end_of(f'state_hash = "{right}"')[0]["state_hash"].is_good
    assert not end_of(f'state_hash = "{wrong}"')[0]["state_hash"].is_good


@pytest.mark.parametrize("field", ["position", "velocity", "spin"])
def test_a_single_sphere(field):
    _, world, _ = end_of("")
    found = fc.to_numpy(getattr(world, f"{field}s" if field != "velocity" else "velocities"))[7].astype(float)

    for axis in range(3):
        for change, is_good in ((0.0009, True), (-0.0009, True), (0.0011, False), (-0.0011, False)):
            expected = found.copy()
            expected[axis] += change
            outcomes, _, _ = end_of(f"[[expect.sphere]]\nid = 7\n{field} = {expected.tolist()}\ntolerance = 0.001")
            assert outcomes[f"sphere 7 {field}"].is_good == is_good
    assert not end_of(f"[[expect.sphere]]\nid = 80\n{field} = [0, 0, 0]")[0]["sphere 80"].is_good


def test_an_end_that_is_not_as_expected_is_a_failure(program):
    Path("small.toml").write_text(SMALL + "[expect]\nescaped = { max = 0 }\ncontacts = { min = 1e6 }")

    code, output, errors = program("run", "small.toml")

    assert code == 1
    assert re.search(r"^expected +escaped at most 0, found 0$", output, re.MULTILINE)
    assert re.search(r"^expected +contacts at least 1e\+06, found \d+: NOT MET$", output, re.MULTILINE)
    assert re.fullmatch(r"fastcollide: expect\.contacts: found \d+; expected: at least 1e\+06\n", errors)
    assert program("run", "small.toml", "--set", "expect.contacts.min=0")[0] == 0


def test_a_scene_that_is_stopped_is_not_checked(capfd, monkeypatch):
    Path("small.toml").write_text(SMALL + "[expect]\ncontacts = { min = 1e6 }")
    step = fc.World.step

    def press(world, *arguments, **options):
        step(world, *arguments, **options)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(fc.World, "step", press)
    code = run_scene_and_report(Path("small.toml"), [], {})

    assert code == 130
    assert "expected" not in capfd.readouterr().out


def test_the_report_of_a_scene(program):
    pytest.importorskip("matplotlib")
    pytest.importorskip("jinja2")
    Path("small.toml").write_text('title = "Eighty <spheres>"' + SMALL + "[expect]\ncontacts = { min = 1e6 }")

    code, _, _ = program("run", "small.toml", "--report", "--set", "world.drag=0")
    page = Path("small/report.html").read_text(encoding="utf-8")

    assert code == 1
    assert "<h1>Eighty &lt;spheres&gt;</h1>" in page
    assert "fastcollide run small.toml --set world.drag=0 --set output.report=true" in page
    assert "<td>world.drag</td><td>0.0</td>" in page
    assert "<td>spheres[0].count</td><td>80</td>" in page
    assert "not met" in page


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
