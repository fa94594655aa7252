"""The oracle of collision detection: every pair, in double precision, without any cleverness that could be wrong."""

import numpy as np


def overlapping_pairs(position, radius):
    """first < second, int64, sorted by (first, second): the pairs with d² < (r₁ + r₂)². Touching is not overlapping."""
    x, y, z = np.ascontiguousarray(np.asarray(position, dtype=np.float64).T)
    radius = np.asarray(radius, dtype=np.float64)
    firsts, seconds = [], []
    for i in range(len(radius)):
        dx, dy, dz = x[i + 1 :] - x[i], y[i + 1 :] - y[i], z[i + 1 :] - z[i]
        reach = radius[i + 1 :] + radius[i]
        found = np.flatnonzero(dx * dx + dy * dy + dz * dz < reach * reach)
        firsts.append(np.full(len(found), i))
        seconds.append(found + i + 1)
    if not firsts:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    return np.concatenate(firsts), np.concatenate(seconds)


def pair_hash(first, second):
    """Σ (first · 1000003 + second) · 0x9E3779B97F4A7C15 mod 2⁶⁴, as 16 hexadecimal digits."""
    words = np.asarray(first).astype(np.uint64) * np.uint64(1000003) + np.asarray(second).astype(np.uint64)
    return f"{int((words * np.uint64(0x9E3779B97F4A7C15)).sum()):016x}"


def splitmix64_uniforms(seed, count):
    """The first numbers of splitmix64 (Steele, Lea, Flood 2014) in [0, 1), from the upper 53 bits."""
    z = np.uint64(seed) + np.arange(1, count + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53


# Radii from a uniform number, pairs among 20,000 spheres, hash of the pairs.
GOLDEN_SETS = {
    "radii 0.1 to 0.4": (lambda u: 0.1 + 0.3 * u, 6_040, "2ee102c2e99765e6"),
    "radii 0.4": (lambda u: np.full_like(u, 0.4), 20_782, "f12a02f333272fdb"),
    "radii log-uniform 0.001 to 1": (lambda u: 0.001 * 1000.0**u, 6_566, "9bc90a5ac57a84f7"),
}


def golden_cloud(name):
    """Positions in a cube of 27 m about the origin and radii of a golden set, in double precision."""
    radius_of = GOLDEN_SETS[name][0]
    uniforms = splitmix64_uniforms(20240601, 4 * 20_000).reshape(20_000, 4)
    return -13.5 + 27.0 * uniforms[:, :3], radius_of(uniforms[:, 3])


def deepest_in_a_wall(position, radius, bounds, boundary):
    """How far a sphere reaches into a wall of the box [m], rounded as the engine does; 0 where none does."""
    deepest = np.float32(0)
    names = (boundary,) * 3 if isinstance(boundary, str) else boundary
    for axis, name in enumerate(names):
        if name == "wall":
            lower, upper = (np.float32(corner[axis]) for corner in bounds)
            x, r = position[:, axis].astype(np.float32), radius.astype(np.float32)
            deepest = max(deepest, (lower + r - x).max(initial=0), (x - (upper - r)).max(initial=0))
    return deepest
