"""The solvers side by side on small scenes: prints the table of docs/physics.md.

    python benchmarks/compare_solvers.py [--device cpu] [--results FOLDER]

Three piles of 400 of the report's spheres, as deep as there, after 15 s; a column of 28 equal spheres after 20 s; an
elastic gas of 500 after 100 collisions of each; two spheres alone. The time is that of a frame of 5,000 spheres at
rest, from the same start for all, in turns. --results writes compare_solvers.json there.
"""

from __future__ import annotations

import json
import statistics
import time
from pathlib import Path

import click
import fastcollide as fc
import numpy as np

DT = 1 / 60
SCHEMES = {
    "reference, 5": ("reference", 5),
    "substep, 5": ("substep", 5),
    "substep, 8": ("substep", 8),
    "substep, 12": ("substep", 12),
}
# Name in the table, key, format.
ROWS = (
    ("pile: v_rms, m/s", "pile_v_rms", ".4f"),
    ("pile: mean overlap", "pile_overlap", ".4f"),
    ("pile: largest gain of a frame, % of E₀", "pile_gain", ".5f"),
    ("column: v_rms, m/s", "column_v_rms", ".4f"),
    ("column: mean overlap", "column_overlap", ".4f"),
    ("pair alone: worst error of e", "pair_error", ".1e"),
    ("gas, φ 0.2: T/T₀", "gas_20", ".4f"),
    ("gas, φ 0.4: T/T₀", "gas_40", ".4f"),
    ("ms a frame", "frame_ms", ".1f"),
)


def speed_of(world: fc.World) -> float:
    """Root mean square [m/s], less what the centre of mass does along x and y: nothing can stop it there."""
    velocity = fc.to_numpy(world.velocities).astype(np.float64)
    velocity[:, :2] -= np.average(velocity, axis=0, weights=fc.to_numpy(world.masses))[:2]
    return float(np.sqrt((velocity**2).sum(axis=1).mean()))


def start_pile(edge: float, seed: int, **options: object) -> fc.World:
    """50 spheres for each square metre of a floor that goes on sideways, from a start 20 m high."""
    bounds = ((0, 0, 0), (edge, edge, 20))
    world = fc.World(bounds, ("periodic", "periodic", "wall"), drag=0.0, **options)
    world.add(fc.random_spheres(round(50 * edge**2), bounds, seed=seed))
    return world


def measure_piles(**options: object) -> dict[str, float]:
    """Medians of three; the gain is the largest of all, of a frame in the second half."""
    speeds, overlaps, gains = [], [], []
    for seed in (1, 2, 3):
        world = start_pile(8**0.5, seed, **options)
        start = world.energy().total
        world.step(450, DT)
        before, squares = world.energy().total, []
        for frame in range(450, 900):
            world.step(1, DT)
            total = world.energy().total
            gains.append((total - before) / start)
            before = total
            if frame >= 840:
                squares.append(speed_of(world) ** 2)
        speeds.append(np.sqrt(np.mean(squares)))
        overlaps.append(world.mean_overlap())
    return {
        "pile_v_rms": float(statistics.median(speeds)),
        "pile_overlap": statistics.median(overlaps),
        "pile_gain": 100 * max(gains),
    }


def measure_column(**options: object) -> dict[str, float]:
    world = fc.World(((-0.11, -0.11, 0), (0.11, 0.11, 8)), drag=0.0, **options)
    world.add(position=[(0, 0, 0.1 + 0.2 * i) for i in range(28)], radius=0.1, mass=1.0, restitution=0.3)
    world.step(1200, DT)
    return {"column_v_rms": speed_of(world), "column_overlap": world.mean_overlap()}


def measure_pair(**options: object) -> dict[str, float]:
    """Over five places in a substep, three mass ratios and three restitutions."""
    errors = []
    for phase in range(5):
        for mass in (1.0, 0.01, 7.0):
            for restitution in (0.0, 0.5, 1.0):
                world = fc.World(boundary="open", gravity=(0, 0, 0), drag=0.0, **options)
                world.add(
                    position=[(-0.2 - 0.003 * phase, 0, 0), (0.2, 0, 0)], velocity=[(2, 0, 0), (-1, 0, 0)], radius=0.1,
                    mass=[1, mass], restitution=restitution,
                )  # fmt: skip
                world.step(12, DT)
                first, second = fc.to_numpy(world.velocities)[:, 0].astype(np.float64)
                errors.append(abs((second - first) / 3 - restitution))
    return {"pair_error": float(max(errors))}


def measure_gas(fraction: float, collision_rate: float, **options: object) -> float:
    """Diameter, mass and temperature 1, on a cubic lattice at first; collision_rate by Enskog's theory."""
    count, dt = 512, 5 * 0.0025
    edge = (count * np.pi / 6 / fraction) ** (1 / 3)
    place = (np.stack(np.meshgrid(*[np.arange(8)] * 3, indexing="ij"), axis=-1).reshape(-1, 3) + 0.5) * edge / 8
    velocity = np.random.default_rng(1).normal(size=(count, 3))
    velocity -= velocity.mean(axis=0)
    world = fc.World(((0, 0, 0), (edge, edge, edge)), "periodic", gravity=(0, 0, 0), drag=0.0, **options)
    world.add(position=place, velocity=velocity, radius=0.5, mass=1.0, restitution=1.0)
    start = world.energy().kinetic
    world.step(round(100 / collision_rate / dt), dt)
    return world.energy().kinetic / start


def measure_times(device: str, rounds: int = 7, frames: int = 20) -> dict[str, float]:
    """Milliseconds of a frame, the best of some rounds in which all take turns."""
    rest = start_pile(10, 1, device=device)
    rest.step(600, DT)
    arrays = {
        name: fc.to_numpy(getattr(rest, plural)).copy()
        for name, plural in (
            ("position", "positions"), ("velocity", "velocities"), ("radius", "radii"), ("mass", "masses"),
            ("restitution", "restitutions"),
        )
    }  # fmt: skip
    best = dict.fromkeys(SCHEMES, float("inf"))
    for _ in range(rounds):
        for scheme, (solver, iterations) in SCHEMES.items():
            world = fc.World(rest.bounds, rest.boundary, drag=0.0, solver=solver, iterations=iterations, device=device)
            world.add(**arrays)
            world.step(5, DT)
            world.energy()  # the device has done it
            started = time.perf_counter()
            world.step(frames, DT)
            world.energy()
            best[scheme] = min(best[scheme], 1e3 * (time.perf_counter() - started) / frames)
    return best


def table(figures: dict[str, dict[str, float]]) -> str:
    """In Markdown, a column for each scheme."""
    lines = ["| | " + " | ".join(figures) + " |", "|" + " --- |" * (1 + len(figures))]
    for name, key, form in ROWS:
        lines.append(f"| {name} | " + " | ".join(format(found[key], form) for found in figures.values()) + " |")
    return "\n".join(lines)


@click.command(help=__doc__)
@click.option("--device", default="cpu", show_default=True)
@click.option("--results", type=click.Path(path_type=Path, file_okay=False))
def main(device: str, results: Path | None) -> None:
    """Measures one scheme after the other, and all of them in turns for the times."""
    times = measure_times(device)
    figures = {}
    for scheme, (solver, iterations) in SCHEMES.items():
        click.echo(f"{scheme} …", err=True)
        options = {"solver": solver, "iterations": iterations, "device": device}
        figures[scheme] = {
            **measure_piles(**options),
            **measure_column(**options),
            **measure_pair(**options),
            "gas_20": measure_gas(0.2, 4.7604, **options),
            "gas_40": measure_gas(0.4, 20.060, **options),
            "frame_ms": times[scheme],
        }
    click.echo(table(figures))
    if results:
        results.mkdir(parents=True, exist_ok=True)
        found = {"device": fc.World(device=device).device_name, "schemes": figures}
        (results / "compare_solvers.json").write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
