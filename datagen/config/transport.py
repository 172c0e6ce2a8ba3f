"""The section `transport`: how finely the light is followed, and which of it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from datagen.config.base import Settings
from datagen.errors import InputError
from datagen.records import Accuracy
from datagen.records.accuracy import chosen_by_target

CHOSEN_BY_TARGET = ("lookins", "fov_samples", "replicates")


class TransportConfig(Settings):
    """Sample counts and effects; see `datagen.Accuracy`."""

    lookins: Annotated[int, Field(ge=1, le=2**31)] = 2048
    """Rays from each laser point into the scene."""
    fov_samples: Annotated[int, Field(ge=1, le=2**20)] = 4
    """FoV points that each vertex of a light path connects to, per pixel."""
    max_bounces: Annotated[int, Field(ge=3, le=64)] | None = 3
    """Highest bounce order followed; 3 is the primary, 4 adds the secondary; null follows all orders."""
    replicates: Annotated[int, Field(ge=1, le=1024)] = 4
    """Independent randomisations, from which the standard error comes."""
    observed: Annotated[int, Field(ge=1, le=2**24)] | None = None
    """Observed points of each lookin: the secondary in the factorised form; left out: by the walk."""
    secondary: Literal["all", "none", "strongest"] | Annotated[int, Field(ge=1)] = "all"
    """All secondary paths, none, or only the strongest (or k strongest) of each lookin, which needs `observed`."""
    direct: bool = False
    """Also the direct return (1 and 2 bounces), which a gated measurement keeps out."""
    target: Annotated[float, Field(ge=1e-4, le=1)] | None = None
    """Relative L2 error of each transient to be met: then the sample counts are chosen, and may not be given."""
    part_target: Annotated[float, Field(ge=1e-4, le=1)] | None = None
    """With `target`: relative L2 error of each object's own primary; left out: 2.5 times the target, at most 1."""
    max_lookins: Annotated[int, Field(ge=2048, le=2**40)] = 1 << 23
    """With `target`: give up before more rays than this leave each laser point, on average, in all."""

    def accuracy(self) -> Accuracy:
        """The same as the record that `simulate` takes."""
        others = ("target", "part_target", "max_lookins") if self.target is None else CHOSEN_BY_TARGET
        return Accuracy(**{name: getattr(self, name) for name in type(self).model_fields if name not in others})

    @model_validator(mode="after")
    def _consistent(self) -> TransportConfig:
        if self.part_target is not None and self.target is None:
            raise InputError(f"part_target = {self.part_target}: needs a target; set target, too")
        if self.target is not None:
            for name in CHOSEN_BY_TARGET:
                if name in self.model_fields_set:
                    raise InputError(chosen_by_target("", name, getattr(self, name)))
        self.accuracy()
        return self

    @model_serializer(mode="wrap")
    def _without_chosen(self, written: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Counts that the target chooses are left out, so that what is written can be read again."""
        values: dict[str, Any] = written(self)
        return values if self.target is None else {k: v for k, v in values.items() if k not in CHOSEN_BY_TARGET}
