"""The time of a frame: sizes × solvers × ways to find neighbours × devices, on the report's scene.

Nothing wrong is timed: every measurement of a size and solver must end in the same state, on any device, by any method,
at each repeat.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import fastcollide as fc
from fastcollide.bench_settings import SIZES, BenchSettings
from fastcollide.roof import copy_bandwidth, model_bytes

DT = 1 / 60  # s
ITERATIONS = 5
WARM_UP = 40  # frames: spheres are still in flight, and the first have landed
BALL_FRICTION, WALL_FRICTION = 0.4, 0.3
STAGES = (
    "load",
    "advance",
    "build_grid",
    "make_lists",
    "solve_contacts",
    "gather_contacts",
    "apply_contacts",
    "store",
)


class DifferentStates(RuntimeError):
    """Two measurements of the same scene ended in different states; the message says which."""


@dataclass(frozen=True)
class Case:
    """What is timed. solver: "reference", "substep" or "friction" (substep with friction and spin); method: as World
    takes it."""

    device: str
    spheres: int
    solver: str
    method: str
    threads: int | None = None

    def __str__(self) -> str:
        return f"{self.spheres:,} spheres, {self.solver}, {self.method}, {self.device}"

    @property
    def yardstick(self) -> Case:
        """The report's design: its loop, with a new grid for every pass."""
        return replace(self, solver="reference", method="cells")


@dataclass(frozen=True)
class Row:
    """One case, measured. Times are those of one frame [ms].

    ms: median of the repeats; ms_fastest, ms_slowest: of the repeats; ms_one_by_one: where each frame is a call of its
    own, from one more run; times_yardstick: how often this fits into the time of the yardstick, as the median over the
    repeats, in each of which the two ran one soon after the other, None where the device has no memory for it;
    contacts_per_sphere: overlapping pairs over spheres, at the end; model_bytes: that a frame moves at least for each
    sphere; copy_gb_s: what a plain copy reads and writes [10⁹ bytes/s]; roof_share: the time that the model's bytes
    take at that rate over ms; None where there is no library to measure it with; stages: from one more run that times
    each stage.
    """

    device: str
    device_name: str
    spheres: int
    solver: str
    method: str
    frames: int
    repeats: int
    ms: float
    ms_fastest: float
    ms_slowest: float
    ms_one_by_one: float
    times_yardstick: float | None
    contacts_per_sphere: float
    model_bytes: int
    copy_gb_s: float | None
    roof_share: float | None
    state_hash: str
    stages: dict[str, float]


@dataclass
class _Measurement:
    """What is known of a case so far. seconds: a frame, for each repeat; one_by_one: a frame that is a call of its own;
    spent: all told [s]."""

    seconds: list[float] = field(default_factory=list)
    one_by_one: float = 0.0
    spent: float = 0.0
    contacts: int = 0
    stages: dict[str, float] = field(default_factory=dict)
    device_name: str = ""
    state: int = 0

    @property
    def is_done(self) -> bool:
        return bool(self.stages)


def scene_edge(spheres: int) -> float:
    """Edge of the box [m]: 20 up to 40,000 spheres, above that as many spheres in a volume as 20,000 in that box."""
    return 20.0 if spheres <= 40_000 else 20.0 * (spheres / 20_000) ** (1 / 3)


def new_world(case: Case) -> fc.World:
    """The scene of a case before its first frame."""
    half = scene_edge(case.spheres) / 2
    bounds = ((-half, -half, 0.0), (half, half, 2 * half))
    is_rough = case.solver == "friction"
    world = fc.World(
        bounds,
        solver="reference" if case.solver == "reference" else "substep",
        wall_friction=WALL_FRICTION if is_rough else 0.0,
        iterations=ITERATIONS,
        device=case.device,
        threads=case.threads,
        method=case.method,
    )
    world.add(fc.random_spheres(case.spheres, bounds, friction=BALL_FRICTION if is_rough else 0.0))
    return world


def devices_of(settings: BenchSettings) -> list[str]:
    """The names of the devices to measure, each once."""
    if settings.device is None:
        return [device.name for device in fc.devices()]
    return list(dict.fromkeys(fc.World(device=name).device for name in settings.device))


def cases_of(settings: BenchSettings, device: str, spheres: int) -> list[Case]:
    """The cases of one size on one device: the yardstick first, wanted or not."""
    threads = settings.threads if device == "cpu" else None
    cases = [Case(device, spheres, solver, method, threads) for solver in settings.solver for method in settings.method]
    return list(dict.fromkeys([Case(device, spheres, "", "", threads).yardstick, *cases]))


def run_bench(
    settings: BenchSettings,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
    on_left_out: Callable[[Case, str], None] = lambda case, reason: None,
) -> list[Row]:
    """Measures all that the settings ask for. A case that the device has no memory for is told and left out.

    Raises DifferentStates where two measurements of one scene end differently.
    """
    sizes, devices = settings.sizes or SIZES, devices_of(settings)
    groups = [cases_of(settings, device, spheres) for spheres in sizes for device in devices]
    done, total = 0, sum(map(len, groups))
    bandwidth = {device: copy_bandwidth(device, settings.threads) for device in devices}
    states: dict[tuple[int, str], tuple[int, Case]] = {}
    rows = []
    for cases in groups:
        measurements = {case: _Measurement() for case in cases}
        for case, run in _interleaved(measurements, settings):
            try:
                run()
            except fc.OutOfMemory as error:
                del measurements[case]
                on_left_out(case, str(error))
            else:
                _compare(states, case, measurements[case].state)
                done += measurements[case].is_done
                on_progress(done, total)
        rows += [_row(case, measurements, settings.frames, bandwidth[case.device]) for case in measurements]
    return rows


def _interleaved(
    measurements: dict[Case, _Measurement], settings: BenchSettings
) -> Iterator[tuple[Case, Callable[[], None]]]:
    """What to run: each case in turn, again and again, so that what else the machine does hits all alike."""
    for way in (*["at once"] * settings.repeats, "one by one", "by stages"):
        for case in list(measurements):
            measured = measurements.get(case)
            if measured is None:
                continue
            repeats = len(measured.seconds)
            would_take = measured.spent * (repeats + 1) / max(repeats, 1)
            if way == "at once" and repeats and would_take > settings.seconds:
                continue
            yield case, partial(_run_once, case, measured, settings.frames, way)


def _run_once(case: Case, measured: _Measurement, frames: int, way: str) -> None:
    started = time.perf_counter()
    world = new_world(case)
    world.step(WARM_UP, DT)
    world.timed = way == "by stages"
    calls = [1] * frames if way == "one by one" else [frames]
    before = time.perf_counter()
    for frames_of_call in calls:
        world.step(frames_of_call, DT)
    seconds = (time.perf_counter() - before) / frames
    measured.state = world.state_hash()
    measured.device_name = world.device_name
    if way == "by stages":
        measured.stages = {name: 1e3 * spent / frames for name, spent in world.stage_times.items()}
        measured.contacts = world.contact_count()
    elif way == "one by one":
        measured.one_by_one = seconds
    else:
        measured.seconds.append(seconds)
    measured.spent += time.perf_counter() - started


def _compare(states: dict[tuple[int, str], tuple[int, Case]], case: Case, found: int) -> None:
    expected, first = states.setdefault((case.spheres, case.solver), (found, case))
    if found != expected:
        raise DifferentStates(
            f"{case}: found state {found:016x}; expected: {expected:016x}, as {first} ended; nothing was written"
        )


def _row(case: Case, measurements: dict[Case, _Measurement], frames: int, bandwidth: float | None) -> Row:
    measured = measurements[case]
    yardstick = measurements.get(case.yardstick)
    ratios = [a / b for a, b in zip(yardstick.seconds, measured.seconds, strict=False)] if yardstick else []
    seconds = statistics.median(measured.seconds)
    least = model_bytes(ITERATIONS, case.solver == "friction")
    return Row(
        device=case.device,
        device_name=measured.device_name,
        spheres=case.spheres,
        solver=case.solver,
        method=case.method,
        frames=frames,
        repeats=len(measured.seconds),
        ms=1e3 * seconds,
        ms_fastest=1e3 * min(measured.seconds),
        ms_slowest=1e3 * max(measured.seconds),
        ms_one_by_one=1e3 * measured.one_by_one,
        times_yardstick=statistics.median(ratios) if ratios else None,
        contacts_per_sphere=measured.contacts / case.spheres,
        model_bytes=least,
        copy_gb_s=None if bandwidth is None else 1e-9 * bandwidth,
        roof_share=None if bandwidth is None else least * case.spheres / bandwidth / seconds,
        state_hash=f"{measured.state:016x}",
        stages=measured.stages,
    )
