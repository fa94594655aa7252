"""The oracle itself: against exact rational arithmetic, and against the golden sets."""

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
from reference.all_pairs import GOLDEN_SETS, golden_cloud, overlapping_pairs, pair_hash, splitmix64_uniforms


def exactly_overlapping_pairs(position, radius):
    position = [[Fraction(float(x)) for x in row] for row in position]
    radius = [Fraction(float(r)) for r in radius]
    return [
        (i, j)
        for i, j in combinations(range(len(radius)), 2)
        if sum((a - b) ** 2 for a, b in zip(position[i], position[j], strict=True)) < (radius[i] + radius[j]) ** 2
    ]


def test_the_oracle_agrees_with_rational_arithmetic():
    random = np.random.default_rng(1)
    position = random.uniform(-2, 2, (150, 3))
    radius = random.uniform(0.05, 0.5, 150)
    # Among them a lattice whose neighbours touch exactly.
    position[:27] = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
    radius[:27] = 0.5

    expected = exactly_overlapping_pairs(position, radius)

    assert len(expected) > 100
    assert list(zip(*overlapping_pairs(position, radius), strict=True)) == expected


def test_the_oracle_finds_nothing_among_none_and_one():
    assert len(overlapping_pairs(np.empty((0, 3)), np.empty(0))[0]) == 0
    assert len(overlapping_pairs(np.zeros((1, 3)), np.ones(1))[0]) == 0


def test_splitmix64_gives_its_published_numbers():
    # The first two outputs for the seed 1234567, as widely published with the generator.
    words = [6457827717110365317, 3203168211198807973]
    assert list(splitmix64_uniforms(1234567, 2)) == [(word >> 11) * 2.0**-53 for word in words]


@pytest.mark.parametrize("rounded", [False, True], ids=["double", "rounded to float32"])
@pytest.mark.parametrize("name", GOLDEN_SETS)
def test_the_oracle_reproduces_the_golden_sets(name, rounded):
    """In float32 too, which is what the engine is given: the rounding of these positions flips no pair."""
    position, radius = golden_cloud(name)
    if rounded:
        position, radius = position.astype(np.float32), radius.astype(np.float32)

    first, second = overlapping_pairs(position, radius)

    assert (len(first), pair_hash(first, second)) == GOLDEN_SETS[name][1:]
