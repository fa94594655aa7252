"""One page about one run, in a single HTML file that needs nothing else: no network, no files beside it."""

from __future__ import annotations

import io
from base64 import b64encode
from collections.abc import Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import fastcollide as fc
from fastcollide.errors import MissingLibrary
from fastcollide.files import written_beside
from fastcollide.ledger import LEDGER_NAME, read_ledger
from fastcollide.pictures import draw, renderer_for
from fastcollide.plots import INSTALL, need_matplotlib, plot_ledger, render_plot
from fastcollide.run import RunSummary
from fastcollide.settings import SimulationSettings
from fastcollide.source import Source

if TYPE_CHECKING:
    from fastcollide.expectations import Outcome

REPORT_NAME = "report.html"


def need_report_libraries() -> None:
    """Raises MissingLibrary where a library for the page is not installed."""
    need_matplotlib()
    try:
        import jinja2  # noqa: F401
    except ImportError:
        raise MissingLibrary(f"--report needs Jinja2, which is not installed; get it with: {INSTALL}") from None


class Report:
    """The page of one run: made with the fresh world, written after its last frame.

    Raises MissingLibrary where a library that it needs is not installed.
    """

    def __init__(self, world: fc.World, settings: SimulationSettings, source: Source) -> None:
        need_report_libraries()
        self.path = settings.output / REPORT_NAME
        self._world = world
        self._settings = settings
        self._source = source
        self._renderer = renderer_for(world, settings)
        self._pictures = [self._draw()]

    def write(self, summary: RunSummary, outcomes: Sequence[Outcome] = ()) -> None:
        """Writes the page into the output folder; it is whole or not there at all. outcomes: what was expected."""
        import jinja2

        self._pictures.append(self._draw())
        ledger = read_ledger(self._settings.output)
        folder = jinja2.FileSystemLoader(Path(__file__).parent / "templates")
        template = jinja2.Environment(loader=folder, autoescape=True).get_template("report.html.jinja")
        build = fc.build_info()
        page = template.render(
            title=self._source.title,
            subtitle=f"{self._world.device} ({self._world.device_name}), "
            f"{datetime.now(timezone.utc):%Y-%m-%d %H:%M} UTC",
            notes=f"Stopped after {summary.frames:,} of {self._settings.frames:,} frames."
            if summary.stopped_early
            else "",
            summary=_figures(summary, float(ledger["total_J"][0])),
            outcomes=outcomes,
            pictures=self._pictures,
            plot=_text(render_plot(plot_ledger(ledger), "svg")),
            rows=f"{summary.ledger_rows:,}",
            ledger_name=LEDGER_NAME,
            command=self._source.command,
            settings=self._source.settings,
            build=f"FastCollide {build.version}, {build.compiler}, "
            + (f"CUDA {build.cuda}" if build.cuda else "without CUDA"),
        )
        with written_beside(self.path) as unfinished:
            unfinished.write_text(page, encoding="utf-8")

    def _draw(self) -> tuple[str, str]:
        world = self._world
        return f"{world.time:.2f} s, after {world.frame:,} frames", _text(_png(draw(self._renderer, world)))


def _figures(summary: RunSummary, start: float) -> list[tuple[str, str]]:
    """The summary table: label and value."""
    energy = summary.energy
    return [
        ("State hash", f"{summary.state_hash:016x}"),
        ("Frames", f"{summary.frames:,}"),
        ("Speed", f"{summary.frames_per_second:,.1f} frames/s"),
        ("Time", f"{summary.seconds:.2f} s"),
        ("Time in the engine", f"{summary.step_seconds:.2f} s"),
        ("Contacts", f"{summary.contacts:,}"),
        ("Largest overlap", f"{summary.max_overlap:.4g} m"),
        ("Mean overlap", f"{100 * summary.mean_overlap:.4g} % of the smaller radius"),
        ("Energy at the start", f"{start:.6g} J"),
        ("Energy at the end", f"{energy.total:.6g} J"),
        ("Energy of translation", f"{energy.kinetic:.6g} J"),
        ("Energy of rotation", f"{energy.rotational:.6g} J"),
        ("Energy of height", f"{energy.potential:.6g} J"),
    ]


def _png(picture: NDArray[np.uint8]) -> bytes:
    content = io.BytesIO()
    Image.fromarray(picture).save(content, format="PNG")
    return content.getvalue()


def _text(content: bytes) -> str:
    return b64encode(content).decode("ascii")
