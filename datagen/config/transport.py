"""The section `transport`: how finely the light is followed, and which of it."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

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
    direct: bool = False
    """Also the direct return (1 and 2 bounces), which a gated measurement keeps out."""

    def accuracy(self) -> Accuracy:
        return Accuracy(self.lookins, self.fov_samples, self.max_bounces, self.scramblings, self.direct)
