"""A pile of the report's spheres: does it come to rest? Prints a line for each 2.5 s.

    python benchmarks/pile_at_rest.py [--solver substep] [--edge 20] [--seconds 20] [--seed 1] [--device cpu]
                                      [--results FOLDER] [--pictures FOLDER]

50 spheres for each square metre of floor, 20,000 at the report's 20 m, start in a box 20 m high without drag. With
--results the figures go into pile_at_rest.json there, with --pictures a picture of the pile and its energy curves into
pile.png and pile_energy.png (as in docs/physics.md).
"""

import argparse
import json
import tempfile
from pathlib import Path

import fastcollide as fc
import numpy as np
from fastcollide.plots import plot_ledger, save_plot
from fastcollide.video import write_still

DT = 1 / 60


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--solver", default="substep")
    parser.add_argument("--edge", type=float, default=20.0, help="of the floor [m]")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--results", type=Path)
    parser.add_argument("--pictures", type=Path)
    given = parser.parse_args()

    bounds = ((0, 0, 0), (given.edge, given.edge, 20))
    world = fc.World(bounds, drag=0.0, solver=given.solver, device=given.device)
    world.add(fc.random_spheres(int(50 * given.edge**2), bounds=bounds, seed=given.seed))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "ledger.csv"
        figures = simulate(world, round(given.seconds / DT), path)
        ledger = fc.read_ledger(path)
    if given.results:
        given.results.mkdir(parents=True, exist_ok=True)
        text = json.dumps({"solver": given.solver, "edge": given.edge, "seed": given.seed} | figures, indent=1)
        (given.results / "pile_at_rest.json").write_text(text + "\n")
    if given.pictures:
        save_plot(plot_ledger(ledger, panels=("energy", "motion")), given.pictures / "pile_energy.png")
        write_still(given.pictures / "pile.png", picture(world))


def simulate(world: fc.World, frames: int, ledger_path: Path) -> dict[str, object]:
    """Runs to the end, prints, and returns the figures of the last state."""
    start = before = world.energy().total
    lowest, largest_gain, rebound = start, 0.0, 0.0
    figures: dict[str, object] = {}
    with fc.LedgerWriter(ledger_path) as ledger:
        ledger.add(world)
        for frame in range(1, frames + 1):
            world.step(1, DT)
            energy = world.energy().total
            if frame > frames / 2:  # after the last impact
                largest_gain = max(largest_gain, (energy - before) / start)
            before = energy
            lowest = min(lowest, energy)
            rebound = max(rebound, (energy - lowest) / start)
            if frame % 10 == 0 or frame == frames:
                ledger.add(world)
            if frame % 150 == 0 or frame == frames:
                figures = measure(world) | {
                    "energy_ratio": energy / start,
                    "largest_gain": largest_gain,
                    "rebound": rebound,  # from the lowest energy so far, while the squeezed pile springs up
                }
                print(
                    "{time:5.1f} s  v_rms {v_rms:.4f}  fastest {fastest:.2f} m/s  mean overlap {mean_overlap:.2%}  "
                    "contacts {contacts}  E/E0 {energy_ratio:.5f}  largest gain {largest_gain:.5%}".format(**figures),
                    flush=True,
                )
    return figures


def measure(world: fc.World) -> dict[str, object]:
    """Speeds [m/s], and the mean overlap as a part of the smaller radius."""
    speed = np.linalg.norm(fc.to_numpy(world.velocities), axis=1)
    return {
        "device": world.device_name,
        "spheres": len(world),
        "time": world.time,
        "v_rms": float(np.sqrt((speed.astype(float) ** 2).mean())),
        "fastest": float(speed.max()),
        "mean_overlap": world.mean_overlap(),
        "contacts": world.contact_count(),
        "state_hash": f"{world.state_hash():016x}",
    }


def picture(world: fc.World) -> np.ndarray:
    """The pile with colours by radius, since nothing moves, in a box that ends at its top."""
    lower, upper = world.bounds
    radii = fc.to_numpy(world.radii)
    top = float((fc.to_numpy(world.positions)[:, 2] + radii).max())
    bounds = (lower, (*upper[:2], top))
    renderer = fc.Renderer(bounds, color_by="radius", color_map="tide", supersampling=3, device=world.device)
    return renderer.draw(world.positions, radii, radii, time=world.time)


if __name__ == "__main__":
    main()
