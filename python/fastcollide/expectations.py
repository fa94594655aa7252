"""What a scene expects of its end: the figures of a world, and whether they are what was asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import fastcollide as fc
from fastcollide.plots import Ledger
from fastcollide.scene_schema import ExpectTable, Range, SphereExpectation


@dataclass(frozen=True)
class Outcome:
    """One expectation: its key, what was found and what is allowed, in words."""

    name: str
    found: str
    allowed: str
    is_good: bool


@dataclass(frozen=True)
class Start:
    """The figures of the fresh world that the end is compared with."""

    energy: fc.Energy
    momentum: tuple[float, float, float]
    momentum_scale: float


@dataclass(frozen=True)
class _FreeSpheres:
    """The spheres that forces can move, in double precision. speed, radius and mass of shape (n,), position (n, 3)."""

    position: NDArray[np.float64]
    speed: NDArray[np.float64]
    radius: NDArray[np.float64]
    mass: NDArray[np.float64]


def _free_spheres(world: fc.World) -> _FreeSpheres:
    mass = fc.to_numpy(world.masses).astype(np.float64)
    free = np.isfinite(mass)
    position, velocity, radius = (
        fc.to_numpy(array)[free].astype(np.float64) for array in (world.positions, world.velocities, world.radii)
    )
    return _FreeSpheres(position, np.linalg.norm(velocity, axis=1), radius, mass[free])


def measure_start(world: fc.World) -> Start:
    """To be called before the first step."""
    free = _free_spheres(world)
    return Start(world.energy(), tuple(world.momentum().tolist()), float(free.mass.sum() * _rms(free.speed)))


def check_end(expect: ExpectTable, world: fc.World, start: Start, ledger: Ledger | None) -> list[Outcome]:
    """All expectations after the last frame.

    ledger: that of the run; without one the largest energy gain cannot be told and counts as not met.
    """
    outcomes = []
    if expect.state_hash is not None:
        found = f"{world.state_hash():016x}"
        outcomes.append(Outcome("state_hash", found, expect.state_hash, found == expect.state_hash))
    figures = _figures(world, start, ledger)
    for name in type(expect).model_fields:
        wanted = getattr(expect, name)
        if isinstance(wanted, Range):
            value = figures[name]
            outcomes.append(Outcome(name, f"{value:.6g}", _words(wanted), _is_inside(value, wanted)))
    for sphere in expect.sphere:
        outcomes += _check_sphere(sphere, world)
    return outcomes


def _figures(world: fc.World, start: Start, ledger: Ledger | None) -> dict[str, float]:
    """Every figure that a range can be asked for; NaN, which lies in no range, where it has no meaning."""
    free = _free_spheres(world)
    if free.mass.size == 0:
        return dict.fromkeys(ExpectTable.model_fields, np.nan)
    lower, upper = (np.array(corner) for corner in world.bounds)
    now = world.measure()
    energy = now.energy
    figures = {
        "rms_speed": _rms(free.speed),
        "max_speed": float(free.speed.max()),
        "contacts": now.contact_count,
        "max_overlap": now.max_overlap,
        "mean_overlap": now.mean_overlap,
        "escaped": int(((free.position < lower) | (free.position > upper)).any(axis=1).sum()),
        "energy_ratio": _ratio(energy.total, start.energy.total),
        "motion_ratio": _ratio(energy.kinetic + energy.rotational, start.energy.kinetic + start.energy.rotational),
        "largest_energy_gain": _ratio(_largest_gain(ledger), start.energy.total),
        "momentum_change": _ratio(float(np.linalg.norm(now.momentum - start.momentum)), start.momentum_scale),
    }
    radius, mass = free.radius[:, None], free.mass[:, None]
    points = {
        "center": (mass * free.position).sum(axis=0) / mass.sum(),
        "lowest": (free.position - radius).min(axis=0),
        "highest": (free.position + radius).max(axis=0),
    }
    for name, point in points.items():
        figures |= {f"{name}_{axis}": float(value) for axis, value in zip("xyz", point, strict=True)}
    return figures


def _check_sphere(wanted: SphereExpectation, world: fc.World) -> list[Outcome]:
    name = f"sphere {wanted.id}"
    if wanted.id >= len(world):
        return [Outcome(name, "no such sphere", f"an id below {len(world):,}", False)]
    arrays = {"position": world.positions, "velocity": world.velocities}
    if wanted.spin is not None:
        arrays["spin"] = world.spins
    outcomes = []
    for field, array in arrays.items():
        expected = getattr(wanted, field)
        if expected is not None:
            found = fc.to_numpy(array)[wanted.id].astype(np.float64)
            is_good = bool((np.abs(found - expected) <= wanted.tolerance).all())
            words = f"{_vector(np.array(expected))}, each to {wanted.tolerance:g}"
            outcomes.append(Outcome(f"{name} {field}", _vector(found), words, is_good))
    return outcomes


def _largest_gain(ledger: Ledger | None) -> float:
    if ledger is None:
        return np.nan
    return float(np.diff(ledger["total_J"]).max(initial=0.0))


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt((values**2).mean())) if values.size else np.nan


def _ratio(value: float, start: float) -> float:
    return value / start if start else np.nan


def _is_inside(value: float, wanted: Range) -> bool:
    return (wanted.min is None or value >= wanted.min) and (wanted.max is None or value <= wanted.max)


def _words(wanted: Range) -> str:
    if wanted.min is None:
        return f"at most {wanted.max:g}"
    return f"at least {wanted.min:g}" + (f" and at most {wanted.max:g}" if wanted.max is not None else "")


def _vector(value: NDArray[np.float64]) -> str:
    return "[" + ", ".join(f"{component:.6g}" for component in value) + "]"
