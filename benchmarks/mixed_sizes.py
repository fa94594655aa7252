"""The time of a frame of spheres whose sizes differ more and more, by each way to find neighbours.

    python benchmarks/mixed_sizes.py [--device cuda] [--sizes 20000,100000] [--ratios 1,8,32,100]
                                     [--methods auto,list] [--solvers substep,reference] [--frames 20] [--repeats 3]
                                     [--seconds 20] [--output FOLDER] [--note TEXT]

`ratio` is the largest radius (0.4 m) over the smallest, with equal volume in each octave of sizes; the spheres fill a
tenth of a box of walls, none overlaps at the start, speeds are about 1 m/s. All methods must end in the same state. A
method that took longer than `--seconds` for a ratio is not tried for larger ones. Writes mixed_sizes.csv and
mixed_sizes.json.
"""

import argparse
import functools
import statistics
import time
from pathlib import Path

import fastcollide as fc
import numpy as np
from fastcollide.bench_report import write_table

LARGEST_RADIUS, FILL, DT = 0.4, 0.1, 1 / 60
WARM_UP = 10


@functools.lru_cache(maxsize=1)
def mixed_spheres(count: int, ratio: float) -> tuple[fc.Spheres, float]:
    """Spheres that do not overlap, and the edge of their box [m]."""
    random = np.random.default_rng(1)
    smallest = LARGEST_RADIUS / ratio
    # Density of r proportional to r⁻⁴, by the inverse of its distribution.
    radius = smallest * (1 - random.random(count) * (1 - ratio**-3.0)) ** (-1 / 3)
    radius[0] = LARGEST_RADIUS
    edge = max((4 / 3 * np.pi * (radius**3).sum() / FILL) ** (1 / 3), 4 * LARGEST_RADIUS)
    position = np.empty((count, 3), np.float32)
    # In a pair that overlaps, the smaller sphere gets another place.
    misplaced = np.arange(count)
    while len(misplaced) > 0:
        inside = edge - 2.0002 * radius[misplaced, None]
        position[misplaced] = 1.0001 * radius[misplaced, None] + random.random((len(misplaced), 3)) * inside
        pairs = fc.find_contacts(position, radius.astype(np.float32), output="pairs")
        is_first_smaller = radius[pairs.first] < radius[pairs.second]
        misplaced = np.unique(np.where(is_first_smaller, pairs.first, pairs.second))
    velocity, mass = random.normal(0, 1, (count, 3)), 1000 * 4 / 3 * np.pi * radius**3
    arrays = (position, velocity, radius, mass, np.full(count, 0.9))
    return fc.Spheres(*(array.astype(np.float32) for array in arrays)), edge


def measure(device: str, count: int, ratio: float, solver: str, method: str, frames: int, repeats: int) -> dict:
    spheres, edge = mixed_spheres(count, ratio)
    world = fc.World(((0, 0, 0), (edge, edge, edge)), device=device, solver=solver, method=method)
    world.add(spheres)
    world.step(WARM_UP, DT)
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        world.step(frames, DT)
        seconds.append((time.perf_counter() - started) / frames)
    return {
        "device": world.device,
        "device_name": world.device_name,
        "spheres": count,
        "ratio": ratio,
        "solver": solver,
        "method": method,
        "frames": frames,
        "repeats": repeats,
        "ms": 1e3 * statistics.median(seconds),
        "contacts_per_sphere": world.contact_count() / count,
        "state_hash": f"{world.state_hash():016x}",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--sizes", default="20000,100000")
    parser.add_argument("--ratios", default="1,8,32,100")
    parser.add_argument("--methods", default="auto,list")
    parser.add_argument("--solvers", default="substep")
    parser.add_argument("--frames", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--output", type=Path)
    parser.add_argument("--note", default="")
    given = parser.parse_args()
    if given.output is not None:
        given.output.mkdir(parents=True, exist_ok=True)
    rows = []
    for count in map(int, given.sizes.split(",")):
        slow = set()
        for ratio in map(float, given.ratios.split(",")):
            for solver in given.solvers.split(","):
                states = set()
                for method in given.methods.split(","):
                    if (solver, method) in slow:
                        continue
                    row = measure(given.device, count, ratio, solver, method, given.frames, given.repeats)
                    if row["ms"] * given.frames * given.repeats > 1e3 * given.seconds:
                        slow.add((solver, method))
                    states.add(row["state_hash"])
                    rows.append({**row, "version": fc.__version__, "note": given.note})
                    print(
                        f"{count:,} 1:{ratio:g} {solver} {method}: {row['ms']:.4g} ms, {row['state_hash']}", flush=True
                    )
                if len(states) > 1:
                    raise SystemExit("the methods ended in different states; nothing was written")
    if given.output is not None:
        write_table(given.output, "mixed_sizes", rows, {"rows": rows})


if __name__ == "__main__":
    main()
