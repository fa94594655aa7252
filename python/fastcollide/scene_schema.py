"""What a scene file may hold: its tables with their keys, types, ranges and defaults.

Keys have the names of the Python arguments and of the options of `run`, and take ranges and defaults from them.
pydantic checks a file against these classes and makes the JSON schema for editors from them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from fastcollide.parameters import Kind, Parameter, Real, Switch, Whole
from fastcollide.render import ColorBy
from fastcollide.settings import PARAMETERS
from fastcollide.spheres import DEFAULT_BOUNDS

Finite = Annotated[float, Field(strict=True, allow_inf_nan=False)]
NotNegative = Annotated[Finite, Field(ge=0)]
Positive = Annotated[Finite, Field(gt=0)]
Mass = Annotated[float, Field(strict=True, gt=0)]  # of a fixed sphere: infinite
Share = Annotated[Finite, Field(ge=0, le=1)]
Vector = tuple[Finite, Finite, Finite]
Boundary = Literal["wall", "periodic", "open"]

A_VECTOR = "three finite numbers"


def key(default: Any, help: str, allowed: str, **limits: Any) -> Any:
    """A key of a table. help: what it means, with its unit; allowed: the values it may have, in words.

    default: ... where it must be given, None where it can be left open.
    """
    return Field(default=default, description=help, json_schema_extra={"allowed": allowed}, **limits)


def like(name: str, **changes: Any) -> Any:
    """A key that is the option of this name of `run`."""
    parameter = PARAMETERS[name]
    words = {"default": parameter.default, "help": _help(parameter), "allowed": parameter.allowed} | changes
    limits = {} if parameter.value_names else _limits(parameter.kind)
    return key(**words, **limits)


def _help(parameter: Parameter) -> str:
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    return parameter.help.removesuffix(".") + unit + "." + (f" Default: {parameter.unset}." if parameter.unset else "")


def _limits(kind: Kind) -> dict[str, Any]:
    """What pydantic and the JSON schema can say of a kind of value."""
    if isinstance(kind, Whole):
        return {"strict": True, "ge": kind.minimum, "le": kind.maximum} | ({"multiple_of": 2} if kind.even else {})
    if isinstance(kind, Real):
        least = {"gt" if kind.without_minimum else "ge": kind.minimum}
        return {"strict": True, "allow_inf_nan": False, "le": kind.maximum} | least
    return {"strict": True} if isinstance(kind, Switch) else {}


class Table(BaseModel):
    """A table of a scene file; a key that it does not know is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class WorldTable(Table):
    """The box and what holds in it: the arguments of World."""

    bounds: tuple[Vector, Vector] = key(
        DEFAULT_BOUNDS, "Lower and upper corner of the box [m].", "two corners, [[x, y, z], [x, y, z]]"
    )
    boundary: Boundary | tuple[Boundary, Boundary, Boundary] = key(
        "wall",
        "What happens at the ends of the box, for all axes or for each.",
        '"wall", "periodic" or "open", or three of them',
    )
    gravity: Vector = key((0.0, 0.0, -9.8), "Acceleration [m/s²].", A_VECTOR)
    drag: float = like("drag", default=0.06, help="Air drag [1/s]: v ← v·exp(−drag·t).")
    floor_restitution: float = like("floor_restitution")
    wall_friction: float = like("wall_friction")
    rolling_friction: float = like("rolling_friction")
    solver: Literal["substep", "reference"] = like("solver")
    iterations: int = like("iterations")
    cell_size: float | None = like("cell_size")


def _kind() -> Any:
    return key(..., "Where the spheres come from.", '"random", "lattice" or "given"')


class _StartTable(Table):
    kind: str
    count: int = like("particles", default=...)
    bounds: tuple[Vector, Vector] | None = key(
        None, "The part of the box that they start in [m]. Default: all of it.", "two corners, [[x, y, z], [x, y, z]]"
    )
    seed: int = like("seed")
    radius: tuple[Positive, Positive] = like("radius", allowed="two numbers above 0 m, the smaller one first")
    speed: tuple[NotNegative, NotNegative, NotNegative] = like("speed", allowed="three numbers from 0 m/s")
    restitution: tuple[Share, Share] = like("restitution", allowed="two numbers from 0 to 1, the smaller one first")
    density: float = like("density")
    friction: float = like("friction")


class RandomTable(_StartTable):
    """Spheres at random places: the arguments of random_spheres."""

    kind: Literal["random"] = _kind()


class LatticeTable(_StartTable):
    """Spheres in rows and layers, from the bottom up: the arguments of lattice_spheres."""

    kind: Literal["lattice"] = _kind()


_ONE_OR_EACH = ", one for all or a list with one for each sphere"


class GivenTable(Table):
    """Spheres one by one: the arguments of World.add."""

    kind: Literal["given"] = _kind()
    position: list[Vector] = key(..., "Centres [m], one for each sphere.", "a list of [x, y, z]", min_length=1)
    radius: Positive | list[Positive] = key(..., "Radius [m].", "a number above 0" + _ONE_OR_EACH)
    velocity: Vector | list[Vector] = key((0.0, 0.0, 0.0), "Velocity [m/s].", "[x, y, z]" + _ONE_OR_EACH)
    spin: Vector | list[Vector] | None = key(
        None, "Angular velocity [rad/s]. Default: none.", "[x, y, z]" + _ONE_OR_EACH
    )
    density: Positive | list[Positive] | None = key(
        None, "Density [kg/m³], or give mass. Default: 1000.", "a number above 0" + _ONE_OR_EACH
    )
    mass: Mass | list[Mass] | None = key(None, "Mass [kg], in place of the density.", "a number above 0" + _ONE_OR_EACH)
    restitution: Share | list[Share] = key(
        0.6, "Restitution; a pair uses the smaller one.", "a number from 0 to 1" + _ONE_OR_EACH
    )
    friction: NotNegative | list[NotNegative] | None = key(
        None, "Coulomb friction coefficient. Default: none.", "a number from 0" + _ONE_OR_EACH
    )


SpheresTable = Annotated[RandomTable | LatticeTable | GivenTable, Field(discriminator="kind")]


class RunTable(Table):
    """How long, and where it is computed."""

    frames: int = like("frames")
    fps: int = like("fps")
    device: str = like("device", pattern=r"^(auto|cpu|cuda(:\d{1,3})?)$")
    threads: int | None = like("threads")


class OutputTable(Table):
    """What is written. Paths start at the current folder."""

    folder: Path | None = like("output", default=None, help="Folder of the run. Default: the name of the scene file.")
    export_every: int = like("export_every")
    make_frame_files: bool = like("make_frame_files", allowed="true or false")
    trajectory: tuple[Path, ...] | None = like("trajectory", allowed="a list of paths that end in .gsd or .vtkhdf")
    ledger_every: int | None = like("ledger_every")
    parquet: bool = like("parquet", allowed="true or false")
    checkpoint_every: int = like("checkpoint_every")
    report: bool = like("report", allowed="true or false")
    make_video: bool = like("make_video", allowed="true or false")
    video: Path | None = like("video", default=None, help="Video file. Default: video.mp4 in the folder.")
    still: Path | None = like("still")
    video_fps: int | None = like("video_fps")
    width: int = like("width")
    height: int = like("height")
    supersampling: int = like("supersampling")
    color_by: ColorBy = like("color_by")
    color_range: tuple[Finite, Finite] | None = like("color_range", allowed="two numbers, the lower one first")
    color_map: Literal["tide", "ember"] = like("color_map")
    camera: Literal["auto", "front", "top", "orbit"] = like("camera")
    orbit_period: float = like("orbit_period")
    camera_position: Vector | None = like("camera_position", allowed=A_VECTOR)
    camera_target: Vector | None = like("camera_target", allowed=A_VECTOR)
    quality: int = like("quality")


class Range(Table):
    """What a number may be at the end of the run: { min = …, max = … } or one of the two."""

    min: Finite | None = key(None, "The smallest value that is good.", "a finite number")
    max: Finite | None = key(None, "The largest value that is good.", "a finite number")

    @model_validator(mode="after")
    def _is_a_range(self) -> Range:
        if self.min is None and self.max is None:
            raise ValueError("min or max, or both")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError("min up to max")
        return self


def _range(help: str) -> Any:
    return key(None, help, "{ min = number, max = number }, or one of the two")


class SphereExpectation(Table):
    """Where one sphere is and how it moves at the end."""

    id: int = key(..., "Number of the sphere, from 0.", "a whole number from 0", ge=0, strict=True)
    position: Vector | None = key(None, "Centre [m].", A_VECTOR)
    velocity: Vector | None = key(None, "Velocity [m/s].", A_VECTOR)
    spin: Vector | None = key(None, "Angular velocity [rad/s].", A_VECTOR)
    tolerance: NotNegative = key(1e-3, "Largest difference of a component.", "a number from 0")


class ExpectTable(Table):
    """What must hold after the last frame; if anything does not, the exit code is 1."""

    state_hash: str | None = key(
        None, "The state to the last bit, as `run` prints it.", "16 digits from 0 to f", pattern="^[0-9a-f]{16}$"
    )
    rms_speed: Range | None = _range("Root mean square of the speeds [m/s].")
    max_speed: Range | None = _range("Largest speed [m/s].")
    contacts: Range | None = _range("Overlapping pairs.")
    max_overlap: Range | None = _range("Deepest overlap of two spheres, or of a sphere and a wall [m].")
    mean_overlap: Range | None = _range("Mean overlap of the contacts, each as a part of its smaller radius.")
    escaped: Range | None = _range("Spheres whose centre lies outside the bounds.")
    energy_ratio: Range | None = _range("Energy at the end over that at the start.")
    motion_ratio: Range | None = _range("Energy of translation and rotation at the end over that at the start.")
    largest_energy_gain: Range | None = _range(
        "Largest rise of the energy from one row of the ledger to the next, over the energy at the start."
    )
    momentum_change: Range | None = _range(
        "Length of the change of momentum from the start, over the total mass times the rms speed at the start."
    )
    center_x: Range | None = _range("Centre of mass along x [m].")
    center_y: Range | None = _range("Centre of mass along y [m].")
    center_z: Range | None = _range("Centre of mass along z [m].")
    lowest_x: Range | None = _range("Smallest x of the spheres' surfaces [m].")
    lowest_y: Range | None = _range("Smallest y of the spheres' surfaces [m].")
    lowest_z: Range | None = _range("Smallest z of the spheres' surfaces [m].")
    highest_x: Range | None = _range("Largest x of the spheres' surfaces [m].")
    highest_y: Range | None = _range("Largest y of the spheres' surfaces [m].")
    highest_z: Range | None = _range("Largest z of the spheres' surfaces [m].")
    sphere: list[SphereExpectation] = key([], "Single spheres.", "tables [[expect.sphere]]")


class SceneFile(Table):
    """A FastCollide scene."""

    title: str = key("", "What the scene shows, in a few words.", "a text", strict=True)
    world: WorldTable = key(WorldTable(), "The box and what holds in it.", "a table [world]")
    spheres: list[SpheresTable] = key(..., "What starts in it.", "tables [[spheres]]", min_length=1)
    run: RunTable = key(RunTable(), "How long, and where it is computed.", "a table [run]")
    output: OutputTable = key(OutputTable(), "What is written.", "a table [output]")
    expect: ExpectTable = key(ExpectTable(), "What must hold at the end.", "a table [expect]")
