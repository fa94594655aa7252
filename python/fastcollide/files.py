"""Files that are whole or not there at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_beside(path: Path) -> Iterator[Path]:
    """Yields a path beside this one to write to; it takes this name when all went well, else it is removed."""
    unfinished = part_of(path)
    try:
        yield unfinished
        os.replace(unfinished, path)
    except BaseException:
        unfinished.unlink(missing_ok=True)
        raise


def part_of(path: Path) -> Path:
    """What a file is called while it is written."""
    return path.with_name(path.name + ".part")


@contextmanager
def written_durably(path: Path) -> Iterator[Path]:
    """As written_beside, and once it has this name the file outlives a power cut: its bytes are on the disk before it
    takes the name, and the name is when this ends."""
    with written_beside(path) as unfinished:
        yield unfinished
        flush_file(unfinished)
    flush_folder(path.parent)


def make_folder(path: Path) -> None:
    """Makes a folder and those that it lies in; once this returns a power cut leaves them."""
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    path.mkdir(parents=True, exist_ok=True)
    for folder in missing:
        flush_folder(folder.parent)


def flush_file(path: Path) -> None:
    """Waits until the bytes of this file are on the disk."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def flush_folder(folder: Path) -> None:
    """Waits until the names of the files in this folder are on the disk, where the system lets a program ask for it."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(number)
    finally:
        os.close(number)
