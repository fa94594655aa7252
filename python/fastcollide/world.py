"""The world: a box of colliding spheres on one device."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fastcollide import _core
from fastcollide.archive import Archive, read_archive, write_archive
from fastcollide.errors import CheckpointError, InvalidValue
from fastcollide.spheres import DEFAULT_BOUNDS, Bounds, Spheres, corners

SOLVERS = ("substep", "reference")
# An infinite mass means fixed: a finite one that float32 cannot hold must not become infinite; this is refused by name.
LARGEST_FLOAT32 = np.finfo(np.float32).max


@dataclass(frozen=True)
class Contacts:
    """Overlapping pairs, first < second, sorted by (first, second), on the world's device.

    Attributes:
        first: ids, int32, shape (n,).
        second: ids, int32, shape (n,).
        gap: distance of the surfaces, negative in overlap [m], shape (n,).
        normal: unit vectors from first to second, shape (n, 3).
    """

    first: Any
    second: Any
    gap: Any
    normal: Any

    def __len__(self) -> int:
        return len(self.first)


class Energy(NamedTuple):
    """Energy [J].

    Attributes:
        kinetic: of translation.
        rotational: of rotation.
        potential: of height; 0 at the lower corner of the box, along an open axis, which has none, at 0.
    """

    kinetic: float
    rotational: float
    potential: float

    @property
    def total(self) -> float:
        """The sum of the three [J]."""
        return self.kinetic + self.rotational + self.potential


class Measurements(NamedTuple):
    """What a world says of its whole state, each number as its method of that name gives it.

    Attributes:
        energy: [J]
        momentum: [kg m/s], shape (3,)
        angular_momentum: about the origin [kg m²/s], shape (3,)
        contact_count: overlapping pairs
        max_overlap: the deepest [m]
        mean_overlap: as a part of the smaller radius
    """

    energy: Energy
    momentum: NDArray[np.float64]
    angular_momentum: NDArray[np.float64]
    contact_count: int
    max_overlap: float
    mean_overlap: float


class World:
    """Spheres that fall, collide and bounce in a box.

    The state after k frames is a function of the scene alone: the same bits on every device, at any number of threads.

    Args:
        bounds: lower and upper corner of the box [m].
        boundary: what happens at its ends, for all axes or for each: "wall", "periodic" (a sphere that leaves comes in
            on the other side) or "open" (no end: the bounds of that axis only frame pictures).
        gravity: acceleration [m/s²].
        drag: γ [1/s]; v ← v·exp(−γ·dt) each frame.
        floor_restitution: of the lower z wall, 0 to 1; the other five walls use the sphere's own.
        wall_friction: Coulomb coefficient of all walls.
        rolling_friction: rolling resistance where spheres turn, a moment of at most this times R times the normal force
            of a contact, with R = r₁ r₂ / (r₁ + r₂), the radius at a wall.
        solver: "substep", stable at rest, or "reference", the report's loop, kept as a yardstick.
        iterations: substeps, or contact passes of the reference solver, in a frame.
        cell_size: edge of a grid cell [m] of method "cells" and of `contacts()`, at least the largest diameter. None:
            as small as that allows. No result depends on it.
        device: "cpu", "cuda", "cuda:N" or "auto", which takes a GPU if there is one; `World.device` says which.
        threads: of the CPU. None: all.
        method: how neighbours are found, which changes no result: "cells" (a new grid for every pass, simple), "list"
            (lists that are mended and hold for many passes), "frame" (lists for a frame or a few), "levels" (for
            each size of spheres a grid of its own, new for every pass), "small" (lists over all pairs: for smooth
            spheres, at most 4,096 on a CPU, about 2,000 on a GPU of compute capability 9.0 or above) or "auto": "small"
            on such a GPU for up to 1,280 spheres, "levels" where sizes differ more than about 18 times (6 on a GPU),
            else "frame" on a GPU and "list" on a CPU.
        block_size: of CUDA launches of method "cells", a multiple of 32 up to 512.

    Raises:
        InvalidValue: for an argument out of range.
        DeviceError: where there is no such device.
    """

    def __init__(
        self,
        bounds: Bounds = DEFAULT_BOUNDS,
        boundary: str | tuple[str, str, str] = "wall",
        gravity: tuple[float, float, float] = (0.0, 0.0, -9.8),
        drag: float = 0.06,
        floor_restitution: float = 0.6,
        wall_friction: float = 0.0,
        rolling_friction: float = 0.0,
        solver: str = "substep",
        iterations: int = 5,
        cell_size: float | None = None,
        device: str = "auto",
        threads: int | None = None,
        *,
        method: str = "auto",
        block_size: int = 128,
    ) -> None:
        if solver not in SOLVERS:
            raise InvalidValue(f'solver: found "{solver}"; allowed: "substep" or "reference"', "solver")
        if cell_size is not None and not cell_size > 0:
            raise InvalidValue(f"cell_size: found {cell_size}; allowed: more than 0 [m], or None", "cell_size")
        lower, upper = corners(bounds)
        self.bounds: Bounds = (tuple(lower), tuple(upper))
        self.solver = solver
        self._timed = False
        # What a file of this world needs to make it again, on any device.
        self._options: dict[str, Any] = {
            "bounds": self.bounds,
            "boundary": _three_names("boundary", boundary),
            "gravity": _three("gravity", gravity),
            "drag": drag,
            "floor_restitution": floor_restitution,
            "wall_friction": wall_friction,
            "rolling_friction": rolling_friction,
            "solver": solver,
            "iterations": iterations,
            "cell_size": cell_size,
            "method": method,
            "block_size": block_size,
        }
        self._world = _core.World(
            lower=lower,
            upper=upper,
            boundary=self._options["boundary"],
            gravity=self._options["gravity"],
            drag=drag,
            floor_restitution=floor_restitution,
            wall_friction=wall_friction,
            rolling_friction=rolling_friction,
            is_reference=solver == "reference",
            iterations=iterations,
            cell_size=cell_size or 0.0,
            device=device,
            threads=threads or 0,
            method=method,
            block_size=block_size,
        )

    def add(
        self,
        spheres: Spheres | None = None,
        *,
        position: ArrayLike | None = None,
        radius: ArrayLike | None = None,
        velocity: ArrayLike | None = None,
        density: ArrayLike | None = None,
        mass: ArrayLike | None = None,
        restitution: ArrayLike | None = None,
        spin: ArrayLike | None = None,
        friction: ArrayLike | None = None,
    ) -> NDArray[np.int32]:
        """Adds spheres: either Spheres, or the arrays by name. All or nothing.

        A sphere of infinite mass is fixed: no force, gravity or contact changes its velocity and spin, and it moves
        with them, through the walls of the box too (its centre starts inside). The others collide with it as with a
        wall; fixed spheres pass through each other.

        Arrays are anything that NumPy takes, or lie on a GPU; they are copied.

        Args:
            spheres: those of `random_spheres` and its like.
            position: [m], shape (n, 3), or (3,) for one.
            radius: [m], shape (n,), or one number for all.
            velocity: [m/s], shape (n, 3), or (3,) for all. Default: at rest.
            density: [kg/m³], shape (n,), or one number for all. Default: 1000.
            mass: [kg], in place of the density.
            restitution: 0 to 1, shape (n,), or one number for all; a pair uses the smaller of its two. Default: 0.6.
            spin: angular velocity [rad/s], like velocity. Default: none.
            friction: Coulomb coefficient, like restitution. Default: 0.

        Returns:
            The ids of the new spheres, int32, shape (n,); ids count up from 0.

        Raises:
            InvalidValue: with field and index, for a number out of range or a wrong shape.
            OutOfMemory: where the device is too small.
        """
        given = {
            "position": position,
            "radius": radius,
            "velocity": velocity,
            "density": density,
            "mass": mass,
            "restitution": restitution,
            "spin": spin,
            "friction": friction,
        }
        if spheres is None:
            spheres = _spheres(given)
        elif extra := [field for field, value in given.items() if value is not None]:
            raise InvalidValue(f"{extra[0]}: found beside Spheres; allowed: either Spheres or arrays by name", extra[0])
        first = self._world.add(
            spheres.position,
            spheres.velocity,
            spheres.radius,
            spheres.mass,
            spheres.restitution,
            spheres.spin,
            spheres.friction,
        )
        return np.arange(first, first + len(spheres), dtype=np.int32)

    def step(self, frames: int = 1, dt: float = 1 / 60) -> None:
        """Simulates. Ctrl-C ends it between two frames.

        Args:
            frames: how many.
            dt: length of each [s].

        Raises:
            InvalidValue: where an array was written with numbers out of range.
            SimulationError: where the simulation leaves its range; the message names the sphere and the frame, and the
                world stands at the last good one.
            DeviceError: where the device fails.
        """
        self._world.step(frames, dt)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the world to a file: its arrays, clock and options, and what its solver remembers.

        A world that is loaded from it goes on as this one does, to the last bit. Under its name the file is whole or
        not there at all, and it is on the disk when this returns; one that was there before stays until then.
        ``numpy.load`` opens it, too.

        Args:
            path: the file; by custom it ends in .fcw.

        Raises:
            InvalidValue: where an array was written with numbers out of range.
            OSError: where the file cannot be written.
        """
        self._save(path)

    def _save(self, path: str | os.PathLike[str], **contents: Any) -> None:
        """contents: values of JSON that are kept beside the world."""
        state = self._world.save()
        numbers = {name: value for name, value in state.items() if not isinstance(value, np.ndarray)}
        arrays = {name: value for name, value in state.items() if name not in numbers}
        write_archive(path, {"options": self._options, "state": numbers, **contents}, arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str], device: str = "auto", threads: int | None = None) -> World:
        """The world in a file of `save()`. It goes on as the saved one, to the last bit, whatever the two devices are.

        Args:
            path: the file.
            device: "cpu", "cuda", "cuda:N" or "auto".
            threads: of the CPU. None: all.

        Raises:
            CheckpointError: where the file is no saved world or is damaged.
            OSError: where it cannot be read.
            DeviceError: where there is no such device.
            OutOfMemory: where it is too small.
        """
        return cls._from_archive(read_archive(path), device, threads)

    @classmethod
    def _from_archive(cls, archive: Archive, device: str, threads: int | None) -> World:
        options, state = archive.contents.get("options"), archive.contents.get("state")
        try:
            world = cls(**options, device=device, threads=threads)
            world._world.restore(**archive.arrays, **state)
        except (InvalidValue, OverflowError, TypeError) as error:
            if isinstance(error, InvalidValue) and error.field in ("device", "threads"):
                raise  # the caller's own
            # The checksums are right: a hand has written it.
            raise CheckpointError(
                archive.path, None, f"no world ({error})", "the options and the state of one"
            ) from None
        return world

    def __len__(self) -> int:
        return self._world.count

    def __repr__(self) -> str:
        return f"World({len(self)} spheres, frame {self.frame}, time {self.time:g} s, on {self.device})"

    @property
    def frame(self) -> int:
        """Frames simulated so far."""
        return self._world.frame

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self._world.time

    @property
    def boundary(self) -> tuple[str, str, str]:
        """What happens at the ends of the box, for each axis."""
        return self._options["boundary"]

    @property
    def gravity(self) -> tuple[float, float, float]:
        """Acceleration [m/s²]. Like drag and the properties of the walls it can be set between two frames; raises
        InvalidValue where the new value is out of range, and the old one stays."""
        return tuple(self._options["gravity"])

    @gravity.setter
    def gravity(self, gravity: tuple[float, float, float]) -> None:
        three = _three("gravity", gravity)
        self._world.set_gravity(three)
        self._options["gravity"] = three

    @property
    def drag(self) -> float:
        """Air drag γ [1/s], see World; can be set."""
        return self._options["drag"]

    @drag.setter
    def drag(self, drag: float) -> None:
        self._world.set_drag(drag)
        self._options["drag"] = drag

    @property
    def floor_restitution(self) -> float:
        """Restitution of the lower z wall; can be set."""
        return self._options["floor_restitution"]

    @floor_restitution.setter
    def floor_restitution(self, floor_restitution: float) -> None:
        self._world.set_floor_restitution(floor_restitution)
        self._options["floor_restitution"] = floor_restitution

    @property
    def wall_friction(self) -> float:
        """Coulomb friction coefficient of all walls; can be set."""
        return self._options["wall_friction"]

    @wall_friction.setter
    def wall_friction(self, wall_friction: float) -> None:
        self._world.set_wall_friction(wall_friction)
        self._options["wall_friction"] = wall_friction

    def set_restitution(self, restitution: float) -> None:
        """Gives all spheres the same restitution, on the device; for one each, see restitutions.

        Raises InvalidValue where it is out of range.
        """
        self._world.set_restitution(restitution)

    def set_friction(self, friction: float) -> None:
        """Gives all spheres the same Coulomb friction coefficient; see set_restitution."""
        self._world.set_friction(friction)

    @property
    def device(self) -> str:
        """The device where the world lives, ``"cpu"`` or ``"cuda:N"``."""
        return self._world.device

    @property
    def device_name(self) -> str:
        """The maker's name of the device."""
        return self._world.device_name

    @property
    def positions(self) -> Any:
        """Positions [m], float32, shape (n, 3), in id order. This is the world's own memory, to read and to write.

        A NumPy array on the CPU, a DeviceArray on a GPU. After add() it may be an old copy: ask again.
        """
        return self._world.positions

    @property
    def velocities(self) -> Any:
        """Velocities [m/s], float32, shape (n, 3); see positions."""
        return self._world.velocities

    @property
    def radii(self) -> Any:
        """Radii [m], float32, shape (n,); see positions."""
        return self._world.radii

    @property
    def masses(self) -> Any:
        """Masses [kg], float32, shape (n,); infinite for a fixed sphere, see add(). See positions."""
        return self._world.masses

    @property
    def restitutions(self) -> Any:
        """Restitution of each sphere, float32, shape (n,); a pair uses the smaller of its two. See positions."""
        return self._world.restitutions

    @property
    def has_spin(self) -> bool:
        """Whether there is memory for spins and frictions, as some sphere came with them, or they were asked for."""
        return self._world.has_spin

    @property
    def spins(self) -> Any:
        """Angular velocities [rad/s], float32, shape (n, 3); see positions. A world without friction and spin has no
        memory for them until this is asked for."""
        return self._world.spins

    @property
    def frictions(self) -> Any:
        """Coulomb friction coefficient of each sphere, float32, shape (n,); see spins."""
        return self._world.frictions

    def contacts(self) -> Contacts:
        """All overlapping pairs of the present state: d² < (r₁ + r₂)² as decided in double precision.

        Raises:
            OutOfMemory: where the list does not fit on the device.
        """
        return Contacts(*self._world.contacts())

    def contact_count(self) -> int:
        """Number of overlapping pairs, without the list of them."""
        return self._world.contact_count()

    def energy(self) -> Energy:
        """Energy of all spheres but fixed ones [J], as an exact sum: the same bits on every device."""
        return Energy(*self._world.energy())

    def momentum(self) -> NDArray[np.float64]:
        """Momentum of all spheres but fixed ones [kg m/s], shape (3,), as an exact sum."""
        return np.array(self._world.momentum())

    def angular_momentum(self) -> NDArray[np.float64]:
        """Angular momentum of all spheres but fixed ones about the origin [kg m²/s], shape (3,), as an exact sum."""
        return np.array(self._world.angular_momentum())

    def max_overlap(self) -> float:
        """The deepest overlap [m]: of two spheres, or of a sphere and a wall. Of fixed spheres with each other or with
        walls it does not count."""
        return self._world.max_overlap()

    def mean_overlap(self) -> float:
        """The mean overlap of the pairs of spheres that are in contact, each as a part of its smaller radius; 0 without
        any. Pairs of fixed spheres do not count. An exact sum, the same on every device."""
        return self._world.mean_overlap()

    def measure(self) -> Measurements:
        """All of these at once, the same bits in a fraction of the time: pairs are looked for once."""
        energy, momentum, angular_momentum, *contacts = self._world.measure()
        return Measurements(Energy(*energy), np.array(momentum), np.array(angular_momentum), *contacts)

    def state_hash(self) -> int:
        """64 bits that cover every number of the state in id order; equal states have equal hashes on every device."""
        return self._world.state_hash()

    @property
    def fast_spheres(self) -> int:
        """How many times since the world began a sphere moved farther than its own radius in one substep (in one frame,
        with the reference solver): it may have passed through another one unseen. The same on every device."""
        return self._world.fast_flights[0]

    @property
    def safe_iterations(self) -> int | None:
        """Substeps in a frame as long as the last one with which no sphere, as fast as the fastest so far in radii a
        second, moves farther than its radius; the present number where none did. None for the reference solver, whose
        iterations divide no frame: see safe_dt."""
        return None if self.solver == "reference" else self._world.fast_flights[1]

    @property
    def safe_dt(self) -> float:
        """Length of a frame for the same, with the present number of iterations [s]; infinite where none did."""
        return self._world.fast_flights[2]

    @property
    def timed(self) -> bool:
        """Whether stage_times grows. Timing makes a GPU wait after each stage."""
        return self._timed

    @timed.setter
    def timed(self, timed: bool) -> None:
        self._timed = timed
        self._world.set_timed(timed)

    @property
    def stage_times(self) -> dict[str, float]:
        """Seconds spent in each stage while `timed`. The names ("build_grid", "make_lists", "gather_contacts" and more)
        depend on solver and method."""
        return self._world.stage_times


def to_numpy(array: Any) -> NDArray[Any]:
    """A NumPy array of any array, shared if that lies on the host, else copied.

    Args:
        array: of NumPy, a DeviceArray, or any other with DLPack or the CUDA array interface.
    """
    if isinstance(array, np.ndarray):
        return array
    device_type = array.__dlpack_device__()[0] if hasattr(array, "__dlpack_device__") else 1
    if device_type == 1:
        return np.asarray(array)
    return np.asarray(_core.copy_to_host(array))


def _three(field: str, value: ArrayLike) -> list[float]:
    numbers = _numbers(field, value)
    if numbers.shape != (3,):
        raise InvalidValue(f"{field}: found an array of shape {numbers.shape}; allowed: three numbers", field)
    return numbers.tolist()


def _three_names(field: str, value: Any) -> tuple[str, str, str]:
    names = (value,) * 3 if isinstance(value, str) else value
    if not isinstance(names, (tuple, list)) or len(names) != 3 or not all(isinstance(name, str) for name in names):
        raise InvalidValue(f"{field}: found {value!r}; allowed: one name for all axes or three names", field)
    return tuple(names)


def _spheres(given: dict[str, Any]) -> Spheres:
    for field in ("position", "radius"):
        if given[field] is None:
            raise InvalidValue(f"{field}: found None; allowed: an array (or give Spheres)", field)
    if given["mass"] is not None and given["density"] is not None:
        raise InvalidValue("density: found beside mass; allowed: one of the two", "density")
    defaults = {"velocity": (0.0, 0.0, 0.0), "density": 1000.0, "restitution": 0.6}
    arrays = {
        field: _numbers(field, defaults[field] if value is None else value)
        for field, value in given.items()
        if value is not None or field in defaults
    }
    position, radius = arrays["position"], arrays["radius"]
    count = len(position) if position.ndim == 2 else len(radius) if radius.ndim == 1 else 1
    radius = _broadcast("radius", radius, (count,))
    return Spheres(
        position=_broadcast("position", position, (count, 3)),
        velocity=_broadcast("velocity", arrays["velocity"], (count, 3)),
        radius=radius,
        mass=_broadcast("mass", arrays["mass"], (count,)) if "mass" in arrays else _weigh(arrays["density"], radius),
        restitution=_broadcast("restitution", arrays["restitution"], (count,)),
        spin=_broadcast("spin", arrays["spin"], (count, 3)) if "spin" in arrays else None,
        friction=_broadcast("friction", arrays["friction"], (count,)) if "friction" in arrays else None,
    )


def _weigh(density: NDArray[np.float32], radius: NDArray[np.float32]) -> NDArray[np.float32]:
    density = _broadcast("density", density, radius.shape)
    bad = np.flatnonzero(~(density > 0) | ~np.isfinite(density))
    if bad.size:
        i = int(bad[0])
        raise InvalidValue(
            f"density[{i}]: found {density[i]:g}; allowed: a finite number above 0 [kg/m³]", "density", i
        )
    with np.errstate(all="ignore"):  # a radius out of range is refused by the world
        mass = density * (np.float32(4.18879020) * (radius * radius * radius))  # 4/3 π r³
    return np.minimum(mass, LARGEST_FLOAT32)


def _numbers(field: str, value: Any) -> NDArray[np.float32]:
    try:
        array = to_numpy(value) if hasattr(value, "__dlpack_device__") else np.asarray(value)
    except ValueError:
        raise InvalidValue(f"{field}: found rows of different lengths; allowed: an array of numbers", field) from None
    if array.dtype.kind not in "fiu":
        raise InvalidValue(f"{field}: found an array of {array.dtype}; allowed: real numbers", field)
    if field == "mass":
        array = np.where(np.isinf(array), array, np.clip(array, -LARGEST_FLOAT32, LARGEST_FLOAT32))
    with np.errstate(over="ignore"):  # what does not fit becomes infinite, and infinite is refused by name
        return array.astype(np.float32, copy=False)


def _broadcast(field: str, array: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
    try:
        return np.ascontiguousarray(np.broadcast_to(array, shape))
    except ValueError:
        raise InvalidValue(
            f"{field}: found an array of shape {array.shape}; allowed: shape {shape}, or one that broadcasts to it",
            field,
        ) from None
