"""A column of rough spheres that falls apart into a heap on a rough floor.

Units: diameter 1, mass 1, gravity 1.
"""

from dataclasses import dataclass

import fastcollide as fc
import numpy as np


def column(count: int, friction: float, rolling_friction: float, device: str, seed: int = 1) -> fc.World:
    """Spheres on a disturbed lattice in a cylinder 0.8 times as high as its radius, on a wide floor."""
    spacing, random = 1.15, np.random.default_rng(seed)
    layers = round((0.64 * count / np.pi) ** (1 / 3))
    radius = np.sqrt(count / layers / np.pi) * spacing
    across = np.arange(-np.ceil(radius / spacing), np.ceil(radius / spacing) + 1) * spacing
    site = np.stack(np.meshgrid((np.arange(layers) + 0.6) * spacing, across, across, indexing="ij"), axis=-1)
    site = site.reshape(-1, 3)[:, ::-1]
    position = site[np.hypot(site[:, 0], site[:, 1]) < radius]
    position = position + random.uniform(-0.07, 0.07, position.shape)
    half = 6 * layers * spacing
    world = fc.World(
        ((-half, -half, 0), (half, half, 2 * layers * spacing)), gravity=(0, 0, -1), drag=0.0, floor_restitution=0.3,
        wall_friction=friction, rolling_friction=rolling_friction, iterations=20, device=device,
    )  # fmt: skip
    world.add(position=position, radius=0.5, mass=1.0, restitution=0.3, friction=friction)
    return world


@dataclass(frozen=True)
class Heap:
    """slope: of the cone with the same mean height and mean square distance from the axis [degrees]; speed: root mean
    square, of the nine tenths that are slowest; height: mean."""

    slope: float
    speed: float
    height: float


def measure(world: fc.World) -> Heap:
    position = fc.to_numpy(world.positions).astype(np.float64)
    from_axis = np.hypot(*(position[:, :2] - np.median(position[:, :2], axis=0)).T)
    inside = from_axis <= np.quantile(from_axis, 0.95)  # without those that rolled away
    # A solid cone: its centre at a quarter of the height, the mean square distance from the axis 3/10 of the radius'.
    height = 4 * (position[inside, 2].mean() - 0.5)
    radius = np.sqrt(10 / 3 * (from_axis[inside] ** 2).mean())
    speed = np.sort(np.linalg.norm(fc.to_numpy(world.velocities).astype(np.float64), axis=1))[: len(position) * 9 // 10]
    return Heap(
        slope=float(np.degrees(np.arctan2(height, radius))),
        speed=float(np.sqrt((speed**2).mean())),
        height=float(position[:, 2].mean()),
    )
