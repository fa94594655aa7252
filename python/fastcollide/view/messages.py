"""What goes over the WebSocket: JSON both ways, and pictures to the browser as binary float32."""

from __future__ import annotations

import struct
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError, model_validator

from fastcollide.scene_schema import Finite, Share, like
from fastcollide.view.moments import Moment, ViewColor

LARGEST_MESSAGE = 4096  # bytes, from a browser
MAGIC = b"FCV1"
# magic, frame, index, moments, spheres, what follows the positions, time [s]
HEADER = struct.Struct("<4s5Id")
HAS_RADII, HAS_VALUES = 1, 2

Number = Annotated[int, Field(ge=0, lt=2**32)]
Acceleration = Annotated[Finite, Field(ge=-1000, le=1000)]


class InvalidMessage(ValueError):
    """A browser has sent something that is no message; the text says what was found and what is allowed."""


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Simple(_Message):
    """play, pause; step: one frame on; back: one moment back; reset: to the start."""

    type: Literal["play", "pause", "step", "back", "reset"]


class Acknowledge(_Message):
    """A picture has arrived and is drawn: another one may come."""

    type: Literal["ack"]


class Seek(_Message):
    """Show this moment of the past."""

    type: Literal["seek"]
    index: Number


class SetSpeed(_Message):
    """How fast it plays: 1 is real time."""

    type: Literal["speed"]
    factor: Annotated[Finite, Field(ge=0.01, le=100)]


class ColorBy(_Message):
    """What the colours of this browser show."""

    type: Literal["color"]
    by: ViewColor


class Select(_Message):
    """Tell this browser about a sphere, or about none."""

    type: Literal["select"]
    id: Number | None


class Conditions(_Message):
    """What of a running world is changed; restitution and friction are those of all spheres."""

    type: Literal["change"]
    gravity: tuple[Acceleration, Acceleration, Acceleration] | None = None
    drag: float | None = like("drag", default=None)
    restitution: Share | None = None
    floor_restitution: float | None = like("floor_restitution", default=None)
    friction: float | None = like("friction", default=None)
    wall_friction: float | None = like("wall_friction", default=None)

    @model_validator(mode="after")
    def _changes_something(self) -> Conditions:
        if not self.model_dump(exclude={"type"}, exclude_none=True):
            raise ValueError("nothing to change")
        return self


Message = Simple | Acknowledge | Seek | SetSpeed | ColorBy | Select | Conditions
_READER: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="type")])


def read_message(text: str) -> Message:
    """The message in a text from a browser. Raises InvalidMessage."""
    try:
        return _READER.validate_json(text)
    except ValidationError as error:
        fault = error.errors(include_url=False, include_context=False)[0]
        place = ".".join(str(part) for part in fault["loc"]) or "message"
        raise InvalidMessage(f"{place}: {fault['msg']}; found {_short(fault['input'])}") from None


def pack_picture(
    moment: Moment,
    index: int,
    moments: int,
    values: NDArray[np.float32] | None,
    *,
    with_radii: bool,
) -> bytes:
    """A picture for a browser: the header, then positions (n, 3), radii (n,) if asked for and values (n,) if any, all
    little-endian float32.

    index: of the moment, out of this many.
    """
    follows = (HAS_RADII if with_radii else 0) | (HAS_VALUES if values is not None else 0)
    parts = [moment.positions, *([moment.radii] if with_radii else []), *([values] if values is not None else [])]
    header = HEADER.pack(MAGIC, moment.frame % 2**32, index, moments, len(moment), follows, moment.time)
    return b"".join([header, *(np.ascontiguousarray(part, dtype="<f4").tobytes() for part in parts)])


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
