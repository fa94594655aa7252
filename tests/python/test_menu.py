"""The menu, in a pseudo-terminal as a person would use it."""

import sys

import pytest

pexpect = pytest.importorskip("pexpect")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals of this kind")

CHOICE = r"Choice \[1\]: "


@pytest.fixture
def menu(tmp_path, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    terminal = pexpect.spawn(
        sys.executable,
        ["-m", "fastcollide.cli"],
        cwd=tmp_path,
        encoding="utf-8",
        timeout=30,
        dimensions=(40, 120),
    )
    terminal.expect(CHOICE)
    yield terminal
    terminal.close(force=True)


def answer(terminal, question, text):
    terminal.expect(question)
    terminal.sendline(text)


def ended(terminal):
    """The exit code, after the program has ended by itself."""
    terminal.expect(pexpect.EOF)
    terminal.close()
    return terminal.exitstatus


def test_it_lists_what_it_can_do(menu):
    for title in (
        "Quick demo: 10,000 spheres, 5 s",
        "own parameters",
        "Performance test",
        "Render",
        "Live view",
        "Device",
        "Quit",
    ):
        assert title in menu.before


def test_quit(menu):
    menu.sendline("q")

    assert ended(menu) == 0


@pytest.mark.parametrize("leave", ["sendeof", "sendintr"])
def test_leaving_at_the_choice(menu, leave):
    getattr(menu, leave)()

    assert ended(menu) == 0
    assert "Traceback" not in menu.before


@pytest.mark.parametrize("leave", ["sendeof", "sendintr"])
def test_leaving_at_a_parameter(menu, tmp_path, leave):
    menu.sendline("2")
    answer(menu, r"\[y/N\]: ", "n")
    menu.expect(r"Particles \[2000\]: ")
    getattr(menu, leave)()

    assert ended(menu) == 0
    assert "Traceback" not in menu.before
    assert list(tmp_path.iterdir()) == []


def test_a_choice_that_is_none_is_asked_again(menu):
    menu.sendline("7")
    menu.expect("Error: '7' is not one of")
    answer(menu, CHOICE, "q")

    assert ended(menu) == 0


def test_own_parameters_show_range_and_default_and_ask_again(menu, tmp_path):
    menu.sendline("2")
    answer(menu, r"\[y/N\]: ", "")
    menu.expect("from 1 to 100,000,000")
    answer(menu, r"Particles \[2000\]: ", "0")
    menu.expect("Error: particles: found 0; allowed: a whole number from 1 to 100,000,000")
    answer(menu, r"Particles \[2000\]: ", "many")
    menu.expect("Error: particles: found 'many'")
    answer(menu, r"Particles \[2000\]: ", "20")
    answer(menu, r"Frames \[600\]: ", "6")
    answer(menu, r"Fps \[60\]: ", "")
    answer(menu, r"Export every \[2\]: ", "3")
    answer(menu, r"Gravity \[-9.8\]: ", "-1.6")
    answer(menu, r"Damping \[0.999\]: ", "")
    answer(menu, r"Floor restitution \[0.6\]: ", "0.5")
    answer(menu, r"Output \[output\]: ", "moon")
    answer(menu, r"Make video \[1\]: ", "no")
    menu.expect("spheres +20, for 6 frames")
    menu.expect("6/6")
    menu.expect("state hash +[0-9a-f]{16}\r\n")
    answer(menu, CHOICE, "q")

    assert ended(menu) == 0
    names = sorted(path.name for path in tmp_path.rglob("*"))
    assert names == ["frame_00000003.txt", "frame_00000006.txt", "ledger.csv", "moon", "run.json"]


def test_all_parameters_with_answers_that_contradict(menu, tmp_path):
    menu.sendline("2")
    answer(menu, r"\[y/N\]: ", "y")
    answers = {
        "Particles": "5",
        "Frames": "4",
        "Export every": "0",
        "Ledger every": "0",
        "Make video": "0",
        "Radius": "3 12",
    }
    while True:
        menu.expect([r"\n([A-Z][a-z ]+) \[[^\]\n]*\]: ", r"(Error: radius: found 12; allowed: at most 10 m)"])
        label = menu.match[1]
        if label.startswith("Error"):
            break
        menu.sendline(answers.get(label, ""))
    answer(menu, r"Radius \[0.05 0.4\]: ", "0.1 0.2")
    menu.expect("state hash")
    answer(menu, CHOICE, "q")

    assert ended(menu) == 0
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_stops_the_demo_and_returns_to_the_menu(menu, tmp_path):
    pytest.importorskip("av")
    menu.sendline("1")
    menu.expect(r"\b[1-9]\d*/300")
    menu.sendintr()
    menu.expect(r"stopped by Ctrl-C after \d+ of 300 frames")
    answer(menu, CHOICE, "q")

    assert ended(menu) == 0
    assert (tmp_path / "video.mp4").is_file()
    assert not list(tmp_path.rglob("*.part"))


def test_render_asks_for_a_folder_that_is_there(menu, tmp_path):
    menu.sendline("4")
    answer(menu, r"Folder \[output\]: ", "nowhere")
    menu.expect("Error: Directory 'nowhere' does not exist")
    (tmp_path / "empty").mkdir()
    answer(menu, r"Folder \[output\]: ", "empty")
    answer(menu, r"Video \[video.mp4\]: ", "")
    menu.expect("fastcollide: empty: found no frame file")
    answer(menu, CHOICE, "q")

    assert ended(menu) == 0


def test_device_information(menu):
    menu.sendline("6")
    menu.expect(r"cpu +\S+")
    answer(menu, CHOICE, "q")

    assert ended(menu) == 0


def test_live_view_ends_at_ctrl_c_and_comes_back(menu):
    menu.sendline("5")
    answer(menu, r"Scene or finished run \[quick demo\]: ", "nothing/here")
    menu.expect("does not exist")
    answer(menu, r"Scene or finished run \[quick demo\]: ", "")
    menu.expect(r"http://127\.0\.0\.1:\d+/\?token=")
    menu.expect("Ctrl-C")
    menu.sendintr()
    menu.expect(CHOICE)
