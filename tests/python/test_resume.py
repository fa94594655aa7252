"""Runs that were stopped and go on: the files are those of a run that was never stopped."""

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest
from fastcollide import checkpoints as checkpoints_module
from fastcollide import cli, run
from fastcollide.checkpoints import checkpoint_path, checkpoint_paths
from fastcollide.frames import frame_path, frame_paths, read_frame
from fastcollide.ledger import read_ledger

ROOT = Path(__file__).parent.parent.parent
RUN = ["run", "--particles", "120", "--bounds", "-2", "-2", "0", "2", "2", "4", "--radius", "0.1", "0.2"]
RUN += ["--friction", "0.3", "--frames", "50", "--threads", "1", "--no-video"]
OFTEN = ["--export-every", "3", "--ledger-every", "4", "--checkpoint-every", "7"]

SCENE = """
[world]
bounds = [[-2, -2, 0], [2, 2, 3]]

[[spheres]]
kind = "random"
count = 80

[run]
frames = 30
device = "cpu"

[output]
folder = "moved"
make_video = false
checkpoint_every = 10

[expect]
energy_ratio = { min = 0.1, max = 0.9 }
largest_energy_gain = { max = 0.5 }
"""


class Killed(BaseException):
    """Passes all that handles errors, as no handler runs in a process that is killed."""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def kill_at(monkeypatch):
    """kill_at(frame, arguments): runs the program until this frame is done and written."""

    def run_until(frame, arguments):
        on_frame = run.simulate

        def simulate(world, settings, show=lambda done: None, *rest, **names):
            def show_or_die(done):
                if done >= frame:
                    raise Killed
                show(done)

            return on_frame(world, settings, show_or_die, *rest, **names)

        with monkeypatch.context() as patch:
            patch.setattr("fastcollide.console.simulate", simulate)
            with pytest.raises(Killed):
                cli.main([str(word) for word in arguments])

    return run_until


def state_hash(capsys):
    return next(line.split()[-1] for line in capsys.readouterr().out.splitlines() if line.startswith("state hash"))


def files_of(folder):
    """Frame files and ledger: name and bytes."""
    return {path.name: path.read_bytes() for path in [*frame_paths(folder), Path(folder) / "ledger.csv"]}


@pytest.mark.parametrize("frame", [1, 6, 7, 8, 27, 49])
def test_a_run_goes_on_as_if_never_stopped(device, kill_at, capsys, frame):
    assert cli.main([*RUN, *OFTEN, "--output", "straight"]) == 0
    expected = state_hash(capsys)
    kill_at(frame, [*RUN, *OFTEN, "--output", "killed", "--device", "cpu"])
    assert cli.main(["resume", "killed", "--device", device, "--threads", "2"]) == 0
    assert state_hash(capsys) == expected
    assert files_of("killed") == files_of("straight")
    assert [path.name for path in checkpoint_paths("killed")] == ["checkpoint_00000049.fcw", "checkpoint_00000050.fcw"]


def test_it_can_be_stopped_again_and_again(kill_at, capsys):
    assert cli.main([*RUN, *OFTEN, "--output", "straight"]) == 0
    expected = state_hash(capsys)
    kill_at(9, [*RUN, *OFTEN, "--output", "killed"])
    for frame in (30, 29, 48):
        kill_at(frame, ["resume", "killed"])
        for path in frame_paths("killed"):
            assert read_frame(path).frame <= frame  # none of the run before
            assert path.read_bytes() == Path("straight", path.name).read_bytes()
    assert cli.main(["resume", "killed"]) == 0
    assert state_hash(capsys) == expected
    assert files_of("killed") == files_of("straight")


@pytest.mark.parametrize("solver", ["substep", "reference"])
def test_without_frame_files_or_ledger(kill_at, capsys, solver):
    few = [*RUN, "--friction", "0", "--solver", solver, "--export-every", "0", "--ledger-every", "0"]
    assert cli.main([*few, "--output", "straight"]) == 0
    expected = state_hash(capsys)
    kill_at(33, [*few, "--checkpoint-every", "10", "--output", "killed"])
    assert cli.main(["resume", "killed"]) == 0
    assert state_hash(capsys) == expected
    left = {"checkpoint_00000040.fcw", "checkpoint_00000050.fcw", "run.json"}
    assert {path.name for path in Path("killed").iterdir()} == left


def test_checkpoints_change_nothing(capsys):
    hashes = set()
    for more in ([], ["--checkpoint-every", "1"], ["--checkpoint-every", "20"]):
        assert cli.main([*RUN, *more, "--output", "one"]) == 0
        hashes.add(state_hash(capsys))
    assert len(hashes) == 1


def test_ctrl_c_writes_a_checkpoint_and_says_how_to_go_on(monkeypatch, capsys):
    assert cli.main([*RUN, *OFTEN, "--output", "straight"]) == 0
    expected = state_hash(capsys)
    write = checkpoints_module.Checkpoints.write

    def press(self, world, files):
        write(self, world, files)
        if world.frame == 21:
            signal.raise_signal(signal.SIGINT)
            world.step()  # a frame that is no multiple of anything
            assert world.frame == 22

    with monkeypatch.context() as patch:
        patch.setattr(checkpoints_module.Checkpoints, "write", press)
        assert cli.main([*RUN, *OFTEN, "--output", "stopped"]) == 130
    assert "fastcollide resume stopped" in capsys.readouterr().err
    assert read_ledger("stopped")["frame"][-1] == 22
    assert checkpoint_path("stopped", 22).exists()
    assert cli.main(["resume", "stopped"]) == 0
    assert state_hash(capsys) == expected
    assert files_of("stopped") == files_of("straight")


def test_a_damaged_checkpoint_is_put_aside(kill_at, capsys):
    assert cli.main([*RUN, *OFTEN, "--output", "straight"]) == 0
    expected = state_hash(capsys)
    kill_at(30, [*RUN, *OFTEN, "--output", "killed"])
    newest = checkpoint_path("killed", 28)
    damaged = newest.read_bytes()[:-100]
    newest.write_bytes(damaged)
    assert cli.main(["resume", "killed"]) == 0
    output = capsys.readouterr().out
    assert f"damaged         {newest}: found" in output
    assert "put aside as checkpoint_00000028.fcw.damaged" in output
    assert newest.with_name("checkpoint_00000028.fcw.damaged").read_bytes() == damaged
    assert "checkpoint_00000021.fcw, after 21 of 50 frames" in output
    assert expected in output
    assert files_of("killed") == files_of("straight")


def test_with_damaged_checkpoints_only_nothing_is_touched(kill_at, capsys):
    kill_at(30, [*RUN, *OFTEN, "--output", "killed"])
    for frame in (21, 28):
        path = checkpoint_path("killed", frame)
        content = bytearray(path.read_bytes())
        content[400] ^= 1  # in the positions
        path.write_bytes(content)
    before = {path.name: path.read_bytes() for path in Path("killed").iterdir()}
    assert cli.main(["resume", "killed"]) == 1
    output = capsys.readouterr()
    assert "checkpoint_00000028.fcw: " in output.out
    assert "checkpoint_00000021.fcw: " in output.err
    assert {path.name: path.read_bytes() for path in Path("killed").iterdir()} == before


def test_folders_that_cannot_go_on(capsys):
    Path("empty").mkdir()
    assert cli.main(["resume", "empty"]) == 1
    assert "empty: found no checkpoint; allowed: the folder of a run with --checkpoint-every" in capsys.readouterr().err
    fc.World(device="cpu").save(checkpoint_path("empty", 5))
    assert cli.main(["resume", "empty"]) == 1
    assert "checkpoint_00000005.fcw: found no settings of a run" in capsys.readouterr().err
    assert cli.main(["resume", "nowhere"]) == 2


def test_what_is_missing_is_named(kill_at, capsys):
    kill_at(30, [*RUN, *OFTEN, "--output", "killed"])
    shutil.copytree("killed", "second")
    frame_path("killed", 12).unlink()
    assert cli.main(["resume", "killed"]) == 1
    assert f"{frame_path('killed', 12)}: found no such file" in capsys.readouterr().err
    ledger = Path("second", "ledger.csv")
    lines = ledger.read_text().splitlines(keepends=True)
    ledger.write_text("".join(lines[:3] + lines[4:]))
    assert cli.main(["resume", "second"]) == 1
    assert f"{ledger}: found no row of frame 8" in capsys.readouterr().err
    ledger.unlink()
    assert cli.main(["resume", "second"]) == 1
    assert "ledger.csv" in capsys.readouterr().err


def test_half_a_row_and_half_a_file_go(kill_at):
    assert cli.main([*RUN, *OFTEN, "--output", "straight"]) == 0
    kill_at(30, [*RUN, *OFTEN, "--output", "killed"])
    with Path("killed", "ledger.csv").open("a") as ledger:
        ledger.write("32,0.53")
    for name in ("frame_00000031.txt.part", "checkpoint_00000036.fcw.part", "ledger.csv.part"):
        Path("killed", name).write_bytes(b"half")
    Path("killed", "notes.part").write_text("mine")
    assert cli.main(["resume", "killed"]) == 0
    assert files_of("killed") == files_of("straight")
    assert [path.name for path in Path("killed").glob("*.part")] == ["notes.part"]


def test_a_finished_run_stays_as_it_is(capsys):
    assert cli.main([*RUN, *OFTEN, "--output", "done"]) == 0
    expected, before = state_hash(capsys), files_of("done")
    assert cli.main(["resume", "done"]) == 0
    assert state_hash(capsys) == expected
    assert files_of("done") == before
    assert cli.main(["resume", "done", "--device", "cuda:99"]) == 1
    assert "cuda:99" in capsys.readouterr().err
    assert files_of("done") == before


def test_a_new_run_ends_the_old_one(kill_at):
    kill_at(30, [*RUN, *OFTEN, "--output", "one"])
    assert checkpoint_paths("one")
    Path("one", "checkpoint_00000099.fcw").write_text("not of a run")
    assert cli.main([*RUN, "--seed", "2", "--output", "one"]) == 0
    assert [path.name for path in checkpoint_paths("one")] == ["checkpoint_00000099.fcw"]


@pytest.mark.parametrize("moment", ["flush", "write", "remove"])
def test_a_kill_while_a_checkpoint_is_written(monkeypatch, moment):
    assert cli.main([*RUN, *OFTEN, "--output", "straight"]) == 0

    def die(*arguments):
        raise Killed

    places = {
        "flush": ("fastcollide.checkpoints.flush_file", lambda path: path.name == "frame_00000027.txt"),
        "write": ("fastcollide.files.flush_file", lambda path: path.name == "checkpoint_00000028.fcw.part"),
        "remove": ("pathlib.Path.unlink", lambda path, **names: path.name == "checkpoint_00000014.fcw"),
    }
    name, is_moment = places[moment]
    original = Path.unlink if moment == "remove" else checkpoints_module.flush_file
    with monkeypatch.context() as patch:
        patch.setattr(name, lambda path, **names: die() if is_moment(path, **names) else original(path, **names))
        with pytest.raises(Killed):
            cli.main([*RUN, *OFTEN, "--output", "killed"])
    assert cli.main(["resume", "killed"]) == 0
    assert files_of("killed") == files_of("straight")


def test_what_comes_before_a_checkpoint_is_on_the_disk_first(monkeypatch):
    flushed = []
    monkeypatch.setattr(checkpoints_module, "flush_file", lambda path: flushed.append(path.name))
    monkeypatch.setattr(fc.LedgerWriter, "flush", lambda self: flushed.append("ledger.csv"))
    save = fc.World._save
    monkeypatch.setattr(
        fc.World, "_save", lambda self, path, **more: (flushed.append(path.name), save(self, path, **more))
    )
    assert cli.main([*RUN, "--frames", "8", "--export-every", "2", "--checkpoint-every", "4", "--output", "one"]) == 0
    assert flushed == [
        "ledger.csv", "checkpoint_00000000.fcw",
        "ledger.csv", "frame_00000002.txt", "frame_00000004.txt", "checkpoint_00000004.fcw",
        "ledger.csv", "frame_00000006.txt", "frame_00000008.txt", "checkpoint_00000008.fcw",
    ]  # fmt: skip


def test_the_folder_can_be_moved(kill_at, capsys, folder, monkeypatch):
    with_files = [word for word in RUN if word != "--no-video"]
    Path("here").mkdir()
    kill_at(30, [*with_files, *OFTEN, "--width", "64", "--height", "64", "--still", "here/end.png",
                 "--video", "here/run/film.mp4", "--output", "here/run"])  # fmt: skip
    shutil.move("here", "there")
    monkeypatch.chdir("there/run")
    assert cli.main(["resume", "."]) == 0
    assert (folder / "there/end.png").is_file()
    assert (folder / "there/run/film.mp4").is_file()
    assert not (folder / "here").exists()
    assert "made from the frames that were written" in capsys.readouterr().out


def test_the_video_of_a_resumed_run_shows_all_frame_files(kill_at, capsys):
    av = pytest.importorskip("av")
    with_video = [word for word in RUN if word != "--no-video"]
    kill_at(30, [*with_video, *OFTEN, "--width", "64", "--height", "64", "--output", "killed"])
    assert not Path("video.mp4").exists()
    assert cli.main(["resume", "killed"]) == 0
    with av.open("video.mp4") as video:
        assert sum(1 for _ in video.decode(video=0)) == len(frame_paths("killed"))
        assert float(video.streams.video[0].average_rate) == pytest.approx(60 / 3)
    assert "pictures        16" in capsys.readouterr().out


def test_without_frame_files_there_is_no_video_of_a_resumed_run(kill_at, capsys):
    with_video = [word for word in RUN if word != "--no-video"]
    kill_at(30, [*with_video, *OFTEN, "--export-every", "0", "--width", "64", "--height", "64", "--output", "killed"])
    assert cli.main(["resume", "killed"]) == 0
    assert "video           none: there are no frame files" in capsys.readouterr().out
    assert not Path("video.mp4").exists()


@pytest.mark.parametrize(("limit", "code"), [(0.9, 0), (0.2, 1)])
def test_a_scene_goes_on_without_its_file(kill_at, capsys, limit, code):
    scene = Path("scene.toml")
    scene.write_text(SCENE.replace("max = 0.9", f"max = {limit}"))
    assert cli.main(["run", str(scene), "--output", "straight"]) == code
    expected = [line for line in capsys.readouterr().out.splitlines() if line.startswith(("expected", "state"))]
    kill_at(25, ["run", scene])
    scene.unlink()
    assert cli.main(["resume", "moved"]) == code
    found = [line for line in capsys.readouterr().out.splitlines() if line.startswith(("expected", "state"))]
    assert found == expected
    assert len(found) == 3
    assert files_of("moved") == files_of("straight")


def test_the_speed_of_a_resumed_run_counts_its_own_frames(kill_at, monkeypatch):
    kill_at(30, [*RUN, *OFTEN, "--output", "killed"])
    summaries = []
    simulate = run.simulate
    monkeypatch.setattr(
        "fastcollide.console.simulate", lambda *a, **names: summaries.append(simulate(*a, **names)) or summaries[-1]
    )
    assert cli.main(["resume", "killed"]) == 0
    (summary,) = summaries
    assert (summary.first_frame, summary.frames, summary.frame_files, summary.ledger_rows) == (28, 50, 16, 14)
    assert summary.frames_per_second == pytest.approx(22 / summary.step_seconds)


def test_frames_of_a_killed_run_are_whole(kill_at):
    kill_at(30, [*RUN, *OFTEN, "--output", "killed"])
    assert [read_frame(path).frame for path in frame_paths("killed")] == list(range(3, 31, 3))


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
@pytest.mark.parametrize("solver", ["substep", "reference"])
def test_killed_at_random_moments(solver):
    done = subprocess.run(
        [sys.executable, ROOT / "tools" / "kill_and_resume.py", "--kills", "4", "--particles", "400", "--frames", "400",
         "--solver", solver],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.startswith("4 kills")


# --- Trajectories ---


TRAJECTORIES = {"gsd": "gsd.fl", "vtkhdf": "h5py"}


@pytest.fixture(params=TRAJECTORIES)
def trajectory(request):
    """The name of a file of each format."""
    pytest.importorskip(TRAJECTORIES[request.param])
    return f"run.{request.param}"


def frames_in(path):
    with fc.open(path) as run:
        return [(f.frame, f.time, f.positions.tobytes(), f.velocities.tobytes(), f.spins.tobytes()) for f in run]


@pytest.mark.parametrize("frame", [1, 8, 30, 49])
def test_a_trajectory_goes_on(trajectory, kill_at, frame):
    assert cli.main([*RUN, *OFTEN, "--output", "straight", "--trajectory", f"straight/{trajectory}"]) == 0
    kill_at(frame, [*RUN, *OFTEN, "--output", "killed", "--trajectory", f"killed/{trajectory}"])
    expected, part = frames_in(f"straight/{trajectory}"), Path("killed", trajectory)
    assert [found[0] for found in expected] == list(range(3, 51, 3))
    if frame >= 3:
        assert frames_in(part) == expected[: frame // 3]
    if frame == 30:
        kill_at(29, ["resume", "killed"])
        assert frames_in(part) == expected[:9]  # none of the run before
    shutil.move("killed", "moved")
    assert cli.main(["resume", "moved"]) == 0
    assert frames_in(f"moved/{trajectory}") == expected
    assert not [*Path("moved").glob("*.part")]


def test_a_frame_that_a_kill_has_cut_is_not_there(trajectory, kill_at, monkeypatch, folder):
    """The moments inside the writing of a frame that a kill in a test never meets."""
    assert cli.main([*RUN, *OFTEN, "--output", "straight", "--trajectory", f"straight/{trajectory}"]) == 0
    expected = frames_in(f"straight/{trajectory}")
    if trajectory.endswith("vtkhdf"):  # a kill leaves no time to end the file
        monkeypatch.setattr("fastcollide.vtkhdf_file.Writer.close", lambda self: self._file.close())
    kill_at(30, [*RUN, *OFTEN, "--output", "killed", "--trajectory", f"killed/{trajectory}"])
    monkeypatch.undo()
    monkeypatch.chdir(folder)
    path = Path("killed", trajectory)
    if trajectory.endswith("gsd"):
        import gsd.fl

        with gsd.fl.open(path, "r+") as file:
            file.write_chunk("configuration/step", file.read_chunk(0, "configuration/step"))
            file.end_frame()
            file.flush()
            assert file.nframes == 11
    else:
        import h5py

        with h5py.File(path, "r+") as file:
            assert file["VTKHDF/Steps"].attrs["NSteps"] == 16
            file["VTKHDF/Points"][1200:1260] = 7
    path.with_name(path.name + ".part").write_bytes(b"half")
    assert frames_in(path) == expected[:10]
    assert cli.main(["resume", "killed"]) == 0
    assert frames_in(path) == expected
    assert not [*Path("killed").glob("*.part")]


def test_vtkhdf_steps_that_were_not_reached_have_no_points(kill_at, monkeypatch, folder):
    h5py = pytest.importorskip("h5py")
    run = [*RUN, *OFTEN, "--trajectory", "run.vtkhdf"]
    close = "fastcollide.vtkhdf_file.Writer.close"

    def steps():
        with h5py.File("run.vtkhdf") as file:
            root = file["VTKHDF"]
            times, counts = root["Steps/Values"][:], root["NumberOfPoints"][:]
            assert len(times) == root["Steps"].attrs["NSteps"]
            assert times == pytest.approx(np.arange(3, 3 * len(times) + 1, 3) / 60)
            for kind in ("NumberOfCells", "NumberOfConnectivityIds"):
                assert (root[f"Vertices/{kind}"][:] == counts).all()
                assert not root[f"Lines/{kind}"][:].any()
            return counts[: len(times)].tolist()

    kill_at(30, run)  # an error, which leaves time to end the file
    assert steps() == [120] * 10
    with monkeypatch.context() as patch:
        patch.setattr(close, lambda self: self._file.close())
        kill_at(30, run)
        assert steps() == [120] * 10 + [0] * 6
        kill_at(29, ["resume", "output"])
        assert steps() == [120] * 9 + [0] * 7
    assert cli.main(["resume", "output"]) == 0
    assert steps() == [120] * 16


def test_a_trajectory_that_lacks_frames_is_named_and_nothing_touched(trajectory, kill_at, capsys):
    kill_at(30, [*RUN, *OFTEN, "--output", "killed", "--trajectory", f"killed/{trajectory}"])
    kill_at(6, [*RUN, *OFTEN, "--output", "short", "--trajectory", f"short/{trajectory}"])
    shutil.copy(f"short/{trajectory}", f"killed/{trajectory}")
    before = {path.name: path.read_bytes() for path in Path("killed").iterdir()}
    assert cli.main(["resume", "killed"]) == 1
    assert f"{trajectory}: found 2 frames; a run that goes on needs all 9 before it" in capsys.readouterr().err
    Path("killed", trajectory).unlink()
    del before[trajectory]
    assert cli.main(["resume", "killed"]) == 1
    assert f"{trajectory}: No such file or directory" in capsys.readouterr().err
    assert {path.name: path.read_bytes() for path in Path("killed").iterdir()} == before


def test_a_trajectory_alone_goes_on(trajectory, kill_at):
    alone = [*RUN, *OFTEN, "--no-frame-files"]
    assert cli.main([*alone, "--output", "straight", "--trajectory", f"straight/{trajectory}"]) == 0
    kill_at(30, [*alone, "--output", "killed", "--trajectory", f"killed/{trajectory}"])
    assert cli.main(["resume", "killed"]) == 0
    assert frames_in(f"killed/{trajectory}") == frames_in(f"straight/{trajectory}")


def test_a_resumed_run_writes_its_parquet(kill_at):
    parquet = pytest.importorskip("pyarrow.parquet")
    kill_at(30, [*RUN, *OFTEN, "--output", "killed", "--parquet"])
    assert not Path("killed/ledger.parquet").exists()
    assert cli.main(["resume", "killed"]) == 0
    assert parquet.read_table("killed/ledger.parquet")["frame"].to_pylist() == read_ledger("killed")["frame"].tolist()
