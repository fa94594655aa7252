"""Colours for numbers: tables of 256 sRGB colours in which equal steps of the number look equally large."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Stops in OKLCh: lightness, chroma, hue [degrees]. Lightness only rises, so a map keeps its order in grey and for
# people who see few colours, and stays below the light of the background.
_STOPS = {
    # From calm blue over green to yellow.
    "tide": [(0.50, 0.135, 268), (0.59, 0.125, 250), (0.68, 0.110, 215), (0.77, 0.125, 165), (0.86, 0.160, 105)],
    # From blue for what rests over violet and red to the amber of what moves.
    "ember": [(0.50, 0.150, 264), (0.56, 0.170, 300), (0.64, 0.190, 350), (0.73, 0.175, 38), (0.86, 0.155, 85)],
}

COLOR_MAPS = tuple(_STOPS)


def color_table(name: str) -> NDArray[np.uint8]:
    """The colour map of this name, one of COLOR_MAPS, shape (256, 3): sRGB, from the lowest number to the highest."""
    lightness, chroma, hue = np.array(_STOPS[name]).T
    hue = np.unwrap(np.radians(hue))
    stops = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=1)
    fine = _smooth_path(stops, 2048)
    # Equal distances in OKLab are equal steps to the eye.
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
    even = np.linspace(0.0, way[-1], 256)
    lab = np.stack([np.interp(even, way, channel) for channel in fine.T], axis=1)
    return np.round(255.0 * _srgb_from_oklab(lab)).astype(np.uint8)


def _smooth_path(stops: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """A curve through the stops without corners (Catmull-Rom), shape (count, 3)."""
    padded = np.concatenate([[2 * stops[0] - stops[1]], stops, [2 * stops[-1] - stops[-2]]])
    place = np.linspace(0.0, len(stops) - 1, count)
    piece = np.minimum(place.astype(int), len(stops) - 2)
    t = (place - piece)[:, None]
    a, b, c, d = (padded[piece + i] for i in range(4))
    return 0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)


def _srgb_from_oklab(lab: NDArray[np.float64]) -> NDArray[np.float64]:
    """OKLab (Ottosson 2020, "A perceptual color space for image processing") to sRGB in 0 to 1, cut to its gamut."""
    to_cones = np.array(
        [
            [1.0, 0.3963377774, 0.2158037573],
            [1.0, -0.1055613458, -0.0638541728],
            [1.0, -0.0894841775, -1.2914855480],
        ]
    )
    to_linear = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    linear = np.clip((lab @ to_cones.T) ** 3 @ to_linear.T, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
