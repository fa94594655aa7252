"""The server of the live page as a browser, or an attacker, meets it."""

import asyncio
import json
import socket

import aiohttp
import fastcollide as fc
import numpy as np
import pytest
from fastcollide.errors import ViewError
from fastcollide.view.access import Access
from fastcollide.view.live import LiveRun
from fastcollide.view.messages import HAS_RADII, HAS_VALUES, HEADER, LARGEST_MESSAGE
from fastcollide.view.player import Player
from fastcollide.view.server import MOST_BROWSERS, ViewServer, page_files
from serve_view import live_run, serving
from yarl import URL

PATIENCE = 60  # seconds until a test gives up


@pytest.fixture(scope="module")
def served():
    with serving(live_run()) as served:
        yield served


def in_session(work):
    """Runs work(session) with no cookies from before."""

    async def run():
        async with aiohttp.ClientSession() as session:
            return await asyncio.wait_for(work(session), PATIENCE)

    return asyncio.run(run())


def get(served, path, *, token=True, **headers):
    """Status, headers and body of an answer. The path goes out as it is."""

    async def work(session):
        query = f"?token={served.token}" if token is True else f"?token={token}" if token else ""
        url = URL(served.address + path + query, encoded=True)
        async with session.get(url, headers=headers, allow_redirects=False) as response:
            return response.status, response.headers, await response.text()

    return in_session(work)


class Browser:
    """A connection that keeps what it is told."""

    def __init__(self, socket):
        self.socket = socket

    async def send(self, **message):
        await self.socket.send_str(json.dumps(message))

    async def receive(self, kind, condition=lambda message: True):
        """The next message of this type; a picture as a dictionary. Pictures are acknowledged."""
        while True:
            message = await self.socket.receive()
            assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY), message
            if message.type == aiohttp.WSMsgType.BINARY:
                await self.send(type="ack")
                _, frame, index, moments, count, follows, time = HEADER.unpack_from(message.data)
                found = {
                    "type": "picture",
                    "frame": frame,
                    "index": index,
                    "moments": moments,
                    "count": count,
                    "follows": follows,
                    "time": time,
                    "bytes": len(message.data),
                }
            else:
                found = json.loads(message.data)
            if found["type"] == kind and condition(found):
                return found


def watching(served, work, **headers):
    """Runs work(browser) with a connection."""

    async def run(session):
        async with session.ws_connect(
            f"{served.address}/socket?token={served.token}", headers=headers, max_msg_size=0
        ) as socket:
            return await work(Browser(socket))

    return in_session(run)


# --- Files ---


def test_the_page_needs_nothing_from_elsewhere():
    for name, (content, _) in page_files().items():
        text = content.decode().replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in text, name
        assert "https://" not in text, name
        assert "//cdn" not in text, name


def test_the_page_and_its_files(served):
    for name, (content, media_type) in page_files().items():
        status, headers, body = get(served, f"/{name}")
        assert (status, body) == (200, content.decode())
        assert headers["Content-Type"].startswith(media_type)
    assert {"index.html", "main.js", "style.css", "favicon.svg"} <= set(page_files())


@pytest.mark.parametrize("path", ["/main.js", "/nothing", "/socket"])
def test_every_answer_forbids_foreign_code_and_frames(served, path):
    _, headers, _ = get(served, path)
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "script-src 'self'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert headers["X-Content-Type-Options"] == "nosniff"


@pytest.mark.parametrize(
    "path",
    [
        "/../server.py",
        "/..%2fserver.py",
        "/%2e%2e/server.py",
        "/page/../../../__init__.py",
        "//etc/passwd",
        "/%2fetc%2fpasswd",
        "/..%5cserver.py",
        "/main.js%00",
        "/main.js/",
        "/.",
        "/" + "a" * 4000,
    ],
)
def test_paths_that_lead_elsewhere(served, path):
    status, _, body = get(served, path)
    assert status == 404
    assert "import" not in body
    assert "root:" not in body


def test_only_get_is_answered(served):
    async def work(session):
        async with session.post(f"{served.address}/main.js?token={served.token}", data=b"x") as response:
            return response.status

    assert in_session(work) == 405


# --- Who is let in ---


@pytest.mark.parametrize("token", [None, "wrong"])
@pytest.mark.parametrize("path", ["/", "/main.js", "/socket", "/nothing"])
def test_without_the_token_nothing_is_answered(served, path, token):
    status, headers, body = get(served, path, token=token)
    assert status == 403
    assert "open the address that fastcollide shows" in body
    assert "Content-Security-Policy" in headers
    assert "Set-Cookie" not in headers


def test_the_token_moves_into_a_cookie(served):
    status, headers, _ = get(served, "/")
    assert (status, headers["Location"]) == (303, "/")
    cookie = headers["Set-Cookie"]
    assert served.token in cookie
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    status, _, body = get(served, "/", token=None, Cookie=cookie.partition(";")[0])
    assert (status, "<title>FastCollide</title>" in body) == (200, True)


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "192.168.0.1", "127.0.0.1.evil.example"])
@pytest.mark.parametrize("path", ["/", "/socket"])
def test_another_name_is_refused_even_with_the_token(served, path, host):
    status, _, body = get(served, path, Host=host)
    assert status == 403
    assert "another name" in body


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://localhost"])
@pytest.mark.parametrize("path", ["/", "/socket"])
def test_pages_of_other_sites_are_refused_even_with_the_token(served, path, origin):
    status, _, body = get(served, path, Origin=origin)
    assert status == 403
    assert "other sites" in body


def test_a_socket_of_another_site_is_never_opened(served):
    with pytest.raises(aiohttp.WSServerHandshakeError) as raised:
        watching(served, lambda browser: browser.receive("hello"), Origin="http://evil.example")
    assert raised.value.status == 403


def test_our_own_page_is_let_in(served):
    assert watching(served, lambda browser: browser.receive("hello"), Origin=served.address)["spheres"] == 200


# --- What is told ---


def test_a_browser_is_told_what_it_needs(served):
    async def work(browser):
        hello = await browser.receive("hello")
        status = await browser.receive("status")
        picture = await browser.receive("picture")
        energies = await browser.receive("energies")
        return hello, status, picture, energies

    hello, status, picture, energies = watching(served, work)
    assert (hello["kind"], hello["title"], hello["spheres"]) == ("live", "Test", 200)
    assert (hello["lower"], hello["upper"]) == ([-4, -4, 0], [4, 4, 8])
    assert len(hello["colors"]) == 768
    assert status["playing"] is False
    assert status["conditions"]["gravity"] == pytest.approx([0, 0, -9.8])
    assert status["state_hash"] == f"{served.player.run.world.state_hash():016x}"
    assert (picture["count"], picture["follows"]) == (200, HAS_RADII | HAS_VALUES)
    assert picture["bytes"] == HEADER.size + 200 * 4 * 5
    assert energies["rows"][0] == [0.0, *live_run().world.energy()]


def test_colours_that_the_browser_knows_are_not_sent(served):
    async def work(browser):
        await browser.receive("picture")
        pictures = []
        for by in ("radius", "contacts", "id"):
            await browser.send(type="color", by=by)
            pictures.append(await browser.receive("picture"))
        return pictures

    assert [picture["follows"] for picture in watching(served, work)] == [0, HAS_VALUES, 0]


def test_a_sphere_is_told_of():
    with serving(live_run()) as served:

        async def work(browser):
            await browser.send(type="select", id=7)
            return await browser.receive("sphere")

        sphere, world = watching(served, work), live_run().world
    assert sphere["id"] == 7
    assert sphere["position"] == world.positions[7].tolist()
    assert sphere["velocity"] == world.velocities[7].tolist()
    assert (sphere["radius"], sphere["mass"]) == (world.radii[7], world.masses[7])
    assert sphere["restitution"] == world.restitutions[7]
    contacts = world.contacts()
    touched = [*contacts.second[contacts.first == 7], *contacts.first[contacts.second == 7]]
    assert sphere["contacts"] == sorted(touched)


def test_a_sphere_that_turns_and_one_that_is_fixed():
    def create():
        world = fc.World(device="cpu", gravity=(0, 0, 0))
        spin = [(0, 0, 0), (1, 2, 3)]
        world.add(position=[(0, 0, 5), (3, 0, 5)], radius=0.5, mass=[np.inf, 1.0], spin=spin, friction=0.25)
        return world

    with serving(LiveRun(create, "Two", fps=60)) as served:

        async def work(browser):
            told = []
            for sphere in (0, 1):
                await browser.send(type="select", id=sphere)
                told.append(await browser.receive("sphere", lambda told, sphere=sphere: told["id"] == sphere))
            return told

        fixed, turning = watching(served, work)
    assert (fixed["mass"], fixed["spin"]) == ("fixed", [0, 0, 0])
    assert (turning["mass"], turning["spin"], turning["friction"]) == (1, [1, 2, 3], 0.25)


def test_a_browser_that_does_not_draw_gets_two_pictures_and_no_more():
    with serving(live_run(), is_playing=True) as served:

        async def work(session):
            url = f"{served.address}/socket?token={served.token}"
            async with session.ws_connect(url, max_msg_size=0) as socket:
                pictures = 0
                while served.player.run.world.frame < 60:
                    message = await socket.receive()  # the status comes twice a second all the same
                    pictures += message.type == aiohttp.WSMsgType.BINARY
                return pictures

        assert in_session(work) == 2


def test_energies_come_once_and_start_again_with_the_run():
    with serving(live_run()) as served:

        async def work(browser):
            told = [await browser.receive("energies")]
            for order in ("step", "step", "reset"):
                await browser.send(type=order)
                told.append(await browser.receive("energies"))
            return [(rows["from"], [row[0] for row in rows["rows"]]) for rows in told]

        assert watching(served, work) == [(0, [0.0]), (1, [1 / 60]), (2, [2 / 60]), (0, [0.0])]


def test_all_who_watch_see_the_same():
    with serving(live_run()) as served:

        async def work(session):
            url = f"{served.address}/socket?token={served.token}"
            async with session.ws_connect(url, max_msg_size=0) as one, session.ws_connect(url, max_msg_size=0) as two:
                one, two = Browser(one), Browser(two)
                for browser in (one, two):
                    await browser.receive("picture")
                await asyncio.sleep(0.5)  # the acknowledgements have come, and nothing is left to be told
                await one.send(type="step")
                await two.receive("picture", lambda picture: picture["frame"] == 1)
                await one.receive("picture", lambda picture: picture["frame"] == 1)
                await two.send(type="change", gravity=[0, 0, 2])
                status = await one.receive("status", lambda status: status["conditions"]["gravity"] == [0, 0, 2])
                return status["playing"]

        assert in_session(work) is False


# --- What a browser sends ---


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "null", '{"type": "shutdown"}', '{"type": "seek", "index": -1}', '{"type": "seek"}', "{" * 2000]
    + ['{"type": "change", "drag": -1}', '{"type": "select", "id": 100000}', '{"type": "speed", "factor": 1e999}'],
)
def test_a_malformed_message_is_answered_with_what_is_wrong(served, text):
    async def work(browser):
        await browser.socket.send_str(text)
        error = await browser.receive("error")
        await browser.send(type="step")  # the connection goes on
        await browser.receive("picture")
        return error["message"]

    assert ": " in watching(served, work)


def test_bytes_are_no_message(served):
    async def work(browser):
        await browser.socket.send_bytes(b"\0" * 100)
        return (await browser.receive("error"))["message"]

    assert watching(served, work) == "message: found bytes; allowed: JSON as text"


def test_a_message_too_long_ends_its_connection_and_no_other(served):
    async def work(browser):
        await browser.socket.send_str(" " * (LARGEST_MESSAGE + 1))
        while True:
            message = await browser.socket.receive()
            if message.type == aiohttp.WSMsgType.CLOSE:
                return message.data
            assert message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY)

    assert watching(served, work) == aiohttp.WSCloseCode.MESSAGE_TOO_BIG
    assert watching(served, lambda browser: browser.receive("hello"))["spheres"] == 200


def test_what_the_world_refuses_is_told():
    with serving(live_run(solver="reference")) as served:

        async def work(browser):
            await browser.send(type="change", friction=0.5)
            return (await browser.receive("error"))["message"]

        assert "the reference solver has no friction of spheres" in watching(served, work)


def test_one_browser_too_many_is_refused():
    with serving(live_run()) as served:

        async def work(session):
            url = f"{served.address}/socket?token={served.token}"
            sockets = [await session.ws_connect(url) for _ in range(MOST_BROWSERS)]
            with pytest.raises(aiohttp.WSServerHandshakeError) as raised:
                await session.ws_connect(url)
            for one in sockets:
                await one.close()
            return raised.value.status

        assert in_session(work) == 503


def test_a_browser_that_vanishes_leaves_the_others(served):
    async def work(browser):
        await browser.receive("picture")
        browser.socket._response.connection.transport.abort()  # no farewell

    watching(served, work)
    assert watching(served, lambda browser: browser.receive("hello"))["spheres"] == 200


# --- Where it listens ---


def test_a_port_in_use():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        server = ViewServer(Player(live_run()), Access("127.0.0.1"))
        with pytest.raises(ViewError, match=f"port: found {port}, which another program uses"):
            asyncio.run(server.run("127.0.0.1", port, lambda port: None, asyncio.Event()))


def test_an_address_of_another_machine():
    server = ViewServer(Player(live_run()), Access("192.0.2.1"))
    with pytest.raises(ViewError, match=r"host: found 192\.0\.2\.1 .*allowed: an address of this machine"):
        asyncio.run(server.run("192.0.2.1", 0, lambda port: None, asyncio.Event()))
