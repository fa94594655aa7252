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


def boundary_partners(position, radius, direction):
    """For each sphere two partners of its size along the direction, one last bit of a coordinate apart: the outermost
    that still overlaps it as decided in double precision, and the next one out, which does not."""
    position, radius = np.asarray(position, np.float32), np.asarray(radius, np.float32)
    reach = 2 * radius.astype(np.float64)
    rows, axis = np.arange(len(position)), np.abs(direction).argmax(axis=1)
    outwards = np.sign(direction[rows, axis])

    def overlapping(partner):
        return ((partner.astype(np.float64) - position.astype(np.float64)) ** 2).sum(axis=1) < reach**2

    def moved(partner, which, way):
        partner = partner.copy()
        bit = np.maximum(np.spacing(np.abs(partner[rows, axis])), np.spacing(radius))
        partner[rows, axis] += np.where(which, way * bit, 0).astype(np.float32)
        return partner

    inner = (position + direction * reach[:, None]).astype(np.float32)
    for _ in range(100):
        inner = moved(inner, ~overlapping(inner), -outwards)
    for _ in range(100):
        outer = moved(inner, np.full(len(inner), True), outwards)
        inner = np.where(overlapping(outer)[:, None], outer, inner)
    assert overlapping(inner).all()
    assert not overlapping(outer).any()
    return inner, outer


def pairs_within(position, radius, margin=0.0, others=None, lower=None, upper=None, inclusive=False):
    """Pairs with d² < (r₁ + r₂ + margin)² as sorted rows (first, second), every operation in double precision: within
    one set (first < second), or of one from each where others = (positions, radii). To the nearest image along the axes
    where lower and upper are given (NaN along the others)."""
    position, radius = np.asarray(position, np.float64), np.asarray(radius, np.float64)
    other_position, other_radius = (position, radius) if others is None else (np.asarray(a, np.float64) for a in others)
    period = np.full(3, np.nan) if lower is None else np.asarray(upper, np.float64) - np.asarray(lower, np.float64)
    found = []
    for i in range(len(position)):
        offset = other_position - position[i]
        for axis in np.flatnonzero(np.isfinite(period)):
            across = offset[:, axis]
            half = period[axis] / 2
            offset[:, axis] = across - period[axis] * (across > half) + period[axis] * (across < -half)
        squared = offset[:, 0] * offset[:, 0] + offset[:, 1] * offset[:, 1] + offset[:, 2] * offset[:, 2]
        reach = (radius[i] + other_radius) + margin
        hit = squared <= reach * reach if inclusive else squared < reach * reach
        if others is None:
            hit[: i + 1] = False
        partners = np.flatnonzero(hit)
        found.append(np.stack([np.full(len(partners), i), partners], axis=1))
    return np.concatenate(found) if found else np.empty((0, 2), np.int64)
