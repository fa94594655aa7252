"""`fastcollide bench`: what it measures, that it times nothing wrong, its tables and files. No time is judged."""

import csv
import json
import math
from dataclasses import replace

import fastcollide as fc
import pytest
from fastcollide import bench, cli
from fastcollide.bench import Case, cases_of, new_world, run_bench, scene_edge
from fastcollide.bench_settings import METHODS, BenchSettings
from fastcollide.roof import copy_bandwidth, model_bytes

SMALL = BenchSettings(method=("cells", "list"), sizes=(40, 90), device=("cpu",), threads=1, repeats=2, frames=3)
SMALL_WORDS = ["bench", "--sizes", "40,90", "--device", "cpu", "--threads", "1", "--repeats", "2", "--frames", "3"]
BANDWIDTH = 1e9


@pytest.fixture(autouse=True)
def known_bandwidth(monkeypatch):
    monkeypatch.setattr(bench, "copy_bandwidth", lambda device, threads: BANDWIDTH)


@pytest.fixture
def crowd(monkeypatch):
    """A box so small that its spheres meet within a few frames."""
    monkeypatch.setattr(bench, "scene_edge", lambda spheres: 2.5)


def test_there_is_a_row_for_each_size_solver_and_method():
    rows = run_bench(replace(SMALL, method=METHODS))
    found = [(row.spheres, row.solver, row.method) for row in rows]
    solvers = ("reference", "substep", "friction")
    assert found == [(n, solver, method) for n in (40, 90) for solver in solvers for method in METHODS]
    for row in rows:
        assert row.repeats == 2
        assert 0 < row.ms_fastest <= row.ms <= row.ms_slowest
        assert row.device == "cpu"
        assert "1 thread" in row.device_name


@pytest.mark.usefixtures("crowd")
def test_the_state_and_the_contacts_are_those_of_the_scene_after_its_frames(device):
    settings = replace(SMALL, sizes=(60,), device=(device,), frames=30)
    rows = run_bench(settings)
    half = 1.25
    for solver in ("reference", "substep"):
        world = fc.World(((-half, -half, 0), (half, half, 2 * half)), solver=solver, device="cpu")
        world.add(fc.random_spheres(60, world.bounds))
        world.step(70)
        assert world.contact_count() > 10
        for row in rows:
            if row.solver == solver:
                assert row.state_hash == f"{world.state_hash():016x}"
                assert row.contacts_per_sphere == world.contact_count() / 60
    assert len({row.state_hash for row in rows}) == 3


def test_the_friction_case_has_friction():
    world = new_world(Case("cpu", 10, "friction", "list"))
    assert world.frictions.tolist() == pytest.approx([0.4] * 10)
    smooth, rough = (new_world(Case("cpu", 300, solver, "list")) for solver in ("substep", "friction"))
    smooth.step(100)
    rough.step(100)
    assert smooth.energy().rotational == 0
    assert rough.energy().rotational > 0


def test_the_yardstick_is_measured_first_even_where_it_is_not_asked_for():
    settings = replace(SMALL, solver=("substep",), method=("list",))
    cases = cases_of(settings, "cpu", 40)
    assert [(case.solver, case.method) for case in cases] == [("reference", "cells"), ("substep", "list")]


@pytest.fixture
def clock(monkeypatch):
    """Measurements that take known times: run(case) is noted, each repeat of a case is twice as long as the last."""
    runs = []

    def run_once(case, measured, frames, way):
        runs.append((case.solver, case.method, way))
        seconds = (8.0 if case == case.yardstick else 2.0) * 2 ** len(measured.seconds)
        measured.spent += seconds
        if way == "by stages":
            measured.stages = {"advance": 1.0}
        elif way == "at once":
            measured.seconds.append(seconds)

    monkeypatch.setattr(bench, "_run_once", run_once)
    return runs


def test_repeats_take_turns_and_the_stages_come_last(clock):
    run_bench(replace(SMALL, sizes=(40,), solver=("reference",), seconds=1e4))
    cells, fast = ("reference", "cells"), ("reference", "list")
    ways = ("at once", "at once", "one by one", "by stages")
    assert clock == [(*case, way) for way in ways for case in (cells, fast)]


def test_frames_are_also_timed_as_calls_of_their_own(monkeypatch):
    calls = []
    step = fc.World.step
    monkeypatch.setattr(fc.World, "step", lambda world, frames, dt: (calls.append(frames), step(world, frames, dt)))
    (row,) = run_bench(replace(SMALL, sizes=(40,), repeats=1, solver=("reference",), method=("cells",), frames=7))
    assert calls == [40, 7, 40, *[1] * 7, 40, 7]
    assert row.ms_one_by_one > 0


@pytest.mark.usefixtures("clock")
def test_the_figures_of_a_row():
    rows = run_bench(replace(SMALL, sizes=(40,), repeats=3, seconds=1e4))
    yardstick, fast = rows[0], rows[1]
    assert (yardstick.ms, yardstick.ms_fastest, yardstick.ms_slowest) == (16e3, 8e3, 32e3)
    assert (yardstick.times_yardstick, fast.times_yardstick) == (1.0, 4.0)
    assert fast.roof_share == pytest.approx(490 * 40 / BANDWIDTH / 4.0)
    assert rows[-1].solver == "friction"
    assert rows[-1].roof_share == pytest.approx(682 * 40 / BANDWIDTH / 4.0)


def test_no_repeat_is_begun_that_would_take_too_long(clock):
    rows = run_bench(replace(SMALL, sizes=(40,), repeats=9, seconds=20.0, solver=("reference",)))
    # As long as the mean so far, one more would end at 16, then at 36 s; of the other at 4, 9, 18.7, then 37.5 s.
    assert [row.repeats for row in rows] == [2, 4]
    assert clock.count(("reference", "cells", "by stages")) == 1
    assert run_bench(replace(SMALL, sizes=(40,), seconds=1e-9))[0].repeats == 1


def test_progress_reaches_its_end(clock):
    seen = []
    run_bench(replace(SMALL, seconds=1e-9), lambda done, total: seen.append((done, total)))
    assert seen[-1] == (12, 12)
    assert seen == sorted(seen)


@pytest.mark.usefixtures("crowd")
def test_the_stages_are_known_and_those_of_the_method():
    rows = run_bench(replace(SMALL, sizes=(90,), method=METHODS))
    for row in rows:
        assert set(row.stages) <= set(bench.STAGES)
        assert ("make_lists" in row.stages) == (row.method in ("list", "frame", "auto"))
        assert ("solve_contacts" in row.stages) == (row.solver == "reference")


# --- What must not be timed ---


@pytest.fixture
def spoiled(monkeypatch):
    """Worlds that search by lists have one sphere a hair off."""

    def spoiled_world(case):
        world = new_world(case)
        if case.method == "list":
            world.positions[0, 0] += 1e-5
        return world

    monkeypatch.setattr(bench, "new_world", spoiled_world)


@pytest.mark.usefixtures("spoiled")
def test_a_wrong_state_is_a_failure_and_nothing_is_written(capfd, tmp_path):
    assert cli.main([*SMALL_WORDS, "--output", str(tmp_path)]) == 1
    output, errors = capfd.readouterr()
    assert errors.startswith("fastcollide: 40 spheres, reference, list, cpu: found state ")
    assert "as 40 spheres, reference, cells, cpu ended" in errors
    assert output == ""
    assert list(tmp_path.iterdir()) == []


def test_a_state_that_differs_between_repeats_is_a_failure(monkeypatch):
    worlds = []

    def drifting_world(case):
        world = new_world(case)
        worlds.append(world)
        world.positions[0, 0] += 1e-4 * len(worlds)
        return world

    monkeypatch.setattr(bench, "new_world", drifting_world)
    with pytest.raises(bench.DifferentStates):
        run_bench(replace(SMALL, solver=("reference",), method=("cells",), sizes=(40,)))
    assert len(worlds) == 2


def test_a_debug_build_is_refused(capfd, monkeypatch):
    build = replace(fc.build_info(), is_debug=True)
    monkeypatch.setattr(fc, "build_info", lambda: build)
    assert cli.main(SMALL_WORDS) == 1
    output, errors = capfd.readouterr()
    assert errors.startswith("fastcollide: this is a debug build")
    assert output == ""


def test_a_case_without_memory_is_told_and_left_out(capfd, monkeypatch, tmp_path):
    def small_device(case):
        if case == case.yardstick and case.spheres == 90:
            raise fc.OutOfMemory("found 1 GB; needs 2 GB")
        return new_world(case)

    monkeypatch.setattr(bench, "new_world", small_device)
    assert cli.main([*SMALL_WORDS, "--output", str(tmp_path)]) == 0
    assert "90 spheres, reference, cells, cpu: left out: found 1 GB; needs 2 GB" in capfd.readouterr().err
    rows = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))["rows"]
    assert [row["times_yardstick"] is None for row in rows] == [False] * 12 + [True] * 11


# --- The program ---


def test_the_files_hold_what_was_measured(capfd, tmp_path):
    folder = tmp_path / "a" / "machine"
    assert cli.main([*SMALL_WORDS, "--output", str(folder), "--note", "two words"]) == 0
    output = capfd.readouterr().out
    content = json.loads((folder / "bench.json").read_text(encoding="utf-8"))
    assert content["build"]["version"] == fc.__version__
    assert content["options"]["sizes"] == [40, 90]
    with (folder / "bench.csv").open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    assert len(lines) == len(content["rows"]) == 24
    for line, row in zip(lines, content["rows"], strict=True):
        assert line["note"] == "two words"
        assert line["state_hash"] == row["state_hash"]
        assert line["state_hash"] in output
        assert float(line["ms"]) == pytest.approx(row["ms"], rel=1e-5)
        for stage in bench.STAGES:
            found = row["stages"].get(stage)
            assert line[f"{stage}_ms"] == ("" if found is None else f"{found:.6g}")
    assert sorted(path.name for path in folder.iterdir()) == ["bench.csv", "bench.json"]


def test_without_a_library_to_measure_the_copy_there_is_no_roof(capfd, monkeypatch):
    monkeypatch.setattr(bench, "copy_bandwidth", lambda device, threads: None)
    assert [row.roof_share for row in run_bench(replace(SMALL, sizes=(40,)))] == [None] * 6
    assert cli.main(SMALL_WORDS) == 0
    assert "copy: no library to measure it with" in " ".join(capfd.readouterr().out.split())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--sizes", "100,0"], "sizes: found 100,0; allowed: a whole number from 1 to 100,000,000; several"),
        (["--sizes", "1e3"], "sizes: found '1e3'; allowed: a whole number"),
        (["--solver", "substep,fast"], "solver: found substep,fast; allowed: reference, substep, friction"),
        (["--device", "gpu"], "device: found gpu; allowed: auto, cpu, cuda"),
        (["--seconds", "0"], "seconds: found 0; allowed: a number above 0"),
        (["--peers", "--solver", "substep"], "--solver: found beside --peers"),
    ],
)
def test_bad_usage(capfd, words, message):
    assert cli.main(["bench", *words]) == 2
    assert message in capfd.readouterr().err


# --- Scene and roof ---


def test_the_box_grows_above_40_000_spheres_to_the_density_of_20_000():
    assert [scene_edge(n) for n in (1, 20_000, 40_000)] == [20.0] * 3
    assert 40_001 / scene_edge(40_001) ** 3 == pytest.approx(20_000 / 20.0**3)
    assert 1e6 / scene_edge(1_000_000) ** 3 == pytest.approx(20_000 / 20.0**3)


def test_the_least_bytes_of_a_frame():
    # Read and write 32 bytes of state and read one entry of 4, five times, and a build of 150; with spin 16 more.
    assert model_bytes(5, has_spin=False) == 5 * 68 + 150
    assert model_bytes(5, has_spin=True) == 5 * 100 + 182


@pytest.mark.parametrize("threads", [1, 3])
def test_a_copy_has_a_bandwidth(threads):
    found = copy_bandwidth("cpu", threads, size=1 << 16)
    assert math.isfinite(found)
    assert found > 0


def test_a_copy_on_a_gpu(gpu):
    pytest.importorskip("cupy")
    assert copy_bandwidth(f"{gpu}:0", size=1 << 24) > 1e9
