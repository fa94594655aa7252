"""`fastcollide --test`: the report's performance table, on this machine."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass, replace

from rich.console import Console
from rich.table import Table

import fastcollide as fc
from fastcollide.console import EXIT_FAILURE, EXIT_FINE, fail, progress_bar
from fastcollide.run import create_world
from fastcollide.settings import RunSettings

SPHERE_COUNTS = (1_000, 5_000, 10_000, 20_000)
FRAMES = 100


@dataclass(frozen=True)
class Row:
    """One measurement. Times are those of all frames together.

    total_ms: undisturbed [ms]; grid_ms, collision_ms: from a second pass that times each stage [ms];
    state_hash: of the last frame, the same on every device.
    """

    device: str
    device_name: str
    spheres: int
    frames: int
    total_ms: float
    frames_per_second: float
    grid_ms: float
    collision_ms: float
    state_hash: str


def configurations(device: str | None, threads: int | None) -> list[tuple[str, int | None]]:
    """The devices to measure: the one asked for, or the CPU with one thread and with all, and each GPU."""
    if device is not None or threads is not None:
        return [(device or "cpu", threads)]
    return [("cpu", 1), ("cpu", None)] + [(entry.name, None) for entry in fc.devices() if entry.name != "cpu"]


def measure(spheres: int, device: str, threads: int | None) -> Row:
    """Runs the report's scene twice from its start: once for the total, once for the stages."""
    settings = replace(RunSettings(), solver="reference", particles=spheres, device=device, threads=threads)
    create_world(settings).step(2, dt=settings.dt)  # the first use of a device is slow

    world = create_world(settings)
    started = time.perf_counter()
    world.step(FRAMES, dt=settings.dt)
    total = time.perf_counter() - started

    timed_world = create_world(settings)
    timed_world.timed = True
    timed_world.step(FRAMES, dt=settings.dt)
    stages = timed_world.stage_times
    return Row(
        device=world.device,
        device_name=world.device_name,
        spheres=spheres,
        frames=FRAMES,
        total_ms=1000 * total,
        frames_per_second=FRAMES / total,
        grid_ms=1000 * (stages["build_grid"] + stages["make_lists"]),
        collision_ms=1000 * stages["solve_contacts"],
        state_hash=f"{world.state_hash():016x}",
    )


def _print_table(rows: list[Row]) -> None:
    """One table: the rows of one device."""
    table = Table("N", "total ms", "FPS", "grid ms", "collision ms", "state hash")
    table.title = f"{rows[0].device}: {rows[0].device_name}, {rows[0].frames} frames"
    for column in table.columns[:5]:
        column.justify = "right"
    for row in rows:
        times = (row.total_ms, row.frames_per_second, row.grid_ms, row.collision_ms)
        table.add_row(f"{row.spheres:,}", *(f"{value:,.1f}" for value in times), row.state_hash)
    Console().print(table)


def test_and_report(device: str | None, threads: int | None, as_json: bool) -> int:
    """Measures and prints the table; returns the exit code."""
    rows = []
    jobs = [(*configuration, spheres) for configuration in configurations(device, threads) for spheres in SPHERE_COUNTS]
    with progress_bar("measurements", len(jobs)) as show_progress:
        for name, count, spheres in jobs:
            rows.append(measure(spheres, name, count))
            show_progress(len(rows), len(jobs))
    if as_json:
        print(json.dumps({"build": asdict(fc.build_info()), "rows": [asdict(row) for row in rows]}, indent=2))
    else:
        for start in range(0, len(rows), len(SPHERE_COUNTS)):
            _print_table(rows[start : start + len(SPHERE_COUNTS)])
    for spheres in SPHERE_COUNTS:
        if len({row.state_hash for row in rows if row.spheres == spheres}) > 1:
            fail(f"{spheres:,} spheres: found different states on different devices; they must be equal")
            return EXIT_FAILURE
    return EXIT_FINE
