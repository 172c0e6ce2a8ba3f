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


@njit(cache=True, error_model="numpy")
def _within(along_b: float, along_c: float, at_a: float, at_b: float, at_c: float) -> float:
    """∫ weight over the part of a unit triangle a, b, c that a line cuts off at a: shares of the sides to b and c."""
    return along_b * along_c * (at_a + (along_b * (at_b - at_a) + along_c * (at_c - at_a)) * (1.0 / 3.0))


@njit(cache=True, error_model="numpy")
def widened(a: float, b: float, c: float, variance: float) -> tuple[float, float, float]:
    """Arrival times at the vertices, such that those of the triangle have the same mean and a variance larger by so
    much: light that is spread once more, as by a patch of a pixel, whose own spread is short of the triangle's."""
    mean = (a + b + c) / 3.0
    own = ((a - mean) ** 2 + (b - mean) ** 2 + (c - mean) ** 2) / 12.0
    if own > 0.01 * variance:
        stretch = math.sqrt(1.0 + variance / own)
        return mean + (a - mean) * stretch, mean + (b - mean) * stretch, mean + (c - mean) * stretch
    half = math.sqrt(6.0 * (variance + own))
    return mean - half, mean, mean + half


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
    to_c, to_b, from_b = 1.0 / (c - a), 1.0 / (b - a) if b > a else 0.0, 1.0 / (c - b) if c > b else 0.0
    if c < 0.0 or a >= bins:
        return energy
    i = first
    if first < 0:
        i = 0
        before = _until(0.0, a, b, c, at_a, at_b, at_c, whole, to_b, from_b, to_c)
        outside += before * scale
    while i < bins:
        now = _until(i + 1.0, a, b, c, at_a, at_b, at_c, whole, to_b, from_b, to_c)
        histogram[i] += (now - before) * scale
        before = now
        i += 1
        if i >= c:
            break
    return outside + (whole - before) * scale


@njit(cache=True, error_model="numpy")
def _until(
    x: float, a: float, b: float, c: float, at_a: float, at_b: float, at_c: float, whole: float, to_b: float,
    from_b: float, to_c: float,
) -> float:  # fmt: skip
    """∫ weight over what comes before time x; `to_b` = 1/(b − a), `from_b` = 1/(c − b), `to_c` = 1/(c − a)."""
    if x >= c:
        return whole
    if x <= a:
        return 0.0
    if x <= b:
        return _within((x - a) * to_b, (x - a) * to_c, at_a, at_b, at_c)
    return whole - _within((c - x) * from_b, (c - x) * to_c, at_c, at_b, at_a)
