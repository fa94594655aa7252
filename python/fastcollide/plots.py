"""Curves of a ledger against time, drawn by Matplotlib."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastcollide.errors import MissingLibrary
from fastcollide.files import written_beside
from fastcollide.ledger import LedgerError
from fastcollide.parameters import FilePath, Parameter

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FILE = Parameter("output", None, FilePath((".png", ".svg", ".pdf")), "Picture file.")
INSTALL = 'pip install "fastcollide[plot]"'

# Okabe and Ito's colours, which people who see few colours tell apart.
_BLUE, _ORANGE, _GREEN, _PURPLE, _INK = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#2C3440"
_STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": "#9AA3AF",
    "axes.grid": True,
    "axes.labelcolor": _INK,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "figure.facecolor": "white",
    "font.size": 9.5,
    "grid.color": "#E3E7EC",
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "fastcollide",  # the same file for the same curves
    "text.color": _INK,
    "xtick.color": "#5C6675",
    "ytick.color": "#5C6675",
}

Ledger = dict[str, NDArray[Any]]


def need_matplotlib() -> None:
    """Raises MissingLibrary where there is no Matplotlib."""
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError:
        raise MissingLibrary(f"plots need Matplotlib, which is not installed; get it with: {INSTALL}") from None


def plot_ledger(ledger: Ledger, title: str | None = None, panels: Sequence[str] | None = None) -> Figure:
    """A figure of a ledger (see read_ledger): energy, momentum, angular momentum, contacts and overlap against time.

    panels: which of PANELS to draw, two in a row; of an odd number the first has a row of its own; None draws all.
    Raises MissingLibrary where there is no Matplotlib, LedgerError where the ledger has no row.
    """
    need_matplotlib()
    import matplotlib as mpl
    from matplotlib.figure import Figure

    if len(ledger["frame"]) == 0:
        raise LedgerError("the ledger has no row yet, so there is nothing to plot")
    with mpl.rc_context(_STYLE):
        names = PANELS if panels is None else panels
        places = [*names[:1] * (len(names) % 2), *names]
        rows = [places[i : i + 2] for i in range(0, len(places), 2)]
        figure = Figure(figsize=(11, 3 * len(rows)), dpi=120, layout="constrained")
        axes = figure.subplot_mosaic(rows, sharex=True)
        for name, axis in axes.items():
            _PANELS[name](axis, ledger)
        for name in set(rows[-1]):
            axes[name].set_xlabel("Time (s)")
        if len(places) > len(names):  # the times of the row below lie elsewhere
            axes[places[0]].tick_params(labelbottom=True)
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontsize=13)
    return figure


def check_plot_file(path: Path) -> None:
    """Raises InvalidSetting where a plot cannot be written to a file of this name."""
    _FILE.check(path)


def save_plot(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Writes a figure as PNG, SVG or PDF, by the ending of its name; it is whole or not there at all.

    Raises InvalidSetting for another ending, OSError where it cannot be written.
    """
    path = Path(path)
    check_plot_file(path)
    with written_beside(path) as unfinished:
        unfinished.write_bytes(render_plot(figure, path.suffix[1:].lower()))


def render_plot(figure: Figure, file_format: str) -> bytes:
    """The bytes of a picture file: "png", "svg" or "pdf"."""
    import matplotlib as mpl

    content = io.BytesIO()
    dates = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}  # none, for the same file from the same curves
    with mpl.rc_context(_STYLE):
        figure.savefig(content, format=file_format, metadata=dates.get(file_format))
    return content.getvalue()


def _draw(axis: Axes, ledger: Ledger, title: str, unit: str, curves: Sequence[tuple[str, str, str]]) -> None:
    """Curves (column, label, colour) with one unit, in as few digits as its prefixes allow."""
    from matplotlib.ticker import EngFormatter

    for column, label, color in curves:
        # A few rows are shown one by one.
        axis.plot(
            ledger["time_s"], ledger[column], label=label, color=color, marker="o" if len(ledger["frame"]) < 3 else None
        )
    axis.set_title(title)
    axis.yaxis.set_major_formatter(EngFormatter(unit=unit))
    axis.margins(x=0.01)
    if len(curves) > 1:
        # Beside the title, where no curve is.
        place = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2}
        axis.legend(ncols=len(curves), handlelength=1.4, columnspacing=1.2, **place)


def _use_log(axis: Axes, values: Sequence[NDArray[Any]]) -> None:
    """A logarithmic axis where the positive values span more than two powers of ten; zeros then are gaps."""
    positive = np.concatenate(values)
    positive = positive[positive > 0]
    if positive.size and positive.max() > 100 * positive.min():
        axis.set_yscale("log", nonpositive="mask")
        from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

        axis.yaxis.set_major_locator(LogLocator(numticks=7))
        axis.yaxis.set_major_formatter(EngFormatter(unit="J"))
        axis.yaxis.set_minor_formatter(NullFormatter())


def _total_energy(axis: Axes, ledger: Ledger) -> None:
    curves = [("total_J", "total", _INK), ("potential_J", "height", _GREEN), ("kinetic_J", "translation", _BLUE)]
    _draw(axis, ledger, "Energy", "J", curves + _rotation(ledger))


def _kinetic_energy(axis: Axes, ledger: Ledger) -> None:
    curves = [("kinetic_J", "translation", _BLUE), *_rotation(ledger)]
    _draw(axis, ledger, "Energy of motion", "J", curves)
    _use_log(axis, [ledger[column] for column, _, _ in curves])


def _rotation(ledger: Ledger) -> list[tuple[str, str, str]]:
    return [("rotational_J", "rotation", _ORANGE)] if ledger["rotational_J"].any() else []


def _components(name: str, title: str, unit: str) -> Callable[[Axes, Ledger], None]:
    curves = [
        (f"{name}_{axis}_{unit}", axis, color) for axis, color in zip("xyz", (_BLUE, _ORANGE, _GREEN), strict=True)
    ]
    spoken_unit = {"Ns": "N·s", "Js": "J·s"}[unit]
    return lambda axis, ledger: _draw(axis, ledger, title, spoken_unit, curves)


def _contacts(axis: Axes, ledger: Ledger) -> None:
    _draw(axis, ledger, "Contacts", "", [("contacts", "contacts", _PURPLE)])
    from matplotlib.ticker import MaxNLocator, StrMethodFormatter

    axis.yaxis.set_major_locator(MaxNLocator(nbins=7, integer=True))
    axis.yaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axis.set_ylim(bottom=0)


def _max_overlap(axis: Axes, ledger: Ledger) -> None:
    _draw(axis, ledger, "Deepest overlap", "m", [("max_overlap_m", "deepest", _ORANGE)])
    axis.set_ylim(bottom=0)


def _mean_overlap(axis: Axes, ledger: Ledger) -> None:
    _draw(axis, ledger, "Mean overlap, in smaller radii", "", [("mean_overlap", "mean", _ORANGE)])
    from matplotlib.ticker import PercentFormatter

    axis.yaxis.set_major_formatter(PercentFormatter(xmax=1))
    axis.set_ylim(bottom=0)


_PANELS: dict[str, Callable[[Axes, Ledger], None]] = {
    "energy": _total_energy,
    "motion": _kinetic_energy,
    "momentum": _components("momentum", "Momentum", "Ns"),
    "angular_momentum": _components("angular_momentum", "Angular momentum (origin)", "Js"),
    "contacts": _contacts,
    "max_overlap": _max_overlap,
    "mean_overlap": _mean_overlap,
}
PANELS = tuple(_PANELS)
