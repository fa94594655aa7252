"""Impacts of two spheres in closed form, whatever the number of iterations."""

import fastcollide as fc
import numpy as np
import pytest

FREE = {"bounds": ((-8, -8, -8), (8, 8, 8)), "gravity": (0, 0, 0), "drag": 0.0}
DT = 1 / 64

iteration_counts = pytest.mark.parametrize("iterations", [1, 2, 5, 32])


def pair_of(device, solver, position, velocity, mass=1.0, restitution=1.0, radius=0.5, iterations=5):
    world = fc.World(device=device, solver=solver, iterations=iterations, **FREE)
    world.add(position=position, velocity=velocity, radius=radius, mass=mass, restitution=restitution)
    return world


@iteration_counts
def test_head_on(device, solver, iterations):
    """m 1, v 2 and m 3, v -1, e 1: v₁' = -2.5, v₂' = 0.5."""
    world = pair_of(
        device, solver, [(-1, 0, 0), (1, 0, 0)], [(2, 0, 0), (-1, 0, 0)], mass=[1, 3], iterations=iterations
    )
    world.step(64, DT)

    np.testing.assert_allclose(fc.to_numpy(world.velocities), [(-2.5, 0, 0), (0.5, 0, 0)], atol=1e-6)
    # And that was one impact at the right time: they meet at t = 1/3 s.
    np.testing.assert_allclose(
        fc.to_numpy(world.positions)[:, 0], (-1 / 3 - 2.5 * 2 / 3, 2 / 3 + 0.5 * 2 / 3), atol=0.05
    )


@iteration_counts
def test_oblique(device, iterations):
    """Equal masses, n = (1, 1, 0)/√2, e 1: the first keeps what is across n, the second takes what is along it."""
    normal = np.array((1, 1, 0)) / np.sqrt(2)
    # In contact along n after the flight of the first frame.
    first = -0.999 * normal - np.array((DT, 0, 0))
    world = pair_of(device, "reference", [first, (0, 0, 0)], [(1, 0, 0), (0, 0, 0)], iterations=iterations)
    world.step(1, DT)

    np.testing.assert_allclose(fc.to_numpy(world.velocities), [(0.5, -0.5, 0), (0.5, 0.5, 0)], atol=1e-6)


@iteration_counts
@pytest.mark.parametrize("restitution", [0.0, 0.25, 0.5, 0.75, 1.0])
def test_restitution(device, solver, restitution, iterations):
    """e = speed of separation / speed of approach."""
    world = pair_of(
        device, solver, [(-0.6, 0, 0), (0.6, 0, 0)], [(3, 0, 0), (-1, 0, 0)], [1, 2], restitution,
        iterations=iterations,
    )  # fmt: skip
    world.step(16, DT)

    first, second = fc.to_numpy(world.velocities)[:, 0].astype(float)
    assert (second - first) / 4 == pytest.approx(restitution, abs=1e-5)
    assert first + 2 * second == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("order", [(0.2, 0.7), (0.7, 0.2)])
def test_the_smaller_restitution_of_two_counts(device, solver, order):
    world = pair_of(device, solver, [(-0.6, 0, 0), (0.6, 0, 0)], [(1, 0, 0), (-1, 0, 0)], restitution=order)
    world.step(32, DT)

    np.testing.assert_allclose(fc.to_numpy(world.velocities)[:, 0], (-0.2, 0.2), atol=1e-6)


@iteration_counts
def test_an_overlap_is_pushed_apart_by_mass_share(device, iterations):
    """At rest: displacements inverse to the masses, until they touch; no velocity comes of it."""
    start = np.array([(-0.25, 0.5, 1.0), (0.5, 0.75, 1.25)])
    world = pair_of(device, "reference", start, (0, 0, 0), mass=[1, 3], iterations=iterations)
    world.step(1, DT)

    displacement = fc.to_numpy(world.positions) - start
    offset = start[1] - start[0]
    distance = np.linalg.norm(offset)
    normal, depth = offset / distance, 1 - distance
    np.testing.assert_allclose(displacement, [-normal * depth * 0.75, normal * depth * 0.25], atol=1e-6)
    assert world.max_overlap() < 1e-6
    assert not fc.to_numpy(world.velocities).any()


def test_spheres_that_separate_get_no_impulse(device, solver):
    world = pair_of(device, solver, [(-0.4, 0, 0), (0.4, 0, 0)], [(-0.5, 1, 0), (0.25, 0, 2)])
    world.step(1, DT)

    np.testing.assert_array_equal(fc.to_numpy(world.velocities), np.float32([(-0.5, 1, 0), (0.25, 0, 2)]))


def test_spheres_that_touch_do_not_collide(device, solver):
    world = pair_of(device, solver, [(-0.5, 0, 0), (0.5, 0, 0)], [(0, 1, 0), (0, 1, 0)])
    assert world.contact_count() == 0
    world.step(1, DT)

    np.testing.assert_array_equal(fc.to_numpy(world.positions)[:, 0], (-0.5, 0.5))


def test_coincident_centers_come_apart(device):
    world = pair_of(device, "reference", [(1, 1, 1), (1, 1, 1)], (0, 0, 0), iterations=1)
    world.step(1, DT)

    np.testing.assert_allclose(fc.to_numpy(world.positions), [(1.5, 1, 1), (0.5, 1, 1)], atol=1e-6)


def test_a_pair_pushed_towards_a_wall_stays_inside(device):
    world = pair_of(device, "reference", [(-7.5, 0, 0), (-7.0, 0, 0)], (0, 0, 0), iterations=1)
    world.step(1, DT)

    np.testing.assert_allclose(fc.to_numpy(world.positions)[:, 0], (-7.5, -6.75), atol=1e-6)
