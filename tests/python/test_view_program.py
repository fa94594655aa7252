"""`fastcollide view` at the command line: what it shows, how it ends, what it refuses."""

import re
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from contextlib import contextmanager
from pathlib import Path

import pytest
from fastcollide.frames import frame_path, write_frame
from serve_view import live_run

ROOT = Path(__file__).parent.parent.parent
PAGE = (ROOT / "docs" / "view.md").read_text(encoding="utf-8")
SCENE = """
title = "Two"
[[spheres]]
kind = "given"
position = [[0, 0, 5], [1, 1, 9]]
radius = 0.3
"""


@pytest.fixture
def scene(folder):
    path = folder / "two.toml"
    path.write_text(SCENE)
    return path


@pytest.fixture
def frames(folder):
    """A folder with two frame files."""
    world = live_run(20).world
    for _ in range(2):
        world.step(1)
        write_frame(frame_path(folder, world.frame), world.frame, world.time, world.positions, world.radii)
    return folder


@contextmanager
def viewing(*arguments):
    """The program, once it shows its address; yields it and the address."""
    command = [sys.executable, "-u", "-m", "fastcollide.cli", "view", *map(str, arguments), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        try:
            shown = ""
            for line in program.stdout:
                shown += line
                if "Ctrl-C" in line:
                    break
            address = re.search(r"http://\S+", shown)
            assert address, shown + program.stderr.read()
            yield program, address[0], shown
        finally:
            program.kill()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_serves_until_it_is_told_to_end(scene, number):
    with viewing(scene, "--port", 0) as (program, address, shown):
        assert "Two, on cpu" in shown
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(address.partition("?")[0])
        program.send_signal(number)
        assert program.wait(30) == 0
        assert program.stderr.read() == ""


def test_a_folder(frames):
    with viewing(frames, "--port", 0) as (_, _, shown):
        assert frames.name in shown


def test_a_trajectory_file(folder, program):
    words = ["--particles", 5, "--frames", 2, "--no-video", "--device", "cpu", "--trajectory", "run.gsd"]
    assert program("run", *words)[0] == 0
    with viewing("run.gsd", "--port", 0) as (_, _, shown):
        assert "run.gsd" in shown


@pytest.mark.parametrize("command", re.findall(r"^fastcollide view (.+)$", PAGE, flags=re.MULTILINE))
def test_the_commands_of_the_page_about_it(frames, command):
    words = command.replace("scenes/", f"{ROOT}/scenes/").replace("FOLDER", str(frames)).split()
    with viewing(*words, "--port", 0) as (program, _, _):
        program.send_signal(signal.SIGINT)
        assert program.wait(30) == 0


@pytest.mark.parametrize("name", re.findall(r"(?:\]\(|src=\")([^)\"#]+)", PAGE))
def test_what_the_page_about_it_shows_is_there(name):
    assert (ROOT / "docs" / name).stat().st_size < 300_000


def test_other_machines_are_warned_of(scene):
    with viewing(scene, "--port", 0, "--host", "0.0.0.0") as (_, address, shown):
        assert "whoever has this address can watch and steer" in shown
        assert f"//{socket.gethostname()}:" in address


def test_a_port_in_use(scene, program):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        code, _, error = program("view", scene, "--port", port, "--no-browser")
    assert code == 1
    assert f"port: found {port}, which another program uses; allowed: a free one, or 0 to take any" in error


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("two.toml", "--bounds", 0, 0, 0, 1, 1, 1), "bounds: found them without a finished run"),
        ((".", "--set", "world.drag=1"), "set: found it beside a finished run"),
        ((".", "--device", "cpu"), "device: found it beside a finished run"),
        (("--set", "world.drag=1"), "set: found it without a scene"),
        (("two.toml", "--set", "world.drag=-1"), "world.drag: found -1"),
        (("nowhere",), "nowhere"),
        (("--port", 70000), "70000"),
    ],
)
def test_what_has_no_meaning_is_refused(scene, program, arguments, message):
    # What is not refused ends at an address that no machine has.
    code, _, error = program("view", *arguments, "--no-browser", "--host", "192.0.2.1")
    assert (code, message in error) == (2, True), error


def test_a_folder_without_frames(folder, program):
    code, _, error = program("view", ".", "--no-browser")
    assert code == 1
    assert "found no frame file" in error


def test_without_aiohttp(scene, program, monkeypatch):
    monkeypatch.setitem(sys.modules, "fastcollide.view.server", None)
    code, _, error = program("view", scene)
    assert code == 1
    assert 'get it with: pip install "fastcollide[view]"' in error
