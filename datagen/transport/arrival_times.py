"""Time bins of an element's light, exact for a triangle over which arrival time and weight vary linearly.

The share of light that has arrived by time t has a closed form: up to the time of the middle vertex, the part of the
triangle that has arrived is a smaller triangle at the earliest vertex; after it, the part that is still to come is a
smaller triangle at the latest vertex.
"""

from __future__ import annotations

import math

import numpy as np

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
    whole = (at_a + at_b + at_c) * (1.0 / 3.0)
    at_a, at_b, at_c, whole = (1.0, 1.0, 1.0, 1.0) if whole <= 0.0 else (at_a, at_b, at_c, whole)
    # Two vertices at one time leave one of the two smaller triangles empty.
    early, late, of_all = 1.0 / (b - a), 1.0 / (c - b), 1.0 / (c - a)
    early, late, scale = early if b > a else 0.0, late if c > b else 0.0, energy / whole * of_all
    low, high = scale * early * at_a, scale * late * at_c
    up = scale * early * ((at_b - at_a) * early + (at_c - at_a) * of_all) * (1.0 / 3.0)
    down = scale * late * ((at_b - at_c) * late + (at_a - at_c) * of_all) * (1.0 / 3.0)
    return a, b, c, low, up, high, down


@compiled(forceinline=True, allocates=False)
def _add(histogram, row, first, stop, at, by, square):  # type: ignore[no-untyped-def]
    """Adds at + k by + k² square to the bins first + k of a row, up to `stop`."""
    # Whole numbers of 32 bits become floats several at a time, and indices without a sign are taken as they are.
    start, own = np.uint64(first), np.uint64(row)
    for k in range(np.int32(stop - first)):
        x = np.float64(k)
        histogram[own, start + np.uint64(k)] += at + x * (by + x * square)


@compiled(allocates=False)
def pour(
    histogram: Floats, row: int, shape: tuple[float, float, float, float, float, float, float], energy: float
) -> float:
    """Energy outside the bins, after `energy` was added to a row of bins with the distribution of a `tent`."""
    a, b, c, low, up, high, down = shape
    bins: int = histogram.shape[1]
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
    last, outside = math.floor(c), 0.0
    # What arrives before the window opens.
    if first < 0:
        outside = a * a * (low - a * up) if b >= 0.0 else energy - c * c * (high + c * down)
    i, middle, before = max(first, 0), min(math.floor(b), bins), outside
    # Bins before that of the middle vertex: the first one, and those whose light is a difference of cubes.
    if i < middle:
        x = i + 1.0 - a
        histogram[row, i] += x * x * (low + x * up) - before
        at, by = low * (2.0 * x + 1.0) + up * (3.0 * x * (x + 1.0) + 1.0), 2.0 * low + up * (6.0 * x + 3.0)
        _add(histogram, row, i + 1, middle, at, by, 3.0 * up)
        x = middle - a
        i, before = middle, x * x * (low + x * up)
    # That bin, and those after it from the end, so that small differences of nearly all the energy keep their digits.
    if i == bins:
        return outside + energy - before
    x = max(c - (i + 1.0), 0.0)
    histogram[row, i] += energy - before - x * x * (high + x * down)
    x -= 1.0
    at, by = high * (2.0 * x + 1.0) + down * (3.0 * x * (x + 1.0) + 1.0), 2.0 * high + down * (6.0 * x + 3.0)
    _add(histogram, row, i + 1, min(last, bins), at, -by, 3.0 * down)
    if last < bins:
        x = c - last
        histogram[row, last] += x * x * (high + x * down) if last > i else 0.0
        return outside
    x = c - bins
    return outside + x * x * (high + x * down)
