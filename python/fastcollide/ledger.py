"""The ledger of a run: energy, momentum, contacts and overlap against time, as a CSV file.

One header line with the names in COLUMNS, then one line for each measured frame. Floats are written with as many digits
as float64 needs to come back unchanged; all of them are exact sums, so two devices give the same bytes. A run that is
killed leaves all rows but the one at hand.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastcollide.errors import MissingLibrary
from fastcollide.files import written_durably
from fastcollide.world import World

LEDGER_NAME = "ledger.csv"
PARQUET_NAME = "ledger.parquet"


@dataclass(frozen=True)
class Column:
    """One column: its name (which ends in the unit, if it has one), its type and what it holds."""

    name: str
    dtype: type
    meaning: str


COLUMNS = (
    Column("frame", np.int64, "frames simulated so far"),
    Column("time_s", np.float64, "simulated time"),
    Column("kinetic_J", np.float64, "energy of translation"),
    Column("rotational_J", np.float64, "energy of rotation"),
    Column("potential_J", np.float64, "energy of height, see Energy"),
    Column("total_J", np.float64, "the sum of the three"),
    Column("momentum_x_Ns", np.float64, "momentum along x, in N s = kg m/s"),
    Column("momentum_y_Ns", np.float64, "momentum along y"),
    Column("momentum_z_Ns", np.float64, "momentum along z"),
    Column("angular_momentum_x_Js", np.float64, "angular momentum about the origin along x, in J s = kg m²/s"),
    Column("angular_momentum_y_Js", np.float64, "angular momentum along y"),
    Column("angular_momentum_z_Js", np.float64, "angular momentum along z"),
    Column("contacts", np.int64, "overlapping pairs of spheres"),
    Column("max_overlap_m", np.float64, "deepest overlap of two spheres, or of a sphere and a wall"),
    Column("mean_overlap", np.float64, "mean overlap of the contacts, each as a part of its smaller radius"),
)
_HEADER = ",".join(column.name for column in COLUMNS)
_ROW = np.dtype([(column.name, column.dtype) for column in COLUMNS])


class LedgerError(ValueError):
    """A file is no ledger; the message names the file and what is wrong."""


def measure(world: World) -> tuple[int | float, ...]:
    """A row of the ledger: the numbers of a world as it is now, in the order of COLUMNS."""
    now = world.measure()
    return (
        world.frame,
        world.time,
        *now.energy,
        now.energy.total,
        *now.momentum.tolist(),
        *now.angular_momentum.tolist(),
        now.contact_count,
        now.max_overlap,
        now.mean_overlap,
    )


class LedgerWriter:
    """Writes a ledger row by row::

        with fc.LedgerWriter("ledger.csv") as ledger:
            ledger.add(world)
            for _ in range(60):
                world.step(10)
                ledger.add(world)

    Args:
        path: the file; a ledger of this name is replaced.
        keep: where a run goes on, the frames of the rows that stay; what the ledger holds beside them is cut off.

    Raises:
        LedgerError: where the file is something else or lacks one of these rows.
        OSError: where it cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str], keep: Sequence[int] | None = None) -> None:
        self.path = Path(path)
        self.rows = 0
        check_replaceable(self.path)
        if keep is not None:
            _cut(self.path, keep)
            self.rows = len(keep)
        mode = "w" if keep is None else "a"
        self._file = self.path.open(mode, encoding="ascii", newline="\n", buffering=1)  # each line goes out whole
        if keep is None:
            self._file.write(_HEADER + "\n")

    def __enter__(self) -> LedgerWriter:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def add(self, world: World) -> None:
        """Adds the state of a world as it is now."""
        self._file.write(",".join(map(repr, measure(world))) + "\n")
        self.rows += 1

    def flush(self) -> None:
        """Waits until all rows are on the disk."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """Ends the file. May be called twice."""
        self._file.close()


def _cut(path: Path, frames: Sequence[int]) -> None:
    """Leaves the rows of these frames in a ledger, byte for byte."""
    found = read_ledger(path)["frame"].tolist()
    rows = dict(zip(found, path.read_bytes().split(b"\n")[1:], strict=False))
    missing = [frame for frame in frames if frame not in rows]
    if missing:
        raise LedgerError(f"{path}: found no row of frame {missing[0]}; a run that goes on needs all rows before it")
    with written_durably(path) as unfinished:
        unfinished.write_bytes(b"".join(line + b"\n" for line in (_HEADER.encode(), *map(rows.get, frames))))


def check_replaceable(path: Path) -> None:
    """Raises LedgerError where a file of this name is there that no run has written."""
    if path.exists() and not _is_ledger(path.read_bytes()[: len(_HEADER) + 2]):
        raise LedgerError(
            f"{path}: found a file that is no ledger; it would be lost, so move it or choose another folder"
        )


def read_ledger(path: str | os.PathLike[str]) -> dict[str, NDArray[Any]]:
    """The columns of a ledger by name, int64 or float64, shape (rows,): ``pandas.DataFrame(fc.read_ledger(folder))``.

    A last line that a killed run has not finished is left out.

    Args:
        path: the file, or the folder of a run.

    Raises:
        LedgerError: where it is no ledger.
        OSError: where it cannot be read.
    """
    path = Path(path)
    if path.is_dir():
        path = path / LEDGER_NAME
    content = path.read_bytes()
    if not _is_ledger(content):
        found = content.split(b"\n", 1)[0][:80].decode(errors="replace")
        raise LedgerError(f"{path}: found '{found}' in the first line; a ledger starts with '{_HEADER[:30]}…'")
    lines = content.decode("ascii", errors="replace").split("\n")[1:-1]
    rows = np.empty(len(lines), dtype=_ROW)
    for i, line in enumerate(lines):
        try:
            cells = line.split(",")
            rows[i] = tuple(column.dtype(cell) for column, cell in zip(COLUMNS, cells, strict=True))
        except ValueError:
            raise LedgerError(f"{path}: found '{line}' in line {i + 2}; expected {len(COLUMNS)} numbers") from None
    return {column.name: np.ascontiguousarray(rows[column.name]) for column in COLUMNS}


def need_parquet() -> None:
    """Raises MissingLibrary where there is no PyArrow."""
    try:
        import pyarrow.parquet  # noqa: F401
    except ImportError:
        raise MissingLibrary(
            'Parquet files need PyArrow, which is not installed; get it with: pip install "fastcollide[files]"'
        ) from None


def write_parquet(path: str | os.PathLike[str], ledger: Mapping[str, NDArray[Any]]) -> None:
    """Writes columns as read_ledger() gives them into a Parquet file; it is whole or not there at all.

    Raises MissingLibrary where there is no PyArrow, OSError where the file cannot be written.
    """
    need_parquet()
    import pyarrow
    import pyarrow.parquet

    about = {column.name: {"meaning": column.meaning} for column in COLUMNS}
    table = pyarrow.table(
        [*ledger.values()],
        schema=pyarrow.schema(
            [
                pyarrow.field(name, pyarrow.from_numpy_dtype(values.dtype), nullable=False, metadata=about.get(name))
                for name, values in ledger.items()
            ]
        ),
    )
    with written_durably(Path(path)) as unfinished:
        pyarrow.parquet.write_table(table, unfinished)


def _is_ledger(content: bytes) -> bool:
    return content.replace(b"\r\n", b"\n").startswith(_HEADER.encode() + b"\n")
