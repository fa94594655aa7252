"""The program: its commands, exit codes, messages and files."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from importlib.util import find_spec

import click
import fastcollide as fc
import numpy as np
import pytest
from fastcollide import cli, report_table
from fastcollide.frames import frame_paths, read_frame
from fastcollide.parameters import Switch
from fastcollide.run import create_world, simulate
from fastcollide.settings import PARAMETERS, RunSettings

pytestmark = pytest.mark.usefixtures("folder")

SMALL = ["--particles", "30", "--frames", "12", "--width", "160", "--height", "90", "--threads", "1"]
NO_FILES = ["--no-video", "--export-every", "0", "--ledger-every", "0"]
# Crowded, so that contacts, walls and floor all have their say in the last state.
CROWDED = [*NO_FILES, "--particles", "200", "--frames", "40", "--bounds", "-2", "-2", "0", "2", "2", "3"]

needs_video = pytest.mark.skipif(find_spec("av") is None, reason="PyAV, the video encoder, is not installed")


def summary_of(output):
    """The lines of a summary, by their labels."""
    return {line[:16].strip(): line[16:] for line in output.splitlines()}


def decode(path):
    av = pytest.importorskip("av")
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        return pictures, float(stream.average_rate)


def options_after(text, *names):
    """The options that a line of the summary advises."""
    return {name: next(iter(text.split(f"{name} ")[1].split())) for name in names}


@needs_video
def test_positional_run_writes_frames_and_a_video_in_real_time(program, folder):
    code, output, errors = program(*["30", "12", "60", "2", "-9.8", "0.999", "0.6", "output", "video.mp4", "1"])

    assert (code, errors) == (0, "")
    assert [path.name for path in frame_paths("output")] == [f"frame_{k:08d}.txt" for k in range(2, 13, 2)]
    assert sorted(path.name for path in folder.iterdir()) == ["output", "video.mp4"]
    pictures, rate = decode("video.mp4")
    assert len(pictures) / rate == pytest.approx(12 / 60)
    assert len(pictures) == 6
    assert pictures[0].shape == (720, 1280, 3)
    assert not np.array_equal(pictures[0], pictures[-1])
    assert str(folder / "video.mp4") in output
    assert str(folder / "output") in output


def test_the_report_s_600_frames_give_300_files_with_every_sphere_in_the_box(program, folder):
    code, _, _ = program(*["100", "600", "60", "2", "-9.8", "0.999", "0.6", "output", "video.mp4", "0"])

    assert code == 0
    frames = [read_frame(path) for path in frame_paths("output")]
    assert [frame.frame for frame in frames] == list(range(2, 601, 2))
    assert [frame.time for frame in frames] == pytest.approx([k / 60 for k in range(2, 601, 2)])
    lower, upper = np.float32(RunSettings().corners)
    for frame in frames:
        assert (frame.positions - frame.radii[:, None] >= lower - 1e-5).all()
        assert (frame.positions + frame.radii[:, None] <= upper + 1e-5).all()
    assert not (folder / "video.mp4").exists()


def test_the_last_frame_file_is_the_state_of_the_world(program):
    program("run", *SMALL, "--no-video")

    world = create_world(replace(RunSettings(), particles=30))
    world.step(12, dt=1 / 60)
    frame = read_frame(frame_paths("output")[-1])
    assert frame.positions.tobytes() == fc.to_numpy(world.positions).tobytes()
    assert frame.radii.tobytes() == fc.to_numpy(world.radii).tobytes()


def test_fps_is_the_length_of_a_frame(program):
    program("run", *SMALL, "--no-video", "--fps", "30")

    assert read_frame(frame_paths("output")[-1]).time == pytest.approx(12 / 30)


def test_friction_and_boundary_reach_the_world():
    plain = create_world(replace(RunSettings(), particles=50))
    changed = create_world(replace(RunSettings(), particles=50, friction=0.25, boundary="periodic"))
    assert fc.to_numpy(changed.frictions).tolist() == [0.25] * 50
    assert fc.to_numpy(plain.frictions).tolist() == [0.0] * 50
    for world in (plain, changed):
        world.step(60)
    lowest = [fc.to_numpy(world.positions).min(axis=0) for world in (plain, changed)]
    assert (lowest[0][:2] > -9.96).all()  # a wall holds even the smallest sphere back by most of its radius
    assert (lowest[1][:2] < -9.96).any()  # a periodic end does not


@pytest.mark.parametrize(
    ("words", "boundary"),
    [(["periodic"], "periodic"), (["open", "wall", "periodic"], ("open", "wall", "periodic"))],
    ids=["for all", "for each axis"],
)
@pytest.mark.parametrize("place", ["first", "last"])
def test_a_boundary_for_all_axes_or_for_each(program, words, boundary, place):
    options = [*CROWDED, "--speed", "30", "30", "30"]
    axes = ["--boundary", *words]
    code, output, _ = program("run", *(axes + options if place == "first" else options + axes))
    bounds = (-2, -2, 0, 2, 2, 3)
    world = create_world(
        replace(RunSettings(), particles=200, bounds=bounds, speed=(30, 30, 30), boundary=boundary, threads=1)
    )
    world.step(40)
    assert code == 0
    assert summary_of(output)["state hash"] == f"{world.state_hash():016x}"
    is_out = [
        np.abs(fc.to_numpy(world.positions)[:, axis] - middle).max() > 2 for axis, middle in enumerate((0, 0, 1.5))
    ]
    assert is_out == [name == "open" for name in ([boundary] * 3 if isinstance(boundary, str) else boundary)]


def test_rolling_friction_reaches_the_world():
    hashes = set()
    for rolling_friction in (0.0, 0.1, 0.2):
        world = create_world(
            replace(RunSettings(), particles=50, friction=0.25, wall_friction=0.25, rolling_friction=rolling_friction)
        )
        world.step(60)
        hashes.add(world.state_hash())
    assert len(hashes) == 3


def test_the_summary_tells_the_state(program):
    code, output, _ = program("run", *SMALL, *NO_FILES)

    world = create_world(replace(RunSettings(), particles=30, threads=1))
    world.step(12, dt=1 / 60)
    summary = summary_of(output)
    assert code == 0
    assert summary["state hash"] == f"{world.state_hash():016x}"
    assert summary["contacts"] == str(world.contact_count())
    assert summary["energy"].startswith(f"{world.energy().total:.6g} J")
    assert summary["largest overlap"] == f"{world.max_overlap():.6g} m"
    assert summary["mean overlap"] == f"{100 * world.mean_overlap():.4g} % of the smaller radius"
    assert summary["speed"].endswith(" FPS")
    assert summary["time"].endswith(" s")
    assert summary["device"] == f"{world.device} ({world.device_name})"
    assert "fast spheres" not in summary


def test_fast_spheres_are_told_with_what_would_be_safe(program):
    """The options that the summary names make the line go away, one less does not."""
    fast = ["run", *NO_FILES, "--particles", "1", "--radius", "0.1", "0.1", "--boundary", "open", "--speed", 0, 0, 300]
    fast += ["--gravity", 0, "--drag", 0]
    told = {}
    for solver in ("substep", "reference"):
        arguments = [*fast, "--frames", "6", "--fps", "60", "--solver", solver]
        told[solver] = summary_of(program(*arguments)[1])["fast spheres"]
        names = ("--iterations", "--fps") if solver == "substep" else ("--fps",)
        for name, value in options_after(told[solver], *names).items():
            for number, is_safe in ((int(value), True), (int(value) - 1, False)):
                found = summary_of(program(*arguments, name, number)[1])
                assert ("fast spheres" not in found) == is_safe, (solver, name, number)

    assert told["substep"].startswith("30 times one moved more than its radius in a substep")
    assert told["reference"].startswith("6 times one moved more than its radius in a frame")
    assert "--iterations" not in told["reference"]
    too_fast = summary_of(program(*fast, "--frames", "2", "--fps", 10, "--speed", 0, 0, 10_000)[1])["fast spheres"]
    assert "--iterations" not in too_fast  # as more than the program takes would be needed


@pytest.mark.parametrize(
    "change",
    [
        ["--particles", "199"],
        ["--frames", "41"],
        ["--fps", "61"],
        ["--gravity", "-9.7"],
        ["--damping", "0.998"],
        ["--drag", "0.1"],
        ["--floor-restitution", "0.5"],
        ["--wall-friction", "0.3"],
        ["--bounds", "-2", "-2", "0", "2", "2", "3.1"],
        ["--seed", "2"],
        ["--radius", "0.05", "0.39"],
        ["--speed", "8", "8", "7"],
        ["--restitution", "0.3", "0.9"],
        ["--density", "999"],
        ["--iterations", "4"],
        ["--solver", "reference"],
    ],
    ids=lambda change: change[0],
)
def test_options_of_the_scene_change_the_state(program, change):
    _, usual, _ = program("run", *CROWDED)
    code, changed, errors = program("run", *CROWDED, *change)

    assert (code, errors) == (0, "")
    assert summary_of(changed)["state hash"] != summary_of(usual)["state hash"]


@pytest.mark.parametrize(
    "change", [["--threads", "3"], ["--cell-size", "1.1"], ["--device", "cpu"]], ids=lambda change: change[0]
)
def test_options_of_the_machine_do_not(program, change):
    _, usual, _ = program("run", *CROWDED, "--threads", "1", "--device", "cpu")
    code, changed, _ = program("run", *CROWDED, "--threads", "1", "--device", "cpu", *change)

    assert code == 0
    assert summary_of(changed)["state hash"] == summary_of(usual)["state hash"]


def test_damping_and_its_drag_are_the_same(program):
    _, damped, _ = program("run", *CROWDED, "--damping", "0.99")
    _, dragged, _ = program("run", *CROWDED, "--drag", repr(fc.drag_from_damping(0.99, 60)))

    assert summary_of(dragged)["state hash"] == summary_of(damped)["state hash"]


def test_every_parameter_has_an_option_with_range_and_default():
    # A line so wide that nothing is wrapped.
    context = click.Context(cli.run, info_name="run", terminal_width=1000, max_content_width=1000)
    text = cli.run.get_help(context)

    for parameter in PARAMETERS.values():
        assert parameter.option in text
        if not isinstance(parameter.kind, Switch):
            assert f"[{parameter.allowed}; default: {parameter.default_text}]" in text


BAD_OPTIONS = [
    ("particles", ["0"]),
    ("particles", ["100000001"]),
    ("particles", ["many"]),
    ("frames", ["0"]),
    ("fps", ["10001"]),
    ("export_every", ["-1"]),
    ("ledger_every", ["-1"]),
    ("checkpoint_every", ["-1"]),
    ("gravity", ["nan"]),
    ("damping", ["1.5"]),
    ("drag", ["-1"]),
    ("floor_restitution", ["1.01"]),
    ("wall_friction", ["-0.1"]),
    ("rolling_friction", ["-0.1"]),
    ("friction", ["-0.1"]),
    ("boundary", ["closed"]),
    ("boundary", ["wall", "closed", "wall"]),
    ("boundary", ["wall", "open"]),
    ("bounds", ["0", "0", "0", "1", "1", "0"]),
    ("bounds", ["0", "0", "0", "1", "1", "inf"]),
    ("seed", ["-1"]),
    ("radius", ["0", "1"]),
    ("radius", ["0.4", "0.1"]),
    ("radius", ["0.1", "10.5"]),
    ("speed", ["1", "1", "fast"]),
    ("restitution", ["0.5", "1.5"]),
    ("density", ["0"]),
    ("solver", ["magic"]),
    ("iterations", ["0"]),
    ("cell_size", ["0.6"]),
    ("output", [""]),
    ("device", ["gpu"]),
    ("threads", ["0"]),
    ("video", ["video.avi"]),
    ("still", ["frame.jpg"]),
    ("video_fps", ["61"]),
    ("width", ["1281"]),
    ("height", ["0"]),
    ("supersampling", ["5"]),
    ("color_by", ["taste"]),
    ("color_range", ["1", "1"]),
    ("color_map", ["jet"]),
    ("camera", ["side"]),
    ("orbit_period", ["0"]),
    ("camera_position", ["1", "2", "far"]),
    ("camera_target", ["1", "2", "3"]),
    ("trajectory", ["run.xyz"]),
    ("quality", ["101"]),
]


def test_each_parameter_is_among_the_wrong_ones():
    assert {name for name, _ in BAD_OPTIONS} == set(PARAMETERS) - {
        "make_video",
        "make_frame_files",
        "parquet",
        "report",
    }


@pytest.mark.parametrize(
    ("name", "words"), BAD_OPTIONS, ids=lambda value: value if isinstance(value, str) else " ".join(value)
)
def test_a_wrong_option_gives_one_line_and_no_file(program, folder, name, words):
    code, output, errors = program("run", PARAMETERS[name].option, *words)

    assert (code, output) == (2, "")
    assert errors.count("\n") == 1
    assert errors.startswith(f"fastcollide: {name.replace('_', '-')}: found ")
    assert "; allowed: " in errors
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["2000", "600", "60", "2", "-9.8", "1.5"], "damping: found 1.5; allowed: a number above 0 up to 1"),
        (["1"] * 11, "found 11 values"),
        (["fly"], "No such command 'fly'"),
        (["--fly"], "No such option"),
        (["run", "--fly"], "No such option"),
        (["run", "--radius", "1"], "requires 2 arguments"),
        (["run", "more"], "more"),
        (["run", "--drag", "1", "--damping", "0.5"], "drag: found 1 together with damping 0.5"),
        (["render"], "Missing argument 'RUNS...'"),
        (["render", "nowhere"], "nowhere"),
        (["--test", "--threads", "x"], "threads: found 'x'"),
    ],
    ids=" ".join,
)
def test_bad_usage_gives_one_line_and_no_file(program, folder, arguments, message):
    code, output, errors = program(*arguments)

    assert (code, output) == (2, "")
    assert errors.count("\n") == 1
    assert message in errors
    assert list(folder.iterdir()) == []


def test_a_file_in_the_place_of_a_folder_and_the_reverse(program, folder):
    (folder / "file").write_text("mine")
    (folder / "folder.mp4").mkdir()

    assert program("run", *SMALL, "--output", "file")[0] == 2
    assert program("run", *SMALL, "--video", "folder.mp4")[0] == 2
    assert (folder / "file").read_text() == "mine"
    assert sorted(path.name for path in folder.iterdir()) == ["file", "folder.mp4"]


def test_a_folder_that_cannot_be_made_is_a_failure(program, folder):
    (folder / "file").write_text("mine")

    code, _, errors = program("run", *SMALL, "--no-video", "--output", "file/output")

    assert code == 1
    assert errors.count("\n") == 1
    assert "file/output: Not a directory" in errors


@needs_video
def test_a_full_disk_is_a_failure_that_leaves_whole_files(program, folder, monkeypatch):
    replace_file = os.replace

    def fill_up(source, target):
        if "frame_00000006" in str(target):
            raise OSError(28, "No space left on device", str(target))
        replace_file(source, target)

    monkeypatch.setattr(os, "replace", fill_up)
    code, _, errors = program("run", *SMALL)

    assert code == 1
    assert errors.count("\n") == 1
    assert "frame_00000006.txt: No space left on device" in errors
    assert sorted(path.name for path in folder.rglob("*")) == [
        "frame_00000002.txt",
        "frame_00000004.txt",
        "ledger.csv",
        "output",
        "run.json",
    ]


def test_a_device_that_is_not_there_is_a_failure_without_files(program, folder):
    code, output, errors = program("run", *SMALL, "--device", "cuda:999")

    assert (code, output) == (1, "")
    assert errors.count("\n") == 1
    assert "cuda:999" in errors
    assert list(folder.iterdir()) == []


def test_a_shorter_run_replaces_all_frames_of_a_longer_one(program, folder):
    program("run", *SMALL, "--no-video")
    (folder / "output" / "notes.txt").write_text("mine")

    _, output, _ = program("run", *SMALL, "--no-video", "--frames", "4")

    assert [path.name for path in frame_paths("output")] == ["frame_00000002.txt", "frame_00000004.txt"]
    assert (folder / "output" / "notes.txt").read_text() == "mine"
    assert "replaced 6 of an earlier run" in output


@pytest.mark.parametrize(
    ("frames", "fps", "video_fps", "count"),
    [(600, 60, None, 300), (600, 60, 60, 600), (100, 100, None, 30), (100, 24, None, 100), (7, 60, 24, 2)],
)
def test_pictures_are_spread_evenly_over_the_run(frames, fps, video_fps, count):
    settings = RunSettings(frames=frames, fps=fps, video_fps=video_fps)
    due = [frame for frame in range(1, frames + 1) if settings.is_picture_due(frame)]

    assert len(due) == count
    for number, frame in enumerate(due, start=1):
        assert 0 <= frame / fps - number / settings.pictures_per_second < 1 / fps


@needs_video
def test_one_frame_still_makes_a_video_and_a_still(program, folder):
    code, _, _ = program("run", *SMALL, "--frames", "1", "--still", "pictures/last.png", "--video", "films/one.mp4")

    assert code == 0
    assert len(decode("films/one.mp4")[0]) == 1
    assert (folder / "pictures" / "last.png").read_bytes().startswith(b"\x89PNG")


def test_pictures_are_as_asked(program):
    program("run", *SMALL, "--fps", "30", "--video-fps", "15")
    by_speed, rate = decode("video.mp4")
    assert rate == 15
    assert by_speed[0].shape == (90, 160, 3)

    for change in (
        ["--color-by", "radius"],
        ["--color-by", "id"],
        ["--camera", "top"],
        ["--color-map", "tide"],
        ["--color-range", "0", "1"],
        ["--supersampling", "1"],
    ):
        program("run", *SMALL, "--fps", "30", "--video-fps", "15", *change)
        assert not np.array_equal(decode("video.mp4")[0][-1], by_speed[-1]), change


@needs_video
def test_render_makes_the_video_of_a_folder(program, folder):
    program("run", *SMALL, "--no-video")
    code, output, errors = program("render", "output", "--video", "film.mp4", "--still", "last.png", *SMALL[4:])

    assert (code, errors) == (0, "")
    pictures, rate = decode("film.mp4")
    assert (len(pictures), rate) == (6, 30)
    assert (folder / "last.png").is_file()
    assert str(folder / "film.mp4") in output


def test_render_of_no_frames_is_a_failure(program, folder):
    (folder / "empty").mkdir()
    code, _, errors = program("render", "empty")

    assert code == 1
    assert errors.count("\n") == 1
    assert "empty" in errors
    assert not (folder / "video.mp4").exists()


@needs_video
def test_ctrl_c_ends_with_whole_files_and_a_video_of_what_was_done(folder):
    settings = RunSettings(particles=30, frames=10_000, width=160, height=90, threads=1)

    def press(frame):
        if frame == 8:
            signal.raise_signal(signal.SIGINT)

    summary = simulate(create_world(settings), settings, on_frame=press)

    assert summary.stopped_early
    assert summary.frames == 8
    assert [read_frame(path).frame for path in frame_paths("output")] == [2, 4, 6, 8]
    assert len(decode("video.mp4")[0]) == 4
    assert not list(folder.rglob("*.part"))
    with pytest.raises(KeyboardInterrupt):  # handled as before the run
        signal.raise_signal(signal.SIGINT)


@pytest.mark.skipif(sys.platform == "win32", reason="a child process cannot be sent Ctrl-C alone")
def test_the_program_says_that_ctrl_c_ended_it(folder):
    command = [
        sys.executable,
        "-m",
        "fastcollide.cli",
        "run",
        "--particles",
        "30",
        "--frames",
        "10000000",
        "--no-video",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        deadline = time.monotonic() + 30
        while not (folder / "output" / "frame_00000002.txt").exists():
            assert time.monotonic() < deadline
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=30)
    finally:
        process.kill()

    assert process.returncode == 130
    assert errors.startswith("fastcollide: stopped by Ctrl-C after ")
    assert errors.count("\n") == 1
    assert "state hash" in output
    assert len(read_frame(frame_paths("output")[-1]).radii) == 30
    assert not list(folder.rglob("*.part"))


def test_without_arguments_and_terminal_there_is_help():
    result = subprocess.run(
        [sys.executable, "-m", "fastcollide.cli"], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )

    assert result.returncode == 2
    assert "2000 600 60 2 -9.8 0.999 0.6 output video.mp4 1" in result.stdout
    assert result.stderr == ""


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], ["run", "--help"], ["render", "-h"], ["--version"]])
def test_help_is_no_error(program, arguments):
    code, output, errors = program(*arguments)

    assert (code, errors) == (0, "")
    assert "fastcollide" in output


def test_info_names_version_and_devices(program):
    code, output, _ = program("info")

    assert code == 0
    assert fc.__version__ in output
    for device in fc.devices():
        assert device.name in output
        assert device.description in output


@pytest.fixture
def quick_table(monkeypatch):
    monkeypatch.setattr(report_table, "SPHERE_COUNTS", (50, 80))
    monkeypatch.setattr(report_table, "FRAMES", 3)


@pytest.mark.usefixtures("quick_table")
def test_the_table_has_a_row_for_each_count(program):
    code, output, errors = program("--test", "--device", "cpu", "--threads", "1")

    assert (code, errors) == (0, "")
    for heading in ("N", "total ms", "FPS", "grid ms", "collision ms"):
        assert heading in output
    rows = [line for line in output.splitlines() if line.startswith("│")]
    assert [row.split()[1] for row in rows] == ["50", "80"]
    assert "1 thread" in output


@pytest.mark.usefixtures("quick_table")
def test_the_table_as_json_compares_devices(program):
    code, output, errors = program("--test", "--json")

    assert (code, errors) == (0, "")
    rows = json.loads(output)["rows"]
    assert {(row["device_name"], row["spheres"]) for row in rows} >= {(rows[0]["device_name"], 50)}
    assert len(rows) == 2 * (1 + len(fc.devices()))
    for row in rows:
        assert row["frames"] == 3
        assert row["frames_per_second"] == pytest.approx(3000 / row["total_ms"])
        assert row["grid_ms"] > 0
        assert row["collision_ms"] > 0
    assert len({row["state_hash"] for row in rows if row["spheres"] == 50}) == 1


@pytest.mark.usefixtures("quick_table")
def test_different_states_on_two_devices_are_a_failure(program, monkeypatch):
    measure = report_table.measure

    def disagree(spheres, device, threads):
        row = measure(spheres, device, threads)
        return replace(row, state_hash="0" * 16) if threads == 1 and spheres == 80 else row

    monkeypatch.setattr(report_table, "measure", disagree)
    code, _, errors = program("--test")

    assert code == 1
    assert errors.count("\n") == 1
    assert "80 spheres: found different states" in errors
