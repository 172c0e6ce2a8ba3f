"""The section `store`: which fields a dataset holds and how they are cut into shards."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from datagen.config.base import Settings
from datagen.records.label_fields import LabelName

StoredField = Literal[
    "histogram", "transient", "transient_stderr", "moving_transient", "background_histogram", "background_transient",
    LabelName,
]  # fmt: skip


class StoreConfig(Settings):
    """What is written. Small fields (laser points, pixels, parameters) are always there."""

    fields: Annotated[tuple[StoredField, ...], Field(min_length=1)] = ("histogram", "transient", "depth")
    """The fields to store. `moving_transient`, of a `sequence`: the part of the transient that is by what moves.
    `objects`: tables of object classes, poses, boxes and evidence. `evidence`: the image of
    expected detections from each label pixel. `background_histogram` and `background_transient`: counts and light of
    the same room without its objects, which takes one more simulation. `presence`: the significance of the difference
    between the scene with an object and without it, which takes one more simulation for each object. `zone_depth`:
    the depth of what each zone of the sensor (or each pixel) sees first."""
    scenes_per_shard: Annotated[int, Field(ge=1, le=256)] | None = None
    """A power of two; left out: chosen by the size of a sample and the number of scenes (8 to 256, shards of at most
    256 MiB)."""
    histogram_dtype: Literal["uint8", "uint16", "uint32"] = "uint16"
    """Counts above its range are an error, never wrapped."""

    def _check(self) -> None:
        k = self.scenes_per_shard
        if k is not None and k & (k - 1):
            raise ValueError(f"scenes_per_shard = {k}: must be a power of two in 1 … 256")
        if len(set(self.fields)) != len(self.fields):
            raise ValueError(f"fields = {list(self.fields)}: a field is named twice")
