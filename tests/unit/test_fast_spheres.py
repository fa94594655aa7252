"""Spheres that move more than their radius in one substep are counted, and told how to be slowed."""

import fastcollide as fc
import numpy as np
import pytest

DT = 1 / 64


def free_flight(device, solver, speed, iterations=4, **options):
    """One sphere of radius 0.25 m along a periodic axis."""
    world = fc.World(
        ((-8,) * 3, (8,) * 3),
        "periodic",
        (0, 0, 0),
        0.0,
        solver=solver,
        iterations=iterations,
        device=device,
        **options,
    )
    world.add(position=(7.5, 0, 0), velocity=(speed, 0, 0), radius=0.25)
    return world


def test_none_is_fast(device, solver):
    """One that moves by exactly its radius is not; and nothing limits the step."""
    world = free_flight(device, solver, 0.25 / DT * (4 if solver == "substep" else 1))
    world.step(20, DT)
    assert (world.fast_spheres, world.safe_dt) == (0, float("inf"))
    assert world.safe_iterations == (4 if solver == "substep" else None)


@pytest.mark.parametrize("iterations", [1, 4])
def test_each_step_counts(device, iterations):
    """3.5 radii in a substep want 3.5 times as many of them."""
    world = free_flight(device, "substep", 3.5 * 0.25 / DT * iterations, iterations)
    assert world.fast_spheres == 0
    world.step(20, DT)
    world.step(2, DT)
    assert world.fast_spheres == 22 * iterations
    assert world.safe_iterations == {1: 4, 4: 14}[iterations]
    assert world.safe_dt == DT / 3.5


def test_each_frame_of_the_reference_solver_counts(device):
    """Its iterations divide no frame."""
    world = free_flight(device, "reference", -3.5 * 0.25 / DT)
    world.step(22, DT)
    assert (world.fast_spheres, world.safe_iterations, world.safe_dt) == (22, None, DT / 3.5)


def test_the_advice_is_enough_and_not_too_much(device):
    for factor in (1.001, 1.3, 2.0, 7.77):
        speed = factor * 0.25 / DT * 4
        world = free_flight(device, "substep", speed)
        world.step(3, DT)
        enough = free_flight(device, "substep", speed, world.safe_iterations)
        fewer = free_flight(device, "substep", speed, world.safe_iterations - 1)
        for other in (enough, fewer):
            other.step(3, DT)
        assert (enough.fast_spheres, fewer.fast_spheres > 0) == (0, True)
        shorter = free_flight(device, "substep", speed)
        shorter.step(3, world.safe_dt * 0.9999)
        assert shorter.fast_spheres == 0


def test_the_fastest_sets_the_limit(device, write):
    """In radii a second, whatever the length of its frame; safe_iterations are for frames as long as the last."""
    world = free_flight(device, "substep", 2 * 0.25 / DT * 4)
    world.step(1, DT)
    world.step(1, 2 * DT)  # as fast, twice as far
    assert (world.fast_spheres, world.safe_dt, world.safe_iterations) == (8, DT / 2, 16)
    write(world.velocities, [(3 * 0.25 / DT * 4, 0, 0)])
    world.step(1, DT / 2)
    assert (world.fast_spheres, world.safe_dt, world.safe_iterations) == (12, DT / 3, 6)
    write(world.velocities, [(0, 0, 0)])
    world.step(1, DT)
    assert (world.fast_spheres, world.safe_dt, world.safe_iterations) == (12, DT / 3, 12)


def test_a_frame_of_free_flight_against_numpy(device):
    bounds = ((-1000,) * 3, (1000,) * 3)
    spheres = fc.random_spheres(3000, bounds, 5, (0.05, 0.4), (8, 8, 8))
    world = fc.World(bounds, gravity=(0, 0, 0), drag=0.0, solver="reference", device=device)
    world.add(spheres)
    world.step(1)
    way = np.linalg.norm(spheres.velocity.astype(float), axis=1) / 60 / spheres.radius
    assert world.contact_count() == 0
    assert np.abs(way - 1).min() > 1e-4  # none so close to the limit that rounding decides
    assert world.fast_spheres == (way > 1).sum() > 100
    assert world.safe_dt == pytest.approx(1 / 60 / way.max(), rel=1e-4)


def test_a_fixed_sphere_counts_too(device, solver):
    world = fc.World(boundary="open", solver=solver, iterations=4, device=device)
    world.add(position=(0, 0, 0), velocity=(0, 8 / DT, 0), radius=0.25, mass=float("inf"))
    world.step(4, DT)
    assert world.fast_spheres == {"substep": 16, "reference": 4}[solver]


def test_frames_that_failed_do_not_count(device, solver):
    """The frame that leaves the reach of float32 is undone, and so is what was counted in it."""
    world = fc.World(boundary="open", gravity=(0, 0, 0), drag=0.0, solver=solver, iterations=4, device=device)
    world.add(position=(0, 0, 0), velocity=(1000 / DT, 0, 0), radius=0.25)
    with pytest.raises(fc.SimulationError, match="sphere 0 in frame 33: "):
        world.step(100, DT)
    assert world.fast_spheres == 32 * {"substep": 4, "reference": 1}[solver]


def test_many_frames_at_once(device, solver):
    counts = set()
    for steps in ([40], [1] * 40, [17, 23]):
        world = fc.World(solver=solver, device=device)
        world.add(fc.random_spheres(2000))
        for frames in steps:
            world.step(frames)
        counts.add((world.fast_spheres, world.safe_iterations, world.safe_dt))
    assert len(counts) == 1
    assert counts.pop()[0] > 50
