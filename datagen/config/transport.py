"""The section `transport`: how finely the light is followed."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from datagen.config.base import Settings
from datagen.records import Accuracy


class TransportConfig(Settings):
    """Sample counts; see `datagen.Accuracy`."""

    lookins: Annotated[int, Field(ge=1, le=2**31)] = 2048
    """Rays from each laser point into the scene."""
    fov_samples: Annotated[int, Field(ge=1, le=2**20)] = 4
    """FoV points that each lookin connects to, per pixel."""
    max_bounces: Annotated[int, Field(ge=3, le=3)] = 3
    """Highest bounce order followed; 3 is the primary."""
    scramblings: Annotated[int, Field(ge=1, le=1024)] = 4
    """Independent randomisations, from which the standard error comes."""

    def accuracy(self) -> Accuracy:
        return Accuracy(self.lookins, self.fov_samples, self.max_bounces, self.scramblings)
