"""GSD files of the HOOMD schema, which OVITO, freud and HOOMD-blue read.

The box of GSD is centred on the origin, and all its axes are periodic to its readers, so positions are shifted by the
middle of the bounds, and along an axis that is not periodic the box is as long as it takes to hold every sphere whole:
no reader finds a contact through a wall. What the schema has no place for goes into the frame's log: the time, the
middle that positions were shifted by, which axes are periodic, the angular velocities.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import gsd.fl
import numpy as np
from numpy.typing import NDArray

from fastcollide.files import written_durably
from fastcollide.frames import Frame, FrameError
from fastcollide.snapshots import Cast, Snapshot

_APPLICATION = "FastCollide"
_SPIN = "log/particles/angular_velocity"
_LAST = "log/time"  # of the chunks of a frame, the one whose entry in the index is written last


class Writer:
    """See trajectories.open_writer."""

    def __init__(self, path: Path, cast: Cast, frames: Sequence[int], keep: int) -> None:
        self._path = path
        self._cast = cast
        lower, upper = (np.array(corner) for corner in cast.bounds)
        self._middle = ((lower + upper) / 2).astype(np.float32)
        self._edges = (upper - lower).astype(np.float32)
        self._is_periodic = np.array([name == "periodic" for name in cast.boundary])
        with np.errstate(invalid="ignore"):
            moment = np.float32(0.4) * cast.masses * cast.radii**2  # of a solid sphere, 2/5 m r² [kg m²]
        self._moment = np.where(np.isfinite(moment), moment, np.float32(0))  # HOOMD's word for "does not turn"
        if keep:
            _cut(path, keep)
        else:
            with written_durably(path) as unfinished:
                _create(unfinished).close()
        self._file = _open(path, "r+")

    def write(self, snapshot: Snapshot) -> Path:
        file, cast = self._file, self._cast
        positions = snapshot.positions - self._middle
        box = self._box(positions)
        if self._is_periodic.any():
            # Rounding may put a centre on the upper end, which is the lower one, or below that.
            is_outside = self._is_periodic & ((positions >= box / 2) | (positions < -box / 2))
            positions = np.where(is_outside, -box / 2, positions)
        file.write_chunk("configuration/step", np.array([snapshot.frame], np.uint64))
        file.write_chunk("configuration/box", np.array([*box, 0, 0, 0], np.float32))
        if file.nframes == 0:
            file.write_chunk("configuration/dimensions", np.array([3], np.uint8))
            file.write_chunk("particles/N", np.array([len(cast)], np.uint32))
            file.write_chunk("particles/types", np.frombuffer(b"sphere\0", np.int8)[None])
            file.write_chunk("particles/diameter", 2 * cast.radii)
            file.write_chunk("particles/mass", cast.masses)
            file.write_chunk("particles/moment_inertia", np.repeat(self._moment[:, None], 3, axis=1))
            file.write_chunk("log/bounds", np.array(cast.bounds, float))
            file.write_chunk("log/box_middle", self._middle.astype(float))
            file.write_chunk("log/is_periodic", self._is_periodic.astype(np.uint8))
        file.write_chunk("particles/position", positions)
        file.write_chunk("particles/velocity", snapshot.velocities)
        if snapshot.spins is not None:
            # A quaternion p with L = ½ q* p; spheres keep the orientation q = 1, so p is 2 L.
            momenta = np.zeros((len(cast), 4), np.float32)
            momenta[:, 1:] = 2 * self._moment[:, None] * snapshot.spins
            file.write_chunk("particles/angmom", momenta)
            file.write_chunk(_SPIN, snapshot.spins)
        file.write_chunk(_LAST, np.array([snapshot.time]))
        file.end_frame()
        file.flush()
        return self._path

    def close(self) -> None:
        self._file.close()

    def _box(self, positions: NDArray[np.float32]) -> NDArray[np.float32]:
        """Edges of a box about the origin: the bounds along a periodic axis, else at least these and all spheres."""
        if self._is_periodic.all():
            return self._edges
        reach = 2 * (np.abs(positions) + self._cast.radii[:, None]).max(axis=0)
        grown = np.nextafter(reach, np.float32(np.inf))  # the sum has been rounded, maybe down
        return np.where(self._is_periodic | (reach <= self._edges), self._edges, grown)


class Reader:
    """See trajectories.TrajectoryReader. Positions have gone through a shift and back: they may differ from the
    world's by rounding."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = _open(path, "r")
        self.count = _whole_frames(self._file)
        self.times = [float(self._chunk(i, _LAST)[0]) for i in range(self.count)]

    def read(self, i: int) -> Frame:
        spins = self._chunk(i, _SPIN) if self._file.chunk_exists(i, _SPIN) else None
        positions = (self._chunk(i, "particles/position") + self._chunk(0, "log/box_middle")).astype(np.float32)
        # A world's positions are in [lower, upper) along a periodic axis; rounding must not take them out.
        lower, upper = self._chunk(0, "log/bounds").astype(np.float32)
        is_outside = (self._chunk(0, "log/is_periodic") != 0) & ((positions < lower) | (positions >= upper))
        return Frame(
            frame=int(self._chunk(i, "configuration/step")[0]),
            time=self.times[i],
            positions=np.where(is_outside, lower, positions),
            radii=self._chunk(0, "particles/diameter") / 2,
            velocities=self._chunk(i, "particles/velocity"),
            spins=spins,
        )

    def close(self) -> None:
        self._file.close()

    def _chunk(self, i: int, name: str) -> NDArray[np.generic]:
        try:
            return self._file.read_chunk(i, name)
        except KeyError:
            raise FrameError(f"{self._path}: found no {name} of frame {i}; expected a file of FastCollide") from None


def count_frames(path: Path) -> int:
    """The number of whole frames in a file of FastCollide. Raises FrameError where it is something else."""
    with _open(path, "r") as file:
        return _whole_frames(file)


def _create(path: Path) -> gsd.fl.GSDFile:
    return gsd.fl.open(path, "w", _APPLICATION, schema="hoomd", schema_version=[1, 4])


def _open(path: Path, mode: str) -> gsd.fl.GSDFile:
    try:
        file = gsd.fl.open(path, mode)
    except RuntimeError as error:
        raise FrameError(f"{path}: found no GSD file ({error}); expected one of FastCollide") from None
    if file.application != _APPLICATION:
        found = file.application
        file.close()
        raise FrameError(f"{path}: found a GSD file of {found}; expected one of FastCollide")
    return file


def _whole_frames(file: gsd.fl.GSDFile) -> int:
    """A kill can, once in a very long while, leave a part of the last frame's entries in the index."""
    count = file.nframes
    return count if count == 0 or file.chunk_exists(count - 1, _LAST) else count - 1


def _cut(path: Path, frames: int) -> None:
    """Leaves the first frames in the file; GSD itself can take all of them out, or none."""
    with _open(path, "r") as file:
        if file.nframes == frames:
            return
        names = file.find_matching_chunk_names("")
        with written_durably(path) as unfinished, _create(unfinished) as kept:
            for i in range(frames):
                for name in names:
                    if file.chunk_exists(i, name):
                        kept.write_chunk(name, file.read_chunk(i, name))
                kept.end_frame()
