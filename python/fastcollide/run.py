"""One run: a world, its frame files, its video and what came out."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass

import fastcollide as fc
from fastcollide.frames import frame_path, remove_frames, write_frame
from fastcollide.interrupt import StopOnInterrupt
from fastcollide.ledger import LEDGER_NAME, LedgerWriter, check_replaceable
from fastcollide.parameters import InvalidSetting
from fastcollide.pictures import Painter, check_picture_files
from fastcollide.settings import RunSettings, SimulationSettings


@dataclass(frozen=True)
class RunSummary:
    """What a run did, and the state it ended in.

    seconds: the whole run [s]; step_seconds, ledger_seconds: the parts spent in the engine and for the ledger [s];
    fast_spheres, safe_iterations and safe_dt [s]: as the World has them.
    """

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
        return self.frames / self.step_seconds if self.step_seconds else 0.0


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


def check_paths(settings: SimulationSettings) -> None:
    """Raises InvalidSetting or LedgerError where something else stands in the place of a file or folder of the run."""
    if settings.uses_output and settings.output.exists() and not settings.output.is_dir():
        raise InvalidSetting("output", f"the file {settings.output}", "a folder, or a name that is free")
    if settings.ledger_interval:
        check_replaceable(settings.output / LEDGER_NAME)
    check_picture_files(settings)


def _frames_at_once(settings: SimulationSettings, done: int, seconds: float) -> int:
    """Frames until the next one that is written, measured or drawn, but no more than the engine does in a tenth of a
    second: the bar moves and Ctrl-C is heard, and a GPU has work ahead."""
    most = max(1, int(0.1 * done / seconds)) if seconds else 1
    for ahead in range(1, min(most, settings.frames - done)):
        if settings.is_anything_due(done + ahead):
            return ahead
    return min(most, settings.frames - done)


def simulate(
    world: fc.World, settings: SimulationSettings, on_frame: Callable[[int], None] = lambda frame: None
) -> RunSummary:
    """Runs a fresh world to its last frame and writes what the settings ask for.

    Frame files and the ledger of an earlier run in the same folder are replaced. Every now and then calls
    on_frame(frames done). Ctrl-C ends the run between two frames.
    """
    started = time.perf_counter()
    step_seconds = ledger_seconds = 0.0
    frame_files = replaced = 0
    with ExitStack() as stack:
        stop = stack.enter_context(StopOnInterrupt())
        painter = stack.enter_context(Painter(settings, world))
        if settings.uses_output:
            settings.output.mkdir(parents=True, exist_ok=True)
        if settings.export_every:
            replaced = remove_frames(settings.output)
        ledger = None
        if settings.ledger_interval:
            ledger = stack.enter_context(LedgerWriter(settings.output / LEDGER_NAME))
            ledger.add(world)
        while world.frame < settings.frames and not stop.requested:
            step_started = time.perf_counter()
            world.step(_frames_at_once(settings, world.frame, step_seconds), dt=settings.dt)
            step_seconds += time.perf_counter() - step_started
            if settings.is_export_due(world.frame):
                path = frame_path(settings.output, world.frame)
                write_frame(path, world.frame, world.time, fc.to_numpy(world.positions), fc.to_numpy(world.radii))
                frame_files += 1
            if ledger and settings.is_ledger_due(world.frame):
                ledger_started = time.perf_counter()
                ledger.add(world)
                ledger_seconds += time.perf_counter() - ledger_started
            if settings.is_picture_due(world.frame):
                painter.add_picture()
            on_frame(world.frame)
        if ledger and not settings.is_ledger_due(world.frame):  # stopped early
            ledger.add(world)
        painter.finish()
    return RunSummary(
        frames=world.frame,
        stopped_early=world.frame < settings.frames,
        seconds=time.perf_counter() - started,
        step_seconds=step_seconds,
        ledger_seconds=ledger_seconds,
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
        ledger_rows=ledger.rows if ledger else 0,
        pictures=painter.pictures,
    )
