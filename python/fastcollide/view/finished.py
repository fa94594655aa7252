"""A finished run, from the files in its folder."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastcollide.frames import Frame, FrameError, frame_paths, read_frame
from fastcollide.ledger import LEDGER_NAME, read_ledger
from fastcollide.render import Bounds
from fastcollide.video import _bounds_of
from fastcollide.view.live import MOST_ENERGIES, PAST_BYTES, EnergyRow
from fastcollide.view.messages import Conditions
from fastcollide.view.moments import Box, Moment, Thinned


class FinishedRun:
    """The frame files of a folder, read when they are looked at, and the energies of its ledger.

    bounds: the box [m]; None takes round numbers that hold the spheres, since frame files do not name it; past_bytes:
    memory for frames that were read. Velocities are the way of each sphere since the frame file before, over the time
    between the two; in the first one, until the next. Raises FrameError where the folder holds no frame file or one
    that is not whole, LedgerError where its ledger is none, OSError where one cannot be read.
    """

    kind = "finished"
    device = None
    fps = 60

    def __init__(self, folder: Path, bounds: Bounds | None = None, past_bytes: int = PAST_BYTES) -> None:
        self._paths = frame_paths(folder)
        if not self._paths:
            raise FrameError(f"{folder}: found no frame file; allowed: a folder of frame_00000001.txt and so on")
        self.title = folder.resolve().name
        self.box = Box(bounds or _bounds_of(self._paths), ("open",) * 3)
        self._kept: OrderedDict[int, Frame] = OrderedDict()
        self._radii: NDArray[np.float32] | None = None
        self._past_bytes = past_bytes
        self.energies = _energies_of(folder)

    def __len__(self) -> int:
        return len(self._paths)

    def moment(self, index: int) -> Moment:
        """The moment of a frame file. Raises FrameError, OSError."""
        frame = self._frame(index)
        neighbor = self._frame(index - 1 if index else min(1, len(self) - 1))
        velocities = np.zeros_like(frame.positions)
        both = min(len(frame.radii), len(neighbor.radii))
        if frame.time != neighbor.time:
            way = frame.positions[:both] - neighbor.positions[:both]
            velocities[:both] = way / (frame.time - neighbor.time)
        return Moment(frame.frame, frame.time, self.box, frame.positions, velocities, self._shared(frame.radii))

    def time_of(self, index: int) -> float:
        """The time of a moment [s]."""
        return self._frame(index).time

    def advance(self) -> bool:
        """A finished run does not go on."""
        return False

    def reset(self) -> None:
        """There is nothing to make anew."""

    def state_hash(self) -> None:
        """Frame files hold a part of the state only."""

    @property
    def conditions(self) -> dict[str, Any]:
        """Nothing can be changed."""
        return {}

    def change(self, conditions: Conditions) -> None:
        """Nothing can be changed."""
        raise ValueError("this run is finished: nothing of it can be changed")

    def sphere(self, sphere: int, moment: Moment) -> dict[str, Any]:
        """Frame files say no more than place and radius."""
        return {}

    def _frame(self, index: int) -> Frame:
        if index in self._kept:
            self._kept.move_to_end(index)
            return self._kept[index]
        frame = read_frame(self._paths[index])
        self._kept[index] = frame
        most = max(3, self._past_bytes // max(1, 16 * len(frame.radii)))
        while len(self._kept) > most:
            self._kept.popitem(last=False)
        return frame

    def _shared(self, radii: NDArray[np.float32]) -> NDArray[np.float32]:
        """The same array as before where the radii are the same, so that they are sent once."""
        if self._radii is None or not np.array_equal(self._radii, radii):
            self._radii = radii
        return self._radii


def _energies_of(folder: Path) -> Thinned[EnergyRow]:
    rows: Thinned[EnergyRow] = Thinned(MOST_ENERGIES)
    if (folder / LEDGER_NAME).exists():
        ledger = read_ledger(folder)
        columns = (ledger[name].tolist() for name in ("frame", "time_s", "kinetic_J", "rotational_J", "potential_J"))
        for frame, *row in zip(*columns, strict=True):
            rows.add(frame, lambda row=row: tuple(row))
    return rows
