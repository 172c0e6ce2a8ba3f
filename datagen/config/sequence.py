"""The section `sequence`: each scene is measured in frames, one after the other, while things move."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

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


def sequence_said(sequence: Mapping[str, Any], capture: Mapping[str, Any]) -> str:
    """How frames are measured, for people, from the plain values of the sections `sequence` and `capture`."""
    order, motion = sequence["order"], capture.get("motion")
    at_once = order == "together" or capture["illumination"] == "flood"
    lit = "all laser points at once" if at_once else f"laser points in the order {order}"
    moves = "" if motion is None else f"; the sensor moves ({motion['kind']})"
    return f"{sequence['rate_hz']:g} a second, {lit}{moves}"
