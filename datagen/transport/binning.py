"""A path's energy into the time bins. A bin is the integral of the flux between its edges, what a TDC counts."""

from __future__ import annotations

from datagen.compiled import compiled
from datagen.records.arrays import Floats


@compiled(inline="always")
def put(histogram: Floats, position: float, energy: float) -> float:
    """Add `energy` to the bin that holds `position` (bin i spans i … i + 1); returns what fell outside the window.

    Narrow bins thus add up to wide ones. Nothing is wrapped or piled into an end bin: what lies beyond is returned,
    to be tallied as overflow.
    """
    if not 0.0 <= position < len(histogram):
        return energy
    histogram[int(position)] += energy
    return 0.0
