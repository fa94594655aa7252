"""A simulation that runs while it is watched."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import fastcollide as fc
from fastcollide.view.messages import Conditions
from fastcollide.view.moments import Box, Moment, Thinned

PAST_BYTES = 256 * 2**20  # of the moments that can be looked at again
MOST_MOMENTS = 4000
MOST_ENERGIES = 1500  # as many points as a plot can show

EnergyRow = tuple[float, float, float, float]


class LiveRun:
    """A world that goes on for as long as it is watched, and what it remembers of its past.

    create: makes the world at its start; title: of the page; fps: frames in a simulated second;
    past_bytes: memory for the past.
    """

    kind = "live"

    def __init__(self, create: Callable[[], fc.World], title: str, fps: int, past_bytes: int = PAST_BYTES) -> None:
        self._create = create
        self.title = title
        self.fps = fps
        self._past_bytes = past_bytes
        self.energies: Thinned[EnergyRow] = Thinned(MOST_ENERGIES)
        self.reset()

    def reset(self) -> None:
        """Goes back to the start, with the conditions of the start. Raises what create() raises."""
        world = self._create()
        self.world = world
        self.box = Box(world.bounds, world.boundary)
        self._radii = np.array(fc.to_numpy(world.radii))
        self._masses = fc.to_numpy(world.masses).copy()
        self._read_surfaces()
        bytes_each = max(1, (36 if world.has_spin else 24) * len(world))
        self._moments: Thinned[Moment] = Thinned(min(MOST_MOMENTS, self._past_bytes // bytes_each))
        self.energies.clear()
        self._remember()

    @property
    def device(self) -> str:
        """Where it is computed, in words."""
        return f"{self.world.device} ({self.world.device_name})"

    def __len__(self) -> int:
        return len(self._moments)

    def moment(self, index: int) -> Moment:
        """A moment of the past; the last one is the present."""
        return self._moments[index]

    def time_of(self, index: int) -> float:
        """The time of a moment [s]."""
        return self._moments[index].time

    def advance(self) -> bool:
        """Simulates one frame. Raises what World.step() raises; the present is then the last good frame."""
        self.world.step(1, dt=1 / self.fps)
        self._remember()
        return True

    def state_hash(self) -> str | None:
        """The state of the present to the last bit."""
        return f"{self.world.state_hash():016x}"

    @property
    def conditions(self) -> dict[str, Any]:
        """What can be changed while it runs, with its present value; None where each sphere has its own."""
        world = self.world
        found = {
            "gravity": world.gravity,
            "drag": world.drag,
            "restitution": self._restitution,
            "floor_restitution": world.floor_restitution,
            "wall_friction": world.wall_friction,
        }
        return found if world.solver == "reference" else found | {"friction": self._friction}

    def change(self, conditions: Conditions) -> None:
        """Changes conditions of the present. Raises InvalidValue, and those before it in the list are changed."""
        given = conditions.model_dump(exclude_none=True)
        for name in ("gravity", "drag", "floor_restitution", "wall_friction"):
            if name in given:
                setattr(self.world, name, given[name])
        if "restitution" in given:
            self.world.set_restitution(given["restitution"])
        if "friction" in given:
            self.world.set_friction(given["friction"])
        self._read_surfaces()

    def sphere(self, sphere: int, moment: Moment) -> dict[str, Any]:
        """What is known of one sphere beside its place and motion."""
        mass = float(self._masses[sphere])
        frictions = self._frictions
        found: dict[str, Any] = {
            "mass": mass if np.isfinite(mass) else "fixed",
            "restitution": float(self._restitutions[sphere]),
            "friction": float(frictions[sphere]) if frictions is not None else 0.0,
        }
        return found if moment.spins is None else found | {"spin": moment.spins[sphere].tolist()}

    def _read_surfaces(self) -> None:
        self._restitutions = fc.to_numpy(self.world.restitutions).copy()
        self._frictions = fc.to_numpy(self.world.frictions).copy() if self.world.has_spin else None
        self._restitution = _shared_value(self._restitutions)
        self._friction = _shared_value(self._frictions) if self._frictions is not None else 0.0

    def _remember(self) -> None:
        world = self.world
        self._moments.add(
            world.frame,
            lambda: Moment(
                world.frame,
                world.time,
                self.box,
                fc.to_numpy(world.positions).copy(),
                fc.to_numpy(world.velocities).copy(),
                self._radii,
                fc.to_numpy(world.spins).copy() if world.has_spin else None,
            ),
        )
        self.energies.add(world.frame, lambda: (world.time, *world.energy()), is_newest_kept=False)


def _shared_value(values: np.ndarray) -> float | None:
    return float(values[0]) if len(values) and (values == values[0]).all() else None
