"""Scenes on the command line: run, make and check them. Apart, since pydantic takes as long to load as all the rest."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomlkit

from fastcollide.console import EXIT_FINE, guard, run_world, say
from fastcollide.expectations import Outcome, check_end, measure_start
from fastcollide.ledger import read_ledger
from fastcollide.parameters import InvalidSetting
from fastcollide.run import check_paths
from fastcollide.run_record import checkpoints_of
from fastcollide.scene import load_scene
from fastcollide.scene_schema import OutputTable, RunTable
from fastcollide.scene_text import new_scene

# Where the options of `run` that can stand beside a scene lie in it.
_OPTION_PLACES: dict[str, str] = {
    **{name: f"run.{name}" for name in RunTable.model_fields},
    **{name: f"output.{name}" for name in OutputTable.model_fields if name != "folder"},
    "output": "output.folder",
}


def run_scene_and_report(path: Path, overrides: Sequence[str], options: dict[str, Any]) -> int:
    """Runs a scene in front of a person and returns the exit code: 1 where its end is not as expected.

    overrides: "key=value"; options: those of `run` that were given, which go before the overrides.
    """
    scene = load_scene(path, [*overrides, *(_override(name, value) for name, value in options.items())])
    check_paths(scene.settings)
    world = scene.create_world()
    start = measure_start(world)
    say("scene", f"{scene.path}{': ' + scene.file.title if scene.file.title else ''}")

    def check() -> list[Outcome]:
        ledger = read_ledger(scene.settings.output) if scene.settings.ledger_interval else None
        return check_end(scene.file.expect, world, start, ledger)

    source = scene.source()
    checkpoints = checkpoints_of(scene.settings, source, scene.file.expect, start)
    return run_world(world, scene.settings, source, check, checkpoints=checkpoints)


def new_scene_and_report(path: Path) -> int:
    """Writes a new scene file in front of a person and returns the exit code."""
    with path.open("x", encoding="utf-8") as file:  # a file that is there stays
        file.write(new_scene())
    say("scene", str(path.resolve()))
    return EXIT_FINE


def check_scenes_and_report(paths: Sequence[Path], overrides: Sequence[str]) -> int:
    """Checks scene files in front of a person, down to the last sphere, and returns the exit code."""
    code = EXIT_FINE
    for path in paths:
        code = max(code, guard(lambda path=path: _check_scene(path, overrides)))
    return code


def _check_scene(path: Path, overrides: Sequence[str]) -> int:
    scene = load_scene(path, overrides)
    world = scene.create_world(device="cpu")
    print(f"{path}: fine, {len(world):,} spheres for {scene.settings.seconds:g} s")
    return EXIT_FINE


def _override(name: str, value: Any) -> str:
    """An option of `run` as a change of the scene."""
    if name not in _OPTION_PLACES:
        raise InvalidSetting(name, "it beside a scene", "--set with a key of the scene")
    value = [*map(_plain, value)] if isinstance(value, tuple) else _plain(value)
    return f"{_OPTION_PLACES[name]}={tomlkit.item(value).as_string()}"


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else value
