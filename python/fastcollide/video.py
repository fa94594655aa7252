"""Videos, stills and folders of frames: pictures go in, whole files come out."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastcollide.errors import InvalidValue
from fastcollide.files import written_beside
from fastcollide.frames import Frame, FrameError, frame_paths, read_frame
from fastcollide.render import Bounds, Camera, ColorBy, Renderer, round_step

MOST_FPS = 240  # pictures a second
_WAITING_PICTURES = 3  # enough to keep drawing and encoding both busy, few enough to cost no memory


class VideoError(RuntimeError):
    """A video cannot be written; the message says why."""


class VideoWriter:
    """Writes pictures to an H.264 video in an MP4 file that players and browsers open.

        with VideoWriter("video.mp4", 1280, 720, fps=60) as video:
            video.add(picture)

    path: the file; until the video is whole it has another name beside it, and after an error there is none.
    width, height: picture size [pixels], even numbers; fps: pictures a second, 1 to 240;
    quality: 0 (small file) to 100 (no loss to be seen).
    Encoding runs in a thread of its own, at the same time as the drawing of the next picture.
    Raises InvalidValue where one of them is outside its range, VideoError where the encoder is missing or fails,
    OSError where the file cannot be written.
    """

    def __init__(
        self, path: str | os.PathLike[str], width: int, height: int, fps: float = 60, quality: int = 75
    ) -> None:
        for name, side in (("width", width), ("height", height)):
            if side < 2 or side % 2:
                raise _invalid(name, side, "an even number of pixels, as H.264 wants it")
        if not 1 <= fps <= MOST_FPS:
            raise _invalid("fps", fps, f"1 to {MOST_FPS} pictures a second")
        if not 0 <= quality <= 100:
            raise _invalid("quality", quality, "0 to 100")
        self._av = _import_av()
        self.path = Path(path)
        self.pictures = 0
        self._shape = (height, width, 3)
        self._unfinished = self.path.with_name(self.path.name + ".part")
        self._error: BaseException | None = None
        try:
            self._container = self._av.open(
                os.fspath(self._unfinished), "w", format="mp4", options={"movflags": "+faststart"}
            )
            self._stream = self._open_stream(width, height, fps, quality)
            self._container.start_encoding()  # opens the file: what cannot be written is known now
        except self._av.FFmpegError as error:
            self._abandon()
            if isinstance(error, OSError):
                raise type(error)(error.errno, error.strerror, os.fspath(self.path)) from None
            raise VideoError(f"{self.path}: the encoder cannot be opened ({error})") from None
        self._queue: queue.Queue[NDArray[np.uint8] | None] = queue.Queue(_WAITING_PICTURES)
        self._thread = threading.Thread(target=self._encode_all, name="video encoder", daemon=True)
        self._thread.start()

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self._stop_thread()
            self._abandon()

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Adds a picture, shape (height, width, 3), RGB uint8. The writer keeps the array: do not change it."""
        if picture.shape != self._shape or picture.dtype != np.uint8:
            raise _invalid("picture", f"{picture.dtype} of shape {picture.shape}", f"uint8 of shape {self._shape}")
        self._raise_error()
        self._queue.put(picture)
        self.pictures += 1

    def close(self) -> None:
        """Writes what is left and gives the file its name."""
        self._stop_thread()
        try:
            self._raise_error()
            if not self.pictures:
                raise VideoError(f"{self.path}: found no picture; a video needs at least one")
            self._container.close()
            os.replace(self._unfinished, self.path)
        except BaseException:
            self._abandon()
            raise

    def _open_stream(self, width: int, height: int, fps: float, quality: int) -> Any:
        stream = self._container.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"crf": f"{36 - 0.24 * quality:.1f}", "preset": "veryfast"}
        # Says how its colours are meant; without it players guess, and guess differently.
        context = stream.codec_context
        context.color_primaries = context.color_trc = context.colorspace = 1  # BT.709
        context.color_range = 1  # 16 to 235
        return stream

    def _encode_all(self) -> None:
        picture: NDArray[np.uint8] | None = None
        try:
            while (picture := self._queue.get()) is not None:
                self._encode(picture)
            self._encode(None)
        except BaseException as error:  # handed to the thread that adds pictures
            self._error = error
            while picture is not None:  # nobody may wait for room in the queue; None has come if the end failed
                picture = self._queue.get()

    def _encode(self, picture: NDArray[np.uint8] | None) -> None:
        """Encodes a picture, or with None what the encoder still holds back."""
        frame = None
        if picture is not None:
            frame = self._av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame = frame.reformat(format="yuv420p", dst_colorspace="ITU709", dst_color_range="MPEG")
        for packet in self._stream.encode(frame):
            self._container.mux(packet)

    def _stop_thread(self) -> None:
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()

    def _raise_error(self) -> None:
        if self._error is not None:
            raise VideoError(f"{self.path}: the encoder failed ({self._error})") from self._error

    def _abandon(self) -> None:
        if hasattr(self, "_container"):
            with suppress(self._av.FFmpegError):  # nothing is kept of it anyway
                self._container.close()
        self._unfinished.unlink(missing_ok=True)


def write_still(path: str | os.PathLike[str], picture: NDArray[np.uint8]) -> None:
    """Writes a picture, shape (height, width, 3), as a PNG file; under its name it is whole or not there at all.

    Raises OSError where the file cannot be written.
    """
    with written_beside(Path(path)) as unfinished:
        Image.fromarray(picture).save(unfinished, format="PNG")


def render_folder(
    folder: str | os.PathLike[str],
    video: str | os.PathLike[str] | None = None,
    still: str | os.PathLike[str] | None = None,
    *,
    bounds: Bounds | None = None,
    width: int = 1280,
    height: int = 720,
    supersampling: int = 2,
    camera: str | Camera | None = None,
    color_by: ColorBy = "speed",
    color_range: tuple[float, float] | None = None,
    color_map: str = "ember",
    fps: float | None = None,
    quality: int = 75,
    title: str | None = None,
    device: str = "auto",
    threads: int | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> int:
    """Draws a folder of frame files, each of which becomes one picture of the video; returns the number of pictures.

    video: MP4 file; still: PNG file with the last frame; None makes none.
    bounds: the box [m]; None takes round numbers that hold the spheres, since frame files do not name it.
    fps: pictures a second; None plays in real time, as far as 1 to 240 pictures a second can.
    color_by "speed" [m/s]: the way of each sphere since the frame before over the time between the two (in the first
    frame: until the next one).
    progress(done, total) is called after each picture. All else is as in Renderer and VideoWriter.
    Raises what these do, and FrameError where the folder holds no frame file or one that is not whole.
    """
    paths = frame_paths(folder)
    if not paths:
        raise FrameError(f"{Path(folder)}: found no frame file; allowed: a folder of frame_00000001.txt and so on")
    renderer = Renderer(
        bounds or _bounds_of(paths),
        width=width,
        height=height,
        supersampling=supersampling,
        camera=camera,
        color_by=color_by,
        color_range=color_range,
        color_map=color_map,
        device=device,
        threads=threads,
    )
    if video is None:
        paths = paths[-1:]
    before = read_frame(paths[0])
    after = read_frame(paths[1]) if len(paths) > 1 else before
    with ExitStack() as files:
        writer = None
        if video is not None:
            writer = files.enter_context(
                VideoWriter(video, width, height, fps or _real_time_fps(before, after), quality)
            )
        for done, path in enumerate(paths, start=1):
            frame = before if done == 1 else read_frame(path)
            neighbor = after if done == 1 else before
            values = _values(frame, neighbor, color_by)
            picture = renderer.draw(frame.positions, frame.radii, values, title=title, time=frame.time)
            if writer is not None:
                writer.add(picture)
            before = frame
            progress(done, len(paths))
        if still is not None:
            write_still(still, picture)
    return len(paths)


def _values(frame: Frame, neighbor: Frame, color_by: ColorBy) -> NDArray[np.float32]:
    """What the colours show, shape (n,). A sphere that the neighbouring frame does not have is at rest."""
    count = len(frame.radii)
    if color_by == "radius":
        return frame.radii
    if color_by == "id":
        return np.arange(count, dtype=np.float32)
    speeds = np.zeros(count, np.float32)
    both = min(count, len(neighbor.radii))
    if frame.time != neighbor.time:
        way = np.linalg.norm(frame.positions[:both] - neighbor.positions[:both], axis=1)
        speeds[:both] = way / abs(frame.time - neighbor.time)
    return speeds


def _bounds_of(paths: list[Path]) -> Bounds:
    """A box with round corners that holds the spheres of a few frames, the first and the last among them."""
    chosen = np.unique(np.linspace(0, len(paths) - 1, 6).round().astype(int))
    lower, upper = np.full(3, np.inf), np.full(3, -np.inf)
    for frame in (read_frame(paths[i]) for i in chosen):
        if len(frame.radii):
            lower = np.minimum(lower, (frame.positions - frame.radii[:, None]).min(axis=0))
            upper = np.maximum(upper, (frame.positions + frame.radii[:, None]).max(axis=0))
    if not np.isfinite(upper - lower).all():
        return (-1.0, -1.0, 0.0), (1.0, 1.0, 2.0)
    step = round_step(float((upper - lower).max()) / 50)
    # What float32 leaves of a wall that is touched must not cost a whole step.
    low, high = np.floor(lower / step + 1e-3) * step, np.ceil(upper / step - 1e-3) * step
    return tuple(low.tolist()), tuple(high.tolist())


def _real_time_fps(first: Frame, second: Frame) -> float:
    between = second.time - first.time
    return min(max(1.0 / between, 1.0), MOST_FPS) if between > 0 else 30.0


def _import_av() -> Any:
    try:
        import av
    except ImportError:
        raise VideoError('videos need PyAV; install it with: pip install "fastcollide[video]"') from None
    return av


def _invalid(field: str, found: Any, allowed: str) -> InvalidValue:
    return InvalidValue(f"{field}: found {found}; allowed: {allowed}", field)
