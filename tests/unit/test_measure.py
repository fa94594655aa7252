"""Hash, energy, momentum and overlap against NumPy."""

import fastcollide as fc
import numpy as np
import pytest


@pytest.fixture
def world(device, solver):
    world = fc.World(gravity=(0.5, -1.0, -9.8), solver=solver, device=device)
    world.add(fc.random_spheres(2000, seed=31))
    world.step(3)
    return world


def arrays_of(world):
    names = ("positions", "velocities", "radii", "masses", "restitutions")
    return [fc.to_numpy(getattr(world, name)) for name in names]


def mix64(z):
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def state_hash(arrays):
    """mix64(count + Σ mix64(bits + 2³² (16 id + field))), fields x y z, v_x v_y v_z, radius, mass, restitution."""
    numbers = np.column_stack(arrays).astype(np.float32)
    place = np.arange(len(numbers), dtype=np.uint64)[:, None] * np.uint64(16) + np.arange(9, dtype=np.uint64)
    words = mix64(numbers.view(np.uint32).astype(np.uint64) + (place << np.uint64(32)))
    return int(mix64(np.array([len(numbers)], np.uint64) + words.sum(dtype=np.uint64))[0])


def test_the_hash_is_the_documented_one(world):
    assert world.state_hash() == state_hash(arrays_of(world))


def test_the_hash_of_no_spheres(device):
    assert fc.World(device=device).state_hash() == state_hash([np.empty((0, 9), np.float32)])


@pytest.mark.parametrize("field", range(5), ids=["position", "velocity", "radius", "mass", "restitution"])
def test_the_hash_sees_the_last_bit_of_every_number(world, write, field):
    array = (world.positions, world.velocities, world.radii, world.masses, world.restitutions)[field]
    before = world.state_hash()
    values = fc.to_numpy(array).copy()
    values.flat[-1] = np.nextafter(values.flat[-1], np.float32(1e9))
    write(array, values)

    assert world.state_hash() != before
    assert world.state_hash() == state_hash(arrays_of(world))


def test_the_hash_tells_zero_from_negative_zero(device):
    hashes = set()
    for zero in (0.0, -0.0):
        world = fc.World(device=device)
        world.add(position=(zero, 1, 5), radius=0.1)
        hashes.add(world.state_hash())
    assert len(hashes) == 2


def test_energy(world):
    """The potential is 0 at the lower corner of the box."""
    position, velocity, _, mass, _ = (array.astype(np.float64) for array in arrays_of(world))
    gravity = np.float32((0.5, -1.0, -9.8)).astype(np.float64)
    energy = world.energy()

    assert energy.kinetic == pytest.approx(0.5 * (mass * (velocity**2).sum(axis=1)).sum(), rel=1e-13)
    assert energy.potential == pytest.approx(-(mass * ((position - (-10, -10, 0)) @ gravity)).sum(), rel=1e-13)
    assert energy.total == energy.kinetic + energy.potential


def test_momentum(world):
    _, velocity, _, mass, _ = (array.astype(np.float64) for array in arrays_of(world))
    momentum = world.momentum()

    assert momentum.shape == (3,)
    assert momentum.dtype == np.float64
    np.testing.assert_allclose(momentum, mass @ velocity, rtol=1e-12, atol=1e-12 * (mass @ np.abs(velocity)).max())


def test_largest_overlap(device):
    world = fc.World(device=device)
    world.add(position=[(0, 0, 5), (0.5, 0, 5), (5, 0, 5), (5, 0.75, 5)], radius=[0.375, 0.25, 0.5, 0.375])
    assert world.max_overlap() == 0.125
    assert world.contact_count() == 2


def test_a_world_without_spheres_measures_nothing(device):
    world = fc.World(device=device)
    assert world.energy() == (0, 0, 0)
    assert world.momentum().tolist() == [0, 0, 0]
    assert world.max_overlap() == 0
    assert world.contact_count() == 0
    assert len(world.contacts()) == 0


def test_one_dominant_term_and_many_small_ones(device):
    """The sums keep 40 bits below their largest term and more."""
    world = fc.World(gravity=(0, 0, 0), device=device)
    mass = np.concatenate([[1e9], np.full(1000, 1.0)])
    position = np.random.default_rng(1).uniform(0, 5, (1001, 3))
    world.add(position=position, radius=0.1, mass=mass, velocity=(1, 0, 0))

    assert world.momentum()[0] == 1e9 + 1000
    assert world.energy().kinetic == 0.5 * (1e9 + 1000)
