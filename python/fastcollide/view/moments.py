"""A run at one moment, and the past of a run in bounded memory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

import fastcollide as fc
from fastcollide.render import Bounds

ViewColor = Literal["speed", "radius", "id", "contacts"]
T = TypeVar("T")


@dataclass(frozen=True)
class Box:
    """bounds: lower and upper corner [m]; boundary: what happens at its ends, for each axis."""

    bounds: Bounds
    boundary: tuple[str, str, str]


@dataclass(frozen=True)
class Moment:
    """The spheres after a frame; nobody changes its arrays.

    time [s]; positions [m] and velocities [m/s], shape (n, 3) float32; radii [m], shape (n,) float32; spins [rad/s],
    shape (n, 3) float32, or None where there are none.
    """

    frame: int
    time: float
    box: Box
    positions: NDArray[np.float32]
    velocities: NDArray[np.float32]
    radii: NDArray[np.float32]
    spins: NDArray[np.float32] | None = None

    def __len__(self) -> int:
        return len(self.radii)

    @cached_property
    def speeds(self) -> NDArray[np.float32]:
        """Speeds [m/s], shape (n,)."""
        return np.sqrt(np.einsum("ij,ij->i", self.velocities, self.velocities))

    @cached_property
    def contact_counts(self) -> NDArray[np.float32]:
        """How many spheres each one overlaps, shape (n,); found when first asked for."""
        counts = fc.find_contacts(
            self.positions, self.radii, bounds=self.box.bounds, boundary=self.box.boundary, output="counts"
        )
        return counts.astype(np.float32)

    def touching(self, sphere: int) -> list[int]:
        """The spheres that this one overlaps, in the order of their ids."""
        found = fc.find_contacts(
            self.positions[sphere : sphere + 1],
            self.radii[sphere : sphere + 1],
            bounds=self.box.bounds,
            boundary=self.box.boundary,
            other_positions=self.positions,
            other_radii=self.radii,
            output="pairs",
        )
        return sorted(int(i) for i in found.second if i != sphere)

    def values(self, color_by: ViewColor) -> NDArray[np.float32] | None:
        """What the colours show where the browser cannot know it, shape (n,); it knows radii and ids."""
        if color_by == "speed":
            return self.speeds
        return self.contact_counts if color_by == "contacts" else None


class Thinned(Generic[T]):
    """Items by frame, from the first one to the newest, never more than `most`: when full, every second one goes, so
    that what stays covers the whole run evenly. The newest item is always there.

    version: changes whenever items other than the newest have gone.
    """

    def __init__(self, most: int) -> None:
        self._most = max(3, most)
        self._frames: list[int] = []
        self._items: list[T] = []
        self._stride = 1
        self.version = 0

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, index: int) -> T:
        return self._items[index]

    def since(self, index: int) -> list[T]:
        """The items from this index on."""
        return self._items[index:]

    def is_loose(self, frame: int) -> bool:
        """Whether the item of this frame only stays until the next one comes."""
        return frame % self._stride != 0

    def add(self, frame: int, make: Callable[[], T], *, is_newest_kept: bool = True) -> None:
        """Adds the item of a frame that is later than all before.

        is_newest_kept: False leaves out an item that would not stay.
        """
        if self._frames and self.is_loose(self._frames[-1]):
            self._frames.pop()
            self._items.pop()
        if self.is_loose(frame) and not is_newest_kept:
            return
        self._frames.append(frame)
        self._items.append(make())
        while len(self._items) > self._most:
            self._stride *= 2
            stays = len(self._items) - 1 if is_newest_kept else None
            kept = [i for i, frame in enumerate(self._frames) if i == stays or not self.is_loose(frame)]
            self._frames = [self._frames[i] for i in kept]
            self._items = [self._items[i] for i in kept]
            self.version += 1

    def clear(self) -> None:
        """Forgets everything."""
        self._frames.clear()
        self._items.clear()
        self._stride = 1
        self.version += 1
