"""What a run has written, read back frame by frame: `fc.open`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from fastcollide.errors import MissingLibrary
from fastcollide.frames import Frame, FrameError, frame_paths, read_frame, read_frame_time
from fastcollide.ledger import read_ledger
from fastcollide.run_folder import read_run
from fastcollide.settings import TRAJECTORY_SUFFIXES
from fastcollide.spheres import Bounds
from fastcollide.trajectories import TrajectoryReader, open_reader


class Recording(Sequence[Frame]):
    """The frames of a run, each read when it is asked for::

        with fc.open("output") as run:
            print(len(run), run.times[-1], run[-1].positions.mean(axis=0))
            for frame in run[10:20]:
                ...

    A slice is a Recording, too, of the same open file.

    Attributes:
        path: what the frames come from, a trajectory file or a folder of frame files.
    """

    def __init__(self, path: Path, source: TrajectoryReader, run: dict[str, Any], folder: Path, chosen: range) -> None:
        self.path = path
        self._source = source
        self._run = run
        self._folder = folder
        self._chosen = chosen

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __len__(self) -> int:
        return len(self._chosen)

    @overload
    def __getitem__(self, index: int) -> Frame: ...

    @overload
    def __getitem__(self, index: slice) -> Recording: ...

    def __getitem__(self, index: int | slice) -> Frame | Recording:
        if isinstance(index, slice):
            return Recording(self.path, self._source, self._run, self._folder, self._chosen[index])
        try:
            return self._source.read(self._chosen[index])
        except IndexError:
            raise IndexError(f"frame {index}: found {len(self)} frames in {self.path}") from None

    def __iter__(self) -> Iterator[Frame]:
        return map(self._source.read, self._chosen)

    def __repr__(self) -> str:
        return f"Recording({len(self)} frames of {self.path})"

    @property
    def times(self) -> NDArray[np.float64]:
        """Simulated time of each frame [s], shape (frames,)."""
        return np.array([self._source.times[i] for i in self._chosen], dtype=np.float64)

    @property
    def bounds(self) -> Bounds | None:
        """Lower and upper corner of the box [m]; None where only frames are there."""
        bounds = self._run.get("world", {}).get("bounds")
        return bounds and (tuple(bounds[0]), tuple(bounds[1]))

    @property
    def world(self) -> dict[str, Any]:
        """The arguments of the World; empty where only frames are there."""
        return self._run.get("world", {})

    @property
    def settings(self) -> dict[str, Any]:
        """The settings of the run by their names; empty where only frames are there."""
        return self._run.get("settings", {})

    @property
    def ledger(self) -> dict[str, NDArray[Any]]:
        """The ledger of the whole run, see read_ledger(). Raises what that raises."""
        return read_ledger(self._folder)

    def close(self) -> None:
        """Closes the file. May be called twice."""
        self._source.close()


def open(path: str | os.PathLike[str]) -> Recording:
    """Opens what a run has written: its output folder, or one of its trajectory files.

    Of a folder the trajectory is read where the run made one (.vtkhdf before .gsd) and its library is installed, else
    the frame files. A run may still be going on, or have been killed: the frames are those that are whole now.

    Args:
        path: the folder or the file.

    Raises:
        FrameError: where there are no frames or the file is something else.
        MissingLibrary: where a library for it is not installed.
        OSError: where it cannot be read.
    """
    path = Path(path)
    if path.suffix.lower() in TRAJECTORY_SUFFIXES and not path.is_dir():
        run = _about(path.parent)
        is_its_own = any(_is_same(path.parent / name, path) for name in _trajectories(run))
        return _recording(path, open_reader(path), path.parent, run if is_its_own else {})
    run = _about(path)
    missing: MissingLibrary | None = None
    named = (path / name for name in _trajectories(run))
    for trajectory in sorted(named, key=lambda name: name.suffix.lower() != ".vtkhdf"):
        if trajectory.exists():
            try:
                return _recording(trajectory, open_reader(trajectory), path, run)
            except MissingLibrary as error:
                missing = error
    paths = frame_paths(path)
    if not paths:
        raise missing or FrameError(f"{path}: found no frame file; allowed: a folder of frame_00000001.txt and so on")
    return _recording(path, _FrameFileReader(paths), path, run)


class _FrameFileReader:
    """A folder of frame files as a TrajectoryReader."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = paths
        self._times: list[float] | None = None

    @property
    def count(self) -> int:
        return len(self._paths)

    @property
    def times(self) -> Sequence[float]:
        if self._times is None:  # opens every file
            self._times = [read_frame_time(path) for path in self._paths]
        return self._times

    def read(self, i: int) -> Frame:
        return read_frame(self._paths[i])

    def close(self) -> None:
        pass


def _recording(path: Path, source: TrajectoryReader, folder: Path, run: dict[str, Any]) -> Recording:
    return Recording(path, source, run, folder, range(source.count))


def _trajectories(run: dict[str, Any]) -> Sequence[str]:
    return run.get("settings", {}).get("trajectory") or ()


def _is_same(path: Path, other: Path) -> bool:
    return path.resolve() == other.resolve()


def _about(folder: Path) -> dict[str, Any]:
    try:
        return read_run(folder) or {}
    except ValueError as error:
        raise FrameError(str(error)) from None
