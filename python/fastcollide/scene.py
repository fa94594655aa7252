"""Scenes: TOML files that say what is simulated, what is written and what must come out."""

from __future__ import annotations

import difflib
import json
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import tomlkit
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails
from tomlkit.exceptions import ParseError, TOMLKitError

import fastcollide as fc
from fastcollide.errors import SceneError
from fastcollide.parameters import InvalidSetting
from fastcollide.scene_schema import GivenTable, LatticeTable, RandomTable, RunTable, SceneFile
from fastcollide.settings import SimulationSettings
from fastcollide.source import Setting, Source
from fastcollide.toml_lines import line_of

Place = tuple[str | int, ...]
SPHERE_KINDS: dict[str, type[BaseModel]] = {"random": RandomTable, "lattice": LatticeTable, "given": GivenTable}


@dataclass(frozen=True)
class Scene:
    """A checked scene. path: its file; overrides: what was set in place of the file's own values, as "key=value"."""

    path: Path
    overrides: tuple[str, ...]
    file: SceneFile
    settings: SimulationSettings
    _text: str

    def create_world(self, device: str | None = None) -> fc.World:
        """The world of this scene with its spheres, on the device of the scene or on this one.

        Raises SceneError where world or spheres are refused, DeviceError where there is no such device, MemoryError
        where it is too small.
        """
        settings = self.settings
        try:
            arguments = self.file.world.model_dump()
            world = fc.World(**arguments, device=device or settings.device, threads=settings.threads)
        except fc.InvalidValue as error:
            raise self._refused(("world", error.field), f"world.{error}") from None
        for i, table in enumerate(self.file.spheres):
            try:
                _add(world, table)
            except fc.InvalidValue as error:
                raise self._refused(("spheres", i, error.field), f"spheres[{i}].{error}") from None
        return world

    def source(self) -> Source:
        """What a report says about the run."""
        words = [word for override in self.overrides for word in ("--set", override)]
        return Source(
            title=self.file.title or self.path.stem.replace("_", " ").capitalize(),
            command=shlex.join(["fastcollide", "run", str(self.path), *words]),
            settings=[*_settings_of(self.file)],
        )

    def _refused(self, place: Place, message: str) -> SceneError:
        return SceneError([f"{_where(self.path, self._text, place, self.overrides)}: {message}"])


def load_scene(path: Path, overrides: Sequence[str] = ()) -> Scene:
    """Reads and checks a scene file.

    overrides: "key=value", where key is like world.gravity or spheres[0].count and value is a TOML value (a word alone
    may go without quotes); later ones win. Raises SceneError, or OSError where the file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
        document = tomlkit.parse(text).unwrap()
    except UnicodeDecodeError as error:
        raise SceneError([f"{path}: found bytes that are no UTF-8 text at {error.start}"]) from None
    except ParseError as error:
        reason = re.sub(r" at line \d+ col \d+$", "", str(error))
        raise SceneError([f"{path}:{error.line}: found no valid TOML: {reason}"]) from None
    except TOMLKitError as error:
        raise SceneError([f"{path}: found no valid TOML: {error}"]) from None
    for override in overrides:
        _apply(document, override)
    try:
        file = SceneFile.model_validate(document)
    except ValidationError as error:
        raise SceneError(_messages(error, document, path, text, overrides)) from None
    try:
        settings = _settings(file, path)
    except InvalidSetting as error:
        table = "run" if error.name in RunTable.model_fields else "output"
        place = (table, error.name)
        message = f"{_name(place)}: found {error.found}; allowed: {error.allowed}"
        raise SceneError([f"{_where(path, text, place, overrides)}: {message}"]) from None
    if file.expect.largest_energy_gain is not None and not settings.ledger_interval:
        where = _where(path, text, ("output", "ledger_every"), overrides)
        raise SceneError(
            [f"{where}: output.ledger_every: found 0; allowed: above 0, as expect.largest_energy_gain needs it"]
        )
    return Scene(path, tuple(overrides), file, settings, text)


def _settings(file: SceneFile, path: Path) -> SimulationSettings:
    output = file.output.model_dump()
    folder = output.pop("folder") or Path(path.stem)
    video = output.pop("video") or folder / "video.mp4"
    return SimulationSettings(**file.run.model_dump(), **output, output=folder, video=video)


def _add(world: fc.World, table: RandomTable | LatticeTable | GivenTable) -> None:
    arguments = table.model_dump(exclude={"kind"}, exclude_none=True)
    if isinstance(table, GivenTable):
        world.add(**arguments)
        return
    make = fc.random_spheres if isinstance(table, RandomTable) else fc.lattice_spheres
    world.add(make(**{"bounds": world.bounds, **arguments}))


# --- Overrides ---


def _apply(document: dict[str, Any], override: str) -> None:
    name, equals, value = override.partition("=")
    place = _place(name.strip())
    if not equals or not place:
        raise SceneError(
            [f"--set {override}: found no key and value; allowed: key=value, like world.gravity=[0,0,-1.6]"]
        )
    table: Any = document
    try:
        for part in place[:-1]:
            table = table.setdefault(part, {}) if isinstance(table, dict) else table[part]
        table[place[-1]] = _toml_value(value.strip())
    except (AttributeError, IndexError, KeyError, TypeError):
        raise SceneError(
            [f"--set {name}: found no such place in the scene; allowed: a key of one of its tables"]
        ) from None


def _place(name: str) -> Place:
    """world.gravity or spheres[0].count as parts."""
    words = re.sub(r"\[(\d+)\]", r".\1", name).split(".")
    return tuple(int(word) if word.isdigit() else word for word in words) if all(words) else ()


def _toml_value(text: str) -> Any:
    try:
        return tomlkit.value(text).unwrap()
    except TOMLKitError:
        return text  # a word that a shell has freed from its quotes


# --- Errors ---


def _messages(
    error: ValidationError, document: dict[str, Any], path: Path, text: str, overrides: Sequence[str]
) -> list[str]:
    # One fault a key: "one for all or a list" gives one for each of the two, and the one further inside says more.
    found_at: dict[Place, Place] = {}
    faults: dict[Place, str] = {}
    for detail in error.errors(include_url=False):
        place, found = _place_in(document, detail)
        key = place[: 1 + max((i for i, part in enumerate(place) if isinstance(part, str)), default=-1)]
        if key not in found_at or len(place) > len(found_at[key]):
            faults.pop(found_at.get(key, ()), None)
            found_at[key] = place
            faults[place] = _fault(detail, place, found)
    places = sorted(faults, key=lambda place: line_of(text, place) or 0)
    return [f"{_where(path, text, place, overrides)}: {faults[place]}" for place in places]


def _place_in(document: Any, detail: ErrorDetails) -> tuple[Place, Any]:
    """Where in the file the fault lies, and what stands there: pydantic's place without its words for the kinds of a
    union, and the whole list where an element of it is missing. A missing key has its own place, and None."""
    place: list[str | int] = []
    for part in detail["loc"]:
        if isinstance(document, dict):
            if part in document:
                document = document[part]
            elif detail["type"] == "missing" and part == detail["loc"][-1]:
                document = None
            else:
                continue
        elif isinstance(document, list) and isinstance(part, int) and part < len(document):
            document = document[part]
        else:
            continue
        place.append(part)
    if detail["type"] in ("union_tag_invalid", "union_tag_not_found"):
        return (*place, "kind"), document.get("kind")
    return tuple(place), document


def _fault(detail: ErrorDetails, place: Place, found: Any) -> str:
    table = _table_at(detail["loc"])
    if detail["type"] == "extra_forbidden":
        names = list(table.model_fields) if table else []
        near = difflib.get_close_matches(str(place[-1]), names, n=1)
        hint = f'; did you mean "{near[0]}"?' if near else ""
        return f"{_name(place)}: found a key that does not exist{hint}; allowed: {', '.join(names)}"
    if table is None:
        return f"{_name(place)}: found {_found(found)}; allowed: {', '.join(map(_found, SPHERE_KINDS))}"
    return f"{_name(place)}: found {_found(found)}; allowed: {_allowed(table, detail)}"


def _table_at(location: Sequence[str | int]) -> type[BaseModel] | None:
    """The table of the schema that holds the key at this place of pydantic's."""
    table: type[BaseModel] | None = SceneFile
    for part in location[:-1]:
        if part in SPHERE_KINDS and table is None:
            table = SPHERE_KINDS[str(part)]
        elif table is not None and part in table.model_fields:
            inner = table.model_fields[str(part)].annotation
            models = [m for m in (inner, *get_args(inner)) if isinstance(m, type) and issubclass(m, BaseModel)]
            if not models and part != "spheres":
                return table  # a value with parts
            table = models[0] if models else None
    return table


def _allowed(table: type[BaseModel] | None, detail: ErrorDetails) -> str:
    for part in reversed(detail["loc"]):
        if table is not None and part in table.model_fields:
            extra = table.model_fields[str(part)].json_schema_extra
            if isinstance(extra, dict):
                return str(extra["allowed"])
    return re.sub(r"^(Input should be|Value error,) ", "", detail["msg"])


def _where(path: Path, text: str, place: Place, overrides: Sequence[str]) -> str:
    """The override that set this place, or else file and line."""
    for override in reversed(overrides):
        set_place = _place(override.partition("=")[0].strip())
        if set_place == place[: len(set_place)] or place == set_place[: len(place)]:
            return f"--set {override}"
    line = line_of(text, place)
    return str(path) if line is None else f"{path}:{line}"


def _name(place: Place) -> str:
    name = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)
    return name.removeprefix(".") or "the scene"


def _found(value: Any) -> str:
    if value is None:
        return "nothing"
    words = json.dumps(value, ensure_ascii=False, default=str)
    return words if len(words) <= 60 else words[:57] + "..."


# --- For the report ---


def _settings_of(model: BaseModel, prefix: str = "") -> Sequence[Setting]:
    settings: list[Setting] = []
    for name, field in type(model).model_fields.items():
        value = getattr(model, name)
        tables = value if isinstance(value, list) and value and isinstance(value[0], BaseModel) else [value]
        if isinstance(tables[0], BaseModel):
            for i, table in enumerate(tables):
                index = f"[{i}]" if tables is value else ""
                settings += _settings_of(table, f"{prefix}{name}{index}.")
        elif value is not None and value != []:
            shown = _found(json.loads(json.dumps(value, default=str)))
            settings.append(Setting(prefix + name, shown, field.description or "", value != field.default))
    return settings
