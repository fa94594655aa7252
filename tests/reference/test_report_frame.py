"""The engine's frames against the plain ones."""

import fastcollide as fc
import numpy as np
import pytest
from reference.report_frame import Scene, simulate

BOUNDS = ((-2.0, -1.5, 0.5), (2.5, 2.0, 4.0))
DT = 1 / 60


def both(device, count, seed, **options):
    spheres = fc.random_spheres(count, bounds=BOUNDS, seed=seed, radius=(0.05, 0.25))
    world = fc.World(bounds=BOUNDS, solver="reference", device=device, **options)
    world.add(spheres)
    arrays = (spheres.position, spheres.velocity, spheres.radius, spheres.mass, spheres.restitution)
    return world, Scene(*(array.astype(np.float64) for array in arrays), bounds=BOUNDS, **options)


def assert_same_state(world, scene, tolerance):
    np.testing.assert_allclose(fc.to_numpy(world.positions), scene.position, rtol=0, atol=tolerance)
    np.testing.assert_allclose(fc.to_numpy(world.velocities), scene.velocity, rtol=0, atol=tolerance / DT)


@pytest.mark.parametrize(("wall_friction", "drag"), [(0.0, 0.06), (0.3, 0.0), (2.0, 1.5)])
def test_one_pass_in_a_crowd(device, wall_friction, drag):
    """Many contacts on each sphere; one pass, as in a second one rounding would decide which of them still overlap."""
    options = {
        "gravity": (1.0, -2.0, -9.8), "drag": drag, "floor_restitution": 0.6, "wall_friction": wall_friction,
        "iterations": 1,
    }  # fmt: skip
    world, scene = both(device, 800, 2, **options)
    assert world.contact_count() > 800

    world.step(1, DT)
    simulate(scene, 1, DT)

    assert_same_state(world, scene, 2e-6)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_five_passes_and_many_frames(device, seed):
    options = {
        "gravity": (0.0, 0.0, -9.8), "drag": 0.06, "floor_restitution": 0.6, "wall_friction": 0.2, "iterations": 5,
    }  # fmt: skip
    world, scene = both(device, 60, seed, **options)
    start = scene.velocity.copy()

    for _ in range(10):
        world.step(1, DT)
        simulate(scene, 1, DT)
        assert_same_state(world, scene, 2e-5)

    assert (np.linalg.norm(scene.velocity - start, axis=1) > 2).mean() > 0.3  # most have hit something
