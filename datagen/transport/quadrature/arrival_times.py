"""When the light of an element arrives: the exact distribution over time bins of a triangle's linear arrival time.

Over a triangle whose arrival time and weight vary linearly, the share of light that has come by time x is closed: the
part of the triangle before x is, up to the middle vertex, a triangle similar in kind at the earliest vertex, and
behind it the whole less one at the latest.
"""

from __future__ import annotations

import math

from datagen.compiled import compiled
from datagen.records.arrays import Floats


@compiled()
def widened(a: float, b: float, c: float, variance: float) -> tuple[float, float, float]:
    """Arrival times at the vertices, such that those of the triangle have the same mean and a variance larger by so
    much: light that is spread once more, as by a footprint of a pixel, whose own spread is short of the
    triangle's."""
    mean = (a + b + c) / 3.0
    own = ((a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2) / 12.0
    stretch, half = math.sqrt(1.0 + variance / own), math.sqrt(6.0 * (variance + own))
    stretched = own > 0.01 * variance
    return (
        mean + (a - mean) * stretch if stretched else mean - half,
        mean + (b - mean) * stretch if stretched else mean,
        mean + (c - mean) * stretch if stretched else mean + half,
    )


@compiled()
def spread(
    histogram: Floats, row: int, a: float, b: float, c: float, at_a: float, at_b: float, at_c: float, energy: float
) -> float:
    """Add `energy` over the bins of a row as it arrives from a triangle, and return what fell outside the window.

    histogram : (rows, T) bin i spans times i … i + 1.
    a, b, c : arrival times at the vertices, in bins; linear in between.
    at_a, at_b, at_c : weights ≥ 0 there, in any unit; linear in between.
    """
    return pour(histogram, row, tent(a, b, c, at_a, at_b, at_c, energy), energy)


@compiled()
def tent(
    a: float, b: float, c: float, at_a: float, at_b: float, at_c: float, energy: float
) -> tuple[float, float, float, float, float, float, float]:
    """How `energy` arrives from a triangle: its vertices' times in order, a ≤ b ≤ c, and four numbers of its sides.

    The line that has come by time a + x cuts off shares x/(b − a) and x/(c − a) of two sides, and holds
    x² (low + x · up) of the energy; what is still to come at c − x is x² (high + x · down).
    """
    a, b, at_a, at_b = (b, a, at_b, at_a) if a > b else (a, b, at_a, at_b)
    b, c, at_b, at_c = (c, b, at_c, at_b) if b > c else (b, c, at_b, at_c)
    a, b, at_a, at_b = (b, a, at_b, at_a) if a > b else (a, b, at_a, at_b)
    whole = (at_a + at_b + at_c) / 3.0
    at_a, at_b, at_c, whole = (1.0, 1.0, 1.0, 1.0) if whole <= 0.0 else (at_a, at_b, at_c, whole)
    scale = energy / whole / (c - a)
    early, late = 1.0 / (b - a), 1.0 / (c - b)
    early, late = early if b > a else 0.0, late if c > b else 0.0
    low, high = scale * early * at_a, scale * late * at_c
    up = scale * early * ((at_b - at_a) * early + (at_c - at_a) / (c - a)) * (1.0 / 3.0)
    down = scale * late * ((at_b - at_c) * late + (at_a - at_c) / (c - a)) * (1.0 / 3.0)
    return a, b, c, low, up, high, down


@compiled()
def pour(
    histogram: Floats, row: int, shape: tuple[float, float, float, float, float, float, float], energy: float
) -> float:
    """Add `energy` over the bins of a row in the shape of a `tent`, and return what fell outside the window."""
    a, b, c, low, up, high, down = shape
    bins = histogram.shape[1]
    if not (c > 0.0 and a < bins and c < 1e15 and a > -1e15):
        return energy
    first = math.floor(a)
    if c < first + 1 or not c > a:
        if not 0.0 <= b < bins:
            return energy
        histogram[row, int(b)] += energy
        return 0.0
    stop, outside = min(bins, math.ceil(c)), 0.0
    if first < 0:
        outside = a * a * (low - a * up) if b >= 0.0 else energy - c * c * (high + c * down)
    before, middle = outside, min(stop, math.floor(b))
    for i in range(max(first, 0), middle):
        x = i + 1.0 - a
        now = x * x * (low + x * up)
        histogram[row, i] += now - before
        before = now
    left = energy - before
    for i in range(max(first, middle, 0), stop):
        x = max(c - (i + 1.0), 0.0)
        rest = x * x * (high + x * down)
        histogram[row, i] += left - rest
        left = rest
    return outside + (left if stop < c else 0.0)
