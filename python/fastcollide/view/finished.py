"""A finished run, from the files that it has written."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fastcollide as fc
from fastcollide.frames import Frame
from fastcollide.recording import Recording
from fastcollide.render import Bounds
from fastcollide.render_frames import bounds_of_run
from fastcollide.view.live import MOST_ENERGIES, PAST_BYTES, EnergyRow
from fastcollide.view.messages import Conditions
from fastcollide.view.moments import Box, Moment, Thinned


class FinishedRun:
    """The frames of an output folder or a trajectory file, read when looked at, and the energies of the ledger.

    bounds: the box [m]; None takes that of the run or, where only frames are there, round numbers that hold the
    spheres; past_bytes: memory for frames that were read. Where the frames have no velocities, they are the way of each
    sphere since the frame before, over the time between the two; in the first one, until the next. Raises what
    fastcollide.open() raises, and LedgerError where the ledger is none.
    """

    kind = "finished"
    device = None

    def __init__(self, path: Path, bounds: Bounds | None = None, past_bytes: int = PAST_BYTES) -> None:
        self._run = fc.open(path)
        self.title = path.resolve().name
        self.fps: int = self._run.settings.get("fps", 60)
        boundary = self._run.world.get("boundary", ("open",) * 3)
        self.box = Box(bounds or self._run.bounds or bounds_of_run(self._run), tuple(boundary))
        self._past_bytes = past_bytes
        self._kept: OrderedDict[int, Frame] = OrderedDict()
        self._radii: NDArray[np.float32] | None = None
        self.energies = _energies_of(self._run)

    def __len__(self) -> int:
        return len(self._run)

    def moment(self, index: int) -> Moment:
        """The moment of a frame. Raises FrameError, OSError."""
        frame = self._frame(index)
        velocities = self._way(index, frame) if frame.velocities is None else frame.velocities
        radii = self._shared(frame.radii)
        return Moment(frame.frame, frame.time, self.box, frame.positions, velocities, radii, frame.spins)

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
        """Frames say no more than place, motion and radius."""
        return {} if moment.spins is None else {"spin": moment.spins[sphere].tolist()}

    def _frame(self, index: int) -> Frame:
        if index in self._kept:
            self._kept.move_to_end(index)
            return self._kept[index]
        frame = self._kept[index] = self._run[index]
        most = max(3, self._past_bytes // max(1, 40 * len(frame.radii)))
        while len(self._kept) > most:
            self._kept.popitem(last=False)
        return frame

    def _way(self, index: int, frame: Frame) -> NDArray[np.float32]:
        neighbor = self._frame(index - 1 if index else min(1, len(self) - 1))
        velocities = np.zeros_like(frame.positions)
        both = min(len(frame.radii), len(neighbor.radii))
        if frame.time != neighbor.time:
            velocities[:both] = (frame.positions[:both] - neighbor.positions[:both]) / (frame.time - neighbor.time)
        return velocities

    def _shared(self, radii: NDArray[np.float32]) -> NDArray[np.float32]:
        """The same array as before where the radii are the same, so that they are sent once."""
        if self._radii is None or not np.array_equal(self._radii, radii):
            self._radii = radii
        return self._radii


def _energies_of(run: Recording) -> Thinned[EnergyRow]:
    rows: Thinned[EnergyRow] = Thinned(MOST_ENERGIES)
    try:
        ledger = run.ledger
    except FileNotFoundError:
        return rows
    columns = (ledger[name].tolist() for name in ("frame", "time_s", "kinetic_J", "rotational_J", "potential_J"))
    for frame, *row in zip(*columns, strict=True):
        rows.add(frame, lambda row=row: tuple(row))
    return rows
