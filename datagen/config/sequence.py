"""The section `sequence`: each scene is measured in frames, one after the other, while things move."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from datagen.config.base import Settings
from datagen.records.clock import MOST_FRAMES, Order


class SequenceConfig(Settings):
    """The frames of a sequence. Frame f begins f / `rate_hz` seconds after the first, and its laser points follow one
    another without a gap, each for the exposure of the detector."""

    frames: Annotated[int, Field(ge=2, le=MOST_FRAMES)]
    """How many frames each scene has."""
    rate_hz: Annotated[float, Field(ge=1e-3, le=1e9)]
    """Frames in a second. The exposures of all laser points must fit into a frame."""
    order: Order = "raster"
    """In which laser points are measured. `raster`: row by row; `serpentine`: every second row backwards;
    `interleaved`: four coarse scans, each of every second point of every second row; `together`: all at once."""
