"""A layer of spheres that runs out through a round hole in a flat floor.

Units: diameter 1, mass 1, gravity 1. The floor is made of fixed spheres; what has fallen through goes on falling.
"""

import fastcollide as fc
import numpy as np
from numpy.typing import NDArray

EDGE = 24.0  # of the box, which repeats sideways
FILL = 20  # layers, about
RIM = 0.15  # radius of the spheres that make the rim
FRAME, SUBSTEPS = 0.05, 5


def floor(hole: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centres, shape (n, 3), and radii, shape (n,), of a floor whose top is flush at RIM, with a round hole.

    Rings of small spheres make the rim nearly sharp; behind it a lattice of large ones, too narrow for a sphere.
    """
    rings = hole / 2 + RIM + 0.25 * np.arange(4)
    angles = [np.linspace(0, 2 * np.pi, int(2 * np.pi * ring / 0.25), endpoint=False) for ring in rings]
    rim = [(r * np.cos(a), r * np.sin(a), np.zeros_like(a)) for r, a in zip(rings, angles, strict=True)]
    across = int(EDGE / 0.6)
    site = (np.arange(across) + 0.5) * EDGE / across - EDGE / 2
    x, y = (axis.ravel() for axis in np.meshgrid(site, site))
    behind = np.hypot(x, y) > hole / 2 + 0.8
    lattice = (x[behind], y[behind], np.full(behind.sum(), RIM - 0.5))
    small = sum(map(len, angles))
    position = np.concatenate([np.stack(part, axis=1) for part in (*rim, lattice)])
    return position, np.where(np.arange(len(position)) < small, RIM, 0.5)


def new_hopper(hole: float, device: str, seed: int = 1) -> tuple[fc.World, int]:
    """The world, and how many of its first spheres are the floor."""
    world = fc.World(
        ((-EDGE / 2, -EDGE / 2, -10), (EDGE / 2, EDGE / 2, 50)), ("periodic", "periodic", "open"), gravity=(0, 0, -1),
        drag=0.0, iterations=SUBSTEPS, device=device,
    )  # fmt: skip
    fixed, radius = floor(hole)
    world.add(position=fixed, radius=radius, mass=np.inf, restitution=0.5, friction=0.5)
    across = int(EDGE / 1.1)
    site = np.stack(np.meshgrid(range(FILL), range(across), range(across), indexing="ij"), axis=-1).reshape(-1, 3)
    random = np.random.default_rng(seed)
    position = (site[:, ::-1] + (0.5, 0.5, 1.0)) * (EDGE / across, EDGE / across, 1.1) - (EDGE / 2, EDGE / 2, 0)
    position += random.uniform(-0.05, 0.05, position.shape)
    world.add(
        position=position, velocity=random.normal(scale=0.1, size=position.shape), radius=0.5, mass=1.0,
        restitution=0.5, friction=0.5,
    )  # fmt: skip
    return world, len(fixed)


def discharge(world: fc.World, first: int, duration: float) -> NDArray[np.float64]:
    """Rows (time, spheres that have fallen through), one for each unit of time."""
    rows = []
    for _ in range(round(duration)):
        world.step(round(1 / FRAME), FRAME)
        height = fc.to_numpy(world.positions)[first:, 2]
        rows.append((world.time, np.count_nonzero(height < -1)))
    return np.array(rows, dtype=np.float64)
