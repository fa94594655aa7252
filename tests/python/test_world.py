"""The world as people meet it."""

import signal
import subprocess
import sys
import textwrap
import threading
import time

import fastcollide as fc
import numpy as np
import pytest


def test_the_default_world_is_the_report_s(device):
    world = fc.World(device=device)
    assert world.bounds == ((-10, -10, 0), (10, 10, 20))
    assert world.solver == "substep"
    assert (len(world), world.frame, world.time) == (0, 0, 0)

    explicit = fc.World(
        bounds=((-10, -10, 0), (10, 10, 20)), gravity=(0, 0, -9.8), drag=0.06, floor_restitution=0.6,
        wall_friction=0.0, solver="substep", iterations=5, cell_size=None, device=device, threads=None,
    )  # fmt: skip
    for one in (world, explicit):
        one.add(fc.random_spheres(1000))
        one.step(30)
    assert world.state_hash() == explicit.state_hash()


@pytest.mark.parametrize(
    "change",
    [
        {"gravity": (0, 0, -9.7)}, {"drag": 0.07}, {"floor_restitution": 0.5}, {"wall_friction": 0.1},
        {"iterations": 4}, {"bounds": ((-10, -10, 0), (10, 10, 20.5))},
    ],
)  # fmt: skip
def test_every_parameter_has_an_effect(device, solver, change):
    plain, changed = (fc.World(device=device, **{"solver": solver, **options}) for options in ({}, change))
    for world in (plain, changed):
        world.add(fc.random_spheres(1000, seed=2))
        world.step(30)
    assert changed.state_hash() != plain.state_hash()


def test_time_and_frames(device, solver):
    world = fc.World(device=device, solver=solver)
    world.add(position=(0, 0, 5), radius=0.5)
    world.step()
    assert (world.frame, world.time) == (1, pytest.approx(1 / 60))
    world.step(3, dt=0.5)
    assert (world.frame, world.time) == (4, pytest.approx(1 / 60 + 1.5))
    world.step(0)
    assert world.frame == 4
    world.step(frames=np.int64(2), dt=np.float32(0.25))
    assert (world.frame, world.time) == (6, pytest.approx(1 / 60 + 2))


def test_time_does_not_depend_on_how_it_is_stepped(device, solver):
    one, many = fc.World(device=device, solver=solver), fc.World(device=device, solver=solver)
    for world in (one, many):
        world.add(position=(0, 0, 5), radius=0.5)
    one.step(100)
    for _ in range(100):
        many.step(1)
    assert many.time == one.time


def test_a_world_without_spheres_can_be_stepped(device, solver):
    world = fc.World(device=device, solver=solver)
    world.step(10)
    assert (world.frame, len(world)) == (10, 0)
    assert world.time == pytest.approx(1 / 6)


def test_ids_count_up(device):
    world = fc.World(device=device)
    first = world.add(position=[(0, 0, 5), (1, 0, 5)], radius=0.1)
    second = world.add(fc.random_spheres(3))
    assert first.dtype == np.int32
    assert (first.tolist(), second.tolist(), len(world)) == ([0, 1], [2, 3, 4], 5)
    assert world.add(position=np.empty((0, 3)), radius=[]).tolist() == []
    assert len(world) == 5


def test_what_is_added_is_what_is_there(device):
    world = fc.World(device=device)
    spheres = fc.random_spheres(100, seed=5)
    world.add(spheres)
    expected = {
        "positions": spheres.position, "velocities": spheres.velocity, "radii": spheres.radius,
        "masses": spheres.mass, "restitutions": spheres.restitution,
    }  # fmt: skip
    for name, values in expected.items():
        assert fc.to_numpy(getattr(world, name)).tobytes() == values.tobytes()


def test_one_number_for_all(device):
    world = fc.World(device=device)
    world.add(position=[(0, 0, 5), (1, 0, 5), (2, 0, 5)], radius=0.5, velocity=(1, 2, 3), restitution=0.25)
    world.add(position=(0, 3, 5), radius=[0.25, 0.5], mass=[2, 3], velocity=[(0, 0, 1), (0, 0, 2)])

    np.testing.assert_array_equal(fc.to_numpy(world.radii), np.float32([0.5, 0.5, 0.5, 0.25, 0.5]))
    np.testing.assert_array_equal(fc.to_numpy(world.velocities)[:3], [(1, 2, 3)] * 3)
    np.testing.assert_array_equal(fc.to_numpy(world.restitutions), np.float32([0.25] * 3 + [0.6] * 2))
    # 1000 kg/m³ unless a mass or another density is given.
    np.testing.assert_allclose(fc.to_numpy(world.masses), [1000 * np.pi / 6] * 3 + [2, 3], rtol=1e-6)
    world.add(position=(0, 5, 5), radius=0.5, density=2.0)
    assert fc.to_numpy(world.masses)[-1] == pytest.approx(2 * np.pi / 6, rel=1e-6)


def test_keywords_beside_spheres_are_not_silently_ignored(device):
    world = fc.World(device=device)
    with pytest.raises((TypeError, ValueError)):
        world.add(fc.random_spheres(2), restitution=0.1)


def test_auto_says_what_it_chose():
    world = fc.World()
    assert world.device == ("cpu" if len(fc.devices()) == 1 else "cuda:0")
    assert world.device in {found.name for found in fc.devices()}
    assert world.device_name


def test_names_of_devices(device):
    world = fc.World(device=device)
    assert world.device == {"cpu": "cpu", "cuda": "cuda:0"}[device]
    assert world.device_name in {found.description for found in fc.devices()}
    assert fc.World(device="cpu", threads=3).device_name.endswith("(3 threads)")
    assert fc.World(device="cpu", threads=1).device_name.endswith("(1 thread)")


def test_devices_and_build():
    cpu, *gpus = fc.devices()
    assert cpu.name == "cpu"
    assert [found.name for found in gpus] == [f"cuda:{i}" for i in range(len(gpus))]
    assert all(found.description and found.memory_bytes > 0 for found in (cpu, *gpus))
    assert fc.build_info().version == fc.__version__
    assert fc.build_info().compiler
    assert fc.build_info().is_debug is False
    assert not gpus or fc.build_info().cuda


def test_repr(device):
    world = fc.World(device=device)
    world.add(fc.random_spheres(7))
    world.step(2, 0.25)
    assert repr(world) == f"World(7 spheres, frame 2, time 0.5 s, on {world.device})"


def test_stage_times(device, solver):
    world = fc.World(device=device, solver=solver, method="list")
    world.add(fc.random_spheres(2000))
    world.step(2)
    assert not any(world.stage_times.values())
    world.timed = True
    world.step(2)
    assert world.timed
    once = dict(world.stage_times)
    names = {"substep": {"gather_contacts", "apply_contacts"}, "reference": {"advance", "solve_contacts"}}[solver]
    assert set(once) == {"load", "build_grid", "make_lists", "store"} | names
    assert all(seconds > 0 for seconds in once.values())
    world.step(2)
    assert all(world.stage_times[name] > seconds for name, seconds in once.items())


@pytest.mark.parametrize(
    ("damping", "fps", "drag"), [(0.999, 60, 0.06003), (1.0, 60, 0.0), (0.5, 1, np.log(2)), (0.9, 30, 3.16082)]
)
def test_drag_from_damping(damping, fps, drag):
    assert fc.drag_from_damping(damping, fps) == pytest.approx(drag, rel=1e-5)


# --- Threads and signals of Python ---


def test_other_threads_of_python_run_during_a_step(device):
    world = fc.World(device=device)
    world.add(fc.random_spheres(20_000))
    begin = time.perf_counter()
    world.step(8)
    frames = int(8 * 0.2 / (time.perf_counter() - begin)) + 1
    done, ticks = threading.Event(), []

    def tick():
        while not done.is_set():
            ticks.append(time.perf_counter())
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    try:
        begin = time.perf_counter()
        world.step(frames)
        end = time.perf_counter()
    finally:
        done.set()
        thread.join()

    margin = 0.1 * (end - begin)
    assert sum(begin + margin < t < end - margin for t in ticks) > 5


def run_python(code, *arguments, timeout=60):
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *arguments], capture_output=True, text=True, timeout=timeout
    )


def test_interrupt(device):
    """Ctrl-C ends a long run within a second, at a whole frame."""
    finished = run_python(
        """
        import signal, sys, threading, time
        import fastcollide as fc
        world = fc.World(device=sys.argv[1])
        world.add(fc.random_spheres(3000))
        sent = []
        def interrupt():
            sent.append(time.perf_counter())
            signal.raise_signal(signal.SIGINT)
        threading.Timer(0.3, interrupt).start()
        try:
            world.step(10**7)
        except KeyboardInterrupt:
            late = time.perf_counter() - sent[0]
            print(world.frame, late, world.state_hash())
            world.step(1)
            print(world.frame)
        """,
        device,
    )
    assert finished.returncode == 0, finished.stderr
    frame, late, state_hash, next_frame = finished.stdout.split()
    assert float(late) < 1
    assert 0 < int(frame) < 10**7
    assert int(next_frame) == int(frame) + 1

    again = fc.World(device=device)
    again.add(fc.random_spheres(3000))
    again.step(int(frame))
    assert again.state_hash() == int(state_hash)


def test_an_interrupt_handler_s_own_error_comes_through(device):
    def handler(number, frame):
        raise RuntimeError("from the handler")

    world = fc.World(device=device)
    world.add(fc.random_spheres(2000))
    previous = signal.signal(signal.SIGINT, handler)
    try:
        timer = threading.Timer(0.1, signal.raise_signal, (signal.SIGINT,))
        timer.start()
        with pytest.raises(RuntimeError, match="from the handler"):
            world.step(1_000_000)  # would take seconds
    finally:
        timer.join()
        signal.signal(signal.SIGINT, previous)
    assert 0 < world.frame < 1_000_000


def test_two_threads_that_use_one_world_take_turns(device):
    """Memory is never used after it is gone, no frame and no sphere is lost."""
    finished = run_python(
        """
        import sys, threading
        import fastcollide as fc
        import numpy as np
        world = fc.World(device=sys.argv[1], threads=1)
        world.add(fc.random_spheres(4000))
        stepping = threading.Thread(target=world.step, args=(60,))
        stepping.start()
        added = 0
        while stepping.is_alive() and added < 8_000:
            added += len(world.add(position=np.random.default_rng(added).uniform(1, 9, (500, 3)), radius=0.1))
            world.energy()
            world.contact_count()
        stepping.join()
        assert len(world) == 4000 + added, len(world)
        assert world.frame == 60, world.frame
        """,
        device,
    )
    assert finished.returncode == 0, f"exit status {finished.returncode}: {finished.stderr}"
