"""The live page on the command line: what is shown, where it listens, and the browser that opens."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import sys
import threading
import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import tomlkit

from fastcollide.console import EXIT_FINE, say
from fastcollide.errors import MissingLibrary
from fastcollide.parameters import InvalidSetting
from fastcollide.run import create_world
from fastcollide.settings import QUICK_DEMO, TRAJECTORY_SUFFIXES
from fastcollide.view import HOST, PORT
from fastcollide.view.access import Access, is_loopback
from fastcollide.view.finished import FinishedRun
from fastcollide.view.live import LiveRun
from fastcollide.view.player import Player, Run

if TYPE_CHECKING:
    from fastcollide.view.server import ViewServer

INSTALL = 'pip install "fastcollide[view]"'


def run_to_view(
    source: Path | None = None,
    overrides: Sequence[str] = (),
    device: str | None = None,
    threads: int | None = None,
    bounds: tuple[float, ...] | None = None,
) -> Run:
    """What is to be seen: of a scene file, of what a run has written, or without either that of the quick demo.

    source: a scene, an output folder or a trajectory file; overrides, device and threads: of a scene; bounds: the box
    of a finished run. Raises InvalidSetting for one that has no meaning there, and what load_scene(),
    Scene.create_world() or FinishedRun raise.
    """
    if source is not None and (source.is_dir() or source.suffix.lower() in TRAJECTORY_SUFFIXES):
        for name, value in (("set", overrides), ("device", device), ("threads", threads)):
            if value:
                raise InvalidSetting(name, "it beside a finished run", "beside a scene, which is simulated")
        return FinishedRun(source, (bounds[:3], bounds[3:]) if bounds else None)
    if bounds:
        raise InvalidSetting("bounds", "them without a finished run", "--set world.bounds=..., beside a scene")
    if source is None:
        if overrides:
            raise InvalidSetting("set", "it without a scene", "after the name of a scene file")
        nothing = {"export_every": 0, "ledger_every": 0, "make_video": False}  # is written
        settings = replace(QUICK_DEMO, device=device or "auto", threads=threads, **nothing)
        return LiveRun(lambda: create_world(settings), f"{settings.particles:,} spheres", settings.fps)
    from fastcollide.scene import load_scene

    given = {"device": device, "threads": threads}
    changes = [f"run.{name}={tomlkit.item(value).as_string()}" for name, value in given.items() if value is not None]
    scene = load_scene(source, [*overrides, *changes])
    return LiveRun(scene.create_world, scene.source().title, scene.settings.fps)


def view_and_report(run: Run, host: str = HOST, port: int = PORT, *, opens_browser: bool = True) -> int:
    """Serves a run in front of a person, until Ctrl-C, and returns the exit code.

    Raises ViewError where the server cannot listen on host and port, MissingLibrary where there is no aiohttp.
    """
    try:
        from fastcollide.view.server import ViewServer
    except ImportError:
        raise MissingLibrary(f"the live page needs aiohttp, which is not installed; get it with: {INSTALL}") from None
    access = Access(host)
    server = ViewServer(Player(run), access)

    def tell(real_port: int) -> None:
        address = f"http://{_shown_host(host)}:{real_port}/?token={access.token}"
        say("showing", run.title + (f", on {run.device}" if run.device else ""))
        say("page", address)
        if not is_loopback(host):
            say("note", "whoever has this address can watch and steer; nothing that is sent is encrypted")
        say("stop with", "Ctrl-C")
        if opens_browser and _has_screen():
            # In a thread, since some browsers keep the caller waiting.
            threading.Thread(target=webbrowser.open, args=(address,), daemon=True).start()

    asyncio.run(_serve(server, host, port, tell))
    return EXIT_FINE


async def _serve(server: ViewServer, host: str, port: int, tell: Callable[[int], None]) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()

    def end() -> None:
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.remove_signal_handler(number)  # a second one acts at once
        stop.set()

    if sys.platform != "win32":  # there asyncio itself ends at Ctrl-C
        for number in (signal.SIGINT, signal.SIGTERM):
            loop.add_signal_handler(number, end)
    await server.run(host, port, tell, stop)


def _shown_host(host: str) -> str:
    """The name that a person types for this address."""
    if host in ("0.0.0.0", "::", ""):
        return socket.gethostname()
    return f"[{host}]" if ":" in host else host


def _has_screen() -> bool:
    """Whether a browser could open a window; one that takes the terminal would be no help."""
    if sys.platform in ("win32", "darwin"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
