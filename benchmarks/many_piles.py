"""Many piles of the report's spheres, each from another start: how fast is a pile still in its last second?

    python benchmarks/many_piles.py [--edge 4] [--piles 128] [--seconds 20] [--periodic] [--processes 2]
                                    [--results FOLDER]

Piles differ by a factor of ten in that, so one says little about a change of the contact law, and a hundred say
something: compare the medians, and the values by a rank test. 50 spheres for each square metre of floor, as in
pile_at_rest.py; --periodic takes the side walls away. --results writes many_piles.json there, with all values.
"""

from __future__ import annotations

import json
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import click
import fastcollide as fc
import numpy as np

DT = 1 / 60
FAST = 0.5  # such a sphere falls freely, or nearly so [m/s]


def measure(edge: float, seconds: int, periodic: bool, seed: int) -> dict[str, float]:
    """Of the last second: six moments, a sixth of a second apart."""
    bounds = ((0, 0, 0), (edge, edge, 20))
    boundary = ("periodic", "periodic", "wall") if periodic else "wall"
    world = fc.World(bounds, boundary, drag=0.0, device="cpu", threads=1)
    world.add(fc.random_spheres(round(50 * edge**2), bounds, seed=seed))
    world.step(60 * (seconds - 1), DT)
    squares = []
    for _ in range(6):
        world.step(10, DT)
        squares.append(squared_speeds(world, periodic))
    square = np.array(squares)
    slow = square[square < FAST**2]
    return {
        "seed": seed,
        "v_rms": float(np.sqrt(square.mean())),
        "v_rms_of_slow": float(np.sqrt(slow.mean())),
        "fast_part": 1 - slow.size / square.size,
        "median_speed": float(np.sqrt(np.median(square))),
        "mean_overlap": world.mean_overlap(),
    }


def squared_speeds(world: fc.World, periodic: bool) -> np.ndarray:
    velocity = fc.to_numpy(world.velocities).astype(np.float64)
    if periodic:  # less what the centre of mass does sideways: nothing can stop it
        velocity[:, :2] -= np.average(velocity, axis=0, weights=fc.to_numpy(world.masses))[:2]
    return (velocity**2).sum(axis=1)


@click.command(help=__doc__.splitlines()[0])
@click.option("--edge", type=click.FloatRange(min=1), default=4.0, help="Of the floor [m].")
@click.option("--piles", type=click.IntRange(min=1), default=128)
@click.option("--seconds", type=click.IntRange(min=1), default=20)
@click.option("--periodic", is_flag=True)
@click.option("--processes", type=click.IntRange(min=1), default=2)
@click.option("--results", type=click.Path(path_type=Path))
def main(edge: float, piles: int, seconds: int, periodic: bool, processes: int, results: Path | None) -> None:
    with ProcessPoolExecutor(processes) as pool:
        running = [pool.submit(measure, edge, seconds, periodic, seed) for seed in range(1, piles + 1)]
        found = [one.result() for one in running]
    for name in ("v_rms", "v_rms_of_slow", "fast_part", "median_speed", "mean_overlap"):
        low, median, high = np.quantile([one[name] for one in found], (0.1, 0.5, 0.9))
        print(f"{name:14} median {median:.5f}, a tenth below {low:.5f}, a tenth above {high:.5f}")
    if results:
        results.mkdir(parents=True, exist_ok=True)
        case = {"edge": edge, "seconds": seconds, "periodic": periodic, "piles": found}
        (results / "many_piles.json").write_text(json.dumps(case, indent=1) + "\n")


if __name__ == "__main__":
    main()
