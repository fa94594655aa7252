"""Plots of a ledger and the page about a run."""

import re
import shlex
import sys
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import fastcollide as fc
import numpy as np
import pytest
from fastcollide import cli
from fastcollide.run import create_world, simulate
from fastcollide.settings import RunSettings
from fastcollide.source import source_of
from PIL import Image

pytestmark = pytest.mark.usefixtures("folder")

matplotlib = pytest.importorskip("matplotlib")
from fastcollide.plots import PANELS, plot_ledger  # noqa: E402

RUN = [
    "run",
    "--particles",
    "60",
    "--frames",
    "40",
    "--no-video",
    "--threads",
    "1",
    "--width",
    "320",
    "--height",
    "180",
]
CROWDED = ["--bounds", "-1.5", "-1.5", "0", "1.5", "1.5", "2.5", "--friction", "0.3"]


@pytest.fixture
def ledger(program):
    """The ledger of a small crowded run with friction: no column of it is zero."""
    program(*RUN, *CROWDED, "--ledger-every", "2")
    return fc.read_ledger("output")


def test_each_column_is_a_curve_against_time(ledger):
    curves = [line for axis in plot_ledger(ledger).axes for line in axis.lines]

    for name in set(ledger) - {"frame", "time_s"}:
        drawn = [line for line in curves if np.array_equal(line.get_ydata(), ledger[name])]
        assert drawn, name
        for line in drawn:
            assert np.array_equal(line.get_xdata(), ledger["time_s"])


def test_axes_have_titles_units_and_legends(ledger):
    figure = plot_ledger(ledger, "my run")
    figure.canvas.draw()

    assert figure.get_suptitle() == "my run"
    assert [axis.get_xlabel() for axis in figure.axes[-2:]] == ["Time (s)"] * 2
    for axis, unit in zip(figure.axes, ["J", "J", "N·s", "J·s", "", "m", "%"], strict=True):
        assert axis.get_title(loc="left")
        labels = [label.get_text() for label in axis.get_yticklabels() if label.get_text()]
        assert all(label.endswith(unit) for label in labels)
        if len(axis.lines) > 1:
            assert axis.get_legend() is not None
            assert len({line.get_color() for line in axis.lines}) == len(axis.lines)


@pytest.mark.parametrize(("count", "widths"), [(1, "w"), (2, "hh"), (3, "whh"), (4, "hhhh"), (7, "whhhhhh")])
def test_of_an_odd_number_of_panels_the_first_is_wide(ledger, count, widths):
    figure = plot_ledger(ledger, panels=PANELS[:count])
    figure.canvas.draw()
    boxes = [axis.get_position() for axis in figure.axes]

    assert ["w" if box.width > 0.6 else "h" for box in boxes] == list(widths)
    lowest = min(box.y0 for box in boxes)
    for axis, box in zip(figure.axes, boxes, strict=True):
        assert bool(axis.get_xlabel()) == (box.y0 == lowest)
        shows_times = any(label.get_text() for label in axis.get_xticklabels())
        assert shows_times == (box.y0 == lowest or box.width > 0.6)


def test_energy_of_motion_is_logarithmic_where_it_spans_orders_of_magnitude(ledger):
    flat = dict(ledger, kinetic_J=np.full(21, 5.0), rotational_J=np.zeros(21))
    steep = dict(ledger, kinetic_J=10.0 ** -np.arange(21))

    assert plot_ledger(flat).axes[1].get_yscale() == "linear"
    assert plot_ledger(steep).axes[1].get_yscale() == "log"


def test_rotation_is_drawn_only_where_there_is_some(ledger):
    still = dict(ledger, rotational_J=np.zeros(21))

    assert [len(axis.lines) for axis in plot_ledger(ledger).axes][:2] == [4, 2]
    assert [len(axis.lines) for axis in plot_ledger(still).axes][:2] == [3, 1]


def test_a_single_row_can_be_seen(ledger):
    one = {name: values[:1] for name, values in ledger.items()}

    assert all(line.get_marker() == "o" for axis in plot_ledger(one).axes for line in axis.lines)


@pytest.mark.parametrize(("name", "start"), [("a.png", b"\x89PNG"), ("a.svg", b"<?xml"), ("a.PDF", b"%PDF")])
@pytest.mark.usefixtures("ledger")
def test_the_ending_decides_the_format(program, folder, name, start):
    code, output, errors = program("plot", "output", "--output", name)

    assert (code, errors) == (0, "")
    assert (folder / name).read_bytes().startswith(start)
    assert str(folder / name) in output
    assert not list(folder.rglob("*.part"))


@pytest.mark.usefixtures("ledger")
def test_without_a_name_it_goes_beside_the_ledger(program, folder):
    code, _, _ = program("plot", "output")

    assert code == 0
    assert np.asarray(Image.open(folder / "output" / "ledger.png")).std() > 10


@pytest.mark.usefixtures("ledger")
def test_the_same_ledger_gives_the_same_file(program, folder):
    for ending in ("png", "svg", "pdf"):
        for name in ("one", "two"):
            program("plot", "output", "--output", f"{name}.{ending}")
        assert (folder / f"one.{ending}").read_bytes() == (folder / f"two.{ending}").read_bytes()


def test_what_cannot_be_plotted(program, folder, ledger):
    (folder / "empty").mkdir()
    (folder / "fresh").mkdir()
    (folder / "fresh" / "ledger.csv").write_text(",".join(ledger) + "\n")

    assert program("plot", "output", "--output", "a.gif")[::2] == (
        2,
        "fastcollide: output: found a.gif; allowed: a path that ends in .png or .svg or .pdf\n",
    )
    code, _, errors = program("plot", "empty")
    assert code == 1
    assert "empty/ledger.csv: No such file" in errors
    code, _, errors = program("plot", "fresh")
    assert code == 1
    assert "no row yet" in errors
    assert program("plot", "nowhere")[0] == 2
    assert not list(folder.rglob("*.png"))


@pytest.mark.parametrize(
    ("library", "arguments"),
    [
        ("matplotlib.figure", ["plot", "output"]),
        ("matplotlib.figure", [*RUN, "--report"]),
        ("jinja2", [*RUN, "--report"]),
    ],
)
def test_a_missing_library_is_named_with_the_command_that_gets_it(program, folder, monkeypatch, library, arguments):
    program(*RUN, "--export-every", "0")
    before = sorted(folder.rglob("*"))
    content = (folder / "output" / "ledger.csv").read_bytes()
    monkeypatch.setitem(sys.modules, library, None)

    code, _, errors = program(*arguments, *([] if arguments[0] == "plot" else ["--ledger-every", "3"]))

    assert code == 1
    assert errors.count("\n") == 1
    assert 'pip install "fastcollide[plot]"' in errors
    assert sorted(folder.rglob("*")) == before
    assert (folder / "output" / "ledger.csv").read_bytes() == content


class Page(HTMLParser):
    """What a page shows and what it refers to."""

    def __init__(self, text):
        super().__init__()
        self.text, self.references = [], []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.references += [value for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]
        assert tag not in ("script", "iframe", "object")

    def handle_data(self, data):
        self.text.append(data.strip())


@pytest.fixture
def page(program, folder):
    pytest.importorskip("jinja2")
    code, output, errors = program(*RUN, *CROWDED, "--report", "--gravity", "-3.7")
    assert (code, errors) == (0, "")
    assert str(folder / "output" / "report.html") in output
    return output, Page((folder / "output" / "report.html").read_text(encoding="utf-8"))


def test_the_page_needs_nothing_beside_it(page, folder):
    _, shown = page

    assert len(shown.references) == 3
    assert all(reference.startswith("data:image/") for reference in shown.references)
    assert "http" not in re.sub(r'base64,[^"]*', "", (folder / "output" / "report.html").read_text(encoding="utf-8"))


def test_the_page_tells_state_settings_device_and_figures(page):
    output, shown = page
    values = {line[:16].strip(): line[16:] for line in output.splitlines()}

    assert values["state hash"] in shown.text
    assert any(text.startswith(values["device"]) for text in shown.text)
    assert shown.text[shown.text.index("gravity") + 1] == "-3.7 m/s²"
    assert shown.text[shown.text.index("particles") + 1] == "60"
    assert shown.text[shown.text.index("cell size") + 1] == "the largest diameter"
    ledger = fc.read_ledger("output")
    start, overlap = ledger["total_J"][0], ledger["max_overlap_m"][-1]
    assert shown.text[shown.text.index("Energy at the start") + 1] == f"{start:.6g} J"
    assert shown.text[shown.text.index("Largest overlap") + 1] == f"{overlap:.4g} m"
    assert shown.text[shown.text.index("Mean overlap") + 1] == values["mean overlap"]


def test_the_pictures_are_those_of_start_and_end(page):
    _, shown = page
    first, last = (np.asarray(Image.open(BytesIO(b64decode(url.split(",")[1])))) for url in shown.references[:2])

    assert first.shape == last.shape == (180, 320, 3)
    assert not np.array_equal(first, last)
    assert "0.00 s, after 0 frames" in shown.text
    assert "0.67 s, after 40 frames" in shown.text


def test_the_command_of_the_page_repeats_the_run(page, program):
    output, shown = page
    (command,) = [text for text in shown.text if text.startswith("fastcollide run")]

    _, again, _ = program(*shlex.split(command)[1:])

    hashes = [re.search(r"state hash +(\w+)", text)[1] for text in (output, again)]
    assert hashes[0] == hashes[1]


def test_the_command_has_every_digit_and_only_what_is_chosen():
    settings = replace(RunSettings(), gravity=-1.0 / 3, radius=(0.1, 0.123456789), make_video=False, output=Path("a b"))

    command = source_of(settings).command

    assert command == (
        "fastcollide run --gravity -0.3333333333333333 --radius 0.1 0.123456789 --output 'a b' --no-video"
    )


def test_a_report_needs_a_ledger(program, folder):
    code, _, errors = program(*RUN, "--report", "--ledger-every", "0")

    assert code == 2
    assert "report: found 1 together with ledger-every 0" in errors
    assert list(folder.iterdir()) == []


def test_a_report_does_not_change_the_state():
    settings = RunSettings(particles=60, frames=40, make_video=False, export_every=0, threads=1)
    plain = simulate(create_world(settings), settings)
    reported = cli.main(["run", "--particles", "60", "--frames", "40", "--no-video", "--report"])

    assert reported == 0
    text = (settings.output / "report.html").read_text(encoding="utf-8")
    assert f"{plain.state_hash:016x}" in text
