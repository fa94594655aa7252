"""What a checkpoint says about its run, so that its folder alone is enough to go on with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from fastcollide.archive import Archive
from fastcollide.checkpoints import Checkpoints
from fastcollide.errors import CheckpointError
from fastcollide.expectations import Start
from fastcollide.parameters import InvalidSetting
from fastcollide.run_folder import seen_from_folder, seen_from_here, shared_part
from fastcollide.scene_schema import ExpectTable
from fastcollide.settings import SimulationSettings
from fastcollide.source import Source


class RunRecord(BaseModel):
    """A run: its settings, where it comes from, and of a scene what is expected of its end and how it started."""

    model_config = ConfigDict(extra="forbid", frozen=True, ser_json_inf_nan="constants")

    settings: SimulationSettings
    source: Source
    expect: ExpectTable | None = None
    start: Start | None = None

    def packed(self) -> dict[str, Any]:
        """As values of JSON. Files of the run are named from its folder, so that both can be moved together."""
        settings = seen_from_folder(shared_part(self.settings))
        return self.model_copy(update={"settings": settings}).model_dump(mode="json")


def record_in(archive: Archive, folder: Path) -> RunRecord:
    """The run that a checkpoint in this folder belongs to.

    Raises CheckpointError where it belongs to none.
    """
    try:
        record = RunRecord.model_validate(archive.contents.get("run"))
    except (ValidationError, InvalidSetting) as error:
        reason = " ".join(str(error).split())
        raise CheckpointError(archive.path, None, f"no settings of a run ({reason})", "a checkpoint of a run") from None
    return record.model_copy(update={"settings": seen_from_here(record.settings, folder)})


def checkpoints_of(
    settings: SimulationSettings, source: Source, expect: ExpectTable | None = None, start: Start | None = None
) -> Checkpoints | None:
    """Where this run writes its checkpoints; None where it writes none."""
    if not settings.checkpoint_every:
        return None
    record = RunRecord(settings=settings, source=source, expect=expect, start=start)
    return Checkpoints(settings.output, record.packed())
