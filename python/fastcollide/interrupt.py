"""Ctrl-C during a run: the frame at hand is finished, then the run ends with whole files."""

from __future__ import annotations

import signal
from types import FrameType


class StopOnInterrupt:
    """While entered, the first Ctrl-C sets `requested`; the next one acts at once, as it would without this."""

    def __init__(self) -> None:
        self.requested = False

    def __enter__(self) -> StopOnInterrupt:
        self._previous = signal.signal(signal.SIGINT, self._request)
        return self

    def __exit__(self, *exception: object) -> None:
        signal.signal(signal.SIGINT, self._previous)

    def _request(self, number: int, frame: FrameType | None) -> None:
        self.requested = True
        signal.signal(signal.SIGINT, self._previous)
