"""The section `labels`: which ground truth stands beside the measurement."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from datagen.config.base import Settings


class LabelsConfig(Settings):
    """Label images look from the plane of the relay wall into the hidden part, orthographically."""

    rows: Annotated[int, Field(ge=1, le=4096)] = 64
    columns: Annotated[int, Field(ge=1, le=4096)] = 64
