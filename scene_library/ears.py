"""Ears of plane polygons, cut off one after the other, compiled: a room has a dozen polygons, a mesh file some of a
thousand corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from scene_library.arrays import Floats

Ints = NDArray[np.int64]


def cut_ears(polygon: Floats) -> Ints:
    """The triangles (m, 3) of a polygon (n, 2), each of a corner and its neighbours at the time it was cut off."""
    # Each numpy function that a kernel calls is compiled with it, so arrays are made here.
    n = len(polygon)
    before, after, triangles = np.arange(n) - 1, np.arange(n) + 1, np.empty((n, 3), np.int64)
    before[0], after[-1] = n - 1, 0
    count = _cut_ears(polygon, before, after, np.zeros(n), triangles)
    if count < 0:
        raise ValueError("the polygon is not simple: no ear can be cut")
    return triangles[:count]


@compiled(allocates=False)
def _cut_ears(polygon: Floats, before: Ints, after: Ints, ears: Floats, triangles: Ints) -> int:
    """Number of triangles, which are written to `triangles`; −1 if there is no ear left to cut.

    before, after : (n,) number of the neighbours of each corner; the latter is set to −1 once it is cut off. ears :
    (n,) zeros.
    """
    n, count = len(polygon), 0
    for left in range(n, 2, -1):
        chosen = _first_fold(polygon, before, after)
        if chosen < 0:
            chosen = _fattest(ears)
            if left == 3:
                first = 0
                while after[first] < 0:
                    first += 1
                chosen = after[first]
            elif ears[chosen] <= 0.0:
                # Cutting an ear frees others, which are looked for when none is left.
                for i in range(n):
                    ears[i] = _ear(polygon, i, before, after)
                chosen = _fattest(ears)
                if ears[chosen] <= 0.0:
                    return -1
            triangles[count, 0], triangles[count, 1], triangles[count, 2] = before[chosen], chosen, after[chosen]
            count += 1
        a, c = before[chosen], after[chosen]
        after[a], before[c] = c, a
        # What was cut off has no neighbours, and is no ear.
        after[chosen], ears[chosen] = -1, 0.0
        ears[a], ears[c] = _ear(polygon, a, before, after), _ear(polygon, c, before, after)
    return count


@compiled(allocates=False)
def _fattest(ears: Floats) -> int:
    """The first corner whose ear is the fattest."""
    fattest = 0
    for i in range(len(ears)):
        if ears[i] > ears[fattest]:
            fattest = i
    return fattest


@compiled(allocates=False)
def _first_fold(polygon: Floats, before: Ints, after: Ints) -> int:
    """The first corner on the way back, as the tip of a spike and the end of a bridge, or on the next corner: it
    encloses nothing; −1 if there is none."""
    for i in range(len(polygon)):
        if after[i] < 0:
            continue
        a, b, c = polygon[before[i]], polygon[i], polygon[after[i]]
        x, y, u, v = b[0] - a[0], b[1] - a[1], c[0] - b[0], c[1] - b[1]
        if x * u + y * v <= 0.0 and abs(x * v - y * u) <= 1e-12 * (x * x + y * y + u * u + v * v):
            return i
    return -1


@compiled(allocates=False)
def _ear(polygon: Floats, i: int, before: Ints, after: Ints) -> float:
    """How fat the triangle at a corner of what is left of a polygon is, if it can be cut off; else 0."""
    if after[i] < 0:
        return 0.0
    a, b, c = polygon[before[i]], polygon[i], polygon[after[i]]
    area = _bend(a, b, c)
    size = abs(a[0] - c[0]) + abs(a[1] - c[1]) + abs(b[0] - a[0]) + abs(b[1] - a[1])
    size = size + abs(c[0] - b[0]) + abs(c[1] - b[1])
    # A corner that bends inwards, or not at all, is none.
    if area <= 1e-12 * size**2:
        return 0.0
    rounding = -1e-9 * area
    for k in range(len(polygon)):
        if after[k] < 0:
            continue
        other = polygon[k]
        # A corner on the rim, but for rounding, is in the way. Where the outline touches itself, the corners of
        # the triangle come again, and the sides that leave there must not cross the cut.
        is_apart = _span(other, a) > 0.0 and _span(other, b) > 0.0 and _span(other, c) > 0.0
        is_inside = (
            _bend(a, b, other) >= rounding and _bend(b, c, other) >= rounding and _bend(c, a, other) >= rounding
        )
        if (is_apart and is_inside) or _crosses(c, a, other, polygon[after[k]]):
            return 0.0
    return float(area / size**2)


@compiled(allocates=False)
def crosses_itself(polygon: Floats) -> bool:
    """Whether two sides of a polygon cross; sides that touch, or run along each other, do not."""
    n = len(polygon)
    for i in range(n - 2):
        for k in range(i + 1, n):
            if _crosses(polygon[i], polygon[i + 1], polygon[k], polygon[(k + 1) % n]):
                return True
    return False


@compiled(allocates=False)
def _crosses(a: Floats, b: Floats, start: Floats, end: Floats) -> bool:
    """Whether the side from `start` to `end` crosses that from `a` to `b` within both."""
    # Areas below rounding are those of sides that end on one another.
    least = 1e-12 * (_span(a, start) + _span(a, end) + _span(a, b)) ** 2
    return _are_opposite(_bend(start, end, a), _bend(start, end, b), least) and _are_opposite(
        _bend(a, b, start), _bend(a, b, end), least
    )


@compiled(allocates=False)
def _are_opposite(one: float, other: float, least: float) -> bool:
    """Whether one of two areas is above `least`, and the other below its opposite."""
    return (one > least and other < -least) or (other > least and one < -least)


@compiled(allocates=False)
def _span(a: Floats, b: Floats) -> float:
    """How far apart two points are, along both axes together."""
    return float(abs(b[0] - a[0]) + abs(b[1] - a[1]))


@compiled(allocates=False)
def _bend(a: Floats, b: Floats, c: Floats) -> float:
    """Twice the signed area of a triangle."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
