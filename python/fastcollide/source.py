"""Where a run comes from: what its report says about it and how to repeat it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from fastcollide.parameters import Parameter
from fastcollide.settings import PARAMETERS, RunSettings


@dataclass(frozen=True)
class Setting:
    """A line of the table of settings; chosen: whether it differs from the default."""

    name: str
    value: str
    help: str
    chosen: bool


@dataclass(frozen=True)
class Source:
    """Where a run comes from: its title, the command that repeats it, and its settings."""

    title: str
    command: str
    settings: Sequence[Setting]


def source_of(settings: RunSettings) -> Source:
    """The source of a run from options."""
    values = {name: getattr(settings, name) for name in PARAMETERS}
    command = ["fastcollide", "run"]
    for name, parameter in PARAMETERS.items():
        if values[name] != parameter.default:
            command += parameter.words(values[name])
    return Source(
        title=f"{settings.particles:,} spheres for {settings.seconds:g} s",
        command=shlex.join(command),
        settings=[
            Setting(
                parameter.name.replace("_", " "),
                _shown(parameter, values[name]),
                parameter.help,
                values[name] != parameter.default,
            )
            for name, parameter in PARAMETERS.items()
        ],
    )


def _shown(parameter: Parameter, value: object) -> str:
    if value is None:
        return parameter.unset
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{parameter.text(value)} {parameter.unit}".rstrip()
