"""The checkpoints of a run: files of World.save in its output folder, each with all that `resume` needs.

They are called checkpoint_00000120.fcw, by the frames done. The newest and the one before it stay.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import fastcollide as fc
from fastcollide.files import flush_file, flush_folder

KEPT = 2  # should the newest be damaged, there is one more
_FILE_NAME = re.compile(r"checkpoint_(\d{8})\.fcw")
_UNFINISHED = re.compile(r"(checkpoint_\d{8}\.fcw|frame_\d{8}\.txt|ledger\.csv|ledger\.parquet|run\.json)\.part")
_FIRST_BYTES = b"PK\x03\x04"


class Checkpoints:
    """Writes the checkpoints of one run. run: what each of them holds beside the world, as values of JSON."""

    def __init__(self, folder: Path, run: dict[str, Any]) -> None:
        self._folder = folder
        self._run = run

    def write(self, world: fc.World, new_files: Iterable[Path]) -> None:
        """Writes one of the world as it is now. new_files: what the run has written since the last one; all of it is on
        the disk before the checkpoint is.

        Raises OSError where a file cannot be written.
        """
        for path in new_files:
            flush_file(path)
        flush_folder(self._folder)
        world._save(checkpoint_path(self._folder, world.frame), run=self._run)
        for path in checkpoint_paths(self._folder)[:-KEPT]:
            path.unlink()


def checkpoint_path(folder: str | os.PathLike[str], frame: int) -> Path:
    """Where the checkpoint after this frame lies."""
    return Path(folder) / f"checkpoint_{frame:08d}.fcw"


def checkpoint_paths(folder: str | os.PathLike[str]) -> list[Path]:
    """All checkpoints of a folder, earliest first."""
    return sorted(path for path in Path(folder).iterdir() if _FILE_NAME.fullmatch(path.name))


def remove_checkpoints(folder: str | os.PathLike[str]) -> None:
    """Deletes the checkpoints of an earlier run.

    A file that only has such a name, but does not start like one, stays.
    """
    for path in checkpoint_paths(folder):
        with path.open("rb") as file:
            is_archive = file.read(len(_FIRST_BYTES)) == _FIRST_BYTES
        if is_archive:
            path.unlink()


def remove_unfinished_files(folder: str | os.PathLike[str]) -> None:
    """Deletes what a killed run was writing at the time."""
    for path in Path(folder).iterdir():
        if _UNFINISHED.fullmatch(path.name):
            path.unlink()
