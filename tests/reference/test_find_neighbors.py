"""find_neighbors against the oracle, and against SciPy where it is installed."""

import fastcollide as fc
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference.all_pairs import pairs_within
from reference.gpu_finder import GpuFinder, no_gpu

TYPES = [np.float32, np.float64]
each_type = pytest.mark.parametrize("dtype", TYPES, ids=lambda dtype: dtype.__name__)


@pytest.fixture(scope="module", params=["generic", "fast", pytest.param("cuda", marks=no_gpu)])
def finder(request):
    if request.param == "cuda":
        return GpuFinder()
    finder = fc.ContactFinder(threads=2)
    finder._finder.use_generic_form(request.param == "generic")
    return finder


def expected_rows(points, radius, queries=None, lower=None, upper=None):
    """Rows and columns of all neighbours, ordered, with their distances."""
    points = np.asarray(points, np.float64)
    none = np.zeros(len(points))
    if queries is None:
        once = pairs_within(points, none, radius, None, lower, upper, inclusive=True)
        rows = np.concatenate([once, once[:, ::-1]])
        queries = points
    else:
        queries = np.asarray(queries, np.float64)
        rows = pairs_within(queries, np.zeros(len(queries)), radius, (points, none), lower, upper, inclusive=True)
    rows = rows[np.lexsort(rows.T[::-1])]
    offset = points[rows[:, 1]] - queries[rows[:, 0]]
    if lower is not None:
        period = np.nan_to_num(np.subtract(upper, lower))
        offset -= period * (offset > period / 2) * (period > 0)
        offset += period * (offset < -period / 2) * (period > 0)
    return rows, (offset * offset).sum(axis=1)


def assert_right(finder, points, radius, queries=None, lower=None, upper=None):
    options = {}
    if lower is not None:
        options["boundary"] = tuple("periodic" if one else "open" for one in np.isfinite(np.subtract(upper, lower)))
        options["bounds"] = (tuple(np.nan_to_num(lower)), tuple(np.nan_to_num(upper)))
    rows, squared = expected_rows(points, radius, queries, lower, upper)
    count = len(points if queries is None else queries)
    offsets = np.concatenate([[0], np.cumsum(np.bincount(rows[:, 0], minlength=count))])

    found = finder.find_neighbors(points, radius, queries, **options)
    assert (found.offsets.dtype, found.indices.dtype, len(found)) == (np.int64, np.int32, count)
    assert found.distances is None
    assert found.shortened_rows == 0
    np.testing.assert_array_equal(found.offsets, offsets)
    np.testing.assert_array_equal(found.indices, rows[:, 1])

    dtype = np.asarray(points).dtype
    epsilon = np.finfo(dtype).eps
    for name, expected in (("squared", squared), ("euclidean", np.sqrt(squared))):
        found = finder.find_neighbors(points, radius, queries, distances=name, **options)
        assert found.distances.dtype == dtype
        np.testing.assert_allclose(found.distances, expected, rtol=2 * epsilon, atol=0)
        np.testing.assert_array_equal(found.indices, rows[:, 1])

    distances = finder.find_neighbors(points, radius, queries, distances="squared", **options).distances
    by_distance = np.lexsort((rows[:, 1], distances, rows[:, 0]))
    found = finder.find_neighbors(points, radius, queries, distances="squared", sort="distance", **options)
    np.testing.assert_array_equal(found.indices, rows[by_distance, 1])
    np.testing.assert_array_equal(found.distances, distances[by_distance])

    rank = np.arange(len(rows)) - offsets[rows[by_distance, 0]]
    for limit in (0, 1, 3, 10**6):
        kept = by_distance[rank < limit]
        for sort, order in (("distance", kept), ("index", np.sort(kept))):
            found = finder.find_neighbors(
                points, radius, queries, distances="squared", sort=sort, max_neighbors=limit, **options
            )
            assert found.shortened_rows == np.count_nonzero(np.diff(offsets) > limit)
            np.testing.assert_array_equal(np.diff(found.offsets), np.minimum(np.diff(offsets), limit))
            np.testing.assert_array_equal(found.indices, rows[order, 1])
            np.testing.assert_array_equal(found.distances, distances[order])
    return len(rows)


@each_type
def test_points_among_themselves(finder, dtype):
    points = np.random.default_rng(1).uniform(-2, 2, (700, 3)).astype(dtype)
    assert assert_right(finder, points, 0.5) > 2000


@each_type
def test_queries(finder, dtype):
    random = np.random.default_rng(2)
    points, queries = (random.uniform(-2, 2, (n, 3)).astype(dtype) for n in (700, 150))
    assert assert_right(finder, points, 0.5, queries) > 500
    assert assert_right(finder, points, 0.5, points[:50]) > 50  # at the same place as points: each finds itself


@each_type
def test_periodic(finder, dtype):
    random = np.random.default_rng(3)
    points, queries = (random.uniform(0, 3, (n, 3)).astype(dtype) for n in (400, 100))
    lower = np.array([0, np.nan, 0])
    assert assert_right(finder, points, 0.6, None, lower, lower + 3) > 1000
    assert assert_right(finder, points, 0.6, queries, lower, lower + 3) > 200


@each_type
def test_the_radius_itself_is_near_enough(finder, dtype):
    points = 0.5 * np.stack(np.meshgrid(*[np.arange(12)] * 3), axis=-1).reshape(-1, 3).astype(dtype)
    assert len(finder.find_neighbors(points, 0.5).indices) == 2 * 3 * 12 * 12 * 11
    assert len(finder.find_neighbors(points, np.nextafter(0.5, 0)).indices) == 0


def test_points_at_one_place(finder):
    found = finder.find_neighbors(np.full((50, 3), 0.25), 1e-3, distances="euclidean")
    assert (np.diff(found.offsets) == 49).all()
    assert (found.distances == 0).all()


def test_no_points(finder):
    none = np.empty((0, 3), np.float32)
    assert finder.find_neighbors(none, 1.0).offsets.tolist() == [0]
    assert finder.find_neighbors(none, 1.0, np.zeros((4, 3), np.float32)).offsets.tolist() == [0] * 5
    assert finder.find_neighbors(np.zeros((4, 3)), 1.0, np.empty((0, 3))).offsets.tolist() == [0]


@each_type
def test_scipy_agrees(finder, dtype):
    spatial = pytest.importorskip("scipy.spatial")
    random = np.random.default_rng(4)
    points, queries = (random.uniform(0, 10, (n, 3)).astype(dtype) for n in (20_000, 500))
    tree = spatial.cKDTree(points)
    once = tree.query_pairs(0.4, output_type="ndarray")
    assert len(finder.find_neighbors(points, 0.4).indices) == 2 * len(once) > 10_000
    found = finder.find_neighbors(points, 0.4, queries)
    rows = tree.query_ball_point(queries, 0.4, return_sorted=True)
    np.testing.assert_array_equal(found.indices, np.concatenate(rows))
    np.testing.assert_array_equal(np.diff(found.offsets), [len(row) for row in rows])


coordinates = st.one_of(st.floats(-2, 2, width=32), st.integers(-8, 8).map(lambda i: i / 4))
clouds = st.lists(st.tuples(coordinates, coordinates, coordinates), max_size=20)


@settings(max_examples=60)
@given(
    points=clouds,
    queries=st.none() | clouds,
    radius=st.sampled_from([0.25, 0.5, 0.75, 1.0, 1.9]),
    periodic=st.tuples(*[st.booleans()] * 3),
    dtype=st.sampled_from(TYPES),
)
def test_any_small_cloud(finder, points, queries, radius, periodic, dtype):
    lower = np.where(periodic, -2.0, np.nan)
    array = np.array(points, dtype).reshape(-1, 3)
    assert_right(
        finder, array, radius, None if queries is None else np.array(queries, dtype).reshape(-1, 3), lower, lower + 4
    )
