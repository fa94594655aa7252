"""Pictures of spheres in their box, ray-cast by the engine on the CPU or a GPU, with colour bar and caption."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from fastcollide import _core
from fastcollide.cameras import CAMERA_NAMES, Bounds, Camera, Orbit, camera_for_box, invalid, listed, triple
from fastcollide.colormaps import COLOR_MAPS, color_table
from fastcollide.world import to_numpy

ColorBy = Literal["speed", "radius", "id"]

STANDARD_GRAVITY = 9.80665  # m/s²
LARGEST_SIDE = 16_384  # pixels; beyond it a picture's buffers alone take gigabytes
SMALLEST_WITH_TEXT = (320, 200)  # pixels; in a smaller picture a colour bar and a caption could not be read

_LABELS = {"speed": "Speed (m/s)", "radius": "Radius (m)", "id": "Sphere number"}
_INK = (44, 52, 64)
_SOFT_INK = (92, 102, 117)


class Renderer:
    """Draws spheres in their box. Keeps its buffers, camera and colour range from picture to picture.

    Args:
        bounds: lower and upper corner of the box [m].
        width: of the picture [pixels].
        height: of the picture [pixels].
        supersampling: samples along each side of a pixel, 1 to 4.
        camera: None or "auto", "front", "top", "orbit", or a Camera, or an Orbit, which goes round with the time.
        color_by: what the values are: "speed" [m/s], "radius" [m] or "id"; names the colour bar.
        color_range: values at its two ends. None takes one range for all pictures, so that a colour means the same in a
            whole video: for the speed 0 to that of a free fall from the box's top to its bottom, or to what 19 of 20
            spheres of the first picture stay below if that is more, rounded up; for radius and id smallest and largest
            of the first picture.
        device: "cpu", "cuda", "cuda:N" or "auto".
        threads: of the CPU. None: all.
        color_map: "ember" (blue over red to amber) or "tide" (blue over green to yellow).
        has_color_bar: whether the picture has a colour bar.

    Raises:
        InvalidValue: where one of them is outside its range.
        DeviceError: where there is no such device.
    """

    def __init__(
        self,
        bounds: Bounds,
        width: int = 1280,
        height: int = 720,
        supersampling: int = 2,
        camera: str | Camera | Orbit | None = None,
        color_by: ColorBy = "speed",
        color_range: tuple[float, float] | None = None,
        device: str = "cpu",
        threads: int | None = None,
        color_map: str = "ember",
        has_color_bar: bool = True,
    ) -> None:
        for name, value, largest in (
            ("width", width, LARGEST_SIDE),
            ("height", height, LARGEST_SIDE),
            ("supersampling", supersampling, 4),
        ):
            if not 1 <= value <= largest:
                raise invalid(name, value, f"1 to {largest}")
        if color_by not in _LABELS:
            raise invalid("color_by", color_by, listed(_LABELS))
        if color_map not in COLOR_MAPS:
            raise invalid("color_map", color_map, listed(COLOR_MAPS))
        lower, upper = (triple(corner) for corner in bounds)
        if not all(-math.inf < low < high < math.inf for low, high in zip(lower, upper, strict=True)):
            raise invalid("bounds", bounds, "a lower and an upper corner, finite")
        if color_range is not None:
            color_range = (float(color_range[0]), float(color_range[1]))
            if not -math.inf < color_range[0] < color_range[1] < math.inf:
                raise invalid("color_range", color_range, "two finite numbers, the lower one first")
        self.bounds = (lower, upper)
        self.width, self.height, self.supersampling = int(width), int(height), int(supersampling)
        if isinstance(camera, str) and camera not in CAMERA_NAMES:
            raise invalid("camera", camera, f"{listed(CAMERA_NAMES)}, a Camera or an Orbit")
        self._orbit = Orbit() if camera == "orbit" else camera if isinstance(camera, Orbit) else None
        if self._orbit is not None:
            self.camera = self._orbit.camera_at(0.0, self.bounds, width / height)
        elif isinstance(camera, Camera):
            self.camera = camera
        else:
            self.camera = camera_for_box(self.bounds, width / height, camera or "auto")
        self.color_by = color_by
        self.color_range = color_range
        self._color_table = color_table(color_map)
        self._has_color_bar = has_color_bar
        self._color_bar: _Overlay | None = None
        self._native = _core.Renderer(device, threads or 0)

    def draw(
        self,
        positions: ArrayLike,
        radii: ArrayLike,
        values: ArrayLike,
        title: str | None = None,
        time: float | None = None,
    ) -> NDArray[np.uint8]:
        """Draws a picture.

        With neither title nor time there is no caption; a picture smaller than 320 × 200 has neither caption nor colour
        bar.

        Args:
            positions: [m], shape (n, 3).
            radii: [m], shape (n,).
            values: what color_by names, shape (n,).
            title: first line of the caption.
            time: [s]; shown below it together with the number of spheres, and the place of an Orbit.

        Returns:
            RGB, uint8, shape (height, width, 3).

        Raises:
            InvalidValue: where the shapes do not fit.
        """
        positions = _float_array("positions", positions)
        count = len(positions)
        radii, values = _float_array("radii", radii), _float_array("values", values)
        for name, array, shape in (
            ("positions", positions, (count, 3)),
            ("radii", radii, (count,)),
            ("values", values, (count,)),
        ):
            if array.shape != shape:
                raise invalid(name, f"an array of shape {array.shape}", f"shape {shape}")
        if self.color_range is None:
            self.color_range = self.choose_color_range(values)
        if self._orbit is not None:
            self.camera = self._orbit.camera_at(time or 0.0, self.bounds, self.width / self.height)
        camera, (lower, upper) = self.camera, self.bounds
        picture = self._native.draw(
            self.width,
            self.height,
            self.supersampling,
            camera.eye,
            camera.target,
            camera.up,
            math.tan(math.radians(camera.field_of_view_degrees) / 2),
            lower,
            upper,
            self._color_table,
            *self.color_range,
            positions,
            radii,
            values,
        )
        if self.width >= SMALLEST_WITH_TEXT[0] and self.height >= SMALLEST_WITH_TEXT[1]:
            self._write_text(picture, title, time, count)
        return picture

    def _write_text(self, picture: NDArray[np.uint8], title: str | None, time: float | None, count: int) -> None:
        if self._has_color_bar and self._color_bar is None:
            assert self.color_range is not None
            self._color_bar = _color_bar(
                self.width, self.height, self._color_table, _LABELS[self.color_by], self.color_range
            )
        if self._color_bar is not None:
            self._color_bar.lay_over(picture)
        if title is not None or time is not None:
            _caption(self.width, self.height, title, time, count).lay_over(picture)

    def choose_color_range(self, values: NDArray[np.float32]) -> tuple[float, float]:
        """The range that a first picture with these values would choose, see color_range."""
        finite = values[np.isfinite(values)]
        if self.color_by == "speed":
            free_fall = math.sqrt(2 * STANDARD_GRAVITY * (self.bounds[1][2] - self.bounds[0][2]))
            usual = float(np.percentile(finite, 95)) if len(finite) else 0.0
            return 0.0, _rounded_up(max(free_fall, usual))
        if not len(finite):
            return 0.0, 1.0
        low, high = float(finite.min()), float(finite.max())
        return (low, high) if low < high else (low, low + 1.0)


# ---------------------------------------------------------------------------------------------------------------------
# What is laid over the picture.


class _Overlay:
    """A drawn rectangle with transparency, ready to be laid over pictures again and again."""

    def __init__(self, left: int, top: int, image: Image.Image) -> None:
        box = image.getbbox() or (0, 0, 0, 0)
        self._left, self._top = left + box[0], top + box[1]
        layer = np.asarray(image.crop(box), dtype=np.uint16)
        self._alpha = layer[..., 3:]
        self._color = layer[..., :3] * self._alpha

    def lay_over(self, picture: NDArray[np.uint8]) -> None:
        height, width = self._alpha.shape[:2]
        part = picture[self._top : self._top + height, self._left : self._left + width]
        shown = (slice(part.shape[0]), slice(part.shape[1]))  # what lies beyond the right and lower border is cut
        part[...] = (part * (255 - self._alpha[shown]) + self._color[shown] + 127) // 255


@lru_cache
def _font(size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(size)


def _unit(width: int, height: int) -> float:
    """Length that the overlay is measured in [pixels]: 1 in a picture of 1280 × 720, and in one of two of 800 × 720."""
    return max(min(height / 720, width / 800), 0.5)


def _color_bar(
    width: int, height: int, table: NDArray[np.uint8], label: str, color_range: tuple[float, float]
) -> _Overlay:
    unit = _unit(width, height)
    bar_width, bar_height = round(12 * unit), round(220 * unit)
    area_width, top_space = round(160 * unit), round(40 * unit)
    image = Image.new("RGBA", (area_width, bar_height + 2 * top_space), (*_SOFT_INK, 0))
    draw = ImageDraw.Draw(image)
    font, small = _font(round(15 * unit)), _font(round(13 * unit))
    left = round(40 * unit)

    shades = table[np.linspace(255, 0, bar_height).round().astype(int)]
    bar = Image.fromarray(np.repeat(shades[:, None], bar_width, axis=1), "RGB")
    # Drawn four times as large and made small, because Pillow's shapes have hard edges.
    mask = Image.new("L", (4 * bar_width, 4 * bar_height), 0)
    ImageDraw.Draw(mask).rounded_rectangle((0, 0, 4 * bar_width - 1, 4 * bar_height - 1), radius=8 * unit, fill=255)
    image.paste(bar, (left, top_space), mask.resize(bar.size, Image.Resampling.LANCZOS))

    low, high = color_range
    for tick in _ticks(low, high):
        y = top_space + (bar_height - 1) * (high - tick) / (high - low)
        right = left + bar_width
        draw.line((right + 4 * unit, y, right + 8 * unit, y), fill=(*_SOFT_INK, 255), width=max(1, round(unit)))
        draw.text((right + 13 * unit, y), f"{tick:,.6g}", font=small, fill=(*_SOFT_INK, 255), anchor="lm")
    draw.text((left, top_space - 14 * unit), label, font=font, fill=(*_INK, 255), anchor="ls")
    return _Overlay(width - area_width, (height - image.height) // 2, image)


def _caption(width: int, height: int, title: str | None, time: float | None, count: int) -> _Overlay:
    unit = _unit(width, height)
    image = Image.new("RGBA", (round(900 * unit), round(80 * unit)), (*_INK, 0))
    draw = ImageDraw.Draw(image)
    y = 24 * unit
    if title is not None:
        draw.text((0, y), title, font=_font(round(22 * unit)), fill=(*_INK, 255), anchor="ls")
        y += 26 * unit
    spheres = f"{count:,} sphere" + ("" if count == 1 else "s")
    text = spheres if time is None else f"{spheres}    {time:.2f} s"
    draw.text((0, y), text, font=_font(round(15 * unit)), fill=(*_SOFT_INK, 255), anchor="ls")
    return _Overlay(round(36 * unit), round(24 * unit), image)


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers in [low, high], about five."""
    step = round_step((high - low) / 5)
    return [i * step for i in range(math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6) + 1)]


def round_step(least: float) -> float:
    """The smallest of 1, 2, 2.5, 5 times a power of ten that is not below `least`, but for rounding."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(power * factor for factor in (1, 2, 2.5, 5, 10) if power * factor >= least * (1 - 1e-6))


def _rounded_up(value: float) -> float:
    """The next number with a short name: a whole multiple of a tick's step."""
    step = round_step(value / 5)
    return step * math.ceil(value / step - 1e-6)


def _float_array(name: str, array: Any) -> NDArray[np.float32]:
    try:
        return np.ascontiguousarray(to_numpy(array), dtype=np.float32)
    except (TypeError, ValueError):
        raise invalid(name, type(array).__name__, "an array of numbers") from None
