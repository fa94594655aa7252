"""The frames of a run on their way to files, in a thread of its own beside the computation."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Protocol

from fastcollide.snapshots import Cast, Snapshot, take
from fastcollide.world import World

_WAITING = 3  # frames: enough for the disk to be late for a moment, few enough to cost little memory


class Sink(Protocol):
    """Files of one format that frames go to, one after the other."""

    def write(self, snapshot: Snapshot) -> Path:
        """Writes a frame, so that a kill at any later moment leaves it readable; returns the file that it is in."""

    def close(self) -> None:
        """Ends the files."""


class Exports:
    """Takes frames of a world and writes them to all sinks while the world goes on::

        with Exports(cast, sinks) as exports:
            exports.add(world)

    A frame that cannot be written ends it: the error comes out of the next add() or drain(), and no later frame is
    written, so that none is missing in between.
    """

    def __init__(self, cast: Cast, sinks: Sequence[Sink]) -> None:
        self._cast = cast
        self._sinks = sinks
        self._pending: deque[Future[None]] = deque()
        self._files: dict[Path, None] = {}  # in the order in which they were written
        self._has_failed = False
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="frames")

    def __enter__(self) -> Exports:
        return self

    def __exit__(self, kind: type[BaseException] | None, *exception: object) -> None:
        self._thread.shutdown()  # what was taken is written, whatever else went wrong
        try:
            if kind is None:
                self.drain()
        finally:
            for sink in self._sinks:
                sink.close()

    def add(self, world: World) -> None:
        """Takes the world as it is now. Waits while a few frames are still to be written."""
        while len(self._pending) >= _WAITING:
            self._pending.popleft().result()
        if self._sinks:
            self._pending.append(self._thread.submit(self._write, take(world, self._cast)))

    def drain(self) -> list[Path]:
        """Waits until all frames are written; returns the files that have been written to since the last time."""
        while self._pending:
            self._pending.popleft().result()
        files = [*self._files]
        self._files.clear()
        return files

    def _write(self, snapshot: Snapshot) -> None:
        if self._has_failed:
            return
        try:
            for sink in self._sinks:
                self._files[sink.write(snapshot)] = None
        except BaseException:
            self._has_failed = True
            raise
