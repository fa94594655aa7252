"""Pictures of a running world: the frames of its video and the still at its end."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

import fastcollide as fc
from fastcollide.parameters import InvalidSetting
from fastcollide.render import ColorBy, Renderer
from fastcollide.settings import PictureSettings, SimulationSettings
from fastcollide.video import VideoWriter, write_still


def check_picture_files(settings: PictureSettings) -> None:
    """Raises InvalidSetting where a folder stands in the place of a wanted file."""
    for name, path in settings.picture_files.items():
        if path.is_dir():
            raise InvalidSetting(name, f"the folder {path}", "a file, or a name that is free")


def make_picture_folders(settings: PictureSettings) -> None:
    """Makes the folders in which the wanted files will lie."""
    for path in settings.picture_files.values():
        path.parent.mkdir(parents=True, exist_ok=True)


class Painter:
    """Draws a world into the video and the still that the settings ask for, if any."""

    def __init__(self, settings: SimulationSettings, world: fc.World) -> None:
        self.pictures = 0
        self._settings = settings
        self._world = world
        self._files = ExitStack()
        self._video: VideoWriter | None = None

    def __enter__(self) -> Painter:
        settings = self._settings
        if settings.picture_files:
            make_picture_folders(settings)
            self._renderer = renderer_for(self._world, settings)
            if settings.make_video:
                self._video = self._files.enter_context(
                    VideoWriter(
                        settings.video,
                        settings.width,
                        settings.height,
                        fps=settings.pictures_per_second,
                        quality=settings.quality,
                    )
                )
        return self

    def __exit__(self, *exception: object) -> bool | None:
        return self._files.__exit__(*exception)  # type: ignore[arg-type]

    def add_picture(self) -> None:
        """Adds the world as it is now to the video."""
        if self._video:
            self._video.add(self._draw())
            self.pictures += 1

    def finish(self) -> None:
        """Writes the still. A run too short for a picture gets one now: a video of none cannot be played."""
        if self.pictures == 0:
            self.add_picture()
        if self._settings.still:
            write_still(self._settings.still, self._draw())

    def _draw(self) -> NDArray[np.uint8]:
        return draw(self._renderer, self._world)


def renderer_for(world: fc.World, settings: PictureSettings) -> Renderer:
    """A renderer of this world's box, on its device."""
    return Renderer(
        world.bounds,
        width=settings.width,
        height=settings.height,
        supersampling=settings.supersampling,
        camera=settings.view(world.bounds),
        color_by=settings.color_by,
        color_range=settings.color_range,
        color_map=settings.color_map,
        device=world.device,
        threads=settings.threads,
    )


def draw(renderer: Renderer, world: fc.World) -> NDArray[np.uint8]:
    """The world as it is now, shape (height, width, 3), RGB."""
    return renderer.draw(world.positions, world.radii, _values(world, renderer.color_by), time=world.time)


def _values(world: fc.World, color_by: ColorBy) -> NDArray[np.float32]:
    """What the colours show, shape (n,)."""
    if color_by == "speed":
        return np.linalg.norm(fc.to_numpy(world.velocities), axis=1)
    if color_by == "radius":
        return fc.to_numpy(world.radii)
    return np.arange(len(world), dtype=np.float32)
