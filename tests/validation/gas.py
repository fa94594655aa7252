"""Gases of hard spheres and what their collisions tell.

Units: diameter 1, mass 1, kT 1. With one substep a frame and no gravity each sphere takes part in at most one collision
of a frame, so the change of the velocities shows them all: half the spheres that changed is the number of collisions,
and since the impulse of smooth spheres acts along the line of centres when they touch, its virial r·Δp is
|Δv| of either sphere.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import fastcollide as fc
import numpy as np
from determinism import golden
from numpy.typing import NDArray


def kolafa(fraction: float) -> float:
    """Compressibility factor Z = pV/NkT of the hard-sphere fluid (Kolafa's improvement of Carnahan and Starling's)."""
    f = fraction
    return (1 + f + f**2 - 2 / 3 * f**3 * (1 + f)) / (1 - f) ** 3


def enskog_rate(fraction: float) -> float:
    """Collisions of one sphere in σ √(m/kT): 4 √π n σ² g, with g = (1 - φ/2) / (1 - φ)³ at contact (Carnahan and
    Starling)."""
    return 24 / np.sqrt(np.pi) * fraction * (1 - fraction / 2) / (1 - fraction) ** 3


def haff_rate(fraction: float, restitution: float) -> float:
    """1/τ of T = T₀ / (1 + t/τ)²: a collision takes (1 - e²)/6 of the temperature of its two spheres, and T is the
    square of a speed."""
    return (1 - restitution**2) * enskog_rate(fraction) / 6


def new_gas(count: int, fraction: float, device: str, seed: int = 1) -> fc.World:
    """Elastic spheres on a lattice with random velocities; equilibrate() melts it."""
    spheres, options = golden.elastic_gas(count, fraction, seed)
    world = fc.World(device=device, iterations=1, **options)
    world.add(spheres)
    return world


def copy_of(world: fc.World, velocity: NDArray | None = None, restitution: float = 1.0) -> fc.World:
    """The gas as it is, with other velocities or another restitution."""
    copy = fc.World(
        world.bounds, "periodic", gravity=(0, 0, 0), drag=0.0, iterations=1, device=world.device
    )  # fmt: skip
    velocity = fc.to_numpy(world.velocities) if velocity is None else velocity
    copy.add(position=world.positions, velocity=velocity, radius=0.5, mass=1.0, restitution=restitution)
    return copy


def equilibrate(world: fc.World, fraction: float, dt: float, collisions: float = 30) -> None:
    """So many for each sphere. A velocity is forgotten after a few, the lattice too where the fluid is stable."""
    world.step(round(collisions / enskog_rate(fraction) / dt), dt)


def temperature(world: fc.World) -> float:
    """kT of spheres whose momentum is zero, which leaves 3(n - 1) degrees of freedom."""
    return 2 * world.energy().kinetic / (3 * (len(world) - 1))


def velocity_changes(world: fc.World, frames: int, dt: float) -> Iterator[NDArray[np.float32]]:
    """Simulates, and after each frame gives the change of every velocity, shape (n, 3)."""
    before = fc.to_numpy(world.velocities).copy()
    for _ in range(frames):
        world.step(1, dt)
        after = fc.to_numpy(world.velocities).copy()
        yield after - before
        before = after


def has_collided(change: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which spheres, shape (n,)."""
    return (change != 0).any(axis=1)


@dataclass(frozen=True)
class CollisionStatistics:
    """Of blocks of equal time: compressibility factor, collisions of a sphere in σ √(m/kT); shape (blocks,)."""

    pressure: NDArray[np.float64]
    rate: NDArray[np.float64]


def collision_statistics(world: fc.World, duration: float, dt: float, blocks: int = 20) -> CollisionStatistics:
    """Z = 1 + Σ r·Δp / (3 N kT t), with the sum over the collisions of the time t."""
    count, frames = len(world), round(duration / dt / blocks)
    kt = temperature(world)  # which elastic collisions keep
    pressure, rate = [], []
    for _ in range(blocks):
        hits, virial = 0, 0.0
        for change in velocity_changes(world, frames, dt):
            hit = change[has_collided(change)].astype(np.float64)
            hits += len(hit)
            virial += np.sqrt((hit**2).sum(axis=1)).sum() / 2
        time = frames * dt
        pressure.append(1 + virial / (3 * count * kt * time))
        rate.append(hits / count / time / np.sqrt(kt))
    return CollisionStatistics(np.array(pressure), np.array(rate))


def kurtosis(velocity: NDArray) -> float:
    """⟨v⁴⟩ / ⟨v²⟩² of all components together; 3 for Maxwell's distribution."""
    squared = velocity.astype(np.float64) ** 2
    return float((squared**2).mean() / squared.mean() ** 2)
