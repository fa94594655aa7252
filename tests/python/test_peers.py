"""`fastcollide bench --peers`: every search finds the same pairs, or the comparison fails."""

import csv
import json

import numpy as np
import pytest
from fastcollide import cli, peers
from fastcollide.peers import OURS, check_pairs, cloud, sifted

WORDS = ["bench", "--peers", "--sizes", "150", "--repeats", "1", "--threads", "1"]


def pairs_of(position, radius):
    offset = position[:, None].astype(np.float64) - position[None, :]
    reach = radius[:, None].astype(np.float64) + radius[None, :]
    return np.argwhere(np.triu((offset**2).sum(axis=2) < reach**2, 1))


@pytest.fixture
def counting_searches(monkeypatch):
    """Ours and all that need no other library."""
    names = [name for name in peers.SEARCHES if name.startswith("FastCollide")]
    monkeypatch.setattr(peers, "SEARCHES", {name: peers.SEARCHES[name] for name in names})
    return peers.SEARCHES


def missing_library(*_):
    raise ImportError("no such library")


@pytest.mark.parametrize("ratio", [1, 8])
def test_the_cloud_fills_three_tenths_with_equal_volume_in_each_octave(ratio):
    position, radius, side = cloud(20_000, ratio)
    volume = 4 / 3 * np.pi * radius.astype(float) ** 3
    assert volume.sum() / side**3 == pytest.approx(0.3, rel=1e-5)
    assert position.min() >= 0
    assert position.max() <= side
    octaves = np.floor(np.log2(radius)).clip(max=-1) if ratio > 1 else np.zeros(len(radius))
    shares = [volume[octaves == octave].sum() / volume.sum() for octave in np.unique(octaves)]
    assert shares == pytest.approx([1 / len(shares)] * len(shares), rel=0.15)
    assert len(shares) == (3 if ratio == 8 else 1)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("ratio", [1, 8])
@pytest.mark.parametrize("name", peers.SEARCHES)
def test_each_search_finds_all_pairs(name, ratio, threads):
    arrays = cloud(400, ratio)
    extra = {"case": (400, ratio)} if name.startswith("LAMMPS") else {}
    try:
        search = peers.SEARCHES[name](*arrays, threads, **extra)
    except ImportError:
        pytest.skip("not installed")
    assert search() == len(pairs_of(*arrays[:2])) > 100


def test_candidates_are_sifted():
    position, radius, _ = cloud(200, 8)
    first, second = np.triu_indices(200, 1)
    assert sifted(position, radius, first, second) == len(pairs_of(position, radius)) < len(first)


@pytest.mark.parametrize(
    ("name", "found", "is_fine"),
    [
        ("SciPy", 1_000_000, True),
        ("SciPy", 1_000_001, False),
        ("freud", 999_981, True),
        ("Warp", 999_979, False),
        ("LAMMPS", 1_000_001, False),
    ],
)
def test_another_number_of_pairs_is_a_failure(name, found, is_fine):
    pairs = {OURS: 1_000_000, f"{name}, its search": found}
    if is_fine:
        check_pairs(pairs)
    else:
        with pytest.raises(peers.DifferentPairs, match=f"{name}, its search: found {found:,} pairs; expected: 1,000,0"):
            check_pairs(pairs)


def test_the_files_hold_what_was_measured(capfd, counting_searches, tmp_path):
    counting_searches["Nobody, a search"] = missing_library
    assert cli.main([*WORDS, "--output", str(tmp_path), "--note", "busy"]) == 0
    output = capfd.readouterr().out
    assert [line.split(maxsplit=2)[2] for line in output.splitlines() if line.startswith("not installed")] == [
        "Nobody, a search"
    ]
    content = json.loads((tmp_path / "search.json").read_text(encoding="utf-8"))
    with (tmp_path / "search.csv").open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["search"] for line in lines] == [row["search"] for row in content["searches"]]
    assert {line["sizes"] for line in lines} == {"1:1", "1:8"}
    assert {(line["threads"], line["note"]) for line in lines} == {("1", "busy")}
    for line in lines:
        ratio = int(line["sizes"].removeprefix("1:"))
        assert int(line["pairs"]) == len(pairs_of(*cloud(150, ratio)[:2]))
        assert float(line["best_ms"]) <= float(line["median_ms"])
    assert content["versions"]["numpy"] == np.__version__


def test_nothing_is_written_of_a_wrong_search(capfd, counting_searches, tmp_path):
    counting_searches["Wrong, a search"] = lambda *_: lambda: 7
    assert cli.main([*WORDS, "--output", str(tmp_path)]) == 1
    assert capfd.readouterr().err.startswith("fastcollide: Wrong, a search: found 7 pairs; expected: ")
    assert list(tmp_path.iterdir()) == []
