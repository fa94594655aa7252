"""Pictures of frames that have been written: of one run, or of several side by side."""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Callable, Sequence
from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

from fastcollide.cameras import Bounds, Camera, Orbit
from fastcollide.frames import Frame, FrameError
from fastcollide.recording import Recording
from fastcollide.recording import open as open_recording
from fastcollide.render import ColorBy, Renderer, round_step
from fastcollide.video import MOST_FPS, VideoWriter, write_still

_LINE = (200, 205, 212)  # between two runs
_SAME_TIME = 1e-6  # s; times of frames come from different sums


def render_folder(
    folders: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    video: str | os.PathLike[str] | None = None,
    still: str | os.PathLike[str] | None = None,
    *,
    bounds: Bounds | None = None,
    width: int = 1280,
    height: int = 720,
    supersampling: int = 2,
    camera: Callable[[Bounds], str | Camera | Orbit] | str | Camera | Orbit | None = None,
    color_by: ColorBy = "speed",
    color_range: tuple[float, float] | None = None,
    color_map: str = "ember",
    fps: float | None = None,
    quality: int = 75,
    labels: Sequence[str] = (),
    device: str = "auto",
    threads: int | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Draws what runs have written; returns the number of pictures.

    folders: what fc.open() takes, or several of these, which are shown side by side at equal times, the frames of the
    one that has most in a second; one that ends before the others keeps its last picture.
    video: MP4 file; still: PNG file with the last picture; None makes none. labels: a caption for each run.
    bounds: the box [m]; None takes that of the run or, where only frame files are there, one of round numbers that
    holds the spheres. camera: as in Renderer, or a function that gives it for a box.
    fps: pictures a second; None plays in real time, as far as 1 to 240 pictures a second can.
    color_by "speed" [m/s]: where a file has no velocities, the way of each sphere since the frame before over the time
    between the two (in the first frame: until the next one). Several runs share one range of colours.
    progress(done, total) is called after each picture. All else is as in Renderer and VideoWriter.
    Raises what these do, and FrameError where there are no frames or one is not whole.
    """
    paths = [folders] if isinstance(folders, (str, os.PathLike)) else [*folders]
    with ExitStack() as files:
        runs = [files.enter_context(open_recording(path)) for path in paths]
        for run in runs:
            if not len(run):
                raise FrameError(f"{run.path}: found no whole frame")
        moments = _moments(runs)
        chosen = moments if video is not None else moments[-1:]
        edges = [round(i * width / len(runs)) for i in range(len(runs) + 1)]
        panels = []
        for i, run in enumerate(runs):
            box = bounds or run.bounds or bounds_of_run(run)
            renderer = Renderer(
                box,
                width=edges[i + 1] - edges[i],
                height=height,
                supersampling=supersampling,
                camera=camera(box) if callable(camera) else camera,
                color_by=color_by,
                color_range=color_range,
                color_map=color_map,
                device=device,
                threads=threads,
                has_color_bar=i == len(runs) - 1,
            )
            panels.append(_Panel(run, renderer, labels[i] if i < len(labels) else None))
        if color_range is None:
            _share_colors(panels, chosen[0])
        writer = None
        if video is not None:
            writer = files.enter_context(VideoWriter(video, width, height, fps or _real_time_fps(runs), quality))
        for done, moment in enumerate(chosen, start=1):
            picture = _beside_each_other([panel.draw(i) for panel, i in zip(panels, moment, strict=True)])
            if writer is not None:
                writer.add(picture)
            progress(done, len(chosen))
        if still is not None:
            write_still(still, picture)
    return len(chosen)


class _Panel:
    """One run's part of the picture. Keeps the frame before, and the picture, for those that come next."""

    def __init__(self, run: Recording, renderer: Renderer, label: str | None) -> None:
        self.renderer = renderer
        self._run = run
        self._label = label
        self._frames: dict[int, Frame] = {}
        self._drawn: tuple[int, NDArray[np.uint8]] | None = None

    def draw(self, i: int) -> NDArray[np.uint8]:
        """The picture of frame i."""
        if self._drawn is None or self._drawn[0] != i:
            frame = self._frame(i)
            picture = self.renderer.draw(
                frame.positions, frame.radii, self.values(i), title=self._label, time=frame.time
            )
            self._drawn = (i, picture)
            self._frames = {i: frame}
        return self._drawn[1]

    def values(self, i: int) -> NDArray[np.float32]:
        """What the colours of frame i show, shape (n,). A sphere that the neighbouring frame does not have is at
        rest."""
        frame = self._frame(i)
        count = len(frame.radii)
        if self.renderer.color_by == "radius":
            return frame.radii
        if self.renderer.color_by == "id":
            return np.arange(count, dtype=np.float32)
        if frame.velocities is not None:
            return np.linalg.norm(frame.velocities, axis=1)
        speeds = np.zeros(count, np.float32)
        if len(self._run) > 1:
            neighbor = self._frame(i - 1 if i else 1)
            both = min(count, len(neighbor.radii))
            if frame.time != neighbor.time:
                way = np.linalg.norm(frame.positions[:both] - neighbor.positions[:both], axis=1)
                speeds[:both] = way / abs(frame.time - neighbor.time)
        return speeds

    def _frame(self, i: int) -> Frame:
        if i not in self._frames:
            self._frames[i] = self._run[i]
        return self._frames[i]


def _moments(runs: Sequence[Recording]) -> list[tuple[int, ...]]:
    """Which frame of each run a picture shows, for all pictures."""
    if len(runs) == 1:
        return [(i,) for i in range(len(runs[0]))]
    all_times = [run.times for run in runs]
    leading = max(all_times, key=lambda times: len(times) / max(times[-1], _SAME_TIME))
    rest = max(all_times, key=lambda times: times[-1])
    ticks = [*leading, *rest[rest > leading[-1] + _SAME_TIME]]
    return [tuple(max(0, bisect_right(times, tick + _SAME_TIME) - 1) for times in all_times) for tick in ticks]


def _share_colors(panels: Sequence[_Panel], first: Sequence[int]) -> None:
    ranges = [panel.renderer.choose_color_range(panel.values(i)) for panel, i in zip(panels, first, strict=True)]
    for panel in panels:
        panel.renderer.color_range = min(low for low, _ in ranges), max(high for _, high in ranges)


def _beside_each_other(pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    if len(pictures) == 1:
        return pictures[0]
    picture = np.concatenate(pictures, axis=1)
    x = 0
    for part in pictures[:-1]:
        x += part.shape[1]
        picture[:, x - 1 : x + 1] = _LINE
    return picture


def bounds_of_run(run: Recording) -> Bounds:
    """A box with round corners that holds the spheres of a few frames, the first and the last among them."""
    chosen = np.unique(np.linspace(0, len(run) - 1, 6).round().astype(int))
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for frame in (run[int(i)] for i in chosen):
        if len(frame.radii):
            lower = np.minimum(lower, (frame.positions - frame.radii[:, None]).min(axis=0))
            upper = np.maximum(upper, (frame.positions + frame.radii[:, None]).max(axis=0))
    if not np.isfinite(upper - lower).all():
        return (-1.0, -1.0, 0.0), (1.0, 1.0, 2.0)
    step = round_step(float((upper - lower).max()) / 50)
    # What float32 leaves of a wall that is touched must not cost a whole step.
    low, high = np.floor(lower / step + 1e-3) * step, np.ceil(upper / step - 1e-3) * step
    return tuple(low.tolist()), tuple(high.tolist())


def _real_time_fps(runs: Sequence[Recording]) -> float:
    between = [run[1].time - run[0].time for run in runs if len(run) > 1]
    between = [step for step in between if step > 0]
    return min(max(1.0 / min(between), 1.0), MOST_FPS) if between else 30.0
