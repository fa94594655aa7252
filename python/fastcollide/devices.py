"""What this machine and this build can do."""

from __future__ import annotations

import os
from dataclasses import dataclass

from fastcollide import _core

# A forked child (multiprocessing's way on Linux) has none of the threads of its parent.
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_core.reset_after_fork)


@dataclass(frozen=True)
class Device:
    """What a world can live on.

    Attributes:
        name: as World takes it, "cpu" or "cuda:N".
        description: the maker's name.
        memory_bytes: of the device.
    """

    name: str
    description: str
    memory_bytes: int


@dataclass(frozen=True)
class BuildInfo:
    """How this package was built.

    Attributes:
        version: of FastCollide.
        compiler: of C++, with its version.
        cuda: version of the CUDA toolkit, None if built without.
        cuda_architectures: as given to the build.
        is_debug: with assertions, so nothing to measure speed with.
    """

    version: str
    compiler: str
    cuda: str | None
    cuda_architectures: str
    is_debug: bool


@dataclass(frozen=True)
class Limits:
    """What a world can hold.

    Attributes:
        spheres: the most in one world.
        bytes_per_sphere: memory on the world's device while it steps in the way that it takes by itself, of more than
            2¹⁷ spheres in flight; where they are crowded, lists of neighbours get longer.
        bytes_by_cells: the same with `method="cells"`.
        bytes_for_spin: more for each sphere of a world with friction or spin.
        bytes_per_cell: a grid has at most 4 cells a sphere, or 2¹⁸ if that is more; those of a world whose sizes are far
            apart 32 together.
        reach_in_radii: coordinates up to this many smallest radii from 0 are always allowed, those from twice that
            never: float32 could not place such a sphere to 1/64 of its radius.
    """

    spheres: int
    bytes_per_sphere: int
    bytes_by_cells: int
    bytes_for_spin: int
    bytes_per_cell: int
    reach_in_radii: int


def limits() -> Limits:
    """The limits that the code enforces."""
    return Limits(*_core.limits())


def devices() -> list[Device]:
    """All devices of this machine: the CPU first, then each GPU that this build can use."""
    return [Device(*device) for device in _core.devices()]


def build_info() -> BuildInfo:
    """Version, compiler and CUDA of this build."""
    version, compiler, cuda, architectures, is_debug = _core.build_info()
    return BuildInfo(version, compiler, cuda or None, architectures, is_debug)
