"""Spheres as arrays: what a world takes in, and the random start."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fastcollide import _core
from fastcollide.errors import InvalidValue

Bounds = tuple[tuple[float, float, float], tuple[float, float, float]]
DEFAULT_BOUNDS: Bounds = ((-10.0, -10.0, 0.0), (10.0, 10.0, 20.0))


@dataclass(frozen=True)
class Spheres:
    """n spheres, float32 arrays in the order of their ids.

    Attributes:
        position: [m], shape (n, 3).
        velocity: [m/s], shape (n, 3).
        radius: [m], shape (n,).
        mass: [kg], shape (n,).
        restitution: 0 to 1, shape (n,).
        spin: [rad/s], shape (n, 3), or None where there is none.
        friction: Coulomb coefficient, shape (n,), or None where there is none.
    """

    position: NDArray[np.float32]
    velocity: NDArray[np.float32]
    radius: NDArray[np.float32]
    mass: NDArray[np.float32]
    restitution: NDArray[np.float32]
    spin: NDArray[np.float32] | None = None
    friction: NDArray[np.float32] | None = None

    def __len__(self) -> int:
        return len(self.radius)


def random_spheres(
    count: int,
    bounds: Bounds = DEFAULT_BOUNDS,
    seed: int = 1,
    radius: tuple[float, float] = (0.05, 0.4),
    speed: tuple[float, float, float] = (8.0, 8.0, 8.0),
    restitution: tuple[float, float] = (0.3, 0.95),
    density: float = 1000.0,
    device: str = "cpu",
    *,
    friction: float = 0.0,
) -> Spheres:
    """The random start: the same bits for the same arguments, on every device.

    Each number is uniform between its limits and drawn by Philox4x32-10 from (seed, id): sphere i is the same in a
    world of ten as in a world of a million.

    Args:
        count: how many.
        bounds: lower and upper corner of the box in which all of a sphere lies [m].
        seed: number of the start, 0 to 2⁶⁴ − 1.
        radius: smallest and largest [m].
        speed: v_x and v_y lie in ± the first two, v_z from 0 to the third [m/s].
        restitution: smallest and largest.
        density: [kg/m³], gives the mass density · 4/3 π r³.
        device: what computes it, "cpu", "cuda" or "cuda:N".
        friction: Coulomb coefficient of all.

    Raises:
        InvalidValue: for an argument out of range.
        DeviceError: where there is no such device.
    """
    if not 0 <= seed < 2**64:
        raise InvalidValue(f"seed: found {seed}; allowed: 0 to 2^64 - 1", "seed")
    lower, upper = corners(bounds)
    spheres = Spheres(*_core.random_spheres(count, lower, upper, seed, radius, speed, restitution, density, device))
    if friction == 0:
        return spheres
    return replace(spheres, friction=np.full(count, friction, dtype=np.float32))


def lattice_spheres(
    count: int,
    bounds: Bounds = DEFAULT_BOUNDS,
    seed: int = 1,
    radius: tuple[float, float] = (0.05, 0.4),
    speed: tuple[float, float, float] = (8.0, 8.0, 8.0),
    restitution: tuple[float, float] = (0.3, 0.95),
    density: float = 1000.0,
    device: str = "cpu",
    *,
    friction: float = 0.0,
) -> Spheres:
    """The spheres of random_spheres in rows and layers, from the bottom up, so that none overlaps another.

    The places are the middles of equal cells, as close to cubes as fills the bounds. The arguments are those of
    `random_spheres`.

    Raises:
        InvalidValue: for an argument out of range, and where the largest sphere is larger than a cell.
        DeviceError: where there is no such device.
    """
    spheres = random_spheres(count, bounds, seed, radius, speed, restitution, density, device, friction=friction)
    lower, upper = (np.array(corner) for corner in corners(bounds))
    edges = upper - lower
    cells = np.ones(3, dtype=np.int64)
    while cells.prod() < count:
        cells[np.argmax(edges / (cells + 1))] += 1
    spacing = edges / cells
    if 2 * radius[1] > spacing.min():
        raise InvalidValue(
            f"radius: found {radius[1]:g} for {count:,} spheres in these bounds; allowed: at most "
            f"{spacing.min() / 2:.4g} m, half the edge of a cell, so that none overlaps another",
            "radius",
        )
    place = np.stack(np.unravel_index(np.arange(count), cells[::-1]), axis=1)[:, ::-1]  # x runs fastest
    return replace(spheres, position=(lower + (place + 0.5) * spacing).astype(np.float32))


def corners(bounds: Bounds) -> tuple[list[float], list[float]]:
    """The two corners of a box, or InvalidValue where they are not two times three numbers."""
    try:
        box = np.asarray(bounds, dtype=np.float64)
    except (TypeError, ValueError):
        box = np.empty(0)
    if box.shape != (2, 3):
        raise InvalidValue(
            f"bounds: found {bounds!r}; allowed: ((x, y, z), (x, y, z)), the lower and the upper corner [m]", "bounds"
        )
    return box[0].tolist(), box[1].tolist()


def drag_from_damping(damping: float, fps: float) -> float:
    """The drag γ [1/s] whose exp(−γ/fps) is this damping factor per frame: γ = −ln(damping) · fps.

    Args:
        damping: part of the speed that is left after a frame, more than 0, up to 1.
        fps: frames a second [1/s].

    Raises:
        InvalidValue: for an argument out of range.
    """
    if not 0 < damping <= 1:
        raise InvalidValue(f"damping: found {damping}; allowed: more than 0, up to 1", "damping")
    if not 0 < fps < math.inf:
        raise InvalidValue(f"fps: found {fps}; allowed: a finite number above 0 [1/s]", "fps")
    return -math.log(damping) * fps
