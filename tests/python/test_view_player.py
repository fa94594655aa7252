"""The thread that plays: what each order does, exactly."""

import threading
import time

import fastcollide as fc
import numpy as np
import pytest
from fastcollide.frames import frame_path, write_frame
from fastcollide.ledger import LedgerWriter
from fastcollide.scene import load_scene
from fastcollide.view.finished import FinishedRun
from fastcollide.view.live import LiveRun
from fastcollide.view.messages import Conditions
from fastcollide.view.moments import Box
from fastcollide.view.player import MOST_ORDERS, Player
from serve_view import live_run

PATIENCE = 60  # seconds until a test gives up


@pytest.fixture
def started():
    """started(run): a player of it that somebody watches, standing still."""
    players = []

    def start(run, *, is_playing=False):
        player = Player(run, is_playing=is_playing)
        player.watchers = 1
        player.start()
        players.append(player)
        return player

    yield start
    for player in players:
        player.stop()


def done(player, action):
    """Has the player do this, and waits until it has; returns its complaint, if any."""
    complaints = []
    finished = threading.Event()
    player.order(action, complaints.append)
    player.order(finished.set)
    assert finished.wait(PATIENCE)
    return complaints[0] if complaints else None


def wait_until(condition):
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "it does not come"
        time.sleep(0.01)


def test_it_plays_and_stands(started):
    player = started(live_run(), is_playing=True)
    wait_until(lambda: player.shown.moment.frame >= 5)
    done(player, player.pause)
    frame = player.run.world.frame
    time.sleep(0.3)

    assert player.run.world.frame == frame
    done(player, player.play)
    wait_until(lambda: player.shown.moment.frame > frame)


def test_it_waits_while_nobody_watches(started):
    player = started(live_run(), is_playing=True)
    done(player, lambda: setattr(player, "watchers", 0))
    frame = player.run.world.frame
    time.sleep(0.3)

    assert player.run.world.frame == frame
    player.watchers = 1
    done(player, player.wake)
    wait_until(lambda: player.run.world.frame > frame)


def test_a_step_is_one_frame_and_that_of_the_world(started):
    player, world = started(live_run()), live_run().world
    for frame in (1, 2, 3):
        done(player, player.step)
        world.step(1, dt=1 / 60)
        assert (player.shown.moment.frame, player.shown.index, player.shown.moments) == (frame, frame, frame + 1)
        assert player.status.state_hash == f"{world.state_hash():016x}"


def test_reset_gives_the_state_and_the_conditions_of_the_start(started):
    player = started(live_run())
    start = player.run.world.state_hash(), player.status.conditions
    done(player, lambda: player.change(Conditions(type="change", gravity=(0, 0, 3.0), restitution=0.1, friction=0.4)))
    for _ in range(10):
        done(player, player.step)
    assert player.run.world.state_hash() != start[0]
    done(player, player.reset)

    assert (player.run.world.state_hash(), player.status.conditions) == start
    assert (player.shown.moment.frame, player.shown.moments, player.status.start) == (0, 1, 1)
    assert len(player.run.energies) == 1


def test_the_past_can_be_looked_at_and_is_left_as_it_was(started):
    player = started(live_run())
    seen = []
    for _ in range(6):
        done(player, player.step)
        seen.append(player.shown.moment)
    done(player, lambda: player.seek(2))
    assert (player.shown.moment.frame, player.shown.index) == (2, 2)
    assert player.status.state_hash is None
    done(player, player.back)
    assert player.shown.moment.frame == 1
    done(player, lambda: player.seek(1000))
    assert player.shown.moment is seen[-1]
    done(player, player.step)
    assert player.shown.moment.frame == 7

    reference = live_run().world
    reference.step(7, dt=1 / 60)
    assert player.run.world.state_hash() == reference.state_hash()


def test_conditions_act_at_once(started):
    player = started(live_run(drag=0.0, bounds=((-4, -4, 0), (4, 4, 8))))
    for _ in range(5):
        done(player, player.step)
    done(player, lambda: player.seek(1))
    done(player, lambda: player.change(Conditions(type="change", gravity=(0, 0, 50.0))))
    assert player.shown.moment.frame == 5  # they are those of the present
    before = player.shown.moment.velocities[:, 2].mean()
    done(player, player.step)

    # Nearly all are in flight; a push of 50 m/s² for 1/60 s is seen in their mean velocity.
    assert player.shown.moment.velocities[:, 2].mean() - before == pytest.approx(50 / 60, rel=0.2)
    assert player.status.conditions["gravity"] == (0, 0, 50)


def test_a_refused_condition_is_told_and_changes_nothing(started):
    player = started(live_run(solver="reference"))
    before = player.status.conditions
    complaint = done(player, lambda: player.change(Conditions(type="change", friction=0.5)))

    assert "the reference solver has no friction of spheres" in complaint
    assert player.run.conditions == before


def test_what_ends_the_simulation_is_told(started):
    def create():
        world = fc.World(device="cpu", boundary="open", drag=0.0)
        world.add(position=(0, 0, 0), radius=1e-3, velocity=(1e4, 0, 0))
        return world

    player = started(LiveRun(create, "Escape", fps=1), is_playing=True)
    done(player, lambda: player.set_speed(100))
    wait_until(lambda: player.status.fault)
    assert not player.status.is_playing
    assert "[0]" in player.status.fault or "sphere 0" in player.status.fault
    assert done(player, player.reset) is None
    assert player.status.fault is None


def test_an_error_in_an_order_ends_nothing(started, capfd):
    player = started(live_run())
    assert done(player, lambda: 1 / 0) == "division by zero"
    assert done(player, player.step) is None
    assert player.shown.moment.frame == 1


def test_too_many_orders_are_refused(started):
    player = started(live_run())
    goes_on, obeyed, complaints = threading.Event(), [], []
    player.order(goes_on.wait)
    for _ in range(MOST_ORDERS + 10):
        player.order(lambda: obeyed.append(1), complaints.append)
    goes_on.set()
    wait_until(lambda: len(obeyed) + len(complaints) == MOST_ORDERS + 10)

    assert 10 <= len(complaints) <= 11  # the first order may have been taken already
    assert "found 256 that wait already" in complaints[0]
    assert done(player, player.step) is None


def test_the_past_of_a_live_run_is_bounded():
    run = live_run(100)
    bounded = LiveRun(run._create, "Test", 60, past_bytes=10 * 24 * 100)
    for _ in range(100):
        bounded.advance()
        assert len(bounded) <= 10
    assert bounded.time_of(0) == 0.0
    assert bounded.moment(len(bounded) - 1).frame == 100


@pytest.fixture
def run_folder(tmp_path):
    """A finished run of 8 frame files with a ledger."""
    world = live_run(50).world
    with LedgerWriter(tmp_path / "ledger.csv") as ledger:
        for _ in range(8):
            world.step(2)
            write_frame(frame_path(tmp_path, world.frame), world.frame, world.time, world.positions, world.radii)
            ledger.add(world)
    return tmp_path


def test_a_finished_run_is_its_files(run_folder, started):
    run = FinishedRun(run_folder, ((-4, -4, 0), (4, 4, 8)))
    player = started(run)
    world = live_run(50).world
    for index in range(8):
        world.step(2)
        done(player, lambda index=index: player.seek(index))
        assert (player.shown.moment.frame, player.shown.moment.positions.tolist()) == (
            world.frame,
            world.positions.tolist(),
        )
        assert run.energies[index] == (world.time, *world.energy())
    assert "nothing of it can be changed" in done(player, lambda: player.change(Conditions(type="change", drag=0.5)))


def test_where_frames_have_no_velocities_they_are_the_way_between_two(run_folder):
    run = FinishedRun(run_folder)
    moments = [run.moment(index) for index in range(3)]
    for moment, before, after in ((0, 0, 1), (1, 0, 1), (2, 1, 2)):
        way = moments[after].positions - moments[before].positions
        np.testing.assert_allclose(moments[moment].velocities, way * 30, rtol=1e-5)  # two frames of 1/60 s
    assert np.abs(moments[0].velocities).max() > 1


@pytest.mark.parametrize("suffix", [".gsd", ".vtkhdf"])
def test_a_trajectory_knows_more_than_text(program, folder, suffix):
    scene = "title = 'Two'\n[world]\nboundary = ['periodic', 'wall', 'wall']\ndrag = 0.0\n" + (
        "[[spheres]]\nkind = 'random'\ncount = 50\nfriction = 0.5\n"
    )
    (folder / "two.toml").write_text(scene)
    name = f"run{suffix}"
    words = ["--frames", 6, "--fps", 30, "--export-every", 2, "--no-video", "--device", "cpu", "--output", "out"]
    assert program("run", "two.toml", *words, "--trajectory", f"out/{name}")[0] == 0
    world = load_scene(folder / "two.toml").create_world("cpu")
    for path in ("out", f"out/{name}"):
        run = FinishedRun(folder / path)
        assert (len(run), run.fps) == (3, 30)
        assert run.box == Box(world.bounds, ("periodic", "wall", "wall"))
        assert run.moment(0).frame == 2
        assert len(run.energies) == 7
    world.step(6, dt=1 / 30)
    moment = run.moment(2)
    np.testing.assert_allclose(moment.positions, world.positions, atol=2e-6)  # those of GSD are shifted
    np.testing.assert_array_equal(moment.velocities, world.velocities)
    np.testing.assert_array_equal(run.sphere(7, moment)["spin"], world.spins[7])


def test_a_finished_run_plays_to_its_end_and_again(run_folder, started):
    player = started(FinishedRun(run_folder), is_playing=True)
    wait_until(lambda: not player.status.is_playing)
    assert player.shown.index == 7
    done(player, player.play)
    wait_until(lambda: player.shown.index < 7)


def test_a_damaged_frame_is_told_and_the_others_can_be_seen(run_folder, started):
    frame_path(run_folder, 8).write_text("# FastCollide frame, format 1\n")
    player = started(FinishedRun(run_folder, ((-4, -4, 0), (4, 4, 8))))
    complaint = done(player, lambda: player.seek(3))
    assert "frame_00000008.txt" in complaint
    assert done(player, lambda: player.seek(6)) is None
    assert player.shown.moment.frame == 14
    done(player, lambda: player.seek(0))
    done(player, player.play)
    wait_until(lambda: not player.status.is_playing)
    assert "frame_00000008.txt" in player.status.fault
    assert done(player, lambda: player.seek(5)) is None
    assert player.shown.moment.frame == 12
