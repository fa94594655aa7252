"""What collisions must keep."""

import fastcollide as fc
import numpy as np
import pytest


@pytest.fixture
def cloud(device, solver):
    """A cloud in free space that collides with itself and never reaches a wall."""
    world = fc.World(bounds=((-50,) * 3, (50,) * 3), gravity=(0, 0, 0), drag=0.0, solver=solver, device=device)
    world.add(fc.random_spheres(1500, bounds=((-3,) * 3, (3,) * 3), seed=3, speed=(4, 4, 4)))
    return world


def state_of(world):
    arrays = (world.masses, world.positions, world.velocities)
    return tuple(fc.to_numpy(array).astype(np.float64) for array in arrays)


def test_momentum_is_kept(cloud):
    """To 1e-6 of what the spheres carry."""
    mass, _, velocity = state_of(cloud)
    before = cloud.momentum()
    np.testing.assert_allclose(before, mass @ velocity, rtol=1e-12, atol=1e-12 * mass.sum())

    cloud.step(60)

    after = state_of(cloud)[2]
    carried = (mass * np.linalg.norm(velocity, axis=1)).sum()
    assert np.abs(cloud.momentum() - before).max() < 1e-6 * carried
    assert (np.linalg.norm(after - velocity, axis=1) > 0.5).mean() > 0.5  # and there was something to keep


def test_the_center_of_mass_moves_on_a_straight_line(cloud):
    """Neither impulses nor the push apart of overlaps move it."""
    mass, position, _ = state_of(cloud)
    expected = (mass @ position + cloud.momentum()) / mass.sum()

    cloud.step(60, 1 / 60)

    np.testing.assert_allclose(mass @ state_of(cloud)[1] / mass.sum(), expected, atol=2e-6)


def test_dilute_elastic_collisions_keep_the_energy(device, solver):
    """Where no sphere touches two others at once, e = 1 loses and gains nothing."""
    world = fc.World(bounds=((-50,) * 3, (50,) * 3), gravity=(0, 0, 0), drag=0.0, solver=solver, device=device)
    spheres = fc.random_spheres(300, ((-10,) * 3, (10,) * 3), 5, (0.3, 0.4), (8, 8, 8), (1, 1))
    world.add(spheres)
    world.step(1)  # overlaps of the start are gone
    before = world.energy().kinetic

    world.step(30)

    assert world.energy().kinetic == pytest.approx(before, rel=1e-5)
    assert (fc.to_numpy(world.velocities) != spheres.velocity).any(axis=1).mean() > 0.1
