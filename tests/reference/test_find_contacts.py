"""find_contacts against the oracle: no contact is missed, none is invented, whatever the cloud, the type, the form."""

import fastcollide as fc
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.all_pairs import GOLDEN_SETS, boundary_partners, golden_cloud, pair_hash, pairs_within
from reference.gpu_finder import GpuFinder, no_gpu

TYPES = [np.float32, np.float64]
each_type = pytest.mark.parametrize("dtype", TYPES, ids=lambda dtype: dtype.__name__)


@pytest.fixture(scope="module", params=["generic", "none", "avx2", "avx512", pytest.param("cuda", marks=no_gpu)])
def finder(request):
    """The form that a GPU runs, the CPU's at each width of its vector units (or the widest there is), and a GPU."""
    if request.param == "cuda":
        yield GpuFinder()
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FASTCOLLIDE_SIMD", request.param)
        finder = fc.ContactFinder(threads=2)
        if request.param == "generic":
            finder._finder.use_generic_form(True)
        for dtype in TYPES:  # the choice is made with the first call
            finder.find_contacts(np.zeros((2, 3), dtype), 1.0)
        yield finder


def search(finder, position, radius, margin=0.0, others=None, lower=None, upper=None, output="contacts"):
    """find_contacts in the words of the oracle."""
    options = {}
    if others is not None:
        options = {"other_positions": others[0], "other_radii": others[1]}
    if lower is not None:
        periodic = np.isfinite(np.subtract(upper, lower))
        options["boundary"] = tuple("periodic" if one else "open" for one in periodic)
        options["bounds"] = (tuple(np.nan_to_num(lower)), tuple(np.nan_to_num(upper)))
    return finder.find_contacts(position, radius, margin, output=output, **options)


def assert_right(finder, position, radius, margin=0.0, others=None, lower=None, upper=None):
    """Every output says what the oracle says, in order; gaps and normals are those of double precision, rounded."""
    position = np.asarray(position)
    radii = np.broadcast_to(radius, len(position))
    expected = pairs_within(position, radii, margin, others, lower, upper)
    question = (finder, position, radius, margin, others, lower, upper)

    found = search(*question)

    assert found.first.dtype == found.second.dtype == np.int32
    assert found.gap.dtype == found.normal.dtype == position.dtype
    assert found.normal.shape == (len(expected), 3)
    np.testing.assert_array_equal(np.stack([found.first, found.second], axis=1), expected)
    pairs = search(*question, output="pairs")
    np.testing.assert_array_equal(np.stack([pairs.first, pairs.second], axis=1), expected)
    assert search(*question, output="total") == len(expected)

    both = expected if others is not None else np.concatenate([expected, expected[:, ::-1]])
    both = both[np.lexsort(both.T[::-1])]
    counts = np.bincount(both[:, 0], minlength=len(position))
    np.testing.assert_array_equal(search(*question, output="counts"), counts)
    rows = search(*question, output="neighbors")
    np.testing.assert_array_equal(rows.offsets, np.concatenate([[0], np.cumsum(counts)]))
    np.testing.assert_array_equal(rows.indices, both[:, 1])

    to, to_radii = (position, radii) if others is None else others
    to_radii = np.broadcast_to(to_radii, len(to)).astype(np.float64)
    offset = np.asarray(to, np.float64)[found.second] - position.astype(np.float64)[found.first]
    if lower is not None:
        period = np.nan_to_num(np.subtract(upper, lower), nan=0.0)
        offset -= np.where(offset > period / 2, period, 0) * (period > 0)
        offset += np.where(offset < -period / 2, period, 0) * (period > 0)
    distance = np.sqrt((offset * offset).sum(axis=1))
    reach = radii.astype(np.float64)[found.first] + to_radii[found.second]
    epsilon = np.finfo(position.dtype).eps
    assert (np.abs(found.gap - (distance - reach)) <= 2 * epsilon * (reach + margin)).all()
    assert (np.abs(np.linalg.norm(found.normal.astype(np.float64), axis=1) - 1) <= 4 * epsilon).all()
    apart = distance > 1e-150
    assert (np.abs(found.normal[apart] - offset[apart] / distance[apart, None]) <= 4 * epsilon).all()
    assert (found.normal[~apart] == (-1, 0, 0)).all()
    return len(expected)


@each_type
@pytest.mark.parametrize("name", GOLDEN_SETS)
def test_golden_sets(finder, name, dtype):
    position, radius = golden_cloud(name)
    _, pairs, golden_hash = GOLDEN_SETS[name]

    found = finder.find_contacts(position.astype(dtype), radius.astype(dtype))

    assert (len(found), pair_hash(found.first, found.second)) == (pairs, golden_hash)


def test_a_golden_set_with_one_radius_for_all(finder):
    position, _ = golden_cloud("radii 0.4")
    _, pairs, golden_hash = GOLDEN_SETS["radii 0.4"]
    found = finder.find_contacts(position, 0.4)
    assert (len(found), pair_hash(found.first, found.second)) == (pairs, golden_hash)


@each_type
def test_mixed_sizes_in_full(finder, dtype):
    random = np.random.default_rng(1)
    position = random.uniform(-3, 3, (2500, 3)).astype(dtype)
    radius = (0.004 * 200.0 ** random.uniform(0, 1, 2500)).astype(dtype)
    assert assert_right(finder, position, radius) > 5000


@each_type
@pytest.mark.parametrize("margin", [0.03, 0.5])
def test_margin(finder, dtype, margin):
    random = np.random.default_rng(2)
    position = random.uniform(0, 4, (800, 3)).astype(dtype)
    radius = random.choice([0.0, 0.01, 0.1, 0.3], 800).astype(dtype)
    assert assert_right(finder, position, radius, margin) > 500
    assert assert_right(finder, position, 0.1, margin) > 200


@each_type
@pytest.mark.parametrize("sizes", [(0.01, 1.0), (1.0, 0.01), (0.0, 0.3)])
def test_two_sets(finder, dtype, sizes):
    random = np.random.default_rng(3)
    first, second = (random.uniform(-4, 4, (n, 3)).astype(dtype) for n in (700, 900))
    radii = [
        (size * random.uniform(0.5, 1, len(x))).astype(dtype) for size, x in zip(sizes, (first, second), strict=True)
    ]
    assert assert_right(finder, first, radii[0], 0.02, (second, radii[1])) > 50
    assert assert_right(finder, first, sizes[0], 0.02, (second, radii[1])) > 50
    assert assert_right(finder, first + dtype(6), radii[0], 0.0, (second, sizes[1])) >= 0


def test_two_sets_of_which_one_is_empty(finder):
    some, none = np.zeros((3, 3)), np.empty((0, 3))
    for first, second in ((some, none), (none, some), (none, none)):
        found = search(finder, first, 1.0, others=(second, 1.0))
        assert len(found) == 0
        assert found.normal.shape == (0, 3)
        assert len(search(finder, first, 1.0, others=(second, 1.0), output="counts")) == len(first)
        assert (search(finder, first, 1.0, others=(second, 1.0), output="neighbors").offsets == 0).all()


@each_type
@pytest.mark.parametrize("axes", [(1, 1, 1), (0, 1, 0), (1, 0, 1)])
@pytest.mark.parametrize("corner", [-1.5, 40.0])
def test_periodic_axes(finder, dtype, axes, corner):
    random = np.random.default_rng(4)
    radius = (0.02 * 20.0 ** random.uniform(0, 1, 600)).astype(dtype)
    lower = np.where(axes, corner, np.nan)
    upper = lower + 3.0
    position = (corner + random.uniform(0, 3, (600, 3))).astype(dtype)
    position = np.clip(position, corner, corner + 3.0).astype(dtype)
    position[:8] = [[corner + 3.0 * ((i >> axis) & 1) for axis in range(3)] for i in range(8)]  # all the corners
    assert assert_right(finder, position, radius, 0.0, None, lower, upper) > 300
    others = (position[::2].copy(), radius[::2].copy())
    assert assert_right(finder, position[1::2].copy(), 0.2, 0.05, others, lower, upper) > 300


@each_type
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_contacts_across_the_end_of_a_period_are_decided_in_double_precision(finder, dtype, axis):
    """Pairs whose distance is the reach to within some last bits of their coordinates, far larger than the reach."""
    random = np.random.default_rng(16)
    reach = 0.0101
    other = 0.05 * np.stack(np.meshgrid(np.arange(25), np.arange(25)), axis=-1).reshape(-1, 2) - 0.6
    inside = (-1.5 + random.uniform(0, 0.003, len(other))).astype(np.float32)
    across = (inside + 1.5 - reach + 1.5).astype(np.float32)
    across += random.integers(-3, 4, len(other)).astype(np.float32) * np.spacing(np.float32(1.4))
    position = np.insert(np.tile(other, (2, 1)).astype(np.float32), axis, np.concatenate([inside, across]), axis=1)
    lower = np.where(np.arange(3) == axis, -1.5, np.nan)
    found = assert_right(finder, position.astype(dtype), reach / 2, 0.0, None, lower, lower + 3)
    assert 0.3 * len(other) < found < 0.7 * len(other)


@each_type
@pytest.mark.parametrize("reach", [0.74, 0.1])
def test_a_period_of_few_cells(finder, dtype, reach):
    random = np.random.default_rng(5)
    position = random.uniform(0, 1.5, (300, 3)).astype(dtype)
    assert assert_right(finder, position, reach / 2, 0.0, None, np.zeros(3), np.full(3, 1.5)) > 30


@each_type
def test_equal_spheres_that_just_touch(finder, dtype):
    """Pairs in all directions that overlap by the last bit of a coordinate or miss each other by it."""
    random = np.random.default_rng(6)
    sites = 3.0 * np.stack(np.meshgrid(*[np.arange(9)] * 3), axis=-1).reshape(-1, 3) - 12
    position = (sites + random.uniform(-0.25, 0.25, sites.shape)).astype(np.float32)
    direction = random.normal(size=sites.shape)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    radius = np.full(len(position), 0.4, np.float32)
    overlapping, touching = boundary_partners(position, radius, direction)
    both = np.concatenate([radius, radius]).astype(dtype)

    near = np.concatenate([position, overlapping]).astype(dtype)
    assert assert_right(finder, near, both) == len(position)
    assert assert_right(finder, np.concatenate([position, touching]).astype(dtype), both) == 0
    # One number for all radii, and the same reach as a margin around points.
    assert assert_right(finder, near, float(np.float32(0.4))) == len(position)
    assert assert_right(finder, near, 0.0, 2 * float(np.float32(0.4))) == len(position)


def test_float64_is_decided_in_double_precision(finder):
    """Gaps of the last bit of float64, far below that of float32."""
    random = np.random.default_rng(7)
    reach = 0.5
    position = 3.0 * np.arange(600).reshape(-1, 1) * np.array([[1.0, 0, 0]])
    nearer = position + np.array([[0, 0, np.nextafter(reach, 0)]])
    beyond = position + np.array([[0, np.nextafter(reach, 1), 0]])
    order = random.permutation(3 * len(position))
    everything = np.concatenate([position, nearer, beyond])[order]
    expected = pairs_within(everything, np.full(len(everything), reach / 2))
    assert len(expected) == 600
    assert assert_right(finder, everything, reach / 2) == 600


@each_type
def test_a_lattice_whose_neighbors_touch_has_no_contacts(finder, dtype):
    position = (0.25 + 0.5 * np.stack(np.meshgrid(*[np.arange(32)] * 3), axis=-1).reshape(-1, 3)).astype(dtype)
    assert finder.find_contacts(position, 0.25, output="total") == 0
    larger = np.full(len(position), np.nextafter(dtype(0.25), dtype(1)))
    found = finder.find_contacts(position, larger)
    assert len(found) == 3 * 32 * 32 * 31
    assert set(np.abs(position[found.second] - position[found.first]).sum(axis=1)) == {0.5}


@each_type
@pytest.mark.parametrize("radius", [0.375, 0.3, 0.05])
def test_centers_on_the_borders_of_cells(finder, dtype, radius):
    """Steps of the reach from the lowest centre: each on a border of cells or next to one, its partner at the limit."""
    border = np.float32(2 * radius) * np.arange(-8, 9, 2, dtype=np.float32)
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
    everything = np.concatenate([position, overlapping, touching]).astype(dtype)

    assert assert_right(finder, everything, np.tile(radii, 3).astype(dtype)) >= len(position)


@each_type
def test_zero_and_negative_zero_are_one_place(finder, dtype):
    tiny = np.finfo(dtype).smallest_subnormal
    position = [(x, y, z) for x in (0.0, -0.0, tiny, -tiny) for y in (0.0, -0.0) for z in (-0.0, tiny)]
    count = len(position)
    assert assert_right(finder, np.array(position, dtype), 0.25) == count * (count - 1) // 2


@each_type
def test_coincident_centers(finder, dtype):
    assert assert_right(finder, np.full((128, 3), 1.5, dtype), 0.25) == 8128
    assert assert_right(finder, np.full((128, 3), 1.5, dtype), 0.0) == 0


def test_more_pairs_than_32_bits_can_count():
    position = np.full((65_537, 3), 1.5, np.float32)
    assert fc.find_contacts(position, 0.25, output="total") == 65_537 * 65_536 // 2 > 2**31
    assert (fc.find_contacts(position[:5000], 0.25, output="counts") == 4999).all()


@pytest.mark.parametrize("size", [2, 3, 4, 9, 16, 17, 18, 32, 33, 34, 60])
def test_rows_of_any_length(finder, size):
    """Each sphere touches all others of its cluster: rows of the same length, which is how they are sorted."""
    center = np.stack(np.unravel_index(np.arange(40), (4, 5, 2)), axis=1)
    position = np.random.default_rng(size).permutation(np.repeat(center, size, axis=0)).astype(np.float32)
    assert assert_right(finder, position, 0.25) == 40 * size * (size - 1) // 2


@pytest.mark.parametrize("count", [2_000, 2_097_152, 2_120_000])
def test_pairs_of_up_to_so_many_spheres_that_two_ids_need_more_than_32_bits(count):
    ids = np.random.default_rng(5).permutation(count).astype(np.int32).reshape(-1, 2)  # two that touch, in each row
    place = np.stack(np.unravel_index(np.arange(len(ids)), (110, 110, 110)), axis=1).astype(np.float32)
    position = np.empty((count, 3), np.float32)
    position[ids[:, 0]] = place
    position[ids[:, 1]] = place + np.float32(0.125)
    finder = fc.ContactFinder(threads=2)

    pairs = finder.find_contacts(position, 0.125, output="pairs")
    rows = finder.find_contacts(position, np.full(count, 0.125, np.float32), output="neighbors")

    expected = np.sort(ids, axis=1)
    expected = expected[np.argsort(expected[:, 0])]
    np.testing.assert_array_equal(np.stack([pairs.first, pairs.second], axis=1), expected)
    partner = np.empty(count, np.int32)
    partner[ids] = ids[:, ::-1]
    np.testing.assert_array_equal(rows.offsets, np.arange(count + 1))
    np.testing.assert_array_equal(rows.indices, partner)


def test_a_list_longer_than_the_limit_is_refused(finder):
    position = np.full((6000, 3), 1.5, np.float32)
    with pytest.raises(fc.OutOfMemory, match=r"max_contacts: found 17997000 contacts; allowed: at most 5000000"):
        finder.find_contacts(position, 0.25, max_contacts=5_000_000)
    with pytest.raises(fc.OutOfMemory, match=r"found 15 contacts; allowed: at most 14"):
        finder.find_contacts(position[:6], 0.25, max_contacts=14, output="pairs")
    assert len(finder.find_contacts(position[:6], 0.25, max_contacts=15)) == 15  # and goes on


@each_type
def test_size_ratio_of_a_thousand(finder, dtype):
    random = np.random.default_rng(8)
    direction = random.normal(size=(3000, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    position = np.concatenate([[(0, 0, 0)], direction * random.uniform(1.0005, 1.0015, (3000, 1))])
    radius = np.concatenate([[1.0], np.full(3000, 0.001)])
    assert assert_right(finder, position.astype(dtype), radius.astype(dtype)) > 1000


@each_type
def test_one_sphere_larger_than_everything(finder, dtype):
    random = np.random.default_rng(9)
    position = random.uniform(-1, 1, (1500, 3)).astype(dtype)
    radius = random.uniform(0.02, 0.06, 1500).astype(dtype)
    radius[700] = 3.5
    assert assert_right(finder, position, radius) > 1499


@each_type
def test_ratio_of_a_million(finder, dtype):
    random = np.random.default_rng(10)
    radius = (10.0 ** random.uniform(-3, 3, 1200)).astype(dtype)
    position = (random.normal(size=(1200, 3)) * radius[:, None] * 3).astype(dtype)
    assert assert_right(finder, position, radius) > 1000


@each_type
def test_clusters_far_apart(finder, dtype):
    """The range has far more cells than there are spheres: cells go round."""
    random = np.random.default_rng(11)
    center = random.uniform(-2000, 2000, (40, 3))
    position = (center[random.integers(0, 40, 1500)] + random.uniform(-0.5, 0.5, (1500, 3))).astype(dtype)
    assert assert_right(finder, position, random.uniform(0.02, 0.1, 1500).astype(dtype)) > 100


@each_type
@pytest.mark.parametrize("flat", [(0,), (1,), (2,), (0, 1), (1, 2)])
def test_spheres_in_a_plane_or_on_a_line(finder, dtype, flat):
    random = np.random.default_rng(12)
    position = random.uniform(0, 10, (500, 3))
    position[:, list(flat)] = 4.0
    assert assert_right(finder, position.astype(dtype), random.uniform(0.05, 0.3, 500).astype(dtype)) > 50


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_few_spheres(finder, count):
    assert assert_right(finder, np.zeros((count, 3)), 1.0) == count * (count - 1) // 2
    assert assert_right(finder, np.eye(3)[:count], np.full(count, 0.1)) == 0


def test_threads_change_nothing():
    random = np.random.default_rng(13)
    position = random.uniform(0, 20, (20_000, 3)).astype(np.float32)
    radius = random.uniform(0.05, 0.4, 20_000).astype(np.float32)
    expected = fc.ContactFinder(1).find_contacts(position, radius)
    assert len(expected) > 10_000
    for threads in (2, 3, 7):
        found = fc.ContactFinder(threads).find_contacts(position, radius)
        for name in ("first", "second", "gap", "normal"):
            assert getattr(found, name).tobytes() == getattr(expected, name).tobytes()


def test_world_and_library_find_the_same():
    world = fc.World(device="cpu")
    world.add(fc.random_spheres(5000, seed=3))
    expected = world.contacts()
    found = fc.find_contacts(world.positions, world.radii)
    assert len(found) > 100
    np.testing.assert_array_equal(found.first, expected.first)
    np.testing.assert_array_equal(found.second, expected.second)


# --- The set does not depend on how the cloud is told: numbers chosen so that each change is exact ---


@pytest.fixture(scope="module")
def cloud():
    random = np.random.default_rng(14)
    position = (random.integers(-3 * 2**12, 3 * 2**12, (1200, 3)) / 2.0**12).astype(np.float32)
    return position, (0.02 * 20.0 ** random.uniform(0, 1, 1200)).astype(np.float32)


def pairs_of(finder, position, radius):
    found = finder.find_contacts(position, radius, output="pairs")
    return set(zip(found.first.tolist(), found.second.tolist(), strict=True))


@pytest.fixture(scope="module")
def cloud_pairs(finder, cloud):
    pairs = pairs_of(finder, *cloud)
    assert len(pairs) > 300
    return pairs


def test_permuted(finder, cloud, cloud_pairs):
    position, radius = cloud
    order = np.random.default_rng(15).permutation(len(radius))
    pairs = pairs_of(finder, position[order], radius[order])
    assert {tuple(sorted((int(order[i]), int(order[j])))) for i, j in pairs} == cloud_pairs


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_mirrored(finder, cloud, cloud_pairs, axis):
    mirror = np.ones(3, np.float32)
    mirror[axis] = -1
    assert pairs_of(finder, cloud[0] * mirror, cloud[1]) == cloud_pairs


@pytest.mark.parametrize("distance", [2.0**-12, 0.5, 64.0, 1024.0])
def test_translated(finder, cloud, cloud_pairs, distance):
    assert pairs_of(finder, cloud[0] + np.float32([distance, -distance, 0]), cloud[1]) == cloud_pairs


@pytest.mark.parametrize("exponent", [-40, -1, 1, 40])
def test_scaled(finder, cloud, cloud_pairs, exponent):
    scale = np.float32(2.0**exponent)
    assert pairs_of(finder, cloud[0] * scale, cloud[1] * scale) == cloud_pairs


def test_a_far_copy_has_the_same_pairs_and_no_others(finder, cloud, cloud_pairs):
    position, radius = cloud
    count = len(radius)
    pairs = pairs_of(
        finder, np.concatenate([position, position + np.float32([1024, 0, 0])]), np.concatenate([radius, radius])
    )
    assert pairs == cloud_pairs | {(i + count, j + count) for i, j in cloud_pairs}


def test_split_in_two_sets(finder, cloud, cloud_pairs):
    position, radius = cloud
    half = len(radius) // 2
    within = [pairs_of(finder, position[part], radius[part]) for part in (slice(half), slice(half, None))]
    across = finder.find_contacts(
        position[:half], radius[:half], other_positions=position[half:], other_radii=radius[half:], output="pairs"
    )
    together = within[0] | {(i + half, j + half) for i, j in within[1]}
    together |= set(zip(across.first.tolist(), (across.second + half).tolist(), strict=True))
    assert together == cloud_pairs


# Coordinates of a coarse lattice among them, where spheres touch, coincide and lie on borders of cells.
coordinates = st.one_of(
    st.floats(-2, 2, width=32), st.integers(-8, 8).map(lambda i: i / 4), st.integers(-20, 20).map(lambda i: i / 10)
)
radii = st.one_of(
    st.floats(0.0625, 0.75, width=32), st.sampled_from([0.125, 0.25, 0.5, 0.1, 0.4, 2.0**-10, 2.0**-16, 0.0])
)
clouds = st.lists(st.tuples(coordinates, coordinates, coordinates, radii), max_size=20)


@settings(max_examples=150)
@given(
    spheres=clouds,
    others=st.none() | clouds,
    margin=st.sampled_from([0.0, 0.1, 0.25]),
    periodic=st.tuples(*[st.booleans()] * 3),
    dtype=st.sampled_from(TYPES),
)
def test_any_small_cloud(finder, spheres, others, margin, periodic, dtype):
    def arrays(numbers):
        numbers = np.array(numbers, dtype).reshape(-1, 4)
        return numbers[:, :3], numbers[:, 3]

    lower = np.where(periodic, -2.0, np.nan)
    assert_right(finder, *arrays(spheres), margin, None if others is None else arrays(others), lower, lower + 4.0)
