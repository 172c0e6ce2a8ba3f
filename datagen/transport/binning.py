"""A path's energy into the time bins: split between the two nearest bins so that its mean arrival time is exact."""

from __future__ import annotations

import math

from numba import njit

from datagen.records.arrays import Floats


@njit(cache=True, inline="always")
def splat(histogram: Floats, position: float, energy: float) -> float:
    """Add `energy` at fractional bin `position` (bin i spans i … i + 1) and return what fell outside the window.

    With weights linear in the distance to the two nearest bin centres, the first moment is kept exactly. Nothing is
    wrapped or piled into an end bin: what lies beyond is returned, to be tallied as overflow.
    """
    shifted = position - 0.5
    bins = histogram.shape[0]
    if not (-1.0 <= shifted < bins):
        return energy
    lower = math.floor(shifted)
    upper_share = shifted - lower
    outside = 0.0
    if lower >= 0:
        histogram[lower] += energy * (1.0 - upper_share)
    else:
        outside += energy * (1.0 - upper_share)
    if lower + 1 < bins:
        histogram[lower + 1] += energy * upper_share
    else:
        outside += energy * upper_share
    return outside
