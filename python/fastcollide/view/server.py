"""The web server: the page's files, and a WebSocket for each browser that watches."""

from __future__ import annotations

import asyncio
import errno
import json
from collections.abc import Callable
from contextlib import suppress
from importlib.resources import files
from typing import Any

import numpy as np
from aiohttp import WSCloseCode, WSMsgType, web

import fastcollide as fc
from fastcollide.colormaps import color_table
from fastcollide.errors import ViewError
from fastcollide.render import Renderer
from fastcollide.view.access import Access
from fastcollide.view.messages import (
    LARGEST_MESSAGE,
    Acknowledge,
    ColorBy,
    Conditions,
    InvalidMessage,
    Message,
    Seek,
    Select,
    SetSpeed,
    Simple,
    pack_picture,
    read_message,
)
from fastcollide.view.moments import ViewColor
from fastcollide.view.player import Player, Shown, Status

MOST_BROWSERS = 16
PICTURES_AHEAD = 2  # sent and not acknowledged yet: one on its way while the other is drawn
SECONDS_BETWEEN_NEWS = 0.2  # of the energies and of a sphere, which people read

_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}
_HEADERS = {
    # Nothing but this server's own files, no inline code, no frame around the page.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def page_files() -> dict[str, tuple[bytes, str]]:
    """The files of the page by name, each with its media type. Only what is in here is ever sent."""
    page = files("fastcollide.view").joinpath("page")
    found = {}
    for entry in page.iterdir():
        suffix = "." + entry.name.rpartition(".")[2]
        if entry.is_file() and suffix in _TYPES:
            found[entry.name] = (entry.read_bytes(), _TYPES[suffix])
    return found


class ViewServer:
    """Serves one player to browsers.

    player: is started and stopped with the server; access: who may connect.
    """

    def __init__(self, player: Player, access: Access) -> None:
        self.player = player
        self.access = access
        self._files = page_files()
        self._browsers: set[_Browser] = set()
        self._cookie = ""

    async def run(self, host: str, port: int, is_ready: Callable[[int], None], stop: asyncio.Event) -> None:
        """Serves until `stop` is set.

        port: 0 takes a free one; is_ready: called with the port once it listens. Raises ViewError where it cannot
        listen there.
        """
        loop = asyncio.get_running_loop()

        def tell_all() -> None:
            for browser in self._browsers:
                browser.news.set()

        def tell_all_from_player() -> None:
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(tell_all)

        app = web.Application(middlewares=[self._guard])
        app.router.add_get("/socket", self._watch)
        app.router.add_get("/{name:.*}", self._file)
        runner = web.AppRunner(app, access_log=None, shutdown_timeout=1.0)
        await runner.setup()
        self.player.on_change = tell_all_from_player
        self.player.start()
        try:
            try:
                await web.TCPSite(runner, host, port).start()
            except OSError as error:
                raise _cannot_listen(host, port, error) from None
            real_port = runner.addresses[0][1]
            self._cookie = f"fastcollide-{real_port}"  # cookies are those of a name, whatever the port
            is_ready(real_port)
            await stop.wait()
        finally:
            for browser in list(self._browsers):
                await browser.close(WSCloseCode.GOING_AWAY, "the program has ended")
            await runner.cleanup()
            await loop.run_in_executor(None, self.player.stop)

    @web.middleware
    async def _guard(self, request: web.Request, handler: Callable[[web.Request], Any]) -> web.StreamResponse:
        try:
            response = await self._answer(request, handler)
        except web.HTTPException as other_answer:
            other_answer.headers.update(_HEADERS)
            raise
        if not response.prepared:
            response.headers.update(_HEADERS)
        return response

    async def _answer(self, request: web.Request, handler: Callable[[web.Request], Any]) -> web.StreamResponse:
        host = request.headers.get("Host")
        if not self.access.allows_host(host):
            raise web.HTTPForbidden(text="This server has another name: open the address that fastcollide shows.\n")
        if not self.access.allows_origin(request.headers.get("Origin"), host):
            raise web.HTTPForbidden(text="Pages of other sites cannot use this server.\n")
        given = request.query.get("token")
        if self.access.allows_token(given):
            if request.path == "/":  # from here on the cookie has it, and the address bar has not
                to_page = web.HTTPSeeOther("/")
                to_page.set_cookie(self._cookie, self.access.token, httponly=True, samesite="Strict", path="/")
                raise to_page
        elif not self.access.allows_token(request.cookies.get(self._cookie)):
            raise web.HTTPForbidden(text="No or another token: open the address that fastcollide shows.\n")
        answer: web.StreamResponse = await handler(request)
        return answer

    async def _file(self, request: web.Request) -> web.Response:
        found = self._files.get(request.match_info["name"] or "index.html")
        if found is None:
            raise web.HTTPNotFound(text="There is no such file.\n")
        content, media_type = found
        return web.Response(body=content, content_type=media_type, charset="utf-8")

    async def _watch(self, request: web.Request) -> web.StreamResponse:
        if len(self._browsers) >= MOST_BROWSERS:
            raise web.HTTPServiceUnavailable(text=f"{MOST_BROWSERS} browsers are watching already.\n")
        # Float32 of moving spheres cannot be packed: compression would cost more than it saves.
        socket = web.WebSocketResponse(max_msg_size=LARGEST_MESSAGE, compress=False, heartbeat=30.0)
        browser = _Browser(socket, self.player)
        self._browsers.add(browser)
        self._count()
        try:
            await socket.prepare(request)
            await browser.serve()
        finally:
            self._browsers.discard(browser)
            self._count()
        return socket

    def _count(self) -> None:
        self.player.watchers = len(self._browsers)
        self.player.order(self.player.wake)


class _Browser:
    """One browser: what it has been told, what it wants to see."""

    def __init__(self, socket: web.WebSocketResponse, player: Player) -> None:
        self.news = asyncio.Event()
        self._socket = socket
        self._player = player
        self._loop = asyncio.get_running_loop()
        self._color: ViewColor = "speed"
        self._selected: int | None = None
        self._pictures_sent = 0
        self._pictures_drawn = 0
        self._picture: tuple[int, ViewColor] | None = None  # the last one sent
        self._radii: object = None
        self._start: int | None = None
        self._status: Status | None = None
        self._energies: tuple[int, int] = (-1, 0)  # version, rows sent
        self._sphere: tuple[int | None, int] = (None, 0)  # the one told of, in which picture
        self._told = 0.0

    async def serve(self) -> None:
        """Listens and tells until the browser has gone."""
        self.news.set()
        telling = asyncio.create_task(self._tell_news())
        try:
            async for message in self._socket:
                # Who does not read complaints is not read any more either.
                if message.type == WSMsgType.TEXT:
                    await self._take(message.data)
                elif message.type == WSMsgType.BINARY:
                    await self._complain("message: found bytes; allowed: JSON as text")
        finally:
            telling.cancel()
            with suppress(asyncio.CancelledError, ConnectionError):
                await telling

    async def close(self, code: WSCloseCode, reason: str) -> None:
        """Ends the connection."""
        with suppress(ConnectionError):
            await self._socket.close(code=code, message=reason.encode())

    # --- From the browser ---

    async def _take(self, text: str) -> None:
        try:
            self._obey(read_message(text))
        except InvalidMessage as error:
            await self._complain(str(error))

    def _obey(self, message: Message) -> None:
        player = self._player
        match message:
            case Acknowledge():
                self._pictures_drawn = min(self._pictures_sent, self._pictures_drawn + 1)
                self.news.set()
            case ColorBy():
                self._color = message.by
                self.news.set()
            case Select():
                if message.id is not None and message.id >= len(player.shown.moment):
                    raise InvalidMessage(f"id: found {message.id}; allowed: 0 to {len(player.shown.moment) - 1}")
                self._selected = message.id
                self._sphere = (None, 0)
                self.news.set()
            case Seek():
                player.order(lambda: player.seek(message.index), self._complain_from_player)
            case SetSpeed():
                player.order(lambda: player.set_speed(message.factor), self._complain_from_player)
            case Conditions():
                player.order(lambda: player.change(message), self._complain_from_player)
            case Simple():
                player.order(getattr(player, message.type), self._complain_from_player)

    def _complain_from_player(self, text: str) -> None:
        with suppress(RuntimeError):  # the loop has ended
            asyncio.run_coroutine_threadsafe(self._complain(text), self._loop)

    async def _complain(self, text: str) -> None:
        await self._send({"type": "error", "message": text})

    # --- To the browser ---

    async def _tell_news(self) -> None:
        status = self._player.status
        while True:
            with suppress(asyncio.TimeoutError):
                # While it plays, what was held back is told in its turn.
                await asyncio.wait_for(self.news.wait(), SECONDS_BETWEEN_NEWS if status.is_playing else None)
            self.news.clear()
            shown, status = self._player.shown, self._player.status
            try:
                await self._tell_status(status, shown)
                await self._tell_picture(shown)
                if self._loop.time() - self._told >= SECONDS_BETWEEN_NEWS or not status.is_playing:
                    self._told = self._loop.time()
                    await self._tell_energies()
                    await self._tell_sphere(shown)
            except ConnectionError:
                return
            except (ValueError, RuntimeError, MemoryError, OSError) as error:
                await self._complain(str(error))

    async def _tell_status(self, status: Status, shown: Shown) -> None:
        if status.start != self._start:
            self._start = status.start
            self._radii = self._picture = None
            await self._send(_hello(self._player, shown))
        if status is not self._status:
            self._status = status
            await self._send(
                {
                    "type": "status",
                    "playing": status.is_playing,
                    "speed": status.speed,
                    "rate": status.rate,
                    "conditions": status.conditions,
                    "state_hash": status.state_hash,
                    "fault": status.fault,
                }
            )

    async def _tell_picture(self, shown: Shown) -> None:
        if self._picture == (shown.number, self._color):
            return
        if self._pictures_sent - self._pictures_drawn >= PICTURES_AHEAD:
            return
        color = self._color
        if color == "contacts":  # a search
            values = await self._loop.run_in_executor(None, shown.moment.values, color)
        else:
            values = shown.moment.values(color)
        with_radii = shown.moment.radii is not self._radii
        self._radii = shown.moment.radii
        self._picture = (shown.number, color)
        self._pictures_sent += 1
        await self._socket.send_bytes(
            pack_picture(shown.moment, shown.index, shown.moments, values, with_radii=with_radii)
        )

    async def _tell_energies(self) -> None:
        energies = self._player.run.energies
        version, sent = self._energies
        if version != energies.version:
            sent = 0
        rows = energies.since(sent)
        if version == energies.version and not rows:
            return
        self._energies = (energies.version, sent + len(rows))
        await self._send({"type": "energies", "from": sent, "rows": rows})

    async def _tell_sphere(self, shown: Shown) -> None:
        sphere = self._selected
        if sphere is None or self._sphere == (sphere, shown.number) or sphere >= len(shown.moment):
            return
        self._sphere = (sphere, shown.number)
        moment = shown.moment
        touching = await self._loop.run_in_executor(None, moment.touching, sphere)
        await self._send(
            {
                "type": "sphere",
                "id": sphere,
                "position": moment.positions[sphere].tolist(),
                "velocity": moment.velocities[sphere].tolist(),
                "speed": float(moment.speeds[sphere]),
                "radius": float(moment.radii[sphere]),
                "contacts": touching,
                **self._player.run.sphere(sphere, moment),
            }
        )

    async def _send(self, message: dict[str, Any]) -> None:
        with suppress(ConnectionError):
            await self._socket.send_str(json.dumps(message, allow_nan=False))


def _hello(player: Player, shown: Shown) -> dict[str, Any]:
    """What a browser must know before the first picture."""
    run, moment = player.run, shown.moment
    values = {"speed": moment.speeds, "radius": moment.radii, "id": np.arange(len(moment), dtype=np.float32)}
    return {
        "type": "hello",
        "version": fc.__version__,
        "kind": run.kind,
        "title": run.title,
        "device": run.device,
        "spheres": len(moment),
        "lower": run.box.bounds[0],
        "upper": run.box.bounds[1],
        "boundary": run.box.boundary,
        "fps": run.fps,
        # As in pictures and videos, but for contacts: as many equal spheres can touch one.
        "ranges": {
            **{name: Renderer(run.box.bounds, color_by=name).choose_color_range(values[name]) for name in values},
            "contacts": (0.0, 12.0),
        },
        "colors": color_table("ember").ravel().tolist(),
    }


def _cannot_listen(host: str, port: int, error: OSError) -> ViewError:
    if error.errno == errno.EADDRINUSE:
        return ViewError(f"port: found {port}, which another program uses; allowed: a free one, or 0 to take any")
    if error.errno in (errno.EACCES, errno.EPERM):
        return ViewError(f"port: found {port}, which this account may not use; allowed: 1024 to 65535, or 0")
    return ViewError(f"host: found {host} ({error.strerror or error}); allowed: an address of this machine")
