"""The section `transport`: how finely the light is followed, and which of it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from datagen.config.base import Settings
from datagen.errors import InputError
from datagen.records import Accuracy
from datagen.records.accuracy import CHOSEN_BY_TARGET, LIMITS, TARGETS, chosen_by_target


def _within(name: str) -> Any:
    """The limits of a number of `Accuracy`, as pydantic takes them."""
    low, high = LIMITS.get(name, TARGETS)
    return Field(ge=low, le=high)


class TransportConfig(Settings):
    """Sample counts and effects; see `datagen.Accuracy`."""

    lookins: Annotated[int, _within("lookins")] = int(Accuracy.lookins)
    """Rays from each laser point into the scene."""
    fov_samples: Annotated[int, _within("fov_samples")] = int(Accuracy.fov_samples)
    """FoV points that each vertex of a light path connects to, per pixel."""
    max_bounces: Annotated[int, _within("max_bounces")] | None = Accuracy.max_bounces
    """Highest bounce order followed; 3 is the primary, 4 adds the secondary; null follows all orders."""
    replicates: Annotated[int, _within("replicates")] = int(Accuracy.replicates)
    """Independent randomisations, from which the standard error comes."""
    observed: Annotated[int, _within("observed")] | None = None
    """Observed points of each lookin: the secondary in the factorised form; left out: by the walk."""
    secondary: Literal["all", "none", "strongest"] | Annotated[int, Field(ge=1)] = "all"
    """All secondary paths, none, or only the strongest (or k strongest) of each lookin, which needs `observed`."""
    direct: bool = False
    """Also the direct return (1 and 2 bounces), which a gated measurement keeps out."""
    target: Annotated[float, _within("target")] | None = None
    """Relative L2 error of each transient to be met: then the sample counts are chosen, and may not be given."""
    part_target: Annotated[float, _within("part_target")] | None = None
    """With `target`: relative L2 error of each object's own primary; left out: 2.5 times the target, at most 1."""
    max_lookins: Annotated[int, _within("max_lookins")] = Accuracy.max_lookins
    """With `target`: give up before more rays than this leave each laser point, on average, in all."""

    def accuracy(self) -> Accuracy:
        """The record of this section that `simulate` takes."""
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

    def unwritten(self) -> tuple[str, ...]:
        """The counts that a target chooses."""
        return () if self.target is None else CHOSEN_BY_TARGET
