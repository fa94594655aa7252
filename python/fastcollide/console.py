"""What a run shows on the screen: where it computes, how far it is, what came out."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

import fastcollide as fc
from fastcollide.checkpoints import Checkpoints
from fastcollide.errors import MissingLibrary, SceneError, ViewError
from fastcollide.frames import FrameError
from fastcollide.ledger import LEDGER_NAME, LedgerError, read_ledger
from fastcollide.parameters import InvalidSetting
from fastcollide.pictures import check_picture_files, make_picture_folders
from fastcollide.plots import check_plot_file, plot_ledger, save_plot
from fastcollide.render import Bounds
from fastcollide.render_frames import render_folder
from fastcollide.report import Report, Source
from fastcollide.run import RunSummary, create_world, simulate
from fastcollide.settings import PARAMETERS, PictureSettings, RunSettings, SimulationSettings
from fastcollide.source import source_of
from fastcollide.video import VideoError

if TYPE_CHECKING:
    from fastcollide.expectations import Outcome

EXIT_FINE = 0
EXIT_FAILURE = 1
EXIT_BAD_USAGE = 2
EXIT_INTERRUPTED = 130  # 128 + SIGINT, as shells count


class _Rate(ProgressColumn):
    """Frames done per second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:,.1f}/s" if task.speed else "")


@contextmanager
def progress_bar(label: str, total: int | None = None, done: int = 0) -> Iterator[Callable[[int, int], None]]:
    """A bar with rate and remaining time on stderr; nothing at all where that is no terminal.

    done: of an earlier run. Yields a function that takes how many are done, and of how many.
    """
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _Rate(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task(label, total=total, completed=done)
        yield lambda done, total: progress.update(task, completed=done, total=total)


def say(label: str, text: str) -> None:
    """One line of a summary. Never wrapped, so that it can be searched and its paths be copied."""
    print(f"{label:<16}{text}", flush=True)


def fail(message: str) -> None:
    """One line about what went wrong, on stderr."""
    print("fastcollide: " + " ".join(message.split()), file=sys.stderr)


def guard(action: Callable[[], int]) -> int:
    """The exit code of the action; what a person can do something about becomes one line on stderr."""
    try:
        return action()
    except SceneError as error:
        for message in error.messages:
            fail(message)
        return EXIT_BAD_USAGE
    except (InvalidSetting, fc.InvalidValue) as error:
        fail(str(error))
        return EXIT_BAD_USAGE
    except OSError as error:
        fail(f"{error.filename}: {error.strerror}" if error.filename else str(error))
    except (
        fc.CheckpointError,
        FrameError,
        LedgerError,
        MissingLibrary,
        fc.DeviceError,
        fc.SimulationError,
        VideoError,
        ViewError,
    ) as error:
        fail(str(error))
    except MemoryError as error:
        fail(f"not enough memory: {error}")
    except KeyboardInterrupt:
        fail("stopped by Ctrl-C")
        return EXIT_INTERRUPTED
    return EXIT_FAILURE


def run_and_report(settings: RunSettings) -> int:
    """Runs these settings in front of a person and returns the exit code."""
    world, source = create_world(settings), source_of(settings)
    checkpoints = None
    if settings.checkpoint_every:
        from fastcollide.run_record import checkpoints_of  # takes as long to load as all the rest

        checkpoints = checkpoints_of(settings, source)
    return run_world(world, settings, source, checkpoints=checkpoints)


def run_world(
    world: fc.World,
    settings: SimulationSettings,
    source: Source,
    check: Callable[[], Sequence[Outcome]] = tuple,
    *,
    checkpoints: Checkpoints | None = None,
    is_continued: bool = False,
) -> int:
    """Runs a world in front of a person and returns the exit code.

    source: what its report says about it; check: what was expected of the end, asked after the last frame;
    checkpoints, is_continued: as in simulate().
    """
    say("device", f"{world.device} ({world.device_name})")
    say("spheres", f"{len(world):,}, for {settings.frames:,} frames of 1/{settings.fps} s")
    report = Report(world, settings, source) if settings.report else None
    with progress_bar("frames", settings.frames, world.frame) as show_progress:
        summary = simulate(
            world,
            settings,
            lambda frame: show_progress(frame, settings.frames),
            checkpoints,
            is_continued=is_continued,
        )
    _show(world, settings, summary)
    outcomes = () if summary.stopped_early else check()
    if report:
        report.write(summary, outcomes)
        say("report", str(report.path.resolve()))
    for outcome in outcomes:
        verdict = "" if outcome.is_good else ": NOT MET"
        say("expected", f"{outcome.name} {outcome.allowed}, found {outcome.found}{verdict}")
    if not summary.stopped_early:
        return EXIT_FINE if _all_met(outcomes) else EXIT_FAILURE
    hint = f"; go on with: {shlex.join(['fastcollide', 'resume', str(settings.output)])}" if checkpoints else ""
    fail(f"stopped by Ctrl-C after {summary.frames:,} of {settings.frames:,} frames; all files are whole{hint}")
    return EXIT_INTERRUPTED


def _all_met(outcomes: Sequence[Outcome]) -> bool:
    failures = [outcome for outcome in outcomes if not outcome.is_good]
    for outcome in failures:
        fail(f"expect.{outcome.name}: found {outcome.found}; expected: {outcome.allowed}")
    return not failures


def render_and_report(
    paths: Sequence[Path], bounds: Bounds | None, settings: PictureSettings, labels: Sequence[str] = ()
) -> int:
    """Makes video and still of what runs have written in front of a person and returns the exit code.

    paths: output folders or trajectory files, shown side by side; labels: a caption for each; bounds: lower and upper
    corner of the box that they come from [m]; None takes that of the run.
    """
    if len(labels) not in (0, len(paths)):
        raise InvalidSetting("label", f"{len(labels)} for {len(paths)} runs", "one for each, or none")
    if len(paths) > 1 and not labels:
        labels = [path.name or str(path) for path in paths]
    files = settings.picture_files
    check_picture_files(settings)
    make_picture_folders(settings)
    with progress_bar("pictures") as show_progress:
        pictures = render_folder(
            paths,
            video=files.get("video"),
            still=files.get("still"),
            bounds=bounds,
            width=settings.width,
            height=settings.height,
            supersampling=settings.supersampling,
            camera=settings.view,
            color_by=settings.color_by,
            color_range=settings.color_range,
            color_map=settings.color_map,
            fps=settings.video_fps,
            quality=settings.quality,
            labels=labels,
            device=settings.device,
            threads=settings.threads,
            progress=show_progress,
        )
    say("pictures", f"{pictures:,}")
    _show_picture_files(settings)
    return EXIT_FINE


def plot_and_report(folder: Path, output: Path) -> int:
    """Draws the ledger of a folder in front of a person and returns the exit code."""
    check_plot_file(output)
    ledger = read_ledger(folder)
    save_plot(plot_ledger(ledger, title=folder.resolve().name), output)
    say("rows", f"{len(ledger['frame']):,}")
    say("plot", str(output.resolve()))
    return EXIT_FINE


def _show(world: fc.World, settings: SimulationSettings, summary: RunSummary) -> None:
    energy = summary.energy
    say("time", f"{summary.seconds:.2f} s, of which the simulation {summary.step_seconds:.2f} s")
    say("speed", f"{summary.frames_per_second:,.1f} FPS")
    say("contacts", f"{summary.contacts:,}")
    say("energy", f"{energy.total:.6g} J ({energy.kinetic:.6g} kinetic, {energy.potential:.6g} potential)")
    say("largest overlap", f"{summary.max_overlap:.6g} m")
    say("mean overlap", f"{100 * summary.mean_overlap:.4g} % of the smaller radius")
    if summary.fast_spheres:
        say("fast spheres", _about_fast_spheres(world.solver, settings, summary))
    say("state hash", f"{summary.state_hash:016x}")
    if settings.writes_frame_files:
        replaced = (
            f"; replaced {summary.replaced_frame_files:,} of an earlier run" if summary.replaced_frame_files else ""
        )
        say("frame files", f"{summary.frame_files:,} in {settings.output.resolve()}{replaced}")
    for path in settings.trajectory or ():
        say("trajectory", f"{settings.exports(summary.frames):,} frames in {path.resolve()}")
    if settings.ledger_interval:
        share = f"{100 * summary.ledger_seconds / summary.seconds:.1f} % of the time" if summary.seconds else ""
        say("ledger", f"{summary.ledger_rows:,} rows in {(settings.output / LEDGER_NAME).resolve()}, {share}")
    if settings.make_video:
        say("pictures", f"{summary.pictures:,}, {settings.pictures_per_second} a second")
    _show_picture_files(settings)


def _about_fast_spheres(solver: str, settings: SimulationSettings, summary: RunSummary) -> str:
    step = "frame" if solver == "reference" else "substep"
    # Rounded first: a whole number that float64 just misses is not counted up.
    safe = {"iterations": summary.safe_iterations, "fps": math.ceil(round(1 / summary.safe_dt, 6))}
    # Beside a scene, which has iterations of its own, --iterations is refused.
    options = {"iterations": "--iterations " if isinstance(settings, RunSettings) else "--set world.iterations="}
    options["fps"] = "--fps "
    advice = [f"{options[name]}{value}" for name, value in safe.items() if PARAMETERS[name].kind.accepts(value)]
    return f"{summary.fast_spheres:,} times one moved more than its radius in a {step}, maybe through another" + (
        f"; safe: {' or '.join(advice)}" if advice else ""
    )


def _show_picture_files(settings: PictureSettings) -> None:
    for name, path in settings.picture_files.items():
        say(name, str(path.resolve()))
