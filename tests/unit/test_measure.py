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


@pytest.mark.parametrize(("axis", "side"), [(axis, side) for axis in range(3) for side in (0, 1)])
def test_an_overlap_with_a_wall_counts(device, axis, side):
    """Of a sphere that walls hold, deeper than that of two spheres."""
    bounds = ((-4.0, -3.0, -2.0), (3.0, 4.0, 5.0))
    position = np.full((4, 3), 0.5)
    position[1, 0] += 0.9375
    position[2:, axis] = bounds[side][axis] + 0.375 * (1 - 2 * side)
    for boundary, deepest in (("wall", 0.125), ("open", 0.0625), ("periodic", 0.0625)):
        world = fc.World(bounds, boundary, (0, 0, 0), device=device)
        world.add(position=position[:3], radius=0.5)
        assert world.max_overlap() == deepest
        assert world.mean_overlap() == 0.125
    world = fc.World(bounds, device=device)
    world.add(position=position[3], radius=0.5, mass=float("inf"))
    assert world.max_overlap() == 0


def test_mean_overlap(world):
    """Of each pair as a part of its smaller radius."""
    contacts, radii = world.contacts(), fc.to_numpy(world.radii).astype(np.float64)
    smaller = np.minimum(radii[fc.to_numpy(contacts.first)], radii[fc.to_numpy(contacts.second)])
    overlaps = -fc.to_numpy(contacts.gap).astype(np.float64) / smaller
    assert len(overlaps) > 10
    assert world.mean_overlap() == pytest.approx(overlaps.mean(), rel=1e-12)


def test_mean_overlap_of_a_few(device):
    """Of 1/2 and of 1/4 of the smaller radius, the latter across a periodic end; a pair of fixed spheres is none."""
    world = fc.World(boundary="periodic", gravity=(0, 0, 0), device=device)
    world.add(position=[(0, 0, 5), (0.625, 0, 5)], radius=[0.5, 0.25])
    world.add(position=[(-9.5, 0, 5), (9.625, 0, 5)], radius=0.5)
    assert world.mean_overlap() == (0.5 + 0.25) / 2
    world.add(position=[(0, 5, 5), (0, 5, 5)], radius=0.5, mass=float("inf"))
    assert world.mean_overlap() == (0.5 + 0.25) / 2
    world.add(position=(0, 5, 5), radius=0.5)  # with both of them
    assert world.mean_overlap() == (0.5 + 0.25 + 2 + 2) / 4


def test_a_mean_over_many_pairs_of_unequal_depth(device):
    """2,000 spheres on one place inside a large one: a part of 2 each, and of 129."""
    world = fc.World(((-64,) * 3, (64,) * 3), device=device)
    count = 2000
    world.add(position=np.zeros((count, 3)), radius=0.5)
    world.add(position=(0, 0, 0), radius=64.0)
    pairs = count * (count - 1) // 2
    assert world.contact_count() == pairs + count
    assert world.mean_overlap() == pytest.approx((pairs * 2 + count * 129) / (pairs + count), rel=1e-12)


def test_a_world_without_spheres_measures_nothing(device):
    world = fc.World(device=device)
    assert world.energy() == (0, 0, 0)
    assert world.momentum().tolist() == [0, 0, 0]
    assert world.max_overlap() == 0
    assert world.mean_overlap() == 0
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


def crowd(device, count, side, fixed=0):
    world = fc.World(((0, 0, 0), (side, side, side)), gravity=(0.5, -1.0, -9.8), device=device)
    world.add(fc.random_spheres(count, bounds=world.bounds, radius=(0.2, 0.5), seed=7))
    if fixed:
        spheres = fc.random_spheres(fixed, bounds=world.bounds, radius=(0.4, 0.5), seed=8)
        world.add(position=spheres.position, radius=spheres.radius, mass=np.inf)
    return world


@pytest.mark.parametrize(
    ("count", "side", "fixed"),
    [(300, 4.0, 0), (200, 3.0, 60), (1, 9.0, 0), (0, 9.0, 0), (2, 9.0, 0), (400, 1.5, 0), (500, 2.0, 500)],
    ids=["some", "fixed ones", "one", "none", "two apart", "more contacts than room", "many fixed ones"],
)
def test_all_at_once_is_each_by_itself(device, count, side, fixed):
    world = crowd(device, count, side, fixed)
    for _ in range(3):  # the first time, and with the room of the time before
        now = world.measure()
        assert now.energy == world.energy()
        assert now.momentum.tolist() == world.momentum().tolist()
        assert now.angular_momentum.tolist() == world.angular_momentum().tolist()
        contacts = now.contact_count, now.max_overlap, now.mean_overlap
        assert contacts == (world.contact_count(), world.max_overlap(), world.mean_overlap())
    assert now.contact_count > 4 * count or side > 1.5
