"""The examples of docs/search.md run and give what the text says."""

import re
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest

TEXT = (Path(__file__).parent.parent.parent / "docs" / "search.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)


def run(number):
    names = {}
    exec(EXAMPLES[number], names)
    return names


def test_there_are_four_examples():
    assert len(EXAMPLES) == 4


def test_the_first_look(capsys):
    names = run(0)
    assert str(len(names["contacts"])) == capsys.readouterr().out.splitlines()[0]
    assert len(names["contacts"]) > 1000


def test_from_scipy():
    spatial = pytest.importorskip("scipy.spatial")
    names = run(1)
    expected = spatial.cKDTree(names["points"]).query_pairs(0.5, output_type="ndarray")
    expected = expected[np.lexsort(expected.T[::-1])]
    np.testing.assert_array_equal(names["pairs"], expected)


def test_from_torch_cluster(capsys):
    names = run(2)
    points, (neighbor, center) = names["points"].astype(np.float64), names["edge_index"]
    distance = np.linalg.norm(points[:, None] - points[None, :], axis=2)
    np.fill_diagonal(distance, np.inf)
    assert len(neighbor) == np.count_nonzero(distance <= 0.5) > 1000
    assert (distance[neighbor, center] <= 0.5).all()
    assert capsys.readouterr().out == "0\n"


def test_from_warp():
    names = run(3)
    points = names["points"].astype(np.float64)
    distance = np.linalg.norm(points - points[17], axis=1)
    distance[17] = np.inf
    np.testing.assert_array_equal(names["nearest_of_17"], np.flatnonzero(distance <= 0.5))
    assert names["density"][17] == pytest.approx((1 - distance[distance <= 0.5] / 0.5).sum(), rel=1e-5)


def test_what_the_page_says_of_outputs():
    outputs = re.findall(r'^\| `"(\w+)"` \|', TEXT, flags=re.MULTILINE)
    for output in outputs:
        fc.find_contacts(np.zeros((2, 3)), 1.0, output=output)
    assert len(outputs) == 5
