"""One run: a world, its frame files, its video and what came out."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np

import fastcollide as fc
from fastcollide.frames import frame_path, remove_frames, write_frame
from fastcollide.interrupt import StopOnInterrupt
from fastcollide.parameters import InvalidSetting
from fastcollide.pictures import Painter, check_picture_files
from fastcollide.settings import RunSettings


@dataclass(frozen=True)
class RunSummary:
    """What a run did, and the state it ended in.

    seconds: the whole run [s]; step_seconds: the part spent in the engine [s]; fast_spheres, safe_iterations and
    safe_dt [s]: as the World has them.
    """

    frames: int
    stopped_early: bool
    seconds: float
    step_seconds: float
    contacts: int
    energy: fc.Energy
    max_overlap: float
    mean_overlap: float
    fast_spheres: int
    safe_iterations: int | None
    safe_dt: float
    state_hash: int
    frame_files: int
    replaced_frame_files: int
    pictures: int

    @property
    def frames_per_second(self) -> float:
        """Frames that the engine computed in each second."""
        return self.frames / self.step_seconds if self.step_seconds else 0.0


def create_world(settings: RunSettings) -> fc.World:
    """The world of these settings with its random start, on its device.

    Raises InvalidSetting where a file of the run stands in the place of a folder or the other way round, DeviceError
    where there is no such device, MemoryError where it is too small.
    """
    _check_paths(settings)
    drag = fc.drag_from_damping(settings.damping, settings.fps) if settings.drag is None else settings.drag
    world = fc.World(
        bounds=settings.corners,
        boundary=settings.boundary,
        gravity=(0.0, 0.0, settings.gravity),
        drag=drag,
        floor_restitution=settings.floor_restitution,
        wall_friction=settings.wall_friction,
        rolling_friction=settings.rolling_friction,
        solver=settings.solver,
        iterations=settings.iterations,
        cell_size=settings.cell_size,
        device=settings.device,
        threads=settings.threads,
    )
    spheres = fc.random_spheres(
        settings.particles,
        bounds=settings.corners,
        seed=settings.seed,
        radius=settings.radius,
        speed=settings.speed,
        restitution=settings.restitution,
        density=settings.density,
    )
    if settings.friction > 0:
        spheres = replace(spheres, friction=np.full(len(spheres), settings.friction, dtype=np.float32))
    world.add(spheres)
    return world


def _check_paths(settings: RunSettings) -> None:
    if settings.export_every and settings.output.exists() and not settings.output.is_dir():
        raise InvalidSetting("output", f"the file {settings.output}", "a folder, or a name that is free")
    check_picture_files(settings)


def _frames_at_once(settings: RunSettings, done: int, seconds: float) -> int:
    """Frames until the next one that is written or drawn, but no more than the engine does in a tenth of a second:
    the bar moves and Ctrl-C is heard, and a GPU has work ahead."""
    most = max(1, int(0.1 * done / seconds)) if seconds else 1
    for ahead in range(1, min(most, settings.frames - done)):
        if settings.is_export_due(done + ahead) or settings.is_picture_due(done + ahead):
            return ahead
    return min(most, settings.frames - done)


def simulate(
    world: fc.World, settings: RunSettings, on_frame: Callable[[int], None] = lambda frame: None
) -> RunSummary:
    """Runs a fresh world to its last frame and writes what the settings ask for.

    Frame files of an earlier run in the same folder are removed first. Every now and then calls
    on_frame(frames done). Ctrl-C ends the run between two frames.
    """
    started = time.perf_counter()
    step_seconds = 0.0
    frame_files = replaced = 0
    with ExitStack() as stack:
        stop = stack.enter_context(StopOnInterrupt())
        painter = stack.enter_context(Painter(settings, world))
        if settings.export_every:
            settings.output.mkdir(parents=True, exist_ok=True)
            replaced = remove_frames(settings.output)
        while world.frame < settings.frames and not stop.requested:
            step_started = time.perf_counter()
            world.step(_frames_at_once(settings, world.frame, step_seconds), dt=settings.dt)
            step_seconds += time.perf_counter() - step_started
            if settings.is_export_due(world.frame):
                path = frame_path(settings.output, world.frame)
                write_frame(path, world.frame, world.time, fc.to_numpy(world.positions), fc.to_numpy(world.radii))
                frame_files += 1
            if settings.is_picture_due(world.frame):
                painter.add_picture()
            on_frame(world.frame)
        painter.finish()
    return RunSummary(
        frames=world.frame,
        stopped_early=world.frame < settings.frames,
        seconds=time.perf_counter() - started,
        step_seconds=step_seconds,
        contacts=world.contact_count(),
        energy=world.energy(),
        max_overlap=world.max_overlap(),
        mean_overlap=world.mean_overlap(),
        fast_spheres=world.fast_spheres,
        safe_iterations=world.safe_iterations,
        safe_dt=world.safe_dt,
        state_hash=world.state_hash(),
        frame_files=frame_files,
        replaced_frame_files=replaced,
        pictures=painter.pictures,
    )
