"""What writing frames costs a run: the same frames with and without it, in turns.

    python benchmarks/export_cost.py --rounds 15

Each round loads one saved state again and again, and from there steps the same frames writing nothing, text files,
GSD, VTKHDF, and all of them, every second frame. All that a run waits for counts, up to the last byte being written.
Shown is the median over the rounds of the time, and of the processors' time, over that without writing in the same
round, with the rounds' middle half. On a machine that others use at the same time, the second one says more.
"""

from __future__ import annotations

import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import click
import fastcollide as fc
from fastcollide.exports import Exports, Sink
from fastcollide.frames import FrameFiles
from fastcollide.snapshots import Cast, cast_of
from fastcollide.trajectories import open_writer

KINDS = {
    "nothing": (),
    "text": ("text",),
    "gsd": ("gsd",),
    "vtkhdf": ("vtkhdf",),
    "gsd, vtkhdf": ("gsd", "vtkhdf"),
    "all": ("text", "gsd", "vtkhdf"),
}


class Times(NamedTuple):
    """Seconds: on the clock, and of all processors together."""

    clock: float
    processors: float


def sink(kind: str, folder: Path, cast: Cast, frames: Sequence[int]) -> Sink:
    return FrameFiles(folder, cast) if kind == "text" else open_writer(folder / f"run.{kind}", cast, frames)


def measure(kinds: Sequence[str], state: Path, frames: int, every: int, device: str, threads: int | None) -> Times:
    """Seconds for these frames."""
    world = fc.World.load(state, device=device, threads=threads)
    world.step(every)  # first call: memory and lists
    cast = cast_of(world)
    with tempfile.TemporaryDirectory(dir=state.parent) as name:
        numbers = range(world.frame + every, world.frame + frames + 1, every)
        sinks = [sink(kind, Path(name), cast, numbers) for kind in kinds]
        started, processors = time.perf_counter(), time.process_time()
        with Exports(cast, sinks) as exports:
            for _ in numbers:
                world.step(every)
                exports.add(world)
        return Times(time.perf_counter() - started, time.process_time() - processors)


@click.command()
@click.option("--particles", default=20_000, show_default=True)
@click.option("--before", default=150, show_default=True, help="Frames before the saved state.")
@click.option("--frames", default=40, show_default=True, help="Frames that are timed.")
@click.option("--every", default=2, show_default=True, help="Frames from one that is written to the next.")
@click.option("--rounds", default=15, show_default=True)
@click.option("--friction", default=0.0, show_default=True, help="Of the spheres; with some they spin.")
@click.option("--device", default="cpu", show_default=True)
@click.option("--threads", type=int, help="[default: all]")
@click.option(
    "--folder", type=click.Path(file_okay=False, path_type=Path), help="Where to write. [default: the system's]"
)
def main(
    particles: int,
    before: int,
    frames: int,
    every: int,
    rounds: int,
    friction: float,
    device: str,
    threads: int | None,
    folder: Path | None,
) -> None:
    """Measure what writing frames costs."""
    work = Path(tempfile.mkdtemp(dir=folder))
    try:
        world = fc.World(device=device, threads=threads)
        world.add(fc.random_spheres(particles, bounds=world.bounds, friction=friction))
        world.step(before)
        state = work / "state.fcw"
        world.save(state)
        print(f"{particles:,} spheres on {world.device_name}, frames {before} to {before + frames}, every {every}.")
        times: dict[str, list[Times]] = {name: [] for name in KINDS}
        loads = [os.getloadavg()[0]]
        for _ in range(rounds):
            for name, kinds in KINDS.items():
                times[name].append(measure(kinds, state, frames, every, device, threads))
            loads.append(os.getloadavg()[0])
    finally:
        shutil.rmtree(work)
    print(f"{rounds} rounds; load {min(loads):.1f} to {max(loads):.1f} on {os.cpu_count()} processors\n")
    print("| writes | ms a frame | cost | middle half | processor ms | cost | middle half |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name, found in times.items():
        cells = [name]
        for mine, base in zip(zip(*found, strict=True), zip(*times["nothing"], strict=True), strict=True):
            low, middle, high = statistics.quantiles(
                [1e2 * (one / other - 1) for one, other in zip(mine, base, strict=True)], n=4, method="inclusive"
            )
            cells.append(f"{1e3 * statistics.median(mine) / frames:.2f}")
            cells += [f"{middle:+.1f} %", f"{low:+.1f} to {high:+.1f} %"] if KINDS[name] else ["", ""]
        print(f"| {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
