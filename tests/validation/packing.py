"""Spheres that settle on a floor under their weight, and how densely they lie in the bulk.

Units: diameter 1, mass 1, gravity 1; so times are in √(d/g), velocities in √(g d). The floor is a wall, the sides are
periodic.
"""

from dataclasses import dataclass

import fastcollide as fc
import numpy as np
from numpy.typing import NDArray

SLOP = 5e-5  # an overlap that the solver leaves alone: it carries no load


def rain(count: int, edge: float, friction: float, restitution: float, device: str, seed: int) -> fc.World:
    """Spheres on a disturbed lattice, three tenths of the space, with small random velocities."""
    fraction = 0.3
    across = int(edge / (np.pi / 6 / fraction) ** (1 / 3))
    spacing = np.array((edge / across, edge / across, np.pi / 6 / fraction / (edge / across) ** 2))
    layers = -(-count // across**2)
    site = np.stack(np.meshgrid(range(layers), range(across), range(across), indexing="ij"), axis=-1).reshape(-1, 3)
    random = np.random.default_rng(seed)
    position = (site[:count, ::-1] + 0.5) * spacing + random.uniform(-0.4, 0.4, (count, 3)) * (spacing.min() - 1)
    position[:, 2] += 0.5
    world = fc.World(
        ((0, 0, 0), (edge, edge, position[:, 2].max() + 5)), ("periodic", "periodic", "wall"), gravity=(0, 0, -1),
        drag=0.0, floor_restitution=restitution, wall_friction=friction, iterations=20, device=device,
    )  # fmt: skip
    world.add(
        position=position, velocity=random.normal(scale=0.3, size=(count, 3)), radius=0.5, mass=1.0,
        restitution=restitution, **({"friction": friction} if friction else {}),
    )  # fmt: skip
    return world


def settle(world: fc.World, duration: float, substep: float) -> None:
    frame = 20 * substep
    world.step(round(duration / frame), frame)


def volume_between(height: NDArray, lowest: float, highest: float) -> float:
    """Volume of spheres of diameter 1 at these heights between two planes, by their caps."""

    def below(plane: float) -> NDArray:
        cap = np.clip(plane - height + 0.5, 0, 1)
        return np.pi * cap**2 * (1.5 - cap) / 3

    return float((below(highest) - below(lowest)).sum())


@dataclass(frozen=True)
class Bulk:
    """What lies at least five diameters away from the floor and from the top.

    fraction: of the volume, spheres counted whole where they overlap; speed: root mean square; sinking: mean downward
    velocity.
    """

    fraction: float
    speed: float
    sinking: float


@dataclass(frozen=True)
class BulkContacts:
    """Contacts there that carry load.

    coordination: of a sphere that is held; rattlers: part of the spheres that is not; overlap: mean.
    """

    coordination: float
    rattlers: float
    overlap: float


def measure(world: fc.World) -> Bulk:
    lowest, highest = _limits(world)
    height = _heights(world)
    inside = (height > lowest) & (height < highest)
    velocity = fc.to_numpy(world.velocities).astype(np.float64)
    velocity[:, :2] -= velocity[:, :2].mean(axis=0)  # nothing stops that on a smooth floor
    return Bulk(
        fraction=volume_between(height, lowest, highest) / (world.bounds[1][0] ** 2 * (highest - lowest)),
        speed=float(np.sqrt((velocity[inside] ** 2).sum(axis=1).mean())),
        sinking=float(-velocity[inside, 2].mean()),
    )


def measure_contacts(world: fc.World, fewest: int = 4) -> BulkContacts:
    """fewest: contacts that hold a sphere; two may where there is friction."""
    lowest, highest = _limits(world)
    height = _heights(world)
    inside = (height > lowest) & (height < highest)
    contacts = world.contacts()
    first, second, overlap = fc.to_numpy(contacts.first), fc.to_numpy(contacts.second), -fc.to_numpy(contacts.gap)
    carries = overlap > SLOP
    first, second, overlap = first[carries], second[carries], overlap[carries].astype(np.float64)
    is_held, count = np.ones(len(height), bool), 0
    while count != is_held.sum():  # a sphere whose neighbour rattles may rattle too
        count = is_held.sum()
        both = is_held[first] & is_held[second]
        degree = np.bincount(first[both], minlength=len(height)) + np.bincount(second[both], minlength=len(height))
        is_held &= (degree >= fewest) | (height < 1)  # the floor holds too
    return BulkContacts(
        coordination=float(degree[inside & is_held].mean()),
        rattlers=float(1 - is_held[inside].mean()),
        overlap=float(overlap[inside[first] & inside[second]].mean()),
    )


def _heights(world: fc.World) -> NDArray[np.float64]:
    return fc.to_numpy(world.positions)[:, 2].astype(np.float64)


def _limits(world: fc.World) -> tuple[float, float]:
    """Heights of the lower and the upper end of the bulk; the top is the mean height of about one layer."""
    layer = int(world.bounds[1][0] ** 2 / 2)
    return 5.0, float(np.sort(_heights(world))[-layer:].mean()) - 5
