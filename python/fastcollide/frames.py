"""Frame files: one text file for each exported frame, readable by people and by any program.

A file holds five header lines and then one line for each sphere, in id order::

    # FastCollide frame, format 1
    # frame: 120
    # time: 2 s
    # count: 2000
    # columns: id x[m] y[m] z[m] radius[m]
    0 -1.5 2.25 3.125 0.4
    1 ...

Numbers are written with as many digits as float32 needs to come back unchanged.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastcollide import _core
from fastcollide.files import written_beside
from fastcollide.snapshots import Cast, Snapshot

FIRST_LINE = b"# FastCollide frame, format 1"
_HEADER_LINES = 5
_FILE_NAME = re.compile(r"frame_\d{8}\.txt")
_ROW = np.dtype([("id", np.int64), ("position", np.float32, 3), ("radius", np.float32)])


class FrameError(ValueError):
    """A file is not a whole frame file; the message names the file and what is wrong."""


@dataclass(frozen=True)
class Frame:
    """One frame of a run.

    Arrays are float32, in id order.

    Attributes:
        frame: number of frames simulated before it was written.
        time: simulated time [s].
        positions: [m], shape (n, 3).
        radii: [m], shape (n,).
        velocities: [m/s], shape (n, 3), or None where the file has none, as text files never have.
        spins: [rad/s], shape (n, 3), or None likewise.
    """

    frame: int
    time: float
    positions: NDArray[np.float32]
    radii: NDArray[np.float32]
    velocities: NDArray[np.float32] | None = None
    spins: NDArray[np.float32] | None = None


def frame_path(folder: str | os.PathLike[str], frame: int) -> Path:
    """Where the file of this frame lies. Eight digits, so that names sort like numbers."""
    return Path(folder) / f"frame_{frame:08d}.txt"


def frame_paths(folder: str | os.PathLike[str]) -> list[Path]:
    """All frame files of a folder, earliest first."""
    return sorted(path for path in Path(folder).iterdir() if _FILE_NAME.fullmatch(path.name))


def remove_frames(folder: str | os.PathLike[str], after: int = -1) -> int:
    """Deletes the frame files of an earlier run, those after this frame, and returns how many there were.

    A file that only has such a name, but does not start like a frame file, stays.
    """
    removed = 0
    for path in frame_paths(folder):
        if int(path.stem.removeprefix("frame_")) <= after:
            continue
        with path.open("rb") as file:
            is_frame = file.readline().rstrip() == FIRST_LINE
        if is_frame:
            path.unlink()
            removed += 1
    return removed


def write_frame(path: str | os.PathLike[str], frame: int, time: float, positions: ArrayLike, radii: ArrayLike) -> None:
    """Writes one frame file; under its name it is whole or not there at all.

    Args:
        path: the file.
        frame: frames simulated so far.
        time: simulated time [s].
        positions: [m], shape (n, 3).
        radii: [m], shape (n,).

    Raises:
        OSError: where the file cannot be written.
    """
    content = _core.format_frame(
        frame,
        time,
        np.ascontiguousarray(positions, dtype=np.float32),
        np.ascontiguousarray(radii, dtype=np.float32),
    )
    with written_beside(Path(path)) as unfinished:
        unfinished.write_bytes(content)


class FrameFiles:
    """Writes the frame files of a run; a Sink of Exports."""

    def __init__(self, folder: Path, cast: Cast) -> None:
        self._folder = folder
        self._cast = cast

    def write(self, snapshot: Snapshot) -> Path:
        path = frame_path(self._folder, snapshot.frame)
        write_frame(path, snapshot.frame, snapshot.time, snapshot.positions, self._cast.radii)
        return path

    def close(self) -> None:
        pass  # each file is whole when it is there


def read_frame(path: str | os.PathLike[str]) -> Frame:
    """Reads one frame file.

    Args:
        path: the file.

    Raises:
        FrameError: where it is not a whole frame file.
        OSError: where it cannot be read.
    """
    path = Path(path)
    content = path.read_bytes()
    with BytesIO(content) as file:
        frame, time = _read_clock(path, file)
        count = _header_number(path, file.readline(), "count")
        file.readline()
        # Line breaks, not lines: a last line without one may have lost digits.
        lines = content.count(b"\n") - _HEADER_LINES
        if lines != count:
            raise FrameError(f"{path}: found {lines} whole lines of spheres; the header says {count:.0f}")
        try:
            rows = np.loadtxt(file, dtype=_ROW, ndmin=1) if count else np.empty(0, _ROW)
        except ValueError as error:
            raise FrameError(f"{path}: found a line without id, x, y, z, radius ({error})") from None
    if not np.array_equal(rows["id"], np.arange(count)):
        raise FrameError(f"{path}: found ids out of order; they must count up from 0")
    return Frame(int(frame), time, rows["position"], rows["radius"])


def read_frame_time(path: Path) -> float:
    """The time of a frame file [s], from its header alone. Raises as read_frame() does."""
    with path.open("rb") as file:
        return _read_clock(path, file)[1]


def _read_clock(path: Path, file: BinaryIO) -> tuple[float, float]:
    """Frame and time [s] from the first lines of a frame file."""
    if file.readline().rstrip() != FIRST_LINE:
        raise FrameError(f"{path}: found no frame file; its first line must be '{FIRST_LINE.decode()}'")
    return _header_number(path, file.readline(), "frame"), _header_number(path, file.readline(), "time")


def _header_number(path: Path, line: bytes, key: str) -> float:
    match = re.match(rb"# " + key.encode() + rb": ([-+.e\d]+)", line)
    try:
        if match:
            return float(match[1])
    except ValueError:
        pass
    raise FrameError(f"{path}: found '{line.decode(errors='replace').strip()}'; expected '# {key}: ' and a number")
