"""A pile of the report's spheres: does it come to rest? Prints a line for each 2.5 s.

    python benchmarks/pile_at_rest.py [--solver substep] [--edge 20] [--seconds 20] [--seed 1] [--device cpu]

50 spheres for each square metre of floor, 20,000 at the report's 20 m, start in a box 20 m high without drag.
"""

import argparse

import fastcollide as fc
import numpy as np

DT = 1 / 60


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--solver", default="substep")
    parser.add_argument("--edge", type=float, default=20.0, help="of the floor [m]")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--device", default="auto")
    given = parser.parse_args()

    bounds = ((0, 0, 0), (given.edge, given.edge, 20))
    world = fc.World(bounds, drag=0.0, solver=given.solver, device=given.device)
    world.add(fc.random_spheres(int(50 * given.edge**2), bounds=bounds, seed=given.seed))
    start = before = world.energy().total
    largest_gain = 0.0
    frames = round(given.seconds / DT)
    for frame in range(1, frames + 1):
        world.step(1, DT)
        energy = world.energy().total
        if frame > frames / 2:  # after the last impact
            largest_gain = max(largest_gain, (energy - before) / start)
        before = energy
        if frame % 150 == 0 or frame == frames:
            speed = np.linalg.norm(fc.to_numpy(world.velocities), axis=1)
            print(
                f"{world.time:5.1f} s  v_rms {np.sqrt((speed**2).mean()):.4f}  fastest {speed.max():.2f} m/s  "
                f"mean overlap {100 * world.mean_overlap():.2f} %  contacts {world.contact_count()}  "
                f"E/E0 {energy / start:.5f}  largest gain {100 * largest_gain:.5f} %",
                flush=True,
            )


if __name__ == "__main__":
    main()
