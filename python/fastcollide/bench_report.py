"""`fastcollide bench` in front of a person: tables on the screen, CSV and JSON in a folder."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from itertools import groupby
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

import fastcollide as fc
from fastcollide.bench import STAGES, WARM_UP, DifferentStates, Row, run_bench
from fastcollide.bench_settings import BenchSettings
from fastcollide.console import EXIT_FAILURE, EXIT_FINE, fail, progress_bar, say
from fastcollide.files import written_beside

NARROWEST = 132  # columns of text that hold every figure


def bench_and_report(settings: BenchSettings) -> int:
    """Measures, prints tables and writes files; returns the exit code: 1 where two states differ."""
    if fc.build_info().is_debug:
        fail("this is a debug build, whose times say nothing: build with CMAKE_BUILD_TYPE=Release")
        return EXIT_FAILURE
    if settings.output is not None:
        settings.output.mkdir(parents=True, exist_ok=True)  # a folder that cannot be made is told before the work
    try:
        with progress_bar("measurements") as show_progress:
            rows = run_bench(settings, show_progress, lambda case, reason: fail(f"{case}: left out: {reason}"))
    except DifferentStates as error:
        fail(str(error))
        return EXIT_FAILURE
    if not rows:
        fail("no device has the memory for any of these")
        return EXIT_FAILURE
    for _, rows_of_device in groupby(rows_by_device(rows), key=lambda row: row.device):
        print_tables(list(rows_of_device))
    if settings.output is not None:
        write_files(settings.output, settings, rows)
    return EXIT_FINE


def rows_by_device(rows: Sequence[Row]) -> list[Row]:
    devices = list(dict.fromkeys(row.device for row in rows))
    return sorted(rows, key=lambda row: devices.index(row.device))


def print_tables(rows: Sequence[Row]) -> None:
    """The rows of one device: what came out, and where the time went."""
    first = rows[0]
    console = Console(width=max(Console().width, NARROWEST))
    copy = "no library to measure it with" if first.copy_gb_s is None else f"{first.copy_gb_s:,.0f} GB/s"
    results = _table(
        "ms a frame", "fastest", "slowest", "one by one", "× yardstick", "% of roof", "contacts each", "state"
    )
    results.title = (
        f"{first.device}: {first.device_name}; frames {WARM_UP + 1} to {WARM_UP + first.frames}; "
        f"copy: {copy}; yardstick: reference, cells; one by one: each frame a call"
    )
    stages_there = [stage for stage in STAGES if any(stage in row.stages for row in rows)]
    stages = _table(*(stage.replace("_", " ") for stage in stages_there))
    stages.title = "ms a frame in each stage, with a wait after each"
    for spheres, rows_of_size in groupby(rows, key=lambda row: row.spheres):
        for row in rows_of_size:
            names = (f"{spheres:,}", row.solver, row.method)
            share = "" if row.roof_share is None else f"{100 * row.roof_share:.1f}"
            times = (f"{value:.4g}" for value in (row.ms, row.ms_fastest, row.ms_slowest, row.ms_one_by_one))
            ratio = "" if row.times_yardstick is None else f"{row.times_yardstick:.2f}"
            figures = (ratio, share, f"{row.contacts_per_sphere:.2f}", row.state_hash)
            results.add_row(*names, *times, *figures)
            stages.add_row(
                *names, *(f"{row.stages[stage]:.4g}" if stage in row.stages else "" for stage in stages_there)
            )
        results.add_section()
        stages.add_section()
    console.print(results)
    console.print(stages)


def _table(*figures: str) -> Table:
    table = Table("spheres", "solver", "method", *figures)
    for column in table.columns:
        column.no_wrap = column.header in ("spheres", "solver", "method", "state")
        column.justify = "left" if column.header in ("solver", "method") else "right"
    return table


def csv_row(row: Row, note: str | None) -> dict[str, Any]:
    """One line of bench.csv: the figures of the row, then each stage [ms], empty where there is none."""
    values = asdict(row)
    stages = values.pop("stages")
    rounded = {name: f"{value:.6g}" if isinstance(value, float) else value for name, value in values.items()}
    by_stage = {f"{stage}_ms": f"{stages[stage]:.6g}" if stage in stages else None for stage in STAGES}
    return {**rounded, **by_stage, "version": fc.__version__, "note": note}


def write_files(folder: Path, settings: BenchSettings, rows: Sequence[Row]) -> None:
    """Writes bench.csv and bench.json into the folder."""
    lines = [csv_row(row, settings.note) for row in rows]
    options = {entry.name: getattr(settings, entry.name) for entry in fields(settings) if entry.name != "output"}
    write_table(
        folder,
        "bench",
        lines,
        {"build": asdict(fc.build_info()), "options": options, "rows": [asdict(row) for row in rows]},
    )


def write_table(folder: Path, name: str, lines: Sequence[dict[str, Any]], content: dict[str, Any]) -> None:
    """Writes the lines as name.csv and the content as name.json, each whole or not at all."""
    with (
        written_beside(folder / f"{name}.csv") as unfinished,
        unfinished.open("w", encoding="utf-8", newline="") as file,
    ):
        writer = csv.DictWriter(file, lines[0], lineterminator="\n")
        writer.writeheader()
        writer.writerows(lines)
    with written_beside(folder / f"{name}.json") as unfinished:
        unfinished.write_text(json.dumps(content, indent=1, default=str) + "\n", encoding="utf-8")
    for suffix in ("csv", "json"):
        say(suffix.upper(), str((folder / f"{name}.{suffix}").resolve()))
