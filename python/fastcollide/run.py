"""One run: a world, its frame files, its video and what came out."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

import fastcollide as fc
from fastcollide.checkpoints import Checkpoints, remove_checkpoints
from fastcollide.exports import Exports, Sink
from fastcollide.files import make_folder
from fastcollide.frames import FrameFiles, remove_frames
from fastcollide.interrupt import StopOnInterrupt
from fastcollide.ledger import (
    LEDGER_NAME,
    PARQUET_NAME,
    LedgerWriter,
    check_replaceable,
    need_parquet,
    read_ledger,
    write_parquet,
)
from fastcollide.parameters import InvalidSetting
from fastcollide.pictures import Painter, check_picture_files
from fastcollide.run_folder import write_run
from fastcollide.settings import RunSettings, SimulationSettings
from fastcollide.snapshots import cast_of
from fastcollide.trajectories import check_trajectories, open_writer


@dataclass(frozen=True)
class RunSummary:
    """What a run did, and the state it ended in.

    first_frame: of a run that was continued, where it went on, else 0; seconds: the whole run since then [s];
    step_seconds, ledger_seconds: the parts spent in the engine and for the ledger [s];
    fast_spheres, safe_iterations and safe_dt [s]: as the World has them.
    """

    first_frame: int
    frames: int
    stopped_early: bool
    seconds: float
    step_seconds: float
    ledger_seconds: float
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
    ledger_rows: int
    pictures: int

    @property
    def frames_per_second(self) -> float:
        """Frames that the engine computed in each second."""
        return (self.frames - self.first_frame) / self.step_seconds if self.step_seconds else 0.0


def create_world(settings: RunSettings) -> fc.World:
    """The world of these settings with its random start, on its device.

    Raises InvalidSetting where a file of the run stands in the place of a folder or the other way round, DeviceError
    where there is no such device, MemoryError where it is too small.
    """
    check_paths(settings)
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
        friction=settings.friction,
    )
    world.add(spheres)
    return world


def check_paths(settings: SimulationSettings, done: int = 0) -> None:
    """Raises InvalidSetting, LedgerError or FrameError where something else stands in the place of a file or folder of
    the run, or where a trajectory lacks frames up to the one that is done, MissingLibrary where a library for a file is
    not installed."""
    if settings.uses_output and settings.output.exists() and not settings.output.is_dir():
        raise InvalidSetting("output", f"the file {settings.output}", "a folder, or a name that is free")
    if settings.ledger_interval:
        check_replaceable(settings.output / LEDGER_NAME)
    if settings.parquet:
        need_parquet()
    for path in settings.trajectory or ():
        if path.is_dir():
            raise InvalidSetting("trajectory", f"the folder {path}", "a file, or a name that is free")
    check_trajectories(settings.trajectory or (), settings.exports(done))
    check_picture_files(settings)


def _open_exports(world: fc.World, settings: SimulationSettings, done: int) -> Exports:
    """Where the frames go. done: frames of an earlier run that are kept."""
    cast = cast_of(world)
    sinks: list[Sink] = [FrameFiles(settings.output, cast)] if settings.writes_frame_files else []
    frames = range(settings.export_every, settings.frames + 1, settings.export_every)
    for path in settings.trajectory or ():
        sinks.append(open_writer(path, cast, frames, settings.exports(done)))
    return Exports(cast, sinks)


def _frames_at_once(settings: SimulationSettings, done: int, frames_per_second: float) -> int:
    """Frames until the next one that is written, measured or drawn, but no more than the engine does in a tenth of a
    second: the bar moves and Ctrl-C is heard, and a GPU has work ahead."""
    most = max(1, int(0.1 * frames_per_second))
    for ahead in range(1, min(most, settings.frames - done)):
        if settings.is_anything_due(done + ahead):
            return ahead
    return min(most, settings.frames - done)


def simulate(
    world: fc.World,
    settings: SimulationSettings,
    on_frame: Callable[[int], None] = lambda frame: None,
    checkpoints: Checkpoints | None = None,
    *,
    is_continued: bool = False,
) -> RunSummary:
    """Runs a world to its last frame and writes what the settings ask for.

    A fresh world replaces frame files, ledger and checkpoints of an earlier run in the same folder; a continued one
    goes on with those up to its frame and removes the later ones. Every now and then calls on_frame(frames done).
    checkpoints: where the settings ask for some. Ctrl-C ends the run between two frames.
    """
    started = time.perf_counter()
    first_frame = world.frame
    step_seconds = ledger_seconds = 0.0
    frame_files = replaced = 0
    with ExitStack() as stack:
        stop = stack.enter_context(StopOnInterrupt())
        painter = stack.enter_context(Painter(settings, world))
        if settings.uses_output:
            make_folder(settings.output)
            if not is_continued:
                remove_checkpoints(settings.output)  # before all else that belongs to them
                write_run(world, settings)
            if settings.ledger_interval:
                (settings.output / PARQUET_NAME).unlink(missing_ok=True)  # older than what follows
        if settings.writes_frame_files:
            replaced = remove_frames(settings.output, after=first_frame if is_continued else -1)
            frame_files = settings.exports(first_frame)
        exports = None
        if settings.export_every:
            exports = stack.enter_context(_open_exports(world, settings, first_frame if is_continued else 0))
        ledger = None
        if settings.ledger_interval:
            kept = [*filter(settings.is_ledger_due, range(first_frame + 1))] if is_continued else None
            ledger = stack.enter_context(LedgerWriter(settings.output / LEDGER_NAME, keep=kept))
            if not is_continued:
                ledger.add(world)

        def write_checkpoint() -> None:
            if checkpoints:
                if ledger:
                    ledger.flush()
                checkpoints.write(world, exports.drain() if exports else ())

        if not is_continued:
            write_checkpoint()
        while world.frame < settings.frames and not stop.requested:
            step_started = time.perf_counter()
            rate = (world.frame - first_frame) / step_seconds if step_seconds else 0.0
            world.step(_frames_at_once(settings, world.frame, rate), dt=settings.dt)
            step_seconds += time.perf_counter() - step_started
            if exports and settings.is_export_due(world.frame):
                exports.add(world)
                frame_files += settings.writes_frame_files
            if ledger and settings.is_ledger_due(world.frame):
                ledger_started = time.perf_counter()
                ledger.add(world)
                ledger_seconds += time.perf_counter() - ledger_started
            if settings.is_picture_due(world.frame):
                painter.add_picture()
            if settings.is_checkpoint_due(world.frame):
                write_checkpoint()
            on_frame(world.frame)
        if checkpoints and not settings.is_checkpoint_due(world.frame):  # stopped early
            write_checkpoint()
        if ledger and not settings.is_ledger_due(world.frame):  # stopped early
            ledger.add(world)
        painter.finish()
        if exports:
            exports.drain()  # an error now, before what follows says that all went well
        if settings.parquet:
            write_parquet(settings.output / PARQUET_NAME, read_ledger(settings.output))
    seconds = time.perf_counter() - started
    end = world.measure()
    return RunSummary(
        first_frame=first_frame,
        frames=world.frame,
        stopped_early=world.frame < settings.frames,
        seconds=seconds,
        step_seconds=step_seconds,
        ledger_seconds=ledger_seconds,
        contacts=end.contact_count,
        energy=end.energy,
        max_overlap=end.max_overlap,
        mean_overlap=end.mean_overlap,
        fast_spheres=world.fast_spheres,
        safe_iterations=world.safe_iterations,
        safe_dt=world.safe_dt,
        state_hash=world.state_hash(),
        frame_files=frame_files,
        replaced_frame_files=replaced,
        ledger_rows=ledger.rows if ledger else 0,
        pictures=painter.pictures,
    )
