"""The settings of `fastcollide bench`."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fastcollide.parameters import Choice, DeviceName, FilePath, Kind, Real, Several, Switch, Text, Whole
from fastcollide.settings import parameters_of

PHYSICS = ("reference", "substep", "friction")
METHODS = ("cells", "list", "frame", "levels", "auto")
SIZES, PEER_SIZES = (1_000, 5_000, 10_000, 20_000), (100_000, 1_000_000)


def _about(kind: Kind, help: str, **details: Any) -> dict[str, Any]:
    return {"kind": kind, "help": help, **details}


def _written(sizes: tuple[int, ...]) -> str:
    return ",".join(map(str, sizes))


@dataclass(frozen=True, kw_only=True)
class BenchSettings:
    """What is measured, how often and how long.

    Raises InvalidSetting where a value is outside its range.
    """

    sizes: tuple[int, ...] | None = field(
        default=None,
        metadata=_about(
            Several(Whole(1, 100_000_000)),
            "Numbers of spheres.",
            unset=f"{_written(SIZES)}; with --peers {_written(PEER_SIZES)}",
        ),
    )
    solver: tuple[str, ...] = field(
        default=PHYSICS,
        metadata=_about(Several(Choice(PHYSICS)), "Solvers; friction is substep with friction and spin."),
    )
    method: tuple[str, ...] = field(
        # Levels are for sizes far apart, which the report's scene does not have.
        default=("cells", "list", "frame", "auto"),
        metadata=_about(
            Several(Choice(METHODS)),
            "How neighbours are found: a grid for every pass, lists that hold, lists for a frame or a few, grids for "
            "each size of spheres, or as a world does by itself.",
        ),
    )
    device: tuple[str, ...] | None = field(
        default=None, metadata=_about(Several(DeviceName()), "Where to compute.", unset="the CPU and every GPU")
    )
    threads: int | None = field(default=None, metadata=_about(Whole(1, 1024), "Threads on the CPU.", unset="all cores"))
    repeats: int = field(default=5, metadata=_about(Whole(1, 1000), "How often each is measured; the median counts."))
    frames: int = field(
        default=60, metadata=_about(Whole(1, 100_000), "Frames of each measurement, after 40 to warm up.")
    )
    seconds: float = field(
        default=60.0,
        metadata=_about(
            Real(0, 86400, without_minimum=True),
            "Time for each row; a repeat that would go beyond it is not begun.",
            unit="s",
        ),
    )
    peers: bool = field(
        default=False,
        metadata=_about(
            Switch(), "Compare the contact search with SciPy, freud, Warp and LAMMPS instead, where installed."
        ),
    )
    output: Path | None = field(
        default=None, metadata=_about(FilePath(), "Folder for the results as CSV and JSON.", unset="none are written")
    )
    note: str | None = field(
        default=None,
        metadata=_about(Text(), "What a reader of the files should know of the machine.", unset="nothing"),
    )

    def __post_init__(self) -> None:
        for name, parameter in BENCH_PARAMETERS.items():
            parameter.check(getattr(self, name))


BENCH_PARAMETERS = parameters_of(BenchSettings)
WITH_PEERS = ("sizes", "threads", "repeats", "peers", "output", "note")
