"""The oracle of collision detection in a box that repeats: every pair with every image next to it, in double precision.
No choice of a nearest image that could be wrong."""

import itertools

import numpy as np


def overlapping_images(position, radius, period):
    """first < second, int64, sorted by (first, second), and the offset [m], shape (n, 3), from first to the image of
    second that it overlaps. period: length of each axis [m], 0 where it does not repeat."""
    x, y, z = np.asarray(position, np.float64).T
    radius = np.asarray(radius, np.float64)
    reach_squared = (radius[:, None] + radius) ** 2
    later = np.triu(np.ones(reach_squared.shape, bool), 1)
    firsts, seconds, offsets = [], [], []
    for shift in itertools.product(*[(-length, 0.0, length) if length else (0.0,) for length in map(float, period)]):
        dx, dy, dz = (a - a[:, None] + step for a, step in zip((x, y, z), shift, strict=True))
        first, second = np.nonzero((dx * dx + dy * dy + dz * dz < reach_squared) & later)
        firsts.append(first)
        seconds.append(second)
        offsets.append(np.stack([d[first, second] for d in (dx, dy, dz)], axis=1))
    first, second, offset = map(np.concatenate, (firsts, seconds, offsets))
    order = np.lexsort((second, first))
    return first[order], second[order], offset[order]
