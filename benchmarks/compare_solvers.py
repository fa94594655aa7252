"""Time per frame of the reference solver and of the default one, without and with friction, and where it goes.

    python benchmarks/compare_solvers.py DEVICE RESULTS.json

The report's scene, above 20,000 spheres in a cube grown to the same density; 60 frames to warm up, the median of five
times 32 frames, then 32 frames with a clock on each stage.
"""

import json
import sys
import time
from pathlib import Path

import fastcollide as fc

COUNTS = (1_000, 20_000, 100_000, 1_000_000)
DT = 1 / 60


def new_world(count: int, solver: str, device: str) -> fc.World:
    edge = 20 * max(1.0, count / 20_000) ** (1 / 3)
    bounds = ((-edge / 2, -edge / 2, 0), (edge / 2, edge / 2, edge))
    rough = solver == "rough"
    world = fc.World(
        bounds,
        solver="reference" if solver == "reference" else "substep",
        wall_friction=0.3 if rough else 0.0,
        device=device,
    )
    start = fc.random_spheres(count, bounds=bounds)
    friction = {"friction": 0.4} if rough else {}
    world.add(
        position=start.position,
        velocity=start.velocity,
        radius=start.radius,
        mass=start.mass,
        restitution=start.restitution,
        **friction,
    )
    return world


def measure(count: int, solver: str, device: str) -> dict[str, object]:
    world = new_world(count, solver, device)
    world.step(60, DT)
    seconds = []
    for _ in range(5):
        started = time.perf_counter()
        world.step(32, DT)
        seconds.append((time.perf_counter() - started) / 32)
    world.timed = True
    world.step(32, DT)
    return {
        "device": world.device_name,
        "spheres": count,
        "solver": solver,
        "ms": sorted(seconds)[2] * 1e3,
        "contacts": world.contact_count(),
        "stages": {stage: total / 32 * 1e3 for stage, total in world.stage_times.items()},
    }


def main() -> None:
    device, results = sys.argv[1], Path(sys.argv[2])
    rows = []
    for count in COUNTS:
        for solver in ("reference", "substep", "rough"):
            rows.append(measure(count, solver, device))
            print(count, solver, round(rows[-1]["ms"], 4), flush=True)
    results.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
