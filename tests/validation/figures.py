"""What a validation run leaves behind: figures that pass or fail by themselves, and the curves behind them.

A test writes them to one file of the results folder and then asserts them; the pictures and the table of
docs/validation.md are made of these files alone.
"""

import json
import math
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results" / "validation"


@dataclass(frozen=True)
class Figure:
    """One number and the band that it has to lie in.

    standard_error: statistical, of `found`, in the same unit; None where there is only one run of a deterministic
    system. source: where the expected value comes from.
    """

    quantity: str
    found: float
    standard_error: float | None
    expected: float
    lowest: float
    highest: float
    source: str

    @property
    def is_good(self) -> bool:
        return self.lowest <= self.found <= self.highest  # False for NaN

    def __str__(self) -> str:
        error = "" if self.standard_error is None else f" ± {self.standard_error:.2g}"
        return f"{self.quantity}: found {self.found:.5g}{error}; allowed: {self.lowest:.5g} to {self.highest:.5g}"


def within(quantity: str, found: tuple[float, float], expected: float, relative: float, source: str) -> Figure:
    """A figure (value, standard error) that may be off by a part of what is expected."""
    value, error = found
    return Figure(quantity, value, error, expected, expected * (1 - relative), expected * (1 + relative), source)


def mean_and_error(samples) -> tuple[float, float]:
    """Mean and standard error of independent samples, shape (n,)."""
    samples = np.asarray(samples, dtype=np.float64)
    return float(samples.mean()), float(samples.std(ddof=1) / math.sqrt(len(samples)))


def line_through(x, y, error) -> tuple[tuple[float, float], tuple[float, float]]:
    """(intercept, its standard error), (slope, its standard error) of the weighted least squares line."""
    x, y, error = (np.asarray(values, dtype=np.float64) for values in (x, y, error))
    design = np.stack([np.ones_like(x), x], axis=1) / error[:, None]
    covariance = np.linalg.inv(design.T @ design)
    best = covariance @ design.T @ (y / error)
    spread = np.sqrt(np.diag(covariance))
    return (float(best[0]), float(spread[0])), (float(best[1]), float(spread[1]))


def write(path: Path, title: str, figures: list[Figure], curves: dict) -> None:
    """Replaces the file at once, so that a run that is stopped leaves the old one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "title": title,
        "figures": [{**asdict(figure), "is_good": figure.is_good} for figure in figures],
        "curves": curves,
    }
    unfinished = path.with_suffix(".unfinished")
    unfinished.write_text(json.dumps(_rounded(content), indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    os.replace(unfinished, path)


def read(folder: Path = RESULTS) -> dict[str, dict]:
    """All results by the name of their file."""
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))}


def _rounded(value):
    """Six digits: what comes after them depends on how a machine adds up."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_rounded(item) for item in value]
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (float, np.floating)):
        return float(f"{value:.6g}")
    return value
