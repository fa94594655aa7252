"""The thread that simulates and plays a run: one at a time for all who watch."""

from __future__ import annotations

import queue
import sys
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from fastcollide.view.live import EnergyRow
from fastcollide.view.messages import Conditions
from fastcollide.view.moments import Box, Moment, Thinned

MOST_ORDERS = 256
_PICTURE_SECONDS = 1 / 62  # no more pictures than a screen shows
_LATEST_START = 0.25  # a run that is behind by more than this many seconds does not hurry to make up for it


class Run(Protocol):
    """What can be played: moments in a row, the last of which may be followed by more."""

    kind: str
    title: str
    fps: int
    energies: Thinned[EnergyRow]

    @property
    def box(self) -> Box: ...
    @property
    def device(self) -> str | None: ...
    @property
    def conditions(self) -> dict[str, Any]: ...
    def __len__(self) -> int: ...
    def moment(self, index: int) -> Moment: ...
    def time_of(self, index: int) -> float: ...
    def advance(self) -> bool: ...
    def reset(self) -> None: ...
    def change(self, conditions: Conditions) -> None: ...
    def sphere(self, sphere: int, moment: Moment) -> dict[str, Any]: ...
    def state_hash(self) -> str | None: ...


@dataclass(frozen=True)
class Shown:
    """What is to be seen now: a moment, its place among all moments, and a number that grows with each one shown."""

    number: int
    moment: Moment
    index: int
    moments: int


@dataclass(frozen=True)
class Status:
    """How it plays. start: counts the starts; rate: simulated seconds in a second; state_hash: of the present, while
    it waits there; fault: what ended the play."""

    start: int = 0
    is_playing: bool = True
    speed: float = 1.0
    rate: float = 0.0
    conditions: dict[str, Any] | None = None
    state_hash: str | None = None
    fault: str | None = None


class Player:
    """Plays a run in a thread of its own.

    on_change: called in that thread whenever `shown` or `status` are new. Nothing moves while `watchers` is 0.
    """

    def __init__(self, run: Run, on_change: Callable[[], None] = lambda: None, *, is_playing: bool = True) -> None:
        self.run = run
        self.on_change = on_change
        self.watchers = 0
        self._orders: queue.SimpleQueue[tuple[Callable[[], None], Callable[[str], None]] | None] = queue.SimpleQueue()
        self._index = 0
        self._due = 0.0
        self._published = 0.0
        self._rate = _Rate()
        self.status = Status(is_playing=is_playing, conditions=run.conditions, state_hash=self._hash(is_playing))
        self.shown = Shown(1, run.moment(0), 0, len(run))
        self._thread = threading.Thread(target=self._work, name="player", daemon=True)

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Ends the thread, after the frame at hand."""
        self._orders.put(None)
        self._thread.join(timeout=10)

    def order(self, action: Callable[[], None], on_error: Callable[[str], None] = lambda message: None) -> None:
        """Has the thread call one of the methods below. on_error: called with a message where it fails, there, or here
        where too many orders wait already."""
        if self._orders.qsize() >= MOST_ORDERS:
            on_error(f"orders: found {MOST_ORDERS} that wait already; allowed: fewer, so wait for these")
        else:
            self._orders.put((action, on_error))

    # --- What can be ordered ---

    def wake(self) -> None:
        """Looks whether anybody watches."""

    def play(self) -> None:
        """Plays from the moment that is shown; a finished run that stands at its end plays from its start."""
        if self.run.kind == "finished" and self._index == len(self.run) - 1:
            self._index = 0
        self._rate.clear()
        self._due = time.monotonic()
        self._tell(is_playing=True, fault=None)

    def pause(self) -> None:
        """Stands still."""
        self._tell(is_playing=False)

    def step(self) -> None:
        """One moment on; at the end of a live run, exactly one frame."""
        self._stand()
        if (index := self._next()) is not None:
            self._show(index)
        self._tell()

    def back(self) -> None:
        """One moment back."""
        self.seek(self._index - 1)

    def seek(self, index: int) -> None:
        """Shows the moment with this index, or the nearest one, and stands still."""
        self._stand()
        self._show(min(max(index, 0), len(self.run) - 1))
        self._tell()

    def set_speed(self, factor: float) -> None:
        """How fast it plays: 1 is real time."""
        self._rate.clear()
        self._tell(speed=factor)

    def reset(self) -> None:
        """Back to the start, playing or not as before."""
        self.run.reset()
        self._due = time.monotonic()
        self._rate.clear()
        self._show(0)
        self._tell(start=self.status.start + 1, fault=None)

    def change(self, conditions: Conditions) -> None:
        """Changes the present, and shows it."""
        self.run.change(conditions)
        if self._index != len(self.run) - 1:
            self._show(len(self.run) - 1)
        self._tell()

    # --- The thread ---

    def _work(self) -> None:
        while True:
            try:
                order = self._orders.get(timeout=self._patience())
            except queue.Empty:
                self._move()
                continue
            if order is None:
                return
            action, on_error = order
            try:
                action()
            except Exception as error:  # whatever a browser asked for, the others go on watching
                on_error(_message_of(error))

    def _patience(self) -> float | None:
        """How long to wait for an order [s]; None: until one comes."""
        if not (self.status.is_playing and self.watchers):
            return None
        return max(0.0, self._due - time.monotonic())

    def _move(self) -> None:
        try:
            before = self.run.time_of(self._index)
            index = self._next()
            if index is None:
                self._show(self._index)
                self._tell(is_playing=False)
                return
            length = self.run.time_of(index) - before
            self._index = index
            now = time.monotonic()
            self._due = max(self._due + length / self.status.speed, now - _LATEST_START)
            if now - self._published >= _PICTURE_SECONDS:
                self._show(index)
            if (rate := self._rate.add(now, length)) is not None:
                self._tell(rate=rate)
        except Exception as error:
            self._tell(is_playing=False, fault=_message_of(error))

    def _next(self) -> int | None:
        """The index of the next moment, which a live run makes where there is none; None at the end."""
        if self._index + 1 < len(self.run):
            return self._index + 1
        return len(self.run) - 1 if self.run.advance() else None

    def _stand(self) -> None:
        if self.status.is_playing:
            self._tell(is_playing=False)

    def _show(self, index: int) -> None:
        moment = self.run.moment(index)
        self._index = index
        self._published = time.monotonic()
        self.shown = Shown(self.shown.number + 1, moment, index, len(self.run))
        self.on_change()

    def _tell(self, **changes: Any) -> None:
        status = replace(self.status, conditions=self.run.conditions, **changes)
        self.status = replace(status, state_hash=self._hash(status.is_playing))
        self.on_change()

    def _hash(self, is_playing: bool) -> str | None:
        """Not while it plays, when nobody could read it."""
        return None if is_playing or self._index != len(self.run) - 1 else self.run.state_hash()


class _Rate:
    """Simulated seconds in a second, twice a second."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        self._since: float | None = None
        self._simulated = 0.0

    def add(self, now: float, simulated: float) -> float | None:
        if self._since is None:
            self._since = now
            return None
        self._simulated += simulated
        if now - self._since < 0.5:
            return None
        rate = self._simulated / (now - self._since)
        self._since, self._simulated = now, 0.0
        return rate


def _message_of(error: Exception) -> str:
    if not isinstance(error, (ValueError, RuntimeError, MemoryError, OSError)):
        traceback.print_exc(file=sys.stderr)
    return " ".join(str(error).split()) or type(error).__name__
