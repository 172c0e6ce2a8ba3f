"""How far apart convex polygons are, compiled: furnishing asks that some hundred times for a crowded room."""

from __future__ import annotations

import numpy as np

from datagen.compiled import compiled
from scene_library.arrays import Floats


@compiled()
def gap_between(a: Floats, b: Floats) -> float:
    """How far apart convex polygons (n, 2) and (m, 2) are along the best separating edge normal, metres.

    Negative where they overlap, and never more than the true distance (separating-axis theorem), so asking for a gap
    is always on the safe side.
    """
    return max(_along_normals(a, b), _along_normals(b, a))


@compiled()
def stays_clear(footprint: Floats, triangles: Floats, margin_m: float) -> bool:
    """Whether a convex footprint (n, 2) has a gap of at least `margin_m` to each of (m, 3, 2) triangles.

    A triangle whose bounding box is further away than that is not asked.
    """
    low_x, high_x = _extent(footprint, 1.0, 0.0)
    low_y, high_y = _extent(footprint, 0.0, 1.0)
    for k in range(len(triangles)):
        triangle = triangles[k]
        low, high = _extent(triangle, 1.0, 0.0)
        if high < low_x - margin_m or low > high_x + margin_m:
            continue
        low, high = _extent(triangle, 0.0, 1.0)
        if high < low_y - margin_m or low > high_y + margin_m:
            continue
        if gap_between(footprint, triangle) < margin_m:
            return False
    return True


@compiled(allocates=False)
def _along_normals(a: Floats, b: Floats) -> float:
    """The largest gap between the two along a normal of an edge of `a`; an edge without length has none."""
    best = -np.inf
    for k in range(len(a)):
        following = a[(k + 1) % len(a)]
        x, y = following[1] - a[k, 1], a[k, 0] - following[0]
        length = np.sqrt(x * x + y * y)
        if length == 0.0:
            continue
        x, y = x / length, y / length
        low_a, high_a = _extent(a, x, y)
        low_b, high_b = _extent(b, x, y)
        best = max(best, low_b - high_a, low_a - high_b)
    return best


@compiled(allocates=False)
def _extent(polygon: Floats, x: float, y: float) -> tuple[float, float]:
    low, high = np.inf, -np.inf
    for corner in polygon:
        place = x * corner[0] + y * corner[1]
        low, high = min(low, place), max(high, place)
    return low, high
