"""When the light of a cell arrives: the exact distribution over time bins of a triangle's linear arrival time.

Over a triangle whose arrival time and weight vary linearly, the share of light that has come by time x is closed: the
part of the triangle before x is, up to the middle vertex, a triangle similar in kind at the earliest vertex, and
behind it the whole less one at the latest.
"""

from __future__ import annotations

import math

from numba import njit

from datagen.records.arrays import Floats
from datagen.transport.binning import put


@njit(cache=True, inline="always")
def _before(x: float, a: float, b: float, c: float, at_a: float, at_b: float, at_c: float) -> float:
    """∫ weight over the part of a unit triangle that comes before time x, a ≤ x ≤ b ≤ c the times of its vertices."""
    along_b = (x - a) / (b - a) if b > a else 1.0
    along_c = (x - a) / (c - a)
    return along_b * along_c * (at_a + (along_b * (at_b - at_a) + along_c * (at_c - at_a)) / 3.0)


@njit(cache=True)
def spread(
    histogram: Floats, a: float, b: float, c: float, at_a: float, at_b: float, at_c: float, energy: float
) -> float:
    """Add `energy` over the bins as it arrives from a triangle, and return what fell outside the window.

    histogram : (T,) bin i spans times i … i + 1.
    a, b, c : arrival times at the vertices, in bins; linear in between.
    at_a, at_b, at_c : weights ≥ 0 there, in any unit; linear in between.
    """
    if a > b:
        a, b, at_a, at_b = b, a, at_b, at_a
    if b > c:
        b, c, at_b, at_c = c, b, at_c, at_b
    if a > b:
        a, b, at_a, at_b = b, a, at_b, at_a
    first, bins = math.floor(a), len(histogram)
    if not (c < 1e15 and a > -1e15):
        return energy
    if c < first + 1 or not c > a:
        return put(histogram, b, energy)
    whole = (at_a + at_b + at_c) / 3.0
    if whole <= 0.0:
        at_a = at_b = at_c = whole = 1.0
    scale, outside, before = energy / whole, 0.0, 0.0
    if c < 0.0 or a >= bins:
        return energy
    i = first
    if first < 0:
        i = 0
        before = _until(0.0, a, b, c, at_a, at_b, at_c, whole)
        outside += before * scale
    while i < bins:
        now = _until(i + 1.0, a, b, c, at_a, at_b, at_c, whole)
        histogram[i] += (now - before) * scale
        before = now
        i += 1
        if i >= c:
            break
    return outside + (whole - before) * scale


@njit(cache=True, inline="always")
def _until(x: float, a: float, b: float, c: float, at_a: float, at_b: float, at_c: float, whole: float) -> float:
    if x >= c:
        return whole
    if x <= a:
        return 0.0
    if x <= b:
        return _before(x, a, b, c, at_a, at_b, at_c)
    return whole - _before(-x, -c, -b, -a, at_c, at_b, at_a)
