"""Time bins: a bin holds the integral of the flux between its edges, as a TDC counts it."""

from __future__ import annotations

from datagen.compiled import compiled
from datagen.records.arrays import Floats


@compiled(inline="always")
def add_to_bin(histogram: Floats, position: float, energy: float) -> float:
    """The energy that falls outside the window: 0 after `energy` was added to a bin, else all of it.

    position : fractional bin; bin i spans i … i + 1. A contribution goes whole into one bin, so that narrow bins add
    up exactly to wide ones. Light outside the window is neither wrapped around nor added to an end bin: the caller
    adds it to the overflow.
    """
    # Written so that a position that is NaN falls outside.
    if not 0.0 <= position < len(histogram):
        return energy
    histogram[int(position)] += energy
    return 0.0
