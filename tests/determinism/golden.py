"""Scenes whose states are known to the last bit, and the file that holds their hashes."""

import json
from dataclasses import replace
from pathlib import Path

import fastcollide as fc
import numpy as np

PATH = Path(__file__).with_name("golden_hashes.json")


def report(count, solver):
    """The report's random start with its own numbers."""
    return fc.random_spheres(count), {"solver": solver}


def crowd():
    """Every parameter off its default; so dense that most spheres have several contacts at once."""
    bounds = ((-1.5, -2.0, 0.25), (2.5, 1.0, 3.0))
    spheres = fc.random_spheres(3000, bounds, 2**40 + 7, (0.03, 0.15), (3, 2, 1), (0.1, 0.9), 700.0)
    options = {
        "bounds": bounds, "gravity": (1.0, -2.0, -6.5), "drag": 0.4, "floor_restitution": 0.3, "wall_friction": 0.25,
        "iterations": 3, "solver": "reference",
    }  # fmt: skip
    return spheres, options


def elastic_gas(count, fraction, seed=1):
    """Hard spheres of diameter and mass 1 and kT = 1, without momentum, on a lattice in a periodic box. They fill a
    fraction of it."""
    edge = (count * np.pi / 6 / fraction) ** (1 / 3)
    cells = int(np.ceil((count / 4) ** (1 / 3)))
    corners = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    face_centers = np.array([(0, 0, 0), (0.5, 0.5, 0), (0.5, 0, 0.5), (0, 0.5, 0.5)])
    position = (corners + face_centers).reshape(-1, 3)[:count] * edge / cells
    velocity = fc.random_spheres(count, seed=seed, speed=(1, 1, 1)).velocity.astype(np.float64)
    velocity -= velocity.mean(axis=0)
    velocity *= np.sqrt(3 * count / (velocity**2).sum())
    spheres = fc.Spheres(
        position=position.astype(np.float32), velocity=velocity.astype(np.float32),
        radius=np.full(count, 0.5, np.float32), mass=np.ones(count, np.float32),
        restitution=np.ones(count, np.float32),
    )  # fmt: skip
    bounds = ((0.0,) * 3, (edge,) * 3)
    return spheres, {"bounds": bounds, "boundary": "periodic", "gravity": (0, 0, 0), "drag": 0.0}


def mill():
    """All that a rough world has: friction, spin, rolling resistance, fixed spheres at rest and on their way."""
    bounds = ((-1.5, -2.0, 0.25), (2.5, 1.0, 3.0))
    spheres = fc.random_spheres(1500, bounds, 99, (0.03, 0.2), (3, 2, 1), (0.1, 0.9), 700.0)
    number = np.arange(len(spheres))
    options = {
        "bounds": bounds, "boundary": ("periodic", "wall", "wall"), "wall_friction": 0.4, "rolling_friction": 0.05,
        "drag": 0.4, "floor_restitution": 0.3, "gravity": (1.0, -2.0, -6.5),
    }  # fmt: skip
    rough = replace(
        spheres,
        velocity=np.where(number[:, None] % 40 == 1, np.float32(0), spheres.velocity),
        mass=np.where(number % 40 < 2, np.float32(np.inf), spheres.mass),
        spin=np.float32(10) * spheres.velocity[:, ::-1].copy(),
        friction=np.float32(0.2) + np.float32(0.5) * spheres.restitution,
    )
    return rough, options


# Spheres and options of the world, frames, dt.
SCENES = {
    "report, 1,000 spheres, 600 frames": (lambda: report(1_000, "reference"), 600, 1 / 60),
    "report, 20,000 spheres, 60 frames": (lambda: report(20_000, "reference"), 60, 1 / 60),
    "crowd, 3,000 spheres, 100 frames": (crowd, 100, 1 / 120),
    "substep, report, 1,000 spheres, 300 frames": (lambda: report(1_000, "substep"), 300, 1 / 60),
    "substep, report, 5,000 spheres, 60 frames": (lambda: report(5_000, "substep"), 60, 1 / 60),
    "substep, mill, 1,500 spheres, 100 frames": (mill, 100, 1 / 120),
    "substep, elastic gas, 500 spheres, 400 frames": (lambda: elastic_gas(500, 0.3), 400, 0.0125),
}


def world_of(name, **options):
    spheres, scene_options = SCENES[name][0]()
    world = fc.World(**{**scene_options, **options})
    world.add(spheres)
    return world


def hashes(name, **options):
    """State hashes of the scene at its start and at its end, 16 hexadecimal digits each."""
    _, frames, dt = SCENES[name]
    world = world_of(name, **options)
    start = world.state_hash()
    world.step(frames, dt)
    return {"start": f"{start:016x}", "end": f"{world.state_hash():016x}"}


def read():
    return json.loads(PATH.read_text())
