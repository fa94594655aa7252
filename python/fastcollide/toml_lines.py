"""Where a key stands in a TOML file: parsers give values, people need lines."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import tomlkit
from tomlkit.container import Container
from tomlkit.items import AbstractTable, AoT, InlineTable, Item

_MARK = "@line-wanted@"


def line_of(text: str, place: Sequence[str | int]) -> int | None:
    """The line, from 1, of the key at this place, or of the innermost table around it that has one of its own.

    text: valid TOML; place: names and indices, like ("spheres", 0, "count"). None where nothing of it is in the file.

    The key gets a comment, and the line that it comes out in is the one wanted: so no syntax of TOML has to be known.
    """
    document = tomlkit.parse(text)
    item = _innermost(document, place)
    if item is None:
        return None
    height = 0 if isinstance(item, AbstractTable) else item.as_string().count("\n")
    item.comment(_MARK)
    before, mark, _ = tomlkit.dumps(document).partition(_MARK)
    return before.count("\n") + 1 - height if mark else None


def _innermost(document: Container, place: Sequence[str | int]) -> Item | None:
    table: Any = document
    found: Item | None = None
    for part in place:
        if isinstance(table, AoT) and isinstance(part, int) and part < len(table):
            table = found = table[part]
            continue
        container = table.value if isinstance(table, AbstractTable) else table
        if not isinstance(container, Container) or part not in container:
            break
        item = container.item(str(part))
        if isinstance(item, (AoT, AbstractTable)) and not isinstance(item, InlineTable):
            table = item
            found = item if isinstance(item, AbstractTable) and not item.is_super_table() else found
            continue
        return item
    return found
