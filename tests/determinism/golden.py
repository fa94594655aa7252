"""Scenes whose states are known to the last bit, and the file that holds their hashes."""

import json
from pathlib import Path

import fastcollide as fc

PATH = Path(__file__).with_name("golden_hashes.json")


def report(count):
    """The report's random start with its own numbers."""
    return fc.random_spheres(count), {}


def crowd():
    """Every parameter off its default; so dense that most spheres have several contacts at once."""
    bounds = ((-1.5, -2.0, 0.25), (2.5, 1.0, 3.0))
    spheres = fc.random_spheres(3000, bounds, 2**40 + 7, (0.03, 0.15), (3, 2, 1), (0.1, 0.9), 700.0)
    options = {
        "bounds": bounds, "gravity": (1.0, -2.0, -6.5), "drag": 0.4, "floor_restitution": 0.3, "wall_friction": 0.25,
        "iterations": 3,
    }  # fmt: skip
    return spheres, options


# Spheres and options of the world, frames, dt.
SCENES = {
    "report, 1,000 spheres, 600 frames": (lambda: report(1_000), 600, 1 / 60),
    "report, 20,000 spheres, 60 frames": (lambda: report(20_000), 60, 1 / 60),
    "crowd, 3,000 spheres, 100 frames": (crowd, 100, 1 / 120),
}


def world_of(name, **options):
    spheres, scene_options = SCENES[name][0]()
    world = fc.World(**scene_options, **options)
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
