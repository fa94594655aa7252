"""`fastcollide resume`: goes on with a run from its last good checkpoint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import fastcollide as fc
from fastcollide.archive import read_archive
from fastcollide.checkpoints import checkpoint_paths, remove_unfinished_files
from fastcollide.console import EXIT_INTERRUPTED, render_and_report, run_world, say
from fastcollide.errors import CheckpointError
from fastcollide.expectations import Outcome, check_end
from fastcollide.frames import FrameError, frame_path
from fastcollide.ledger import read_ledger
from fastcollide.run import check_paths
from fastcollide.run_record import RunRecord, checkpoints_of, record_in
from fastcollide.settings import SimulationSettings


def resume_and_report(folder: Path, device: str | None, threads: int | None) -> int:
    """Goes on with the run in this folder in front of a person and returns the exit code.

    device, threads: None takes those of the run. Frame files and rows of the ledger follow on those before the
    checkpoint; later ones of the run that was killed are made again. A run that has done all its frames gets what it
    still lacks. Raises CheckpointError where no checkpoint can be used, FrameError and LedgerError where something that
    was written before it is not there any more.
    """
    path, record, world = _last_good(folder, device, threads)
    settings = replace(
        record.settings, device=device or record.settings.device, threads=threads or record.settings.threads
    )
    _check_frames(settings, world.frame)
    check_paths(settings, world.frame)
    remove_unfinished_files(folder)
    say("resumed", f"{path.resolve()}, after {world.frame:,} of {settings.frames:,} frames")

    def check() -> Sequence[Outcome]:
        if record.expect is None or record.start is None:
            return ()
        ledger = read_ledger(folder) if settings.ledger_interval else None
        return check_end(record.expect, world, record.start, ledger)

    checkpoints = checkpoints_of(settings, record.source, record.expect, record.start)
    without_video = replace(settings, make_video=False)  # its pictures before the checkpoint are lost
    code = run_world(world, without_video, record.source, check, checkpoints=checkpoints, is_continued=True)
    if settings.make_video and code != EXIT_INTERRUPTED:
        _make_video(world, settings)
    return code


def _last_good(folder: Path, device: str | None, threads: int | None) -> tuple[Path, RunRecord, fc.World]:
    paths = checkpoint_paths(folder)
    if not paths:
        raise CheckpointError(folder, None, "no checkpoint", "the folder of a run with --checkpoint-every")
    faults: list[tuple[Path, CheckpointError]] = []
    for path in reversed(paths):
        try:
            archive = read_archive(path)
            record = record_in(archive, folder)
            where = device or record.settings.device, threads or record.settings.threads
            world = fc.World._from_archive(archive, *where)
        except CheckpointError as error:
            faults.append((path, error))
            continue
        for bad, fault in faults:  # it must not count as one of those that are kept
            aside = bad.with_name(bad.name + ".damaged")
            bad.replace(aside)
            say("damaged", f"{fault}; put aside as {aside.name}")
        return path, record, world
    for _, fault in faults[:-1]:
        say("damaged", str(fault))
    raise faults[-1][1]


def _check_frames(settings: SimulationSettings, done: int) -> None:
    if not settings.writes_frame_files:
        return
    for frame in filter(settings.is_export_due, range(1, done + 1)):
        path = frame_path(settings.output, frame)
        if not path.is_file():
            raise FrameError(f"{path}: found no such file; a run that goes on after frame {done:,} needs all before it")


def _make_video(world: fc.World, settings: SimulationSettings) -> None:
    if not settings.export_every or not (settings.writes_frame_files or settings.trajectory):
        say("video", "none: there are no frame files, and a run that was stopped has lost its pictures")
        return
    say("video", "made from the frames that were written, one picture for each")
    render_and_report([settings.output], world.bounds, replace(settings, still=None, video_fps=None))
