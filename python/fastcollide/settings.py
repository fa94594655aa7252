"""The settings of a run: the one table of names, defaults, units and ranges.

Command line options, menu prompts, the positional form and every check are made from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_args

from fastcollide.cameras import CAMERA_NAMES, DEFAULT_ORBIT_PERIOD, Bounds, Camera, Orbit
from fastcollide.colormaps import COLOR_MAPS
from fastcollide.parameters import (
    Choice,
    ChoicePerAxis,
    DeviceName,
    FilePath,
    InvalidSetting,
    Kind,
    Parameter,
    Real,
    Several,
    Switch,
    Whole,
)
from fastcollide.render import ColorBy
from fastcollide.world import SOLVERS

DEFAULT_VIDEO_FPS = 30
TRAJECTORY_SUFFIXES = (".gsd", ".vtkhdf")


def _about(kind: Kind, help: str, **details: Any) -> dict[str, Any]:
    return {"kind": kind, "help": help, **details}


def parameters_of(settings: type[Any]) -> dict[str, Parameter]:
    """The table of these settings; a class's own ones come before those it shares."""
    entries = {entry.name: entry for entry in fields(settings)}
    names = [name for layer in settings.__mro__ for name in getattr(layer, "__annotations__", ())]
    return {name: Parameter(name, entries[name].default, **entries[name].metadata) for name in names}


@dataclass(frozen=True, kw_only=True)
class PictureSettings:
    """How pictures are made and where everything is computed: what a run and `render` share.

    Raises InvalidSetting where a value is outside its range.
    """

    device: str = field(
        default="auto", metadata=_about(DeviceName(), "Where to compute; auto takes a GPU if there is one.")
    )
    threads: int | None = field(default=None, metadata=_about(Whole(1, 1024), "Threads on the CPU.", unset="all cores"))
    video: Path = field(default=Path("video.mp4"), metadata=_about(FilePath((".mp4",)), "Video file."))
    make_video: bool = field(default=True, metadata=_about(Switch(), "Make the video or not."))
    still: Path | None = field(
        default=None,
        metadata=_about(FilePath((".png",)), "Also write a picture of the last frame.", unset="no picture"),
    )
    video_fps: int | None = field(
        default=None,
        metadata=_about(
            Whole(1, 240),
            "Pictures per second of the video, which always plays in real time.",
            unit="pictures/s",
            unset=f"{DEFAULT_VIDEO_FPS}, or fps if that is less",
        ),
    )
    width: int = field(default=1280, metadata=_about(Whole(64, 7680, even=True), "Width of a picture.", unit="pixels"))
    height: int = field(default=720, metadata=_about(Whole(64, 4320, even=True), "Height of a picture.", unit="pixels"))
    supersampling: int = field(default=2, metadata=_about(Whole(1, 4), "Draw N times N samples for each pixel."))
    color_by: ColorBy = field(default="speed", metadata=_about(Choice(get_args(ColorBy)), "What the colours show."))
    color_range: tuple[float, float] | None = field(
        default=None,
        metadata=_about(
            Real(-1e9, 1e9), "Values at the two ends of the colours.", value_names=("LOW", "HIGH"), unset="to suit"
        ),
    )
    color_map: str = field(default="ember", metadata=_about(Choice(COLOR_MAPS), "Which colours."))
    camera: str = field(
        default="auto",
        metadata=_about(Choice(CAMERA_NAMES), "Where to look from; orbit goes round the box."),
    )
    orbit_period: float = field(
        default=DEFAULT_ORBIT_PERIOD,
        metadata=_about(
            Real(0, 1_000_000, without_minimum=True), "Time in which the camera orbit goes round once.", unit="s"
        ),
    )
    camera_position: tuple[float, float, float] | None = field(
        default=None,
        metadata=_about(
            Real(-1e6, 1e6),
            "Look from this place instead.",
            unit="m",
            value_names=("X", "Y", "Z"),
            unset="as camera says",
        ),
    )
    camera_target: tuple[float, float, float] | None = field(
        default=None,
        metadata=_about(
            Real(-1e6, 1e6),
            "Where a camera with a position of its own looks.",
            unit="m",
            value_names=("X", "Y", "Z"),
            unset="the middle of the box",
        ),
    )
    quality: int = field(
        default=75, metadata=_about(Whole(0, 100), "Quality of the video, from a small file to no loss to be seen.")
    )

    def __post_init__(self) -> None:
        for name, parameter in parameters_of(type(self)).items():
            parameter.check(getattr(self, name))
        if self.color_range is not None and self.color_range[0] >= self.color_range[1]:
            raise InvalidSetting("color_range", "{:g} {:g}".format(*self.color_range), "the lower value first")
        if self.camera_position is not None and self.camera != "auto":
            raise InvalidSetting("camera_position", f"one beside camera {self.camera}", "one of the two")
        if self.camera_target is not None and self.camera_position is None:
            raise InvalidSetting("camera_target", "one without camera-position", "both, or neither")
        if self.camera_target is not None and self.camera_target == self.camera_position:
            raise InvalidSetting("camera_target", "the camera's own position", "any other point")

    def view(self, bounds: Bounds) -> str | Camera | Orbit:
        """The camera for pictures of this box."""
        if self.camera_position is None:
            return Orbit(self.orbit_period) if self.camera == "orbit" else self.camera
        target = self.camera_target or tuple((low + high) / 2 for low, high in zip(*bounds, strict=True))
        is_above = target[:2] == self.camera_position[:2]
        return Camera(self.camera_position, target, up=(0.0, 1.0, 0.0) if is_above else (0.0, 0.0, 1.0))

    @property
    def picture_files(self) -> dict[str, Path]:
        """The files with pictures that are wanted, by the name of their setting."""
        wanted = {"video": self.video if self.make_video else None, "still": self.still}
        return {name: path for name, path in wanted.items() if path is not None}


@dataclass(frozen=True, kw_only=True)
class SimulationSettings(PictureSettings):
    """How long a world is simulated and what is written meanwhile: what a run from options and one of a scene share.

    Raises InvalidSetting where a value is outside its range or two values contradict each other.
    """

    frames: int = field(default=600, metadata=_about(Whole(1, 10_000_000), "Number of frames to simulate."))
    fps: int = field(
        default=60,
        metadata=_about(Whole(1, 10_000), "Simulated frames per second; a frame lasts 1/fps seconds.", unit="frames/s"),
    )
    export_every: int = field(
        default=2,
        metadata=_about(
            Whole(0, 10_000_000),
            "Write every N-th frame, as a text file and into trajectories; 0 writes none.",
        ),
    )
    make_frame_files: bool = field(default=True, metadata=_about(Switch(), "Write the frames as text files or not."))
    trajectory: tuple[Path, ...] | None = field(
        default=None,
        metadata=_about(
            Several(FilePath(TRAJECTORY_SUFFIXES)),
            "Also write the frames, with velocities, into one file: .gsd for OVITO, freud and HOOMD, .vtkhdf for "
            "ParaView; can be given again.",
            unset="no trajectory",
        ),
    )
    ledger_every: int | None = field(
        default=None,
        metadata=_about(
            Whole(0, 10_000_000),
            "Write a row of ledger.csv (energy, momentum, contacts, overlap) after every N-th frame; 0 writes none.",
            unset="every 10th, for 30 to 600 rows",
        ),
    )
    parquet: bool = field(
        default=False, metadata=_about(Switch(), "Also write the ledger as ledger.parquet when the run ends.")
    )
    checkpoint_every: int = field(
        default=0,
        metadata=_about(
            Whole(0, 10_000_000),
            "Write a checkpoint after every N-th frame, from which `resume` goes on; 0 writes none.",
        ),
    )
    output: Path = field(
        default=Path("output"), metadata=_about(FilePath(), "Folder for the frame files and the ledger.")
    )
    report: bool = field(
        default=False, metadata=_about(Switch(), "Also write report.html: settings, figures, curves and pictures.")
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.report and not self.ledger_interval:
            raise InvalidSetting("report", "1 together with ledger-every 0", "a report with a ledger to draw")
        if self.parquet and not self.ledger_interval:
            raise InvalidSetting("parquet", "1 together with ledger-every 0", "parquet with a ledger to write")
        if self.trajectory:
            if not self.export_every:
                raise InvalidSetting("trajectory", "one together with export-every 0", "export-every above 0")
            if len(set(self.trajectory)) < len(self.trajectory):
                raise InvalidSetting("trajectory", "one file twice", "a name for each")
        if self.pictures_per_second > self.fps:
            raise InvalidSetting("video_fps", self.video_fps, f"at most fps, which is {self.fps}")

    @property
    def seconds(self) -> float:
        """Length of the run [s]."""
        return self.frames / self.fps

    @property
    def dt(self) -> float:
        """Length of a frame [s]."""
        return 1 / self.fps

    @property
    def pictures_per_second(self) -> int:
        """Pictures per second of the video."""
        return min(DEFAULT_VIDEO_FPS, self.fps) if self.video_fps is None else self.video_fps

    def is_export_due(self, frame: int) -> bool:
        """Whether this frame (counted from 1) is written to frame files and trajectories."""
        return self.export_every > 0 and frame % self.export_every == 0

    @property
    def writes_frame_files(self) -> bool:
        """Whether there are frame files."""
        return self.export_every > 0 and self.make_frame_files

    @property
    def uses_output(self) -> bool:
        """Whether anything is written into the output folder."""
        return self.export_every > 0 or self.ledger_interval > 0 or self.checkpoint_every > 0

    def exports(self, frame: int) -> int:
        """How many frames are written up to this one."""
        return frame // self.export_every if self.export_every else 0

    @property
    def ledger_interval(self) -> int:
        """Frames from one row of the ledger to the next; 0 where there is none.

        A row costs about as much as a frame, nearly all of it for the searches for overlaps. Every tenth frame thus
        takes about 10 % of a run; a short one gets 30 rows all the same, a long one no more than 600.
        """
        if self.ledger_every is not None:
            return self.ledger_every
        return max(1, min(10, self.frames // 30), math.ceil(self.frames / 600))

    def is_ledger_due(self, frame: int) -> bool:
        """Whether the ledger gets a row after this frame: the start and the last frame always, if there is a ledger."""
        return self.ledger_interval > 0 and (frame % self.ledger_interval == 0 or frame == self.frames)

    def is_checkpoint_due(self, frame: int) -> bool:
        """Whether a checkpoint is written after this frame: the start and the last frame always, if there are any."""
        return self.checkpoint_every > 0 and (frame % self.checkpoint_every == 0 or frame == self.frames)

    def is_picture_due(self, frame: int) -> bool:
        """Whether the video shows the state after this frame (counted from 1).

        Picture number p belongs to the first frame at or after the time p / pictures_per_second, so the
        video plays in real time whatever the two rates are.
        """
        rate = self.pictures_per_second
        return frame * rate // self.fps > (frame - 1) * rate // self.fps

    def is_anything_due(self, frame: int) -> bool:
        """Whether a frame file, a row of the ledger, a checkpoint or a picture is due after this frame, counted from
        1."""
        return (
            self.is_export_due(frame)
            or self.is_ledger_due(frame)
            or self.is_checkpoint_due(frame)
            or self.is_picture_due(frame)
        )


@dataclass(frozen=True, kw_only=True)
class RunSettings(SimulationSettings):
    """All settings of one run from options; the defaults are the report's example.

    Raises InvalidSetting where a value is outside its range or two values contradict each other.
    """

    particles: int = field(default=2000, metadata=_about(Whole(1, 100_000_000), "Number of spheres."))
    gravity: float = field(
        default=-9.8, metadata=_about(Real(-1000, 1000), "Acceleration along z; negative pulls down.", unit="m/s²")
    )
    damping: float = field(
        default=0.999,
        metadata=_about(Real(0, 1, without_minimum=True), "Part of the speed that the air leaves after each frame."),
    )
    drag: float | None = field(
        default=None,
        metadata=_about(
            Real(0, 10_000), "Air drag, in place of the damping per frame.", unit="1/s", unset="from the damping"
        ),
    )
    floor_restitution: float = field(
        default=0.6, metadata=_about(Real(0, 1), "Part of the normal speed that the floor gives back.")
    )
    wall_friction: float = field(
        default=0.0, metadata=_about(Real(0, 100), "Coulomb friction coefficient of the walls.")
    )
    rolling_friction: float = field(
        default=0.0, metadata=_about(Real(0, 100), "Rolling resistance; only spheres with friction roll.")
    )
    bounds: tuple[float, float, float, float, float, float] = field(
        default=(-10.0, -10.0, 0.0, 10.0, 10.0, 20.0),
        metadata=_about(
            Real(-10_000, 10_000),
            "Lower and upper corner of the box.",
            unit="m",
            value_names=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        ),
    )
    boundary: str | tuple[str, str, str] = field(
        default="wall",
        metadata=_about(ChoicePerAxis(("wall", "periodic", "open")), "What happens at the ends of the box."),
    )
    seed: int = field(
        default=1, metadata=_about(Whole(0, 2**64 - 1), "Number of the random start; the same one gives the same run.")
    )
    radius: tuple[float, float] = field(
        default=(0.05, 0.4),
        metadata=_about(
            Real(0, 10_000, without_minimum=True), "Smallest and largest radius.", unit="m", value_names=("MIN", "MAX")
        ),
    )
    speed: tuple[float, float, float] = field(
        default=(8.0, 8.0, 8.0),
        metadata=_about(
            Real(0, 10_000),
            "Largest speed at the start: x and y both ways, z upwards.",
            unit="m/s",
            value_names=("VX", "VY", "VZ"),
        ),
    )
    restitution: tuple[float, float] = field(
        default=(0.3, 0.95),
        metadata=_about(Real(0, 1), "Smallest and largest restitution of the spheres.", value_names=("MIN", "MAX")),
    )
    friction: float = field(
        default=0.0,
        metadata=_about(Real(0, 100), "Coulomb friction coefficient of the spheres; the reference solver has none."),
    )
    density: float = field(
        default=1000.0,
        metadata=_about(Real(0, 1_000_000, without_minimum=True), "Density of the spheres.", unit="kg/m³"),
    )
    solver: str = field(
        default="substep",
        metadata=_about(
            Choice(SOLVERS), "How contacts are solved: stable at rest, or by the report's loop, kept as a yardstick."
        ),
    )
    iterations: int = field(
        default=5,
        metadata=_about(Whole(1, 1000), "Substeps (or contact passes of the reference solver) in each frame."),
    )
    cell_size: float | None = field(
        default=None,
        metadata=_about(
            Real(0, 10_000, without_minimum=True),
            "Edge of a grid cell where contacts are looked up, at least the largest diameter; no result depends on it.",
            unit="m",
            unset="the largest diameter",
        ),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_pairs()

    @property
    def corners(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Lower and upper corner of the box [m]."""
        return self.bounds[:3], self.bounds[3:]

    def _check_pairs(self) -> None:
        for name in ("radius", "restitution"):
            low, high = getattr(self, name)
            if low > high:
                raise InvalidSetting(name, f"{low:g} {high:g}", "the smallest first, then the largest")
        edges = [upper - lower for lower, upper in zip(*self.corners, strict=True)]
        if min(edges) <= 0:
            raise InvalidSetting(
                "bounds", PARAMETERS["bounds"].text(self.bounds), "an upper corner above the lower one"
            )
        if 2 * self.radius[1] > min(edges):
            raise InvalidSetting(
                "radius", f"{self.radius[1]:g}", f"at most {min(edges) / 2:g} m, or a sphere does not fit the box"
            )
        if self.cell_size is not None and self.cell_size < 2 * self.radius[1]:
            raise InvalidSetting(
                "cell_size", f"{self.cell_size:g}", f"at least the largest diameter, {2 * self.radius[1]:g} m"
            )
        if self.drag is not None and self.damping != PARAMETERS["damping"].default:
            raise InvalidSetting("drag", f"{self.drag:g} together with damping {self.damping:g}", "one of the two")


PARAMETERS = parameters_of(RunSettings)
# Frame files say neither what box they come from nor, by their number, how long they last.
RENDER_PARAMETERS = parameters_of(PictureSettings) | {
    "video_fps": replace(PARAMETERS["video_fps"], unset="real time"),
    "bounds": replace(PARAMETERS["bounds"], default=None, unset="a box that holds the spheres"),
}

QUICK_DEMO = RunSettings(particles=10_000, frames=300, output=Path("demo"))
