"""The examples of docs/contact_search.md run and give what the text says."""

import re
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest

TEXT = (Path(__file__).parent.parent.parent / "docs" / "contact_search.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)


def run(number):
    names = {}
    exec(EXAMPLES[number], names)
    return names


def test_there_are_five_examples():
    assert len(EXAMPLES) == 5


def test_the_first_look(capsys):
    names = run(0)
    assert str(len(names["contacts"])) == capsys.readouterr().out.splitlines()[0]
    assert len(names["contacts"]) > 1000


def test_many_calls(capsys):
    names = run(1)
    assert 30 < int(capsys.readouterr().out) < 50
    expected = fc.find_contacts(names["positions"], names["radii"])
    assert names["contacts"].first.tobytes() == expected.first.tobytes()
    assert names["contacts"].gap.tobytes() == expected.gap.tobytes()


def test_from_scipy():
    names = run(2)
    spatial = pytest.importorskip("scipy.spatial")
    expected = spatial.cKDTree(names["points"]).query_pairs(0.5, output_type="ndarray")
    expected = expected[np.lexsort(expected.T[::-1])]
    np.testing.assert_array_equal(names["pairs"], expected)


def test_from_torch_cluster(capsys):
    names = run(3)
    points, (neighbor, center) = names["points"].astype(np.float64), names["edge_index"]
    distance = np.linalg.norm(points[:, None] - points[None, :], axis=2)
    np.fill_diagonal(distance, np.inf)
    assert len(neighbor) == np.count_nonzero(distance <= 0.5) > 1000
    assert (distance[neighbor, center] <= 0.5).all()
    assert capsys.readouterr().out == "0\n"


def test_torch_cluster_itself_agrees():
    torch_cluster = pytest.importorskip("torch_cluster")
    torch = pytest.importorskip("torch")
    names = run(3)
    points = torch.from_numpy(names["points"])

    edges = torch_cluster.radius_graph(points, r=0.5, max_num_neighbors=32).numpy()

    # Grouped by the centre, which alone tells the two rows of a symmetric graph apart.
    assert (np.diff(edges[1]) >= 0).all()
    np.testing.assert_array_equal(names["edge_index"], edges[:, np.lexsort(edges)])

    queries = points[:500] * 0.9
    edges = torch_cluster.radius(points, queries, r=0.5, max_num_neighbors=64).numpy()  # query, point
    found = fc.find_neighbors(points, 0.5, queries=queries)
    np.testing.assert_array_equal(np.repeat(np.arange(500), np.diff(found.offsets)), edges[0])
    np.testing.assert_array_equal(found.indices, edges[1][np.lexsort(edges[::-1])])
    assert len(found.indices) > 500


def test_from_warp():
    names = run(4)
    points = names["points"].astype(np.float64)
    distance = np.linalg.norm(points - points[17], axis=1)
    distance[17] = np.inf
    np.testing.assert_array_equal(names["nearest_of_17"], np.flatnonzero(distance <= 0.5))
    assert names["density"][17] == pytest.approx((1 - distance[distance <= 0.5] / 0.5).sum(), rel=1e-5)


def test_warp_itself_agrees():
    wp = pytest.importorskip("warp")

    @wp.kernel(module="unique")
    def count(grid: wp.uint64, x: wp.array(dtype=wp.vec3), radius: float, counts: wp.array(dtype=int)):
        i = wp.hash_grid_point_id(grid, wp.tid())
        query = wp.hash_grid_query(grid, x[i], radius)
        j = int(0)  # noqa: UP018, RUF046 (Warp's way to declare a variable that changes)
        while wp.hash_grid_query_next(query, j):
            if j != i and wp.length(x[j] - x[i]) <= radius:
                wp.atomic_add(counts, i, 1)

    names = run(4)
    with wp.ScopedDevice("cpu"):
        grid, x = wp.HashGrid(32, 32, 32), wp.array(names["points"], dtype=wp.vec3)
        counts = wp.zeros(len(x), dtype=int)
        grid.build(x, 0.5)
        wp.launch(count, len(x), [grid.id, x, 0.5, counts])
    # Warp decides in single precision: one pair at the limit may turn.
    assert np.abs(counts.numpy() - np.diff(names["found"].offsets)).sum() <= 2
    assert counts.numpy().sum() > 5000


def test_what_the_page_says_of_outputs():
    outputs = re.findall(r'^\| `"(\w+)"` \|', TEXT, flags=re.MULTILINE)
    for output in outputs:
        fc.find_contacts(np.zeros((2, 3)), 1.0, output=output)
    assert len(outputs) == 5
