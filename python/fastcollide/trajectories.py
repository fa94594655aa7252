"""Trajectory files: all frames of a run in one file of a format that other programs read, chosen by its ending."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

from fastcollide.errors import MissingLibrary
from fastcollide.files import make_folder, part_of
from fastcollide.frames import Frame, FrameError
from fastcollide.snapshots import Cast, Snapshot

INSTALL = 'pip install "fastcollide[files]"'


class TrajectoryWriter(Protocol):
    """Writes one trajectory file; a Sink of Exports."""

    def write(self, snapshot: Snapshot) -> Path: ...

    def close(self) -> None: ...


class TrajectoryReader(Protocol):
    """Reads one trajectory file. count: of its whole frames; times: theirs [s]."""

    count: int
    times: Sequence[float]

    def read(self, i: int) -> Frame: ...

    def close(self) -> None: ...


def open_writer(path: Path, cast: Cast, frames: Sequence[int], keep: int = 0) -> TrajectoryWriter:
    """A writer for a file of this name, which replaces one of an earlier run.

    frames: numbers of all frames that it is going to hold; keep: where a run goes on, how many of them the file has and
    keeps. Raises FrameError where the file is something else or has fewer frames, OSError where it cannot be written.
    """
    check_trajectories([path], keep)
    make_folder(path.parent)
    part_of(path).unlink(missing_ok=True)  # of a run that was killed
    return _format(path).Writer(path, cast, frames, keep)


def open_reader(path: Path) -> TrajectoryReader:
    """A reader of this file.

    Raises FrameError where it is no such file, MissingLibrary where its library is not installed, OSError where it
    cannot be read.
    """
    return _format(path).Reader(path)


def check_trajectories(paths: Iterable[Path], keep: int = 0) -> None:
    """Raises what open_writer would, before anything is touched, and MissingLibrary where a library is not there."""
    for path in paths:
        module = _format(path)
        found = module.count_frames(path) if path.exists() or keep else 0
        if found < keep:
            raise FrameError(f"{path}: found {found} frames; a run that goes on needs all {keep} before it")


def _format(path: Path) -> Any:
    try:
        return import_module(f"fastcollide.{path.suffix.lower().removeprefix('.')}_file")
    except ImportError as error:
        library = str(error.name).partition(".")[0]
        raise MissingLibrary(
            f"{path.suffix} files need {library}, which is not installed; get it with: {INSTALL}"
        ) from None
