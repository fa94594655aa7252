"""VTKHDF files, which ParaView and VTK read: the spheres as points with time.

A kill must leave such a file readable, which HDF5 does not promise where its own tables change. So while frames are
written they do not: all arrays get their place in the file together with the first frame, for all frames that will come
(the file is sparse: it takes on the disk what has been written). A step that is not yet reached has no points. A frame
is numbers in their places and then, at once, one number: how many points and cells its step has.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from fastcollide.files import written_durably
from fastcollide.frames import Frame, FrameError
from fastcollide.snapshots import Cast, Snapshot

_APPLICATION = "FastCollide"
_VERSION = (2, 2)
_SPIN = "PointData/angular_velocity"
# No check sums over tables and no mark that the file is open for writing, which a kill would leave behind.
_OLDEST_LAYOUT = ("earliest", "v110")


class Writer:
    """See trajectories.open_writer."""

    def __init__(self, path: Path, cast: Cast, frames: Sequence[int], keep: int) -> None:
        self._path = path
        self._cast = cast
        self._frames = frames
        self._steps = keep
        self._file: h5py.File | None = None
        if keep:
            self._open()
            self._check_room()
            self._set_steps(len(self._frames))
            self._counts[keep:] = 0  # before anything of them is written over
            self._file.flush()
        else:
            path.unlink(missing_ok=True)  # the first frame makes it

    def write(self, snapshot: Snapshot) -> Path:
        if self._file is None:
            with (
                written_durably(self._path) as unfinished,
                h5py.File(unfinished, "w", libver=_OLDEST_LAYOUT, locking=False) as file,
            ):
                self._lay_out(file.create_group("VTKHDF"), snapshot)
            self._open()
        else:
            self._put(self._root, snapshot)
            self._file.flush()
            self._counts[self._steps] = len(self._cast)
            self._file.flush()
        self._steps += 1
        return self._path

    def close(self) -> None:
        if self._file is not None:
            if self._steps < len(self._frames):  # stopped early
                self._set_steps(self._steps)
            self._file.close()

    def _open(self) -> None:
        self._file = h5py.File(self._path, "r+", locking=False)  # so that it can be read while it grows
        self._root = self._file["VTKHDF"]
        self._counts = self._root["NumberOfPoints"]

    def _moving(self, snapshot: Snapshot) -> dict[str, NDArray[np.float32]]:
        """The arrays that differ from frame to frame, by their place in the file."""
        arrays = {"Points": snapshot.positions, "PointData/velocity": snapshot.velocities}
        return arrays | ({_SPIN: snapshot.spins} if snapshot.spins is not None else {})

    def _lay_out(self, root: h5py.Group, snapshot: Snapshot) -> None:
        """All arrays, with room for all frames, and the first frame."""
        count, steps = len(self._cast), len(self._frames)
        root.attrs["Version"] = np.array(_VERSION)
        root.attrs["Type"] = np.bytes_("PolyData")
        root.attrs["Application"] = np.bytes_(_APPLICATION)
        counts = np.zeros(steps, np.int64)
        counts[0] = count
        root["NumberOfPoints"] = counts
        # A point is seen where a cell, a vertex, holds it. Each kind of cells must be there.
        for kind, cells in (("Vertices", count), ("Lines", 0), ("Polygons", 0), ("Strips", 0)):
            # One array under three names, so that points and cells of a step appear at once.
            numbers = root["NumberOfPoints"] if cells else np.zeros(steps, np.int64)
            root[f"{kind}/NumberOfCells"] = root[f"{kind}/NumberOfConnectivityIds"] = numbers
            root[f"{kind}/Offsets"], root[f"{kind}/Connectivity"] = np.arange(cells + 1), np.arange(cells)
        resting = {"radius": self._cast.radii, "mass": self._cast.masses, "id": np.arange(count, dtype=np.int32)}
        for name, array in resting.items():
            root[f"PointData/{name}"] = array
            root[f"Steps/PointDataOffsets/{name}"] = np.zeros(steps, np.int64)
        for name in self._moving(snapshot):
            root.create_dataset(name, (steps * count, 3), np.float32)
            if name != "Points":
                root[f"Steps/{name.replace('PointData', 'PointDataOffsets')}"] = count * np.arange(steps)
        fields = {"frame": np.array(self._frames)[:, None], "bounds": np.reshape(self._cast.bounds, (1, 6))}
        for name, rows in fields.items():
            root[f"FieldData/{name}"] = rows
            root[f"Steps/FieldDataSizes/{name}"] = np.tile([rows.shape[1], 1], (steps, 1))
            root[f"Steps/FieldDataOffsets/{name}"] = np.minimum(np.arange(steps), len(rows) - 1)
        about = root["Steps"]
        about["PartOffsets"], about["NumberOfParts"] = np.arange(steps), np.ones(steps, np.int64)
        about["PointOffsets"] = count * np.arange(steps)
        about["CellOffsets"] = about["ConnectivityIdOffsets"] = np.zeros((steps, 4), np.int64)
        about.attrs["NSteps"] = np.int64(steps)
        # Of steps that are not yet reached: as far as one can know.
        expected = np.array(self._frames) * (snapshot.time / snapshot.frame)
        about.create_dataset("Values", data=expected, maxshape=(steps,), chunks=(steps,))
        self._put(root, snapshot)

    def _put(self, root: h5py.Group, snapshot: Snapshot) -> None:
        first = self._steps * len(self._cast)
        for name, array in self._moving(snapshot).items():
            root[name][first : first + len(self._cast)] = array
        root["Steps/Values"][self._steps] = snapshot.time

    def _set_steps(self, steps: int) -> None:
        """How many steps readers are shown. They must never find more times than steps: VTK would write them behind the
        end of its memory."""
        attributes, times = self._root["Steps"].attrs, self._root["Steps/Values"]
        if len(times) > steps:
            times.resize((steps,))
            self._file.flush()
        attributes.modify("NSteps", np.int64(steps))
        self._file.flush()
        known = len(times)
        if known < steps:
            times.resize((steps,))
            times[known:] = np.array(self._frames[known:steps]) * (times[0] / self._frames[0])
            self._file.flush()

    def _check_room(self) -> None:
        found = self._root["Points"].shape[0], self._root["NumberOfPoints"].shape[0]
        wanted = len(self._frames) * len(self._cast), len(self._frames)
        if found != wanted:
            self._file.close()
            raise FrameError(
                f"{self._path}: found room for {found[0]} points in {found[1]} frames; "
                f"expected {wanted[0]} in {wanted[1]}, as the run has them"
            )


class Reader:
    """See trajectories.TrajectoryReader."""

    def __init__(self, path: Path) -> None:
        self._file = _open_to_read(path)
        self._root = self._file["VTKHDF"]
        self.count = _whole_frames(self._root)
        self.times = self._root["Steps/Values"][: self.count].tolist()

    def read(self, i: int) -> Frame:
        root = self._root
        count = len(root["PointData/radius"])

        def rows(name: str) -> NDArray[np.float32]:
            return root[name][i * count : (i + 1) * count]

        return Frame(
            frame=int(root["FieldData/frame"][i, 0]),
            time=self.times[i],
            positions=rows("Points"),
            radii=root["PointData/radius"][:],
            velocities=rows("PointData/velocity"),
            spins=rows(_SPIN) if _SPIN in root else None,
        )

    def close(self) -> None:
        self._file.close()


def count_frames(path: Path) -> int:
    """The number of whole frames in a file of FastCollide. Raises FrameError where it is something else."""
    with _open_to_read(path) as file:
        return _whole_frames(file["VTKHDF"])


def _open_to_read(path: Path) -> h5py.File:
    if not path.exists():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    try:
        file = h5py.File(path, "r", locking=False)
    except OSError as error:
        raise FrameError(
            f"{path}: found no HDF5 file that can be read ({error}); expected one of FastCollide"
        ) from None
    if "VTKHDF" not in file or file["VTKHDF"].attrs.get("Application") != np.bytes_(_APPLICATION):
        file.close()
        raise FrameError(f"{path}: found an HDF5 file of another program; expected one of FastCollide")
    return file


def _whole_frames(root: h5py.Group) -> int:
    return int(np.count_nonzero(root["NumberOfPoints"][: len(root["Steps/Values"])]))
