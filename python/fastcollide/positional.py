"""The report's command line: values without names, in a fixed order, trailing ones left out."""

from __future__ import annotations

from collections.abc import Sequence

from fastcollide.parameters import InvalidSetting
from fastcollide.settings import PARAMETERS, RunSettings

ORDER = (
    "particles",
    "frames",
    "fps",
    "export_every",
    "gravity",
    "damping",
    "floor_restitution",
    "output",
    "video",
    "make_video",
)


def is_positional(arguments: Sequence[str]) -> bool:
    """Whether the first argument is a number, as no command is.

    Asked before options are looked for: a negative gravity would be taken for one.
    """
    try:
        float(arguments[0])
    except (IndexError, ValueError):
        return False
    return True


def parse_positional(arguments: Sequence[str]) -> RunSettings:
    """The settings of `fastcollide 2000 600 60 2 -9.8 0.999 0.6 output video.mp4 1`.

    What is left out keeps its default. Raises InvalidSetting.
    """
    if len(arguments) > len(ORDER):
        raise InvalidSetting(
            "positional form", f"{len(arguments)} values", f"at most {len(ORDER)}: {' '.join(ORDER).replace('_', '-')}"
        )
    values = {name: PARAMETERS[name].parse(text) for name, text in zip(ORDER, arguments, strict=False)}
    return RunSettings(solver="reference", **values)  # the report's program has the report's loop
