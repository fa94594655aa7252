"""Many piles of the report's spheres, each from another start: how fast is a pile still after some time?

    python benchmarks/many_piles.py [--edge 4] [--piles 128] [--at 20 --at 30 ...] [--periodic] [--drag 0]
                                    [--device cpu] [--processes 2] [--results FOLDER]

Piles differ by a factor of ten in that, so one says little about a change of the contact law, and a hundred say
something: compare the medians, and the values by a rank test. 50 spheres for each square metre of floor, as in
pile_at_rest.py; --periodic takes the side walls away. Each time is the end of the second that is measured. On a GPU a
pile of 20,000 takes half a second. --results adds all values to many_piles.csv there.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import click
import fastcollide as fc
import numpy as np

DT = 1 / 60
FAST = 0.5  # such a sphere falls freely, or nearly so [m/s]
NAMES = ("v_rms", "v_rms_of_slow", "fast_part", "median_speed", "mean_overlap")


def run_pile(edge: float, at: tuple[int, ...], periodic: bool, drag: float, device: str, seed: int) -> list[dict]:
    bounds = ((0, 0, 0), (edge, edge, 20))
    boundary = ("periodic", "periodic", "wall") if periodic else "wall"
    world = fc.World(bounds, boundary, drag=drag, device=device, threads=1)
    world.add(fc.random_spheres(round(50 * edge**2), bounds, seed=seed))
    found = []
    for second in sorted(at):
        world.step(60 * (second - 1) - world.frame, DT)
        found.append({"seed": seed, "at": second} | measure_second(world, periodic))
    return found


def measure_second(world: fc.World, periodic: bool) -> dict[str, float]:
    """Six moments, a sixth of a second apart."""
    squares = []
    for _ in range(6):
        world.step(10, DT)
        squares.append(squared_speeds(world, periodic))
    square = np.array(squares)
    slow = square[square < FAST**2]
    values = (
        np.sqrt(square.mean()),
        np.sqrt(slow.mean()),
        1 - slow.size / square.size,
        np.sqrt(np.median(square)),
        world.mean_overlap(),
    )
    return {name: float(f"{value:.6g}") for name, value in zip(NAMES, values, strict=True)}


def squared_speeds(world: fc.World, periodic: bool) -> np.ndarray:
    velocity = fc.to_numpy(world.velocities).astype(np.float64)
    if periodic:  # less what the centre of mass does sideways: nothing can stop it
        velocity[:, :2] -= np.average(velocity, axis=0, weights=fc.to_numpy(world.masses))[:2]
    return (velocity**2).sum(axis=1)


def run_piles(run: Callable[[int], list[dict]], piles: int, processes: int) -> list[dict]:
    seeds = range(1, piles + 1)
    if processes == 1:
        return [one for seed in seeds for one in run(seed)]
    with ProcessPoolExecutor(processes) as pool:
        return [one for found in pool.map(run, seeds) for one in found]


def table(rows: list[dict[str, str]]) -> str:
    """What docs/physics.md shows of many_piles.csv."""
    lines = [
        "| piles | after [s] | v_rms: a tenth below, median, a tenth above [m/s] | at most 0.02 | without what falls |",
        "| --- | --- | --- | --- | --- |",
    ]
    for case in dict.fromkeys((row["edge"], row["periodic"], row["at"]) for row in rows):
        these = [row for row in rows if (row["edge"], row["periodic"], row["at"]) == case]
        edge, seconds = float(these[0]["edge"]), these[0]["at"]
        floor = "periodic floor" if these[0]["periodic"] == "True" else "walls"
        speed = np.array([float(row["v_rms"]) for row in these])
        low, median, high = np.quantile(speed, (0.1, 0.5, 0.9))
        slow = np.median([float(row["v_rms_of_slow"]) for row in these])
        lines.append(
            f"| {len(these)} of {round(50 * edge**2):,}, {edge:.3g} m, {floor} | {seconds} "
            f"| {low:.4f} {median:.4f} {high:.4f} | {np.mean(speed <= 0.02):.0%} | {slow:.4f} |"
        )
    return "\n".join(lines)


def add_rows(path: Path, rows: list[dict]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    is_new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, rows[0], lineterminator="\n")
        if is_new:
            writer.writeheader()
        writer.writerows(rows)


@click.command(help=__doc__.splitlines()[0])
@click.option("--edge", type=click.FloatRange(min=1), default=4.0, help="Of the floor [m].")
@click.option("--piles", type=click.IntRange(min=1), default=128)
@click.option("--at", type=click.IntRange(min=2), multiple=True, default=(20,), help="Seconds; may be given again.")
@click.option("--periodic", is_flag=True)
@click.option("--drag", type=click.FloatRange(min=0), default=0.0, help="[1/s]")
@click.option("--device", default="cpu")
@click.option("--processes", type=click.IntRange(min=1), default=2)
@click.option("--results", type=click.Path(path_type=Path))
def main(
    edge: float,
    piles: int,
    at: tuple[int, ...],
    periodic: bool,
    drag: float,
    device: str,
    processes: int,
    results: Path | None,
) -> None:
    found = run_piles(partial(run_pile, edge, at, periodic, drag, device), piles, processes if device == "cpu" else 1)
    for second in sorted(at):
        print(f"after {second} s")
        then = [one for one in found if one["at"] == second]
        for name in NAMES:
            low, median, high = np.quantile([one[name] for one in then], (0.1, 0.5, 0.9))
            print(f"  {name:14} median {median:.5f}, a tenth below {low:.5f}, a tenth above {high:.5f}")
        print(f"  v_rms at most 0.02 m/s: {np.mean([one['v_rms'] <= 0.02 for one in then]):.0%}")
    if results:
        case = {"edge": edge, "periodic": periodic, "drag": drag, "device": device}
        path = results / "many_piles.csv"
        add_rows(path, [case | one for one in found])
        with path.open(newline="") as file:
            print(table(list(csv.DictReader(file))))


if __name__ == "__main__":
    main()
