"""The section `transport`: how finely the light is followed, and which of it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from datagen.config.base import Settings
from datagen.records import Accuracy


class TransportConfig(Settings):
    """Sample counts and effects; see `datagen.Accuracy`."""

    lookins: Annotated[int, Field(ge=1, le=2**31)] = 2048
    """Rays from each laser point into the scene."""
    fov_samples: Annotated[int, Field(ge=1, le=2**20)] = 4
    """FoV points that each vertex of a light path connects to, per pixel."""
    max_bounces: Annotated[int, Field(ge=3, le=64)] | None = 3
    """Highest bounce order followed; 3 is the primary, 4 adds the secondary; null follows all orders."""
    scramblings: Annotated[int, Field(ge=1, le=1024)] = 4
    """Independent randomisations, from which the standard error comes."""
    observed: Annotated[int, Field(ge=1, le=2**24)] | None = None
    """Observed points of each lookin: the secondary in the factorised form; left out: by the walk."""
    secondary: Literal["all", "none", "strongest"] | Annotated[int, Field(ge=1)] = "all"
    """All secondary paths, none, or only the strongest (or k strongest) of each lookin, which needs `observed`."""
    direct: bool = False
    """Also the direct return (1 and 2 bounces), which a gated measurement keeps out."""

    def accuracy(self) -> Accuracy:
        return Accuracy(
            lookins=self.lookins,
            fov_samples=self.fov_samples,
            max_bounces=self.max_bounces,
            scramblings=self.scramblings,
            direct=self.direct,
            observed=self.observed,
            secondary=self.secondary,
        )

    @model_validator(mode="after")
    def _consistent(self) -> TransportConfig:
        self.accuracy()
        return self
