"""The text of a new scene file, with every key, its default and what it means, and the schema for editors."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator
from typing import Any

import tomlkit
from pydantic import BaseModel

from fastcollide.scene_schema import ExpectTable, OutputTable, RandomTable, RunTable, SceneFile, WorldTable

_WIDTH = 110  # columns of a comment


def new_scene() -> str:
    """A scene file that runs as it is: each key with its default, those without one as a comment."""
    lines = [
        "# A FastCollide scene. Units: m, s, kg, rad/s. Only [[spheres]] with kind and count must be there.",
        "# `fastcollide scene check FILE` checks it, `fastcollide run FILE` runs it,",
        "# `fastcollide run FILE --set world.gravity=[0,0,-1.6]` changes a value for one run.",
        'title = "My scene"',
    ]
    lines += _table("[world]", WorldTable, {})
    lines += _table("[[spheres]]", RandomTable, {"kind": "random", "count": 2000})
    lines += [
        "",
        '# More [[spheres]] can follow: kind = "lattice" has the same keys and lays them in rows and layers;',
        '# kind = "given" says them one by one:',
        "# [[spheres]]",
        '# kind = "given"',
        "# position = [[0, 0, 5], [1, 0, 5]]",
        "# radius = 0.2                 # or one for each: [0.2, 0.3]; so are all of the following",
        "# velocity = [0, 0, 0]",
        "# spin = [0, 0, 0]",
        "# density = 1000               # or:",
        "# mass = 30",
        "# restitution = 0.6",
        "# friction = 0.0",
    ]
    lines += _table("[run]", RunTable, {})
    lines += _table("[output]", OutputTable, {})
    lines += ["", "# What must hold after the last frame; if anything does not, the exit code is 1.", "[expect]"]
    examples = {"state_hash": '"0123456789abcdef"', "escaped": "{ max = 0 }"}
    for name, field in ExpectTable.model_fields.items():
        if name != "sphere":
            lines += _comment(field.description)
            lines.append(f"# {name} = {examples.get(name, '{ min = 0, max = 1 }')}")
    lines += [
        "# Single spheres:",
        "# [[expect.sphere]]",
        "# id = 0",
        "# position = [0, 0, 0]",
        "# velocity = [0, 0, 0]",
    ]
    lines += ["# spin = [0, 0, 0]", "# tolerance = 0.001"]
    return "\n".join(lines) + "\n"


def scene_schema() -> str:
    """The JSON schema of scene files, for editors that check TOML."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **SceneFile.model_json_schema()}
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"


def _table(heading: str, table: type[BaseModel], given: dict[str, Any]) -> Iterator[str]:
    yield ""
    yield from _comment(table.__doc__)
    yield heading
    for name, field in table.model_fields.items():
        value = given.get(name, field.default)
        allowed = field.json_schema_extra["allowed"] if isinstance(field.json_schema_extra, dict) else ""
        yield from _comment(f"{field.description} ({allowed})")
        yield f"# {name} =" if value is None else f"{name} = {tomlkit.item(_plain(value)).as_string()}"


def _comment(text: str | None) -> list[str]:
    return ["# " + line for line in textwrap.wrap(text or "", _WIDTH)]


def _plain(value: Any) -> Any:
    """Tuples as lists and whole floats as they are: what TOML has words for."""
    return [_plain(part) for part in value] if isinstance(value, tuple) else value
