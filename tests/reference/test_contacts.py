"""World.contacts() against the oracle: no contact is missed, none is invented, whatever the cloud."""

import fastcollide as fc
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.all_pairs import (
    GOLDEN_SETS,
    boundary_partners,
    deepest_in_a_wall,
    golden_cloud,
    overlapping_pairs,
    pair_hash,
)

EPSILON = float(np.finfo(np.float32).eps)


def cube(half):
    return ((-half,) * 3, (half,) * 3)


def world_of(device, position, radius, bounds, **options):
    world = fc.World(bounds=bounds, device=device, **options)
    world.add(position=np.asarray(position, np.float32), radius=np.asarray(radius, np.float32), mass=1.0)
    return world


def contact_set(world):
    contacts = world.contacts()
    return fc.to_numpy(contacts.first), fc.to_numpy(contacts.second)


def assert_contacts_are_right(world):
    """The pairs are the oracle's, in order; gaps and normals are what double precision gives, rounded."""
    position = fc.to_numpy(world.positions).astype(np.float64)
    radius = fc.to_numpy(world.radii).astype(np.float64)
    expected_first, expected_second = overlapping_pairs(position, radius)

    contacts = world.contacts()
    first, second = fc.to_numpy(contacts.first), fc.to_numpy(contacts.second)
    gap, normal = fc.to_numpy(contacts.gap), fc.to_numpy(contacts.normal)

    assert first.dtype == second.dtype == np.int32
    assert gap.dtype == normal.dtype == np.float32
    assert normal.shape == (len(contacts), 3)
    np.testing.assert_array_equal(first, expected_first)
    np.testing.assert_array_equal(second, expected_second)
    assert world.contact_count() == len(first)

    offset = position[second] - position[first]
    distance = np.linalg.norm(offset, axis=1)
    reach = radius[first] + radius[second]
    assert (gap <= 0).all()
    assert (np.abs(gap - (distance - reach)) <= 4 * EPSILON * reach).all()
    assert (np.abs(np.linalg.norm(normal.astype(np.float64), axis=1) - 1) <= 4 * EPSILON).all()
    apart = distance > 1e-17  # closer centres count as coincident: any unit normal
    assert (np.abs(normal[apart] - offset[apart] / distance[apart, None]) <= 4 * EPSILON).all()
    in_walls = deepest_in_a_wall(position, radius, world.bounds, "wall")
    assert world.max_overlap() == max(-gap.min(initial=0), in_walls)
    return len(first)


@pytest.mark.parametrize("name", GOLDEN_SETS)
def test_golden_sets(device, name):
    position, radius = golden_cloud(name)
    _, pairs, golden_hash = GOLDEN_SETS[name]

    first, second = contact_set(world_of(device, position, radius, cube(15)))

    assert (len(first), pair_hash(first, second)) == (pairs, golden_hash)


@pytest.mark.parametrize("name", GOLDEN_SETS)
def test_golden_sets_in_full(device, name):
    assert_contacts_are_right(world_of(device, *golden_cloud(name), cube(15)))


@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_equal_spheres_that_just_touch(device, offset):
    """Pairs of equal spheres, r = 0.4, in all directions at all places, that overlap by the last bit of a coordinate or
    miss each other by it. Cells smaller than the diameter lose many of them: of cells of 0.6 m one in eight. The box is
    so small that the engine takes the smallest cells it may, as far larger numbers of them would not be worth it."""
    bounds = cube(17)
    random = np.random.default_rng(4)
    sites = 3.0 * np.stack(np.meshgrid(*[np.arange(11)] * 3), axis=-1).reshape(-1, 3) - 15 + offset
    position = (sites + random.uniform(-0.25, 0.25, sites.shape)).astype(np.float32)
    direction = random.normal(size=sites.shape)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    radius = np.full(len(position), 0.4, np.float32)
    overlapping, touching = boundary_partners(position, radius, direction)
    both = np.concatenate([radius, radius])

    world = world_of(device, np.concatenate([position, overlapping]), both, bounds)
    assert_contacts_are_right(world)
    assert world.contact_count() == len(position)

    world = world_of(device, np.concatenate([position, touching]), both, bounds)
    assert_contacts_are_right(world)
    assert world.contact_count() == 0


def test_a_lattice_whose_neighbors_touch_has_no_contacts(device):
    position = 0.25 + 0.5 * np.stack(np.meshgrid(*[np.arange(32)] * 3), axis=-1).reshape(-1, 3)
    bounds = ((0, 0, 0), (16, 16, 16))
    assert world_of(device, position, np.full(len(position), 0.25), bounds).contact_count() == 0

    larger = np.full(len(position), np.nextafter(np.float32(0.25), np.float32(1)))
    world = world_of(device, position, larger, bounds)
    assert world.contact_count() == 3 * 32 * 32 * 31
    first, second = contact_set(world)
    assert len(first) == 3 * 32 * 32 * 31
    assert set(np.abs(position[second] - position[first]).sum(axis=1)) == {0.5}


@pytest.mark.parametrize("radius", [0.375, 0.3, 0.05])
def test_centers_on_the_borders_of_cells(device, radius):
    """Cells of 0.75 m: each centre on a border, or next to one, and its partner at the limit of its reach."""
    border = np.float32(0.75) * np.arange(-8, 9, 2, dtype=np.float32)
    axes = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1)]) / np.array([[1], [1], [1], [np.sqrt(3)]])
    directions = np.concatenate([axes, -axes])
    side = np.concatenate([np.nextafter(border, np.float32(-9)), border, np.nextafter(border, np.float32(9))])
    position, direction = [], []
    for k, x in enumerate(side):
        for j, y in enumerate(side[k % 9 :: 9]):
            position.append((x, y, side[(5 * k + 7 * j) % len(side)]))
            direction.append(directions[(k + j) % len(directions)])
    position, direction = np.array(position, np.float32), np.array(direction)
    radii = np.full(len(position), radius, np.float32)
    overlapping, touching = boundary_partners(position, radii, direction)
    everything = np.concatenate([position, overlapping, touching])

    world = world_of(device, everything, np.tile(radii, 3), cube(7.5), cell_size=0.75)

    assert assert_contacts_are_right(world) >= len(position)


def test_zero_and_negative_zero_are_one_place(device):
    tiny = np.float32(1e-45)
    position = [(x, y, z) for x in (0.0, -0.0, tiny, -tiny) for y in (0.0, -0.0) for z in (-0.0, tiny)]
    count = len(position)

    world = world_of(device, position, np.full(count, 0.25), cube(4), cell_size=0.5)

    assert assert_contacts_are_right(world) == count * (count - 1) // 2


@pytest.mark.parametrize("corner", [(-20.0, -20.0, -20.0), (-1000.0, 5.0, 300.0)])
def test_boxes_away_from_the_origin(device, corner):
    random = np.random.default_rng(5)
    position = random.uniform(0, 6, (1500, 3)) + corner
    bounds = (corner, tuple(np.add(corner, 6.0)))

    assert assert_contacts_are_right(world_of(device, position, random.uniform(0.1, 0.4, 1500), bounds)) > 1000


def test_coincident_centers(device):
    world = world_of(device, np.full((128, 3), 1.5), np.full(128, 0.25), cube(4))

    assert assert_contacts_are_right(world) == 128 * 127 // 2
    assert np.isfinite(fc.to_numpy(world.contacts().normal)).all()


def test_more_pairs_than_32_bits_can_count(device):
    count = 65_537
    world = world_of(device, np.full((count, 3), 1.5), np.full(count, 0.25), cube(4))

    assert world.contact_count() == count * (count - 1) // 2 > 2**31


def test_size_ratio_of_a_thousand(device):
    random = np.random.default_rng(6)
    direction = random.normal(size=(3000, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    position = np.concatenate([[(0, 0, 0)], direction * random.uniform(1.0005, 1.0015, (3000, 1))])
    radius = np.concatenate([[1.0], np.full(3000, 0.001)])

    assert assert_contacts_are_right(world_of(device, position, radius, cube(2))) > 1000


def test_a_sphere_as_large_as_the_box(device):
    random = np.random.default_rng(7)
    position = np.concatenate([[(0, 0, 10)], random.uniform((-10, -10, 0), (10, 10, 20), (2000, 3))])
    radius = np.concatenate([[9.999], random.uniform(0.05, 0.4, 2000)])

    assert assert_contacts_are_right(world_of(device, position, radius, ((-10, -10, 0), (10, 10, 20)))) > 1000


def test_spheres_written_outside_the_box(device, write):
    """Between two steps a user may put spheres anywhere; their contacts count all the same."""
    random = np.random.default_rng(8)
    world = world_of(device, random.uniform(-2, 2, (1000, 3)), random.uniform(0.1, 0.4, 1000), cube(2))
    write(world.positions, random.uniform(-4, 4, (1000, 3)))

    assert assert_contacts_are_right(world) > 100


# --- The set does not depend on how the cloud is told: numbers chosen so that each change is exact in float32 ---


@pytest.fixture(scope="module")
def cloud():
    random = np.random.default_rng(9)
    position = random.integers(-3 * 2**12, 3 * 2**12, (1200, 3)) / 2.0**12
    return position.astype(np.float32), random.uniform(0.1, 0.4, 1200).astype(np.float32)


def pairs_of(device, position, radius, bounds):
    return set(zip(*(ids.tolist() for ids in contact_set(world_of(device, position, radius, bounds))), strict=True))


@pytest.fixture(scope="module")
def cloud_pairs(device, cloud):
    pairs = pairs_of(device, *cloud, cube(4))
    assert len(pairs) > 500
    return pairs


def test_permuted(device, cloud, cloud_pairs):
    position, radius = cloud
    order = np.random.default_rng(10).permutation(len(radius))

    pairs = pairs_of(device, position[order], radius[order], cube(4))

    assert {tuple(sorted((int(order[i]), int(order[j])))) for i, j in pairs} == cloud_pairs


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_mirrored(device, cloud, cloud_pairs, axis):
    position, radius = cloud
    mirror = np.ones(3, np.float32)
    mirror[axis] = -1

    assert pairs_of(device, position * mirror, radius, cube(4)) == cloud_pairs


@pytest.mark.parametrize("distance", [2.0**-12, 0.5, 1.0, 64.0, 256.0])
def test_translated(device, cloud, cloud_pairs, distance):
    position, radius = cloud
    bounds = ((-4 + distance, -4 - distance, -4.0), (4 + distance, 4 - distance, 4.0))

    assert pairs_of(device, position + np.float32([distance, -distance, 0]), radius, bounds) == cloud_pairs


@pytest.mark.parametrize("exponent", [-40, -10, -1, 1, 10, 40])
def test_scaled(device, cloud, cloud_pairs, exponent):
    position, radius = cloud
    scale = np.float32(2.0**exponent)

    assert pairs_of(device, position * scale, radius * scale, cube(4 * 2.0**exponent)) == cloud_pairs


# Coordinates of a coarse lattice among them, where spheres touch, coincide and lie on borders of cells.
coordinates = st.one_of(
    st.floats(-2, 2, width=32), st.integers(-8, 8).map(lambda i: i / 4), st.integers(-20, 20).map(lambda i: i / 10)
)
radii = st.one_of(st.floats(0.0625, 0.75, width=32), st.sampled_from([0.125, 0.25, 0.5, 0.1, 0.4]))


@settings(max_examples=300)
@given(
    spheres=st.lists(st.tuples(coordinates, coordinates, coordinates, radii), max_size=24),
    cell_size=st.sampled_from([None, 1.5, 1.75, 4.0]),
)
def test_any_small_cloud(device, spheres, cell_size):
    numbers = np.array(spheres, np.float32).reshape(-1, 4)

    assert_contacts_are_right(world_of(device, numbers[:, :3], numbers[:, 3], cube(2), cell_size=cell_size))
