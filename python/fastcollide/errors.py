"""The errors that FastCollide raises."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike, fspath


class InvalidValue(ValueError):
    """An argument or a number of the state is outside its range. The message says what was found and what is allowed.

    Attributes:
        field: name of the argument.
        index: which element of it, or None for a scalar.
    """

    def __init__(self, message: str, field: str, index: int | None = None) -> None:
        super().__init__(message, field, index)
        self.field = field
        self.index = index

    def __str__(self) -> str:
        return self.args[0]


class DeviceError(RuntimeError):
    """The device asked for is not there, or it failed."""


class SimulationError(RuntimeError):
    """The simulation left the range in which it is exact; the message names the sphere and the frame."""


class OutOfMemory(MemoryError):
    """The device or the host has less memory than asked for."""


class CheckpointError(ValueError):
    """A file is no saved world, or it is damaged.

    Attributes:
        path: the file.
        block: the part of it, or None for the whole.
        found: what was found there.
        allowed: what is allowed there.
    """

    def __init__(self, path: str | PathLike[str], block: str | None, found: str, allowed: str) -> None:
        super().__init__(fspath(path), block, found, allowed)
        self.path = fspath(path)
        self.block = block
        self.found = found
        self.allowed = allowed

    def __str__(self) -> str:
        where = f"{self.path}: {self.block}" if self.block else self.path
        return f"{where}: found {self.found}; allowed: {self.allowed}"


class MissingLibrary(RuntimeError):
    """A library that this needs is not installed; the message says how to get it."""


class SceneError(ValueError):
    """A scene is not as it must be. messages: one for each fault, with file, line, key, what was found and allowed."""

    def __init__(self, messages: Sequence[str]) -> None:
        self.messages = tuple(messages)
        super().__init__("\n".join(messages))


class ViewError(RuntimeError):
    """The live page cannot be served; the message says why and what to do."""
