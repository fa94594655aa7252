"""Videos and stills: pictures go in, whole files come out."""

from __future__ import annotations

import os
import queue
import threading
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastcollide.errors import InvalidValue
from fastcollide.files import written_beside

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


def _import_av() -> Any:
    try:
        import av
    except ImportError:
        raise VideoError('videos need PyAV; install it with: pip install "fastcollide[video]"') from None
    return av


def _invalid(field: str, found: Any, allowed: str) -> InvalidValue:
    return InvalidValue(f"{field}: found {found}; allowed: {allowed}", field)
