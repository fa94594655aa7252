"""The live page's server in a thread of this process, for tests that talk to it."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import fastcollide as fc
from fastcollide.view.access import Access
from fastcollide.view.live import LiveRun
from fastcollide.view.player import Player, Run
from fastcollide.view.server import ViewServer


def live_run(count: int = 200, seed: int = 1, **world_options: object) -> LiveRun:
    """A live run of a few spheres that start at random."""

    def create() -> fc.World:
        world = fc.World(**{"bounds": ((-4, -4, 0), (4, 4, 8)), "device": "cpu", **world_options})
        world.add(fc.random_spheres(count, bounds=world.bounds, seed=seed, radius=(0.1, 0.3)))
        return world

    return LiveRun(create, "Test", fps=60)


@dataclass
class Served:
    """A server that runs. port, token: how to reach it."""

    server: ViewServer
    player: Player
    port: int
    token: str

    @property
    def address(self) -> str:
        """Without the token."""
        return f"http://127.0.0.1:{self.port}"

    @property
    def page(self) -> str:
        """What a person opens."""
        return f"{self.address}/?token={self.token}"


@contextmanager
def serving(run: Run, *, is_playing: bool = False, host: str = "127.0.0.1") -> Iterator[Served]:
    """Serves a run on a free port until the block ends."""
    player = Player(run, is_playing=is_playing)
    access = Access(host)
    server = ViewServer(player, access)
    loop, stop = asyncio.new_event_loop(), asyncio.Event()
    ready: list[int] = []
    is_ready = threading.Event()

    def tell(port: int) -> None:
        ready.append(port)
        is_ready.set()

    thread = threading.Thread(target=lambda: loop.run_until_complete(server.run(host, 0, tell, stop)), daemon=True)
    thread.start()
    assert is_ready.wait(30)
    try:
        yield Served(server, player, ready[0], access.token)
    finally:
        loop.call_soon_threadsafe(stop.set)
        thread.join(30)
        assert not thread.is_alive(), "the server has not ended"
        loop.close()
