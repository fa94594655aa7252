"""What a setting may be: kinds of values, each of which reads text, checks a value and says what is allowed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol


class InvalidSetting(ValueError):
    """A setting has a value that is not allowed. name: the setting; found, allowed: in words."""

    def __init__(self, name: str, found: object, allowed: str) -> None:
        self.name = name
        self.found = found
        self.allowed = allowed
        super().__init__(f"{name.replace('_', '-')}: found {found}; allowed: {allowed}")


class Kind(Protocol):
    """A kind of value."""

    @property
    def metavar(self) -> str:
        """Stands for the value in a help text."""

    @property
    def allowed(self) -> str:
        """The allowed values, in words."""

    def parse(self, text: str) -> Any:
        """The value that a person typed; ValueError where it is not one of this kind."""

    def accepts(self, value: Any) -> bool:
        """Whether the value is allowed."""


@dataclass(frozen=True)
class Whole:
    """A whole number in a closed range."""

    minimum: int
    maximum: int
    even: bool = False
    metavar = "N"

    @property
    def allowed(self) -> str:
        number = "an even whole number" if self.even else "a whole number"
        return f"{number} from {self.minimum:,} to {self.maximum:,}"

    def parse(self, text: str) -> int:
        return int(text)

    def accepts(self, value: Any) -> bool:
        is_whole = isinstance(value, int) and not isinstance(value, bool)
        return is_whole and self.minimum <= value <= self.maximum and not (self.even and value % 2)


@dataclass(frozen=True)
class Real:
    """A finite number in a range; the minimum itself can be left out."""

    minimum: float
    maximum: float
    without_minimum: bool = False
    metavar = "X"

    @property
    def allowed(self) -> str:
        start = (
            f"a number above {self.minimum:g} up to" if self.without_minimum else f"a number from {self.minimum:g} to"
        )
        return f"{start} {self.maximum:g}"

    def parse(self, text: str) -> float:
        return float(text)

    def accepts(self, value: Any) -> bool:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return False
        above = self.minimum < value if self.without_minimum else self.minimum <= value
        return above and value <= self.maximum


@dataclass(frozen=True)
class Choice:
    """One of a few words."""

    words: tuple[str, ...]

    @property
    def metavar(self) -> str:
        return "|".join(self.words)

    @property
    def allowed(self) -> str:
        return ", ".join(self.words)

    def parse(self, text: str) -> str:
        return text

    def accepts(self, value: Any) -> bool:
        return value in self.words


@dataclass(frozen=True)
class ChoicePerAxis:
    """One of a few words for all axes, or three of them, for x, y and z."""

    words: tuple[str, ...]

    @property
    def metavar(self) -> str:
        return f"{'|'.join(self.words)} ..."

    @property
    def allowed(self) -> str:
        return f"{', '.join(self.words)}; one for all axes, or three, for x, y and z"

    def parse(self, text: str) -> str | tuple[str, ...]:
        words = text.split()
        return words[0] if len(words) == 1 else tuple(words)

    def accepts(self, value: Any) -> bool:
        if isinstance(value, tuple):
            return len(value) == 3 and all(word in self.words for word in value)
        return value in self.words


@dataclass(frozen=True)
class Several:
    """Values of one kind with commas between them."""

    kind: Kind

    @property
    def metavar(self) -> str:
        return f"{self.kind.metavar},..."

    @property
    def allowed(self) -> str:
        return f"{self.kind.allowed}; several with commas between them"

    def parse(self, text: str) -> tuple[Any, ...]:
        return tuple(self.kind.parse(part.strip()) for part in text.split(","))

    def accepts(self, value: Any) -> bool:
        return isinstance(value, tuple) and len(value) > 0 and all(self.kind.accepts(part) for part in value)


@dataclass(frozen=True)
class Text:
    """Any text."""

    metavar = "TEXT"
    allowed = "any text"

    def parse(self, text: str) -> str:
        return text

    def accepts(self, value: Any) -> bool:
        return isinstance(value, str)


@dataclass(frozen=True)
class DeviceName:
    """The name of a device."""

    metavar = "NAME"
    allowed = "auto, cpu, cuda, or cuda: and a number, like cuda:0"

    def parse(self, text: str) -> str:
        return text

    def accepts(self, value: Any) -> bool:
        return isinstance(value, str) and re.fullmatch(r"auto|cpu|cuda(:\d{1,3})?", value) is not None


@dataclass(frozen=True)
class FilePath:
    """A path; relative ones start at the current folder. With suffixes: its name ends in one of them."""

    suffixes: tuple[str, ...] = ()
    metavar = "PATH"

    @property
    def allowed(self) -> str:
        return "a path" + (f" that ends in {' or '.join(self.suffixes)}" if self.suffixes else "")

    def parse(self, text: str) -> Path:
        if not text:
            raise ValueError("empty path")
        return Path(text)

    def accepts(self, value: Any) -> bool:
        return isinstance(value, Path) and (not self.suffixes or value.suffix.lower() in self.suffixes)


@dataclass(frozen=True)
class Switch:
    """On or off."""

    metavar = "1|0"
    allowed = "1 (yes) or 0 (no)"

    def parse(self, text: str) -> bool:
        values = {"1": True, "0": False, "yes": True, "no": False, "y": True, "n": False}
        if text.lower() not in values:
            raise ValueError(text)
        return values[text.lower()]

    def accepts(self, value: Any) -> bool:
        return isinstance(value, bool)


@dataclass(frozen=True)
class Parameter:
    """One setting: its name, default, unit, range and meaning.

    value_names: where it takes several values, a word for each of them.
    unset: where it can be left open, what happens then.
    """

    name: str
    default: Any
    kind: Kind
    help: str
    unit: str = ""
    value_names: tuple[str, ...] = ()
    unset: str = ""

    @property
    def option(self) -> str:
        """Name on the command line. A switch has one that leaves its default: --report, --no-video."""
        name = f"no_{self.name.removeprefix('make_')}" if self.default is True else self.name
        return "--" + name.replace("_", "-")

    @property
    def allowed(self) -> str:
        """The allowed values with their unit, in words."""
        several = f"{len(self.value_names)} values, each " if self.value_names else ""
        return several + self.kind.allowed + (f" {self.unit}" if self.unit else "")

    @property
    def default_text(self) -> str:
        """The default as a person would type it, or what happens without a value."""
        return self.unset if self.default is None else self.text(self.default)

    def text(self, value: Any) -> str:
        """The value as a person would type it."""
        if isinstance(value, tuple):
            return ("," if isinstance(self.kind, Several) else " ").join(self.text(part) for part in value)
        if isinstance(value, bool):
            return str(int(value))
        return f"{value:g}" if isinstance(value, float) else str(value)

    def words(self, value: Any) -> list[str]:
        """The words of the command line that give this value, with every digit."""
        if isinstance(self.kind, Switch):
            return [self.option]
        if isinstance(self.kind, Several):
            return [word for part in value for word in (self.option, str(part))]
        parts = value if isinstance(value, tuple) else (value,)
        return [self.option, *(repr(part) if isinstance(part, float) else str(part) for part in parts)]

    def parse(self, words: str | Sequence[str]) -> Any:
        """The value that was typed: one word, or several where value_names asks for them."""
        parts = [words] if isinstance(words, str) else list(words)
        if len(parts) != max(1, len(self.value_names)):
            raise InvalidSetting(self.name, f"'{' '.join(parts)}'", self.allowed)
        values = []
        for part in parts:
            try:
                values.append(self.kind.parse(part.strip()))
            except ValueError:
                raise InvalidSetting(self.name, f"'{part}'", self.allowed) from None
        value = tuple(values) if self.value_names else values[0]
        self.check(value)
        return value

    def check(self, value: Any) -> None:
        """Raises InvalidSetting where the value is not allowed."""
        if value is None and self.unset:
            return
        parts = value if self.value_names and isinstance(value, tuple) else (value,)
        if len(parts) != max(1, len(self.value_names)):
            raise InvalidSetting(self.name, value, self.allowed)
        for part in parts:
            if not self.kind.accepts(part):
                raise InvalidSetting(self.name, self.text(part), self.allowed)
