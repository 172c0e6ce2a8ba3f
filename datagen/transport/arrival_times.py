"""Time bins of an element's light, exact for a triangle over which arrival time and weight vary linearly.

The share of light that has arrived by time t has a closed form: up to the time of the middle vertex, the part of the
triangle that has arrived is a smaller triangle at the earliest vertex; after it, the part that is still to come is a
smaller triangle at the latest vertex.
"""

from __future__ import annotations

import math

from datagen.compiled import compiled
from datagen.records.arrays import Floats


@compiled(allocates=False)
def tent(
    a: float, b: float, c: float, at_a: float, at_b: float, at_c: float, energy: float
) -> tuple[float, float, float, float, float, float, float]:
    """The times of a triangle's vertices in order, a ≤ b ≤ c, and the numbers low, up, high and down.

    By time a + x ≤ b, x² (low + x · up) of the energy has arrived; at time c − x ≥ b, x² (high + x · down) is still
    to come.
    """
    # Three exchanges without branches sort the vertices by time.
    a, b, at_a, at_b = (b, a, at_b, at_a) if a > b else (a, b, at_a, at_b)
    b, c, at_b, at_c = (c, b, at_c, at_b) if b > c else (b, c, at_b, at_c)
    a, b, at_a, at_b = (b, a, at_b, at_a) if a > b else (a, b, at_a, at_b)
    # Where all weights are zero, the energy comes from all of the triangle alike.
    whole = (at_a + at_b + at_c) / 3.0
    at_a, at_b, at_c, whole = (1.0, 1.0, 1.0, 1.0) if whole <= 0.0 else (at_a, at_b, at_c, whole)
    scale = energy / whole / (c - a)
    # Two vertices at one time leave one of the two smaller triangles empty.
    early, late = 1.0 / (b - a), 1.0 / (c - b)
    early, late = early if b > a else 0.0, late if c > b else 0.0
    low, high = scale * early * at_a, scale * late * at_c
    up = scale * early * ((at_b - at_a) * early + (at_c - at_a) / (c - a)) * (1.0 / 3.0)
    down = scale * late * ((at_b - at_c) * late + (at_a - at_c) / (c - a)) * (1.0 / 3.0)
    return a, b, c, low, up, high, down


@compiled(allocates=False)
def pour(
    histogram: Floats, row: int, shape: tuple[float, float, float, float, float, float, float], energy: float
) -> float:
    """Energy outside the bins, after `energy` was added to a row of bins with the distribution of a `tent`."""
    a, b, c, low, up, high, down = shape
    bins = histogram.shape[1]
    # Beyond 1e15 bins, whole numbers are no longer exact; NaN fails each comparison.
    if not (c > 0.0 and a < bins and c < 1e15 and a > -1e15):
        return energy
    first = math.floor(a)
    # All of it falls into one bin, and is added there without the rounding of differences.
    if c < first + 1 or not c > a:
        if not 0.0 <= b < bins:
            return energy
        histogram[row, int(b)] += energy
        return 0.0
    stop, outside = min(bins, math.ceil(c)), 0.0
    # What arrives before the window opens.
    if first < 0:
        outside = a * a * (low - a * up) if b >= 0.0 else energy - c * c * (high + c * down)
    # Each bin gets the difference of what has arrived by its two edges: up to the middle vertex from the start …
    before, middle = outside, min(stop, math.floor(b))
    for i in range(max(first, 0), middle):
        x = i + 1.0 - a
        now = x * x * (low + x * up)
        histogram[row, i] += now - before
        before = now
    # … and after it from the end, so that small differences of nearly all the energy keep their digits.
    left = energy - before
    for i in range(max(first, middle, 0), stop):
        x = max(c - (i + 1.0), 0.0)
        rest = x * x * (high + x * down)
        histogram[row, i] += left - rest
        left = rest
    return outside + (left if stop < c else 0.0)
