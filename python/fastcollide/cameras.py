"""Cameras: where pictures are taken from."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fastcollide.errors import InvalidValue
from fastcollide.spheres import Bounds

DEFAULT_ORBIT_PERIOD = 20.0  # s
_FIELD_OF_VIEW = 24.0  # degrees, vertical
_MARGIN = 0.09  # share of the picture kept free at each side

# Where the named cameras look from: from the middle of the box towards the eye, and what is up in the picture.
_DIRECTIONS = {
    "auto": ((0.50, -0.84, 0.33), (0.0, 0.0, 1.0)),
    "front": ((0.0, -1.0, 0.12), (0.0, 0.0, 1.0)),
    "top": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
}
CAMERA_NAMES = (*_DIRECTIONS, "orbit")


@dataclass(frozen=True)
class Camera:
    """Where a picture is taken from.

    Args:
        eye: the place of the camera [m].
        target: the place that is in the middle of the picture [m].
        up: direction that is up in the picture.
        field_of_view_degrees: vertical angle of view, 1 to 150.

    Raises:
        InvalidValue: where one of them is outside its range.
    """

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    field_of_view_degrees: float = _FIELD_OF_VIEW

    def __post_init__(self) -> None:
        for name in ("eye", "target", "up"):
            value = np.asarray(getattr(self, name), dtype=float)
            if value.shape != (3,) or not np.isfinite(value).all():
                raise invalid(f"camera.{name}", getattr(self, name), "three finite numbers")
        if tuple(self.eye) == tuple(self.target):
            raise invalid("camera.target", self.target, "any point but the eye")
        if not 1.0 <= self.field_of_view_degrees <= 150.0:
            raise invalid("camera.field_of_view_degrees", self.field_of_view_degrees, "1 to 150")


def camera_for_box(
    bounds: Bounds,
    aspect: float,
    name: str = "auto",
    field_of_view_degrees: float = _FIELD_OF_VIEW,
    margin: float = _MARGIN,
) -> Camera:
    """The nearest camera of this name that holds the whole box.

    bounds: lower and upper corner [m]; aspect: width over height of the picture; name: "auto" (three-quarter view,
    slightly from above), "front" or "top"; margin: share of the picture kept free at each side.
    """
    if name not in _DIRECTIONS:
        raise invalid("camera", name, f"{listed(_DIRECTIONS)} or a Camera")
    direction, up = (np.array(vector) for vector in _DIRECTIONS[name])
    forward = -direction / np.linalg.norm(direction)
    axes = _axes(forward, up)
    lower, upper = (np.asarray(corner, dtype=float) for corner in bounds)
    corners = np.array([[(lower, upper)[bit][axis] for axis, bit in enumerate(bits)] for bits in np.ndindex(2, 2, 2)])
    across, height, ahead = axes @ corners.T
    tan_vertical = math.tan(math.radians(field_of_view_degrees) / 2)
    distance = math.inf
    place = []
    for coordinate, tangent in ((across, tan_vertical * aspect), (height, tan_vertical)):
        # Each corner must lie between the two planes that bound the view: two upper limits of the eye's place
        # ahead, the closest of which the eye takes, and the middle between the planes sideways.
        tangent *= 1 - 2 * margin
        left, right_most = np.max(-coordinate - tangent * ahead), np.max(coordinate - tangent * ahead)
        distance = min(distance, -(left + right_most) / (2 * tangent))
        place.append((right_most - left) / 2)
    eye = axes.T @ np.array([*place, distance])
    target = eye + forward * (float(np.mean(ahead)) - distance)
    return Camera(triple(eye), triple(target), triple(up), field_of_view_degrees)


@dataclass(frozen=True)
class Orbit:
    """A camera that goes round the box, starting where "auto" looks from.

    Args:
        period: simulated time of one round [s].

    Raises:
        InvalidValue: where it is not above 0.
    """

    period: float = DEFAULT_ORBIT_PERIOD

    def __post_init__(self) -> None:
        if not 0 < self.period < math.inf:
            raise invalid("camera.period", self.period, "a finite number above 0 [s]")

    def camera_at(self, time: float, bounds: Bounds, aspect: float) -> Camera:
        """The camera at a time.

        It looks at the middle of the box, from as far away as the whole box needs from the worst side: a distance that
        changed on the way round would look as if the box breathed.

        Args:
            time: simulated time [s].
            bounds: lower and upper corner of the box [m].
            aspect: width over height of the picture.
        """
        lower, upper = (np.asarray(corner, dtype=float) for corner in bounds)
        middle = (lower + upper) / 2
        distance = max(
            _distance(_turned(angle), upper - lower, aspect) for angle in np.linspace(0, 2 * np.pi, 72, endpoint=False)
        )
        eye = middle + distance * _turned(2 * math.pi * (time / self.period))
        return Camera(triple(eye), triple(middle), field_of_view_degrees=_FIELD_OF_VIEW)


def _turned(angle: float) -> NDArray[np.float64]:
    """The direction of "auto", turned about z, as a unit vector."""
    x, y, z = _DIRECTIONS["auto"][0]
    turned = np.array([x * math.cos(angle) - y * math.sin(angle), x * math.sin(angle) + y * math.cos(angle), z])
    return turned / np.linalg.norm(turned)


def _distance(direction: NDArray[np.float64], edges: NDArray[np.float64], aspect: float) -> float:
    """How far from its middle a box must be looked at from this direction to be seen whole."""
    axes = _axes(-direction, (0.0, 0.0, 1.0))
    corners = np.array([*np.ndindex(2, 2, 2)]) - 0.5
    across, height, ahead = axes @ (corners * edges).T
    tangent = math.tan(math.radians(_FIELD_OF_VIEW) / 2) * (1 - 2 * _MARGIN)
    return float(np.max([np.abs(across) / (tangent * aspect) - ahead, np.abs(height) / tangent - ahead]))


def _axes(forward: NDArray[np.float64], up: Any) -> NDArray[np.float64]:
    """What is right, up and ahead for a camera that looks forward (a unit vector), as rows."""
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, forward), forward])


def invalid(field: str, found: Any, allowed: str) -> InvalidValue:
    return InvalidValue(f"{field}: found {found}; allowed: {allowed}", field)


def listed(names: Iterable[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)


def triple(vector: Any) -> tuple[float, float, float]:
    x, y, z = (float(component) for component in vector)
    return x, y, z
