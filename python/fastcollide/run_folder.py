"""The folder of a run: `run.json` says what run it is of, so that the folder alone is enough to read it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from fastcollide.files import written_durably
from fastcollide.settings import SimulationSettings
from fastcollide.world import World

RUN_NAME = "run.json"
FORMAT = "fastcollide run"
VERSION = 1


def shared_part(settings: SimulationSettings) -> SimulationSettings:
    """Those settings that a run from options has in common with one of a scene."""
    return SimulationSettings(**{entry.name: getattr(settings, entry.name) for entry in fields(SimulationSettings)})


def seen_from_folder(settings: SimulationSettings) -> SimulationSettings:
    """The settings with all files named from the output folder, so that they can be moved together."""
    folder = settings.output
    moved = _with_paths(settings, lambda path: path if path.is_absolute() else Path(os.path.relpath(path, folder)))
    return replace(moved, output=Path("."))


def seen_from_here(settings: SimulationSettings, folder: Path) -> SimulationSettings:
    """Undoes seen_from_folder() for a folder that may have moved."""
    return replace(_with_paths(settings, lambda path: Path(os.path.normpath(folder / path))), output=folder)


def write_run(world: World, settings: SimulationSettings) -> None:
    """Writes run.json into the output folder."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "spheres": len(world),
        "world": world._options,
        "settings": asdict(seen_from_folder(shared_part(settings))),
    }
    with written_durably(settings.output / RUN_NAME) as unfinished:
        unfinished.write_text(json.dumps(content, indent=1, ensure_ascii=False, default=str) + "\n", encoding="utf-8")


def read_run(folder: Path) -> dict[str, Any] | None:
    """What run.json of a folder says; None where there is none, as in folders of earlier versions.

    Raises ValueError where it is no such file.
    """
    path = folder / RUN_NAME
    if not path.exists():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path}: found no JSON ({error}); expected what `fastcollide run` writes") from None
    if not isinstance(content, dict) or (content.get("format"), content.get("version")) != (FORMAT, VERSION):
        raise ValueError(f"{path}: found another format; expected '{FORMAT}', version {VERSION}")
    return content


def _with_paths(settings: SimulationSettings, move: Callable[[Path], Path]) -> SimulationSettings:
    """The settings with each of their files, but not the folder, moved."""
    trajectory = settings.trajectory and tuple(map(move, settings.trajectory))
    return replace(
        settings, video=move(settings.video), still=settings.still and move(settings.still), trajectory=trajectory
    )
