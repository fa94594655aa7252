"""World.contacts() across periodic ends and along open axes, against the oracle."""

import itertools

import fastcollide as fc
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.all_pairs import deepest_in_a_wall
from reference.images import overlapping_images

EPSILON = float(np.finfo(np.float32).eps)
NAMES = ("wall", "periodic", "open")
COMBINATIONS = list(itertools.product(NAMES, repeat=3))
CUBE = ((-2.0,) * 3, (2.0,) * 3)


def world_of(device, position, radius, bounds=CUBE, boundary="periodic", **options):
    world = fc.World(bounds=bounds, boundary=boundary, device=device, **options)
    world.add(position=np.asarray(position, np.float32), radius=np.asarray(radius, np.float32), mass=1.0)
    return world


def period_of(bounds, boundary):
    names = np.array((boundary,) * 3 if isinstance(boundary, str) else boundary)
    return np.where(names == "periodic", np.float32(bounds[1]) - np.float32(bounds[0]), 0).astype(np.float64)


def contact_set(world):
    contacts = world.contacts()
    return fc.to_numpy(contacts.first), fc.to_numpy(contacts.second)


def assert_contacts_are_right(world, boundary="periodic"):
    """The pairs are the oracle's, each once and in order; gaps and normals are what double precision gives, to the
    rounding of a coordinate difference of up to a period. Returns their number and that of those across an end."""
    position = fc.to_numpy(world.positions).astype(np.float64)
    radius = fc.to_numpy(world.radii).astype(np.float64)
    period = period_of(world.bounds, boundary)
    expected_first, expected_second, offset = overlapping_images(position, radius, period)

    contacts = world.contacts()
    first, second = fc.to_numpy(contacts.first), fc.to_numpy(contacts.second)
    gap, normal = fc.to_numpy(contacts.gap), fc.to_numpy(contacts.normal)

    np.testing.assert_array_equal(first, expected_first)
    np.testing.assert_array_equal(second, expected_second)
    assert world.contact_count() == len(first)
    distance = np.linalg.norm(offset, axis=1)
    reach = radius[first] + radius[second]
    across = (np.abs(offset - (position[second] - position[first])) > 1e-3).any(axis=1)
    off_by = np.where(across, np.linalg.norm(period) * EPSILON / 2, 0)
    assert (gap <= 0).all()
    assert (np.abs(gap - (distance - reach)) <= 4 * EPSILON * reach + off_by).all()
    assert (np.abs(np.linalg.norm(normal.astype(np.float64), axis=1) - 1) <= 4 * EPSILON).all()
    apart = distance > 1e-17  # closer centres count as coincident: any unit normal
    error = np.abs(normal[apart] - offset[apart] / distance[apart, None]).max(axis=1, initial=0)
    assert (error <= 4 * EPSILON + 2 * off_by[apart] / distance[apart]).all()
    in_walls = deepest_in_a_wall(position, radius, world.bounds, boundary)
    assert world.max_overlap() == max(-gap.min(initial=0), in_walls)
    return len(first), int(across.sum())


@pytest.mark.parametrize("boundary", COMBINATIONS, ids="-".join)
def test_every_combination(device, boundary):
    """Mixed sizes in a box of three lengths; beyond its bounds where an axis is open."""
    random = np.random.default_rng(30)
    bounds = ((-4.0, 1.0, -7.5), (2.0, 6.0, -0.5))
    beyond = np.where(np.array(boundary) == "open", 1.5, 0)
    position = random.uniform(bounds[0] - beyond, bounds[1] + beyond, (250, 3))
    radius = 10 ** random.uniform(-2, 0.08, 250)

    contacts, across = assert_contacts_are_right(world_of(device, position, radius, bounds, boundary), boundary)

    assert contacts > 40
    assert (across > 5) == ("periodic" in boundary)


# A period of 4 m: one cell, two, two that nearly are three, three, four and forty.
@pytest.mark.parametrize("largest", [1.0, 0.95, 0.67, 0.65, 0.49, 0.04])
@pytest.mark.parametrize("boundary", ["periodic", ("periodic", "wall", "open"), ("open", "open", "periodic")])
def test_few_cells_round_an_axis(device, largest, boundary):
    random = np.random.default_rng(31)
    count = 300 if largest < 0.1 else 80
    radius = largest * random.uniform(0.2, 1, count)
    radius[:2] = largest
    position = random.uniform(-2, 2, (count, 3))
    position[:200] *= 2 / np.abs(position[:200]).max(axis=1)[:, None]  # at the ends
    position[::2] = position[1::2] + random.normal(size=(count // 2, 3)) * largest / 2
    position = (position + 2) % 4 - 2

    contacts, across = assert_contacts_are_right(world_of(device, position, radius, boundary=boundary), boundary)

    assert contacts > 50
    assert across >= 5


@pytest.mark.parametrize("cell_size", [None, 0.8, 0.99, 1.0, 1.3, 1.4, 1.9, 2.0, 2.1, 4.0, 1000.0])
def test_no_contact_depends_on_the_size_of_the_cells(device, cell_size):
    random = np.random.default_rng(32)
    position, radius = random.uniform(-2, 2, (250, 3)), random.uniform(0.1, 0.4, 250)

    contacts, across = assert_contacts_are_right(world_of(device, position, radius, cell_size=cell_size))

    assert min(contacts - across, across) > 50


def partners_at_the_limit(position, radius, direction, lower, period):
    """For each sphere two partners of its size along the direction, round the ends of the box, one last bit of a
    coordinate apart: the outermost that still overlaps it as decided in double precision, and the next one out."""
    rows, axis = np.arange(len(position)), np.abs(direction).argmax(axis=1)
    target = position.astype(np.float64) + 2 * radius[:, None] * direction
    target = ((target - lower) % period + lower).astype(np.float32)
    bit = np.maximum(np.spacing(np.abs(target[rows, axis])), 2.0**-24) * np.sign(direction[rows, axis])
    steps = np.arange(-64, 65)
    candidates = np.repeat(target[:, None], len(steps), axis=1)
    candidates[rows, :, axis] += (bit[:, None] * steps).astype(np.float32)
    candidates = np.where(candidates < lower, candidates + np.float32(period), candidates)
    candidates = np.where(candidates >= lower + period, candidates - np.float32(period), candidates)
    offset = candidates.astype(np.float64) - position[:, None]
    offset -= period * np.rint(offset / period)
    overlapping = (offset**2).sum(axis=2) < (2 * radius.astype(np.float64))[:, None] ** 2
    last = overlapping.sum(axis=1) - 1
    assert (last >= 0).all()
    assert (last < len(steps) - 1).all()
    return candidates[rows, last], candidates[rows, last + 1]


@pytest.mark.parametrize("radius", [0.01, 0.4, 1.9, 3.99])
@pytest.mark.parametrize("lower", [-8.0, 0.0])
def test_just_touching_across_faces_edges_and_corners(device, lower, radius):
    """Each pair reaches across one, two or three ends, and overlaps by the last bit of a coordinate or misses by it."""
    random = np.random.default_rng(33)
    signs = np.array([s for s in itertools.product((-1, 0, 1), repeat=3) if any(s)] * 8)
    inside = random.uniform(lower + 4, lower + 12, signs.shape)
    depth = radius * random.uniform(0.01, 0.5, signs.shape)
    place = np.select([signs < 0, signs > 0], [lower + depth, lower + 16 - depth], inside).astype(np.float32)
    direction = signs * random.uniform(0.6, 1, signs.shape)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    radii = np.full(len(place), radius, np.float32)
    overlapping, touching = partners_at_the_limit(place, radii, direction, lower, 16.0)
    bounds = ((lower,) * 3, (lower + 16,) * 3)
    pairs = {(i, i + len(place)) for i in range(len(place))}
    assert (np.abs(overlapping - place).max(axis=1) > 8).mean() > 0.95  # the rest, slanted, stays inside

    for partners, meets in ((overlapping, True), (touching, False)):
        world = world_of(device, np.concatenate([place, partners]), np.tile(radii, 2), bounds)
        assert_contacts_are_right(world)
        found = set(zip(*(ids.tolist() for ids in contact_set(world)), strict=True))
        assert pairs <= found if meets else not pairs & found


def test_a_lattice_whose_neighbors_touch_all_round_has_no_contacts(device):
    position = 0.25 + 0.5 * np.stack(np.meshgrid(*[np.arange(8)] * 3), axis=-1).reshape(-1, 3) - 2
    assert world_of(device, position, np.full(512, 0.25)).contact_count() == 0

    larger = world_of(device, position, np.full(512, np.nextafter(np.float32(0.25), np.float32(1))))

    assert assert_contacts_are_right(larger) == (3 * 512, 3 * 64)


@pytest.mark.parametrize("ends", [(2, 0, 0), (2, 2, 0), (2, 2, 2)])
def test_the_two_ends_are_one_place(device, ends):
    world = world_of(device, [ends, (-ends[0], -ends[1], -ends[2])], [0.25, 0.25])
    contacts = world.contacts()

    assert contact_set(world) == ([0], [1])
    assert fc.to_numpy(contacts.gap) == [-0.5]
    assert np.linalg.norm(fc.to_numpy(contacts.normal)) == 1


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("order", [1, -1])
def test_gap_and_normal_across_an_end(device, axis, order):
    """From the first sphere to the second the short way, through the end."""
    position = np.zeros((2, 3))
    position[:, axis] = 1.875, -1.75
    expected = np.zeros(3)
    expected[axis] = order

    contacts = world_of(device, position[::order], [0.25, 0.25]).contacts()

    np.testing.assert_array_equal(fc.to_numpy(contacts.gap), [-0.125])
    np.testing.assert_array_equal(fc.to_numpy(contacts.normal), [expected])


@pytest.mark.parametrize("ratio", [1.0, 0.6])
def test_an_end_of_another_kind_does_not_join(device, ratio):
    """Spheres at both ends of each axis meet round the periodic axis alone."""
    position = np.zeros((6, 3))
    position[np.arange(6), [0, 0, 1, 1, 2, 2]] = [1.75, -1.75] * 3
    for axis, boundary in enumerate(
        [("periodic", "wall", "open"), ("open", "periodic", "wall"), ("wall", "open", "periodic")]
    ):
        first, second = contact_set(world_of(device, position, np.full(6, 0.26 * ratio + 0.1), boundary=boundary))
        assert (first.tolist(), second.tolist()) == ([2 * axis], [2 * axis + 1])


@pytest.fixture(scope="module")
def lattice_cloud():
    """Places whose translation is exact in float32."""
    random = np.random.default_rng(34)
    return random.integers(-(2**13), 2**13, (250, 3)) / 2.0**12, random.uniform(0.1, 0.4, 250).astype(np.float32)


def pairs_of(device, position, radius, **options):
    return set(zip(*(ids.tolist() for ids in contact_set(world_of(device, position, radius, **options))), strict=True))


@pytest.mark.parametrize("fraction", [2.0**-14, 0.125, 0.5, 0.75, 1 - 2.0**-14])
def test_translated_round_the_box(device, lattice_cloud, fraction):
    position, radius = lattice_cloud
    expected = pairs_of(device, position, radius)
    assert len(expected) > 250
    moved = position + 4 * fraction * np.array((1, -1, 0.5))

    assert pairs_of(device, (moved + 2) % 4 - 2, radius) == expected


@pytest.mark.parametrize("fraction", [0.1, 1 / 3, 0.7])
def test_translated_by_any_fraction(device, lattice_cloud, fraction):
    """To the rounding of the places, only pairs that just touch may come or go."""
    position, radius = lattice_cloud
    first, second, offset = overlapping_images(position, radius.astype(np.float64) + 4e-7, (4, 4, 4))
    depth = radius[first].astype(np.float64) + radius[second] - np.linalg.norm(offset, axis=1)
    possible = set(zip(first.tolist(), second.tolist(), strict=True))
    certain = set(zip(first[depth > 8e-7].tolist(), second[depth > 8e-7].tolist(), strict=True))
    moved = ((position + 4 * fraction + 2) % 4 - 2).astype(np.float32)

    assert certain <= pairs_of(device, np.where(moved >= 2, -2, moved), radius) <= possible
    assert len(possible - certain) <= 2


def test_spheres_written_outside_the_box(device, write):
    """Between two steps a user may put spheres anywhere; along a periodic axis they count where they come in again."""
    random = np.random.default_rng(35)
    position, radius = random.integers(-(2**13), 2**13, (200, 3)) / 2.0**12, random.uniform(0.1, 0.4, 200)
    world = world_of(device, position, radius)
    expected = [ids.tolist() for ids in contact_set(world)]
    write(world.positions, position + 4.0 * random.integers(-2, 3, position.shape))

    assert [ids.tolist() for ids in contact_set(world)] == expected
    assert world.contact_count() == len(expected[0]) > 100


# --- Open axes ---


@pytest.mark.parametrize("far", [-1, 1])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("boundary", ["open", "one open"])
def test_pairs_at_the_limit_of_reach(device, boundary, axis, far):
    """Out to 131,072 radii, where a cell number of 65,536 leaves 7 bits to its fraction: pairs along the axis that
    overlap by as little as the resolution there allows."""
    names = "open" if boundary == "open" else tuple("open" if i == axis else "wall" for i in range(3))
    random = np.random.default_rng(36)
    radius = np.float32(0.1)
    reach = 131072 * radius
    inner = far * random.uniform(0.75, 0.9999, 2000).astype(np.float32) * reach
    outer = inner + np.float32(far) * 2 * radius
    width = np.abs(outer.astype(np.float64) - inner)
    outer = np.where(width < 2 * np.float64(radius), outer, np.nextafter(outer, np.float32(0)))
    place = np.zeros((2000, 3), np.float32)
    place[:, (axis + 1) % 3] = np.arange(2000) % 40 * 0.45 - 9
    place[:, (axis + 2) % 3] = np.arange(2000) // 40 % 40 * 0.45 - 9
    partner = place.copy()
    place[:, axis], partner[:, axis] = inner, outer
    bounds = ((-10.0,) * 3, (10.0,) * 3)

    world = world_of(device, np.concatenate([place, partner]), np.full(4000, radius), bounds, names)
    found = set(zip(*(ids.tolist() for ids in contact_set(world)), strict=True))

    assert {(i, i + 2000) for i in range(2000)} <= found
    assert world.contact_count() == len(found)
    gap = fc.to_numpy(world.contacts().gap)
    assert gap.min() >= -2 * radius
    assert gap.max() <= 0


@pytest.mark.parametrize("boundary", ["open", ("open", "wall", "open"), ("open", "open", "periodic")])
def test_far_clouds_with_the_same_cell_numbers(device, boundary):
    """Numbers of open cells repeat after 3 · 2ⁿ, at most 768, cells of 1 m: each clone has the contacts of the first,
    and none of another's."""
    random = np.random.default_rng(37)
    count = 80
    position = random.integers(-(2**9), 2**9, (count, 3)) / 2.0**9
    radius = random.uniform(0.05, 0.35, count).astype(np.float32)
    is_open = np.array((boundary,) * 3 if isinstance(boundary, str) else boundary) == "open"
    shifts = [(0, 0, 0), (768, 0, 0), (-768, 0, 0), (768, 0, -768), (1536, 0, 768), (0, 0, -1536), (-6144, 0, 6144)]
    shifts = np.unique(np.array(shifts) * is_open, axis=0)
    everything = (position + shifts[:, None]).reshape(-1, 3)
    first, second, _ = overlapping_images(position, radius, period_of(CUBE, boundary))
    assert len(first) > 100

    world = world_of(device, everything, np.tile(radius, len(shifts)), boundary=boundary, cell_size=1.0)

    expected = [(i + count * k, j + count * k) for k in range(len(shifts)) for i, j in zip(first, second, strict=True)]
    assert sorted(zip(*contact_set(world), strict=True)) == sorted(expected)


@pytest.mark.parametrize("shift", [2.0**-10, -1.0, 100.0, -(2.0**12)])
def test_translated_along_open_axes(device, shift):
    random = np.random.default_rng(38)
    position = random.integers(-(2**10), 2**10, (250, 3)) / 2.0**9
    radius = random.uniform(0.1, 0.4, 250).astype(np.float32)
    expected = pairs_of(device, position, radius, boundary="open")
    assert len(expected) > 200

    assert pairs_of(device, position + shift * np.array((1, -2, 0.5)), radius, boundary="open") == expected


@pytest.mark.parametrize("scale", [2.0**-47, 2.0**48])
def test_spheres_of_any_size_in_the_open(device, scale):
    """As small and as large as a radius may be; the squares of their distances leave the range of float32."""
    random = np.random.default_rng(39)
    position = np.concatenate([random.uniform(-2, 2, (120, 3)), [(60_000, 0, 0), (0, -60_000, 0)]])
    world = world_of(device, position * scale, np.full(122, 0.5 * scale), boundary="open")

    first, second, _ = overlapping_images(
        fc.to_numpy(world.positions), fc.to_numpy(world.radii).astype(np.float64), (0, 0, 0)
    )
    assert len(first) > 100
    np.testing.assert_array_equal(contact_set(world), (first, second))


# Coordinates of a coarse lattice among them, where spheres touch, coincide and lie on ends and borders of cells.
coordinates = st.one_of(
    st.floats(-2, 2, width=32), st.integers(-8, 8).map(lambda i: i / 4), st.integers(-20, 20).map(lambda i: i / 10)
)
radii = st.one_of(st.floats(0.0625, 1, width=32), st.sampled_from([0.125, 0.25, 0.5, 0.1, 0.4, 1.0]))


@settings(max_examples=200)
@given(
    spheres=st.lists(st.tuples(coordinates, coordinates, coordinates, radii), max_size=16),
    boundary=st.sampled_from(COMBINATIONS),
    cell_size=st.sampled_from([None, 2.0, 2.5, 4.0]),
)
def test_any_small_cloud(device, spheres, boundary, cell_size):
    numbers = np.array(spheres, np.float32).reshape(-1, 4)

    assert_contacts_are_right(
        world_of(device, numbers[:, :3], numbers[:, 3], boundary=boundary, cell_size=cell_size), boundary
    )
