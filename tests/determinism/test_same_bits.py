"""The state is a function of the scene alone: not of threads, of the way it is stepped, or of what else the process
does."""

import ctypes
import multiprocessing
import platform
import threading

import fastcollide as fc
import numpy as np
import pytest
from determinism import golden

CROWD = "crowd, 3,000 spheres, 100 frames"


def report_world(device, count=20_000, **options):
    world = fc.World(device=device, **options)
    world.add(fc.random_spheres(count, seed=11))
    return world


def hash_after(frames, device="cpu", **options):
    world = report_world(device, **options)
    world.step(frames)
    measured = world.energy(), tuple(world.momentum()), world.max_overlap(), world.mean_overlap()
    return world.state_hash(), world.contact_count(), *measured, world.fast_spheres, world.safe_dt


def test_any_number_of_threads(solver):
    """State, contacts, energy, momentum and overlap."""
    expected = hash_after(6, solver=solver, threads=1)
    for threads in (2, 3, 5, 16):
        assert hash_after(6, solver=solver, threads=threads) == expected


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_any_vector_units(solver, friction, monkeypatch):
    """The narrow ones that every processor has, and those of this one. Deep in a pile, where contacts rest."""
    if solver == "reference" and friction > 0:
        pytest.skip("the reference solver has no friction of spheres")
    bounds = ((0, 0, 0), (3, 3, 10))
    spheres = fc.random_spheres(600, bounds, seed=4, radius=(0.05, 0.2), friction=friction)
    hashes = set()
    for simd in ("none", "avx2", "avx512"):
        monkeypatch.setenv("FASTCOLLIDE_SIMD", simd)
        world = fc.World(bounds=bounds, boundary=("periodic", "wall", "wall"), device="cpu", solver=solver)
        world.add(spheres)
        world.step(150)
        hashes.add(world.state_hash())
    assert len(hashes) == 1


def test_contacts_of_any_number_of_threads():
    expected = report_world("cpu", threads=1).contacts()
    assert len(expected) > 500
    for threads in (2, 5, 16):
        found = report_world("cpu", threads=threads).contacts()
        for name in ("first", "second", "gap", "normal"):
            assert getattr(found, name).tobytes() == getattr(expected, name).tobytes()


def test_cpu_and_gpu(gpu, solver):
    """State, contacts, energy, momentum and overlap."""
    assert hash_after(40, gpu, solver=solver) == hash_after(40, "cpu", solver=solver)


def test_one_run_of_many_frames_equals_many_of_one(device, solver):
    one, many = (golden.world_of(CROWD, device=device, solver=solver) for _ in range(2))

    one.step(40, 1 / 120)
    for _ in range(40):
        many.step(1, 1 / 120)

    assert many.state_hash() == one.state_hash()
    assert many.frame == one.frame == 40
    assert many.time == pytest.approx(one.time, rel=1e-12) == pytest.approx(40 / 120)


def test_looking_changes_nothing(device, solver):
    """Neither do measurements between frames, nor the time that stages are given."""
    blind, watched = (golden.world_of(CROWD, device=device, solver=solver) for _ in range(2))
    watched.timed = True

    for _ in range(10):
        blind.step(1)
        watched.step(1)
        watched.contacts()
        watched.energy()
        watched.max_overlap()
        watched.positions  # noqa: B018

    assert watched.state_hash() == blind.state_hash()


def test_the_order_of_the_spheres_permutes_the_state(device, solver):
    """Sums over contacts do not depend on the order of their terms, not even in the last bit."""
    spheres, options = golden.crowd()
    order = np.random.default_rng(12).permutation(len(spheres))
    plain, permuted = (fc.World(device=device, **{**options, "solver": solver}) for _ in range(2))
    plain.add(spheres)
    permuted.add(
        position=spheres.position[order], velocity=spheres.velocity[order], radius=spheres.radius[order],
        mass=spheres.mass[order], restitution=spheres.restitution[order],
    )  # fmt: skip
    assert plain.contact_count() > len(spheres)

    plain.step(30, 1 / 120)
    permuted.step(30, 1 / 120)

    for name in ("positions", "velocities"):
        expected = fc.to_numpy(getattr(plain, name))[order]
        assert fc.to_numpy(getattr(permuted, name)).tobytes() == expected.tobytes()


def test_spheres_added_one_by_one_equal_those_added_at_once(device):
    spheres = fc.random_spheres(50, seed=13)
    at_once, one_by_one = fc.World(device=device), fc.World(device=device)
    at_once.add(spheres)
    for i in range(len(spheres)):
        ids = one_by_one.add(
            position=spheres.position[i], velocity=spheres.velocity[i], radius=spheres.radius[i],
            mass=spheres.mass[i], restitution=spheres.restitution[i],
        )  # fmt: skip
        assert ids.tolist() == [i]

    assert one_by_one.state_hash() == at_once.state_hash()


def test_two_worlds_in_two_threads_of_python(device):
    expected = hash_after(4, device)
    found = {}

    def run(name):
        found[name] = hash_after(4, device)

    threads = [threading.Thread(target=run, args=(name,)) for name in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert found == dict.fromkeys(range(3), expected)


def _child(results, frames):
    results.put(hash_after(frames, "cpu", threads=2))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_child_can_step():
    """Although the threads of its parent are not in it."""
    expected = hash_after(2, "cpu", threads=2)
    context = multiprocessing.get_context("fork")
    results = context.Queue()
    child = context.Process(target=_child, args=(results, 2))
    child.start()
    try:
        assert results.get(timeout=30) == expected
    finally:
        child.kill()
        child.join()
    assert hash_after(2, "cpu", threads=2) == expected  # and the parent still can


def floating_point_library():
    if platform.system() != "Linux" or platform.machine() != "x86_64":
        pytest.skip("written for the floating-point environment of Linux on x86-64")
    return ctypes.CDLL("libm.so.6")


def flush_to_zero(library):
    environment = (ctypes.c_uint32 * 8)()
    library.fegetenv(environment)
    environment[7] |= 0x8040  # MXCSR: flush to zero, denormals are zero
    library.fesetenv(environment)
    assert np.float32(1e-39) * np.float32(0.5) == 0


def round_upwards(library):
    assert library.fesetround(0x800) == 0
    assert np.float32(1) + np.float32(1e-30) > 1


@pytest.mark.parametrize("change", [flush_to_zero, round_upwards])
def test_a_caller_with_another_floating_point_environment(device, solver, change):
    """Some libraries change it for the whole thread when they are imported."""
    library = floating_point_library()
    spheres = fc.random_spheres(2000, seed=14)
    # Half of the speeds along x and y are denormal numbers.
    velocity = spheres.velocity * np.where(np.arange(2000) % 2, np.float32(1e-39), np.float32(1))[:, None]
    plain, changed = (fc.World(device=device, solver=solver, threads=2) for _ in range(2))
    for world in (plain, changed):
        world.add(position=spheres.position, radius=spheres.radius, velocity=velocity, mass=spheres.mass)
    plain.step(3)
    changes = []

    def run():
        change(library)
        changes.append(change)
        changed.step(3)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()

    assert changes
    assert changed.state_hash() == plain.state_hash()
