"""`fastcollide bench --peers` in front of a person: a table on the screen, CSV and JSON in a folder."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from itertools import groupby, product

from rich.console import Console
from rich.table import Table

import fastcollide as fc
from fastcollide.bench_report import write_table
from fastcollide.bench_settings import PEER_SIZES, BenchSettings
from fastcollide.console import EXIT_FAILURE, EXIT_FINE, fail, progress_bar, say
from fastcollide.peers import DifferentPairs, PeerRow, compare, versions

RATIOS = (1, 8)  # largest radius over smallest


def compare_and_report(settings: BenchSettings) -> int:
    """Compares, prints a table and writes files; returns the exit code: 1 where a peer found other pairs."""
    if settings.output is not None:
        settings.output.mkdir(parents=True, exist_ok=True)
    jobs = list(product(settings.sizes or PEER_SIZES, RATIOS))
    threads = settings.threads or os.cpu_count() or 1
    rows: list[PeerRow] = []
    missing: dict[str, None] = {}
    try:
        with progress_bar("comparisons", len(jobs)) as show_progress:
            for done, (count, ratio) in enumerate(jobs):
                rows += compare(count, ratio, settings.repeats, threads, lambda name: missing.setdefault(name))
                show_progress(done + 1, len(jobs))
    except DifferentPairs as error:
        fail(str(error))
        return EXIT_FAILURE
    _print_table(rows)
    for name in missing:
        say("not installed", name)
    if settings.output is not None:
        machine = fc.devices()[0].description
        lines = [{"machine": machine, "threads": threads, **asdict(row), "note": settings.note} for row in rows]
        content = {
            "machine": machine,
            "threads": threads,
            "repeats": settings.repeats,
            "note": settings.note,
            "versions": versions(),
            "searches": [asdict(row) for row in rows],
        }
        write_table(settings.output, "search", lines, content)
    return EXIT_FINE


def _print_table(rows: Sequence[PeerRow]) -> None:
    table = Table("spheres", "sizes", "search", "pairs", "best ms", "median ms", "processor ms", "× FastCollide")
    table.title = "which spheres touch?"
    for column in table.columns:
        column.justify = "left" if column.header in ("sizes", "search") else "right"
    for _, rows_of_size in groupby(rows, key=lambda row: (row.spheres, row.sizes)):
        for row in rows_of_size:
            times = (f"{value:,.2f}" for value in (row.best_ms, row.median_ms, row.processor_ms))
            figures = (f"{row.spheres:,}", row.sizes, row.search, f"{row.pairs:,}")
            table.add_row(*figures, *times, f"{row.times_fastcollide:.2f}")
        table.add_section()
    Console(width=max(Console().width, 136)).print(table)
