"""What is written of a running world: the part that stays, and copies of the part that moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastcollide.spheres import Bounds
from fastcollide.world import World, to_numpy


@dataclass(frozen=True)
class Cast:
    """What stays the same in all frames of a run.

    bounds: lower and upper corner of the box [m]; boundary: "wall", "periodic" or "open" for each axis;
    radii [m], masses [kg], shape (n,) float32, a mass infinite where a sphere is fixed; has_spin: whether any can turn.
    """

    bounds: Bounds
    boundary: tuple[str, str, str]
    radii: NDArray[np.float32]
    masses: NDArray[np.float32]
    has_spin: bool

    def __len__(self) -> int:
        return len(self.radii)


@dataclass(frozen=True)
class Snapshot:
    """One frame, in arrays that nobody else changes.

    frame: number of frames simulated so far; time [s]; positions [m], velocities [m/s] and, where any sphere can turn,
    spins [rad/s], shape (n, 3) float32, in id order.
    """

    frame: int
    time: float
    positions: NDArray[np.float32]
    velocities: NDArray[np.float32]
    spins: NDArray[np.float32] | None


def cast_of(world: World) -> Cast:
    """What stays the same in the frames of this world."""
    return Cast(
        bounds=world.bounds,
        boundary=world.boundary,
        radii=_copy(world.radii),
        masses=_copy(world.masses),
        has_spin=world.has_spin,
    )


def take(world: World, cast: Cast) -> Snapshot:
    """The world as it is now."""
    return Snapshot(
        frame=world.frame,
        time=world.time,
        positions=_copy(world.positions),
        velocities=_copy(world.velocities),
        spins=_copy(world.spins) if cast.has_spin else None,
    )


def _copy(array: Any) -> NDArray[np.float32]:
    host = to_numpy(array)
    return host.copy() if host is array else host  # what comes from a GPU is a copy
