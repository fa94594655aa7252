"""`fastcollide selftest`: closed forms of mechanics, computed on the user's own device."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from rich.markup import escape
from rich.table import Table

import fastcollide as fc
from fastcollide.console import EXIT_FAILURE, EXIT_FINE, fail

STANDARD = 9.81  # m/s²
NARROWEST = 112  # columns of text that hold every figure


@dataclass(frozen=True)
class Check:
    """One figure. error: |found − expected|; limit: the largest error that passes, in the same unit."""

    case: str
    quantity: str
    expected: float
    found: float
    limit: float

    @property
    def error(self) -> float:
        return abs(self.found - self.expected)

    @property
    def is_good(self) -> bool:
        return self.error <= self.limit  # False for NaN


def selftest(device: str = "auto", threads: int | None = None) -> int:
    """Runs all cases, prints them as a table and returns the exit code: 1 if any is off by more than its limit."""
    world = fc.World(device=device, threads=threads)
    table = Table(title=f"{world.device}: {world.device_name}")
    for heading in ("case", "quantity"):
        table.add_column(heading, no_wrap=True)
    for heading in ("expected", "found", "error", "limit", ""):
        table.add_column(heading, justify="right")
    failures = 0
    for check in run_checks(device, threads):
        failures += not check.is_good
        table.add_row(
            check.case,
            escape(check.quantity),
            f"{check.expected:.7g}",
            f"{check.found:.7g}",
            f"{check.error:.1e}",
            f"{check.limit:.1e}",
            "ok" if check.is_good else "FAILED",
        )
    Console(width=max(Console().width, NARROWEST)).print(table)
    if failures:
        fail(f"{failures} of the figures are off by more than their limit")
        return EXIT_FAILURE
    return EXIT_FINE


def run_checks(device: str = "auto", threads: int | None = None) -> Iterator[Check]:
    """All cases on one device."""

    def open_space(**options: Any) -> fc.World:
        defaults = {"boundary": "open", "gravity": (0, 0, 0), "drag": 0.0}
        return fc.World(device=device, threads=threads, **{**defaults, **options})

    def above_floor(**options: Any) -> fc.World:
        defaults = {"bounds": ((-100, -100, 0), (100, 100, 20)), "gravity": (0, 0, -STANDARD), "drag": 0.0}
        return fc.World(device=device, threads=threads, **{**defaults, **options})

    for case in _FLIGHT_AND_PAIRS:
        yield from case(open_space)
    for case in _FLOOR:
        yield from case(above_floor)
    yield from _elastic_gas(open_space)


NewWorld = Callable[..., fc.World]


def _array(array: Any) -> np.ndarray[Any, Any]:
    return fc.to_numpy(array).astype(np.float64)


def _free_fall(new_world: NewWorld) -> Iterator[Check]:
    world = new_world(gravity=(0, 0, -STANDARD))
    world.add(position=(0, 0, 0), radius=0.1)
    world.step(120)
    # float32 rounds each of 600 substeps: 1e-5 of the value.
    yield Check("free fall, 2 s", "speed [m/s]", -19.62, _array(world.velocities)[0, 2], 2e-4)
    yield Check("", "way [m]", -19.62, _array(world.positions)[0, 2], 2e-4)


def _drag(new_world: NewWorld) -> Iterator[Check]:
    world = new_world(gravity=(0, 0, -STANDARD), drag=0.5)
    world.add(position=(0, 0, 0), radius=0.1)
    world.step(1200, dt=1 / 600)
    yield Check("fall with drag 0.5/s, 2 s", "speed [m/s]", -12.4022, _array(world.velocities)[0, 2], 0.01)
    yield Check("", "way [m]", -14.4356, _array(world.positions)[0, 2], 0.01)


def _head_on(new_world: NewWorld) -> Iterator[Check]:
    world = new_world()
    world.add(
        position=[(-0.4, 0, 0), (0.4, 0, 0)],
        radius=0.1,
        velocity=[(2, 0, 0), (-1, 0, 0)],
        mass=[1, 3],
        restitution=1.0,
    )
    world.step(60)
    yield Check("head-on, 1 kg and 3 kg", "velocity of the light [m/s]", -2.5, _array(world.velocities)[0, 0], 1e-6)
    yield Check("", "velocity of the heavy [m/s]", 0.5, _array(world.velocities)[1, 0], 1e-6)


def _restitution(new_world: NewWorld) -> Iterator[Check]:
    for restitution in (0.0, 0.5, 1.0):
        world = new_world()
        world.add(
            position=[(-0.3, 0, 0), (0.3, 0, 0)],
            radius=0.1,
            velocity=[(1, 0, 0), (-1, 0, 0)],
            restitution=restitution,
        )
        world.step(60)
        x = _array(world.velocities)[:, 0]
        yield Check(f"pair, e = {restitution:g}", "e found", restitution, (x[1] - x[0]) / 2, 1e-5)


def _cradle(new_world: NewWorld) -> Iterator[Check]:
    world = new_world()
    world.add(
        position=[(-0.3, 0, 0)] + [(0.2001 * i, 0, 0) for i in range(4)],
        radius=0.1,
        velocity=[(1, 0, 0)] + [(0, 0, 0)] * 4,
        restitution=1.0,
    )
    world.step(60)
    x = _array(world.velocities)[:, 0]
    yield Check("Newton's cradle", "last ball [m/s]", 1.0, x[4], 0.01)
    yield Check("", "fastest other [m/s]", 0.0, float(np.abs(x[:4]).max()), 0.01)


def _rough_pair(new_world: NewWorld) -> Iterator[Check]:
    world = new_world()
    world.add(
        position=[(-0.2, 0.02, 0), (0.2, -0.02, 0)],
        radius=[0.1, 0.15],
        velocity=[(1, 0, 0), (-2, 0, 0)],
        spin=[(3, 1, 5), (-2, 4, 1)],
        friction=0.5,
        restitution=0.7,
    )
    before = np.concatenate([world.momentum(), world.angular_momentum()])
    world.step(6)
    after = np.concatenate([world.momentum(), world.angular_momentum()])
    change = np.abs(after - before)
    yield Check("rough oblique pair", "momentum, change / size", 0.0, change[:3].max() / np.abs(before[:3]).max(), 1e-6)
    yield Check("", "angular momentum, likewise", 0.0, change[3:].max() / np.abs(before[3:]).max(), 2e-6)


def _bounces(new_world: NewWorld) -> Iterator[Check]:
    world = new_world(floor_restitution=0.8)
    world.add(position=(0, 0, 1.1), radius=0.1)
    peaks, below = [], (-1.0, 0.0)
    for _ in range(240):
        world.step()
        z, v = _array(world.positions)[0, 2] - 0.1, _array(world.velocities)[0, 2]
        if below[1] > 0 >= v:
            peaks.append(below[0] + below[1] ** 2 / (2 * STANDARD))
        below = (z, v)
    for bounce, peak in enumerate(peaks[:3], start=1):
        case = "bounces from 1 m, e = 0.8" if bounce == 1 else ""
        expected = 0.8 ** (2 * bounce)
        yield Check(case, f"peak {bounce} [m]", expected, peak, expected / 100)


def _slide_to_roll(new_world: NewWorld) -> Iterator[Check]:
    world = new_world(floor_restitution=0.0, wall_friction=0.2)
    world.add(position=(0, 0, 0.1), radius=0.1, velocity=(2, 0, 0), friction=0.2)
    world.step(600, dt=1 / 600)
    rolling = 5 / 7 * 2
    yield Check("slide to roll, friction 0.2", "speed [m/s]", rolling, _array(world.velocities)[0, 0], 0.01 * rolling)
    yield Check("", "spin · radius [m/s]", rolling, 0.1 * _array(world.spins)[0, 1], 0.01 * rolling)


def _incline(new_world: NewWorld) -> Iterator[Check]:
    slope = math.radians(15)
    gravity = (STANDARD * math.sin(slope), 0, -STANDARD * math.cos(slope))
    world = new_world(gravity=gravity, floor_restitution=0.0, wall_friction=0.5)
    world.add(position=(0, 0, 0.1), radius=0.1, friction=0.5)
    world.step(60)
    expected = 5 / 7 * gravity[0]
    yield Check("rolling down 15°", "acceleration [m/s²]", expected, _array(world.velocities)[0, 0], 0.005 * expected)


def _stack(new_world: NewWorld) -> Iterator[Check]:
    world = new_world(bounds=((-0.11, -0.11, 0), (0.11, 0.11, 3)), iterations=12)
    world.add(position=[(0, 0, 0.1 + 0.2 * i) for i in range(5)], radius=0.1, restitution=0.3)
    world.step(600)
    heights = _array(world.positions)[:, 2]
    off = float(np.abs(heights - (0.1 + 0.2 * np.arange(5))).max())
    yield Check("stack of five, 12 substeps", "height, worst error [m]", 0.0, off, 1e-3)
    yield Check("", "fastest [m/s]", 0.0, float(np.abs(_array(world.velocities)).max()), 1e-2)


def _elastic_gas(new_world: NewWorld) -> Iterator[Check]:
    count, fraction = 500, 0.2
    edge = (count * math.pi / 6 / fraction) ** (1 / 3)
    cells = math.ceil((count / 4) ** (1 / 3))
    lattice = np.stack(np.meshgrid(*[np.arange(cells)] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 3)
    face_centred = lattice + np.array([(0, 0, 0), (0.5, 0.5, 0), (0.5, 0, 0.5), (0, 0.5, 0.5)])
    velocity = np.random.default_rng(1).normal(size=(count, 3))
    velocity -= velocity.mean(axis=0)
    world = new_world(bounds=((0, 0, 0), (edge, edge, edge)), boundary="periodic")
    world.add(
        position=face_centred.reshape(-1, 3)[:count] * edge / cells,
        radius=0.5,
        velocity=velocity,
        mass=1.0,
        restitution=1.0,
    )
    before = world.energy().kinetic
    world.step(480, dt=0.0125)
    yield Check("elastic gas, 20 % full", "energy, end / start", 1.0, world.energy().kinetic / before, 0.01)


_FLIGHT_AND_PAIRS = (_free_fall, _drag, _head_on, _restitution, _cradle, _rough_pair)
_FLOOR = (_bounces, _slide_to_roll, _incline, _stack)
