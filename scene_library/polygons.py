"""Plane polygons: the little geometry that floor plans and footprints need.

Every polygon is an (n, 2) float64 array of corners, counter-clockwise, without a repeated last corner.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scene_library.arrays import Floats

Polygon = NDArray[np.float64]


def cross(a: Floats, b: Floats) -> Floats:
    """z component of the cross product of plane vectors (…, 2)."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def following(corners: Floats) -> Floats:
    """For every corner the next one around."""
    return np.concatenate([corners[1:], corners[:1]])


def signed_area(polygon: Polygon) -> float:
    """Area, positive when the corners run counter-clockwise (shoelace formula)."""
    return 0.5 * float(cross(polygon, following(polygon)).sum())


def rotation(angle_rad: float) -> Floats:
    """(2, 2) matrix that rotates column vectors counter-clockwise."""
    c, s = float(np.cos(angle_rad)), float(np.sin(angle_rad))
    return np.array([[c, -s], [s, c]])


def convex_hull(points: ArrayLike) -> Polygon:
    """Counter-clockwise convex hull of (n, 2) points (Qhull); of points on one line, a strip a hair wide."""
    p = np.asarray(points, np.float64)
    if len(p) <= 4 and _is_convex(p):
        return p if signed_area(p) > 0 else p[::-1]
    strip = _strip_about(p)
    if strip is not None:
        return strip
    from scipy.spatial import ConvexHull

    return np.asarray(p[ConvexHull(p).vertices])


_HAIR = 1e-6
"""Width over length below which points lie on one line, and that of the strip about them."""


def _strip_about(p: Polygon) -> Polygon | None:
    """The rectangle about points that lie on one line, as the plan of an upright sheet does; None: they do not."""
    far = p[np.argmax(((p - p[0]) ** 2).sum(axis=1))] - p[0]
    long = float(np.linalg.norm(far))
    if long == 0:
        return None
    along = far / long
    axes = np.stack([along, [-along[1], along[0]]])
    places = (p - p[0]) @ axes.T
    low, high = places.min(axis=0), places.max(axis=0)
    if high[1] - low[1] > _HAIR * long:
        return None
    hair = np.array([0.0, 0.5 * _HAIR * long])
    (t0, s0), (t1, s1) = low - hair, high + hair
    return np.asarray(np.array([[t0, s0], [t1, s0], [t1, s1], [t0, s1]]) @ axes + p[0])


def _is_convex(p: Polygon) -> bool:
    edge = following(p) - p
    bend = cross(edge, following(edge))
    # Bending one way only is not enough: a star may wind round twice.
    total = np.arctan2(bend, (edge * following(edge)).sum(axis=1)).sum()
    return bool(len(p) >= 3 and ((bend > 0).all() or (bend < 0).all()) and abs(total) < 7)


def contains(polygon: Polygon, points: ArrayLike) -> NDArray[np.bool_]:
    """Which of the (…, 2) points lie inside, by the parity of crossings."""
    p = np.asarray(points, np.float64)[..., None, :]
    a, b = polygon, following(polygon)
    spans = (a[:, 1] > p[..., 1]) != (b[:, 1] > p[..., 1])
    rise = np.where(b[:, 1] == a[:, 1], 1.0, b[:, 1] - a[:, 1])
    crossing = a[:, 0] + (p[..., 1] - a[:, 1]) * (b[:, 0] - a[:, 0]) / rise
    return np.asarray((spans & (p[..., 0] < crossing)).sum(axis=-1) % 2 == 1)


def point_segment_distance(points: Floats, segments: Floats) -> Floats:
    """(n, m) distances from (n, 2) points to (m, 2, 2) segments."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    offset = points[:, None] - start
    length2 = np.maximum((along**2).sum(-1), 1e-300)
    t = np.clip((offset * along).sum(-1) / length2, 0.0, 1.0)
    return np.asarray(np.linalg.norm(offset - t[..., None] * along, axis=-1))


def segments_of(polygon: Polygon) -> Floats:
    """(n, 2, 2) edges."""
    return np.stack([polygon, following(polygon)], axis=1)


def boundary_distance(polygon: Polygon, segments: Floats) -> float:
    """Smallest distance between the boundary of `polygon` and (m, 2, 2) segments; 0 where they cross."""
    edges = segments_of(polygon)
    if segments_cross(edges, segments).any():
        return 0.0
    return float(
        min(
            point_segment_distance(polygon, segments).min(),
            point_segment_distance(segments.reshape(-1, 2), edges).min(),
        )
    )


def segments_cross(a: Floats, b: Floats) -> NDArray[np.bool_]:
    """(n, m): whether segments (n, 2, 2) and (m, 2, 2) properly cross."""
    a0, a1 = a[:, None, 0], a[:, None, 1]
    b0, b1 = b[None, :, 0], b[None, :, 1]
    over = cross(a1 - a0, b0 - a0) * cross(a1 - a0, b1 - a0) < 0
    under = cross(b1 - b0, a0 - b0) * cross(b1 - b0, a1 - b0) < 0
    return np.asarray(over & under)


def is_simple(polygon: Polygon) -> bool:
    """Whether the polygon is counter-clockwise and no two edges cross."""
    edges = segments_of(polygon)
    return signed_area(polygon) > 0 and not bool(segments_cross(edges, edges).any())


def triangulate(polygon: Polygon) -> NDArray[np.int64]:
    """(n − 2, 3) counter-clockwise triangles of a simple polygon, by cutting ears; fewer where it has spikes.

    Of the ears on offer the one that is fattest is cut, which keeps slivers rare; a convex polygon becomes a fan. The
    outline may touch itself, as that of a polygon with a hole does, which a bridge there and back joins to the rim.
    Raises `ValueError` when the polygon is not simple.
    """
    from scene_library.ears import cut_ears

    if len(polygon) > 4 and _is_convex(polygon):
        k = np.arange(1, len(polygon) - 1)
        return np.stack([np.zeros_like(k), k, k + 1], axis=1)
    return np.asarray(cut_ears(np.ascontiguousarray(polygon)))
