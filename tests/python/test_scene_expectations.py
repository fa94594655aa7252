"""Scenes: what one expects of its end."""

import re
import signal
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest
from fastcollide.expectations import check_end, measure_start
from fastcollide.scene_program import run_scene_and_report
from fastcollide.scene_schema import ExpectTable
from small_scene import SMALL, load

pytestmark = pytest.mark.usefixtures("folder")


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
