"""Scenes: what a file may hold, what its faults are called and what it makes."""

import inspect
import json
import re
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest
from fastcollide.scene_schema import (
    GivenTable,
    LatticeTable,
    OutputTable,
    RandomTable,
    RunTable,
    WorldTable,
)
from fastcollide.scene_text import scene_schema
from fastcollide.settings import PARAMETERS
from fastcollide.toml_lines import line_of
from small_scene import SCENES, SMALL, load, messages

pytestmark = pytest.mark.usefixtures("folder")


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
