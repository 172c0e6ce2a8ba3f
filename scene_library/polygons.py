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
    if len(polygon) > 4 and _is_convex(polygon):
        k = np.arange(1, len(polygon) - 1)
        return np.stack([np.zeros_like(k), k, k + 1], axis=1)
    left = np.arange(len(polygon))
    ears = np.array([_ear(polygon, left, place) for place in range(len(left))])
    triangles: list[tuple[int, int, int]] = []
    while len(left) > 3:
        folds = _folds(polygon[left])
        if folds.any():
            chosen = int(np.argmax(folds))
        else:
            if not (ears > 0).any():
                # Cutting an ear frees others, which are looked for when none is left.
                ears = np.array([_ear(polygon, left, place) for place in range(len(left))])
            chosen = int(np.argmax(ears))
            if ears[chosen] <= 0:
                raise ValueError("the polygon is not simple: no ear can be cut")
            triangles.append((left[chosen - 1], left[chosen], left[(chosen + 1) % len(left)]))
        left, ears = np.delete(left, chosen), np.delete(ears, chosen)
        for place in ((chosen - 1) % len(left), chosen % len(left)):
            ears[place] = _ear(polygon, left, place)
    if not _folds(polygon[left]).any():
        triangles.append((left[0], left[1], left[2]))
    return np.array(triangles, np.int64).reshape(-1, 3)


def _folds(polygon: Polygon) -> NDArray[np.bool_]:
    """Which corners (n,) lie on the way back, as the tip of a spike and the end of a bridge, or on the next corner:
    they enclose nothing."""
    edge = polygon - np.roll(polygon, 1, axis=0)
    after = np.roll(edge, -1, axis=0)
    along, size = (edge * after).sum(axis=1), (edge**2).sum(axis=1) + (after**2).sum(axis=1)
    return np.asarray((along <= 0) & (np.abs(cross(edge, after)) <= 1e-12 * size))


def crosses_itself(polygon: Polygon) -> bool:
    """Whether two sides of a polygon cross; sides that touch, or run along each other, do not."""
    for k in range(len(polygon) - 2):
        if _crossed(polygon[k], polygon[k + 1], polygon[k + 1 :], np.roll(polygon, -1, axis=0)[k + 1 :]):
            return True
    return False


def _bend(a: Floats, b: Floats, c: Floats) -> Floats:
    """Twice the signed area of triangles (…, 2)."""
    return np.asarray(
        (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    )


def _flatness(corners: Floats) -> float:
    """Size of a triangle (3, 2) across over its size along; 0 for one without area."""
    size = np.abs(corners - np.roll(corners, 1, axis=0)).sum()
    return float(np.abs(_bend(*corners)) / size**2) if size > 0 else 0.0


def _ear(polygon: Polygon, left: NDArray[np.int64], place: int) -> float:
    """How fat the triangle at a corner of what is left of a polygon is, if it can be cut off; else 0."""
    a, b, c = corners = polygon[left[[place - 1, place, (place + 1) % len(left)]]]
    fatness = _flatness(corners) if _bend(a, b, c) > 0 else 0.0
    # A corner that bends inwards, or not at all, is none.
    if fatness <= 1e-12:
        return 0.0
    others = polygon[left]
    # A corner on the rim, but for rounding, is in the way. Where the outline touches itself, the corners of
    # the triangle come again, and the sides that leave there must not cross the cut.
    apart = ~((others == a).all(axis=1) | (others == b).all(axis=1) | (others == c).all(axis=1))
    rounding = -1e-9 * _bend(a, b, c)
    inside = (_bend(a, b, others) >= rounding) & (_bend(b, c, others) >= rounding) & (_bend(c, a, others) >= rounding)
    if (inside & apart).any() or _crossed(c, a, others, np.roll(others, -1, axis=0)):
        return 0.0
    return fatness


def _crossed(a: Floats, b: Floats, starts: Floats, ends: Floats) -> bool:
    """Whether one of the sides from `starts` to `ends` (n, 2) crosses that from `a` to `b` within both."""
    # Areas below rounding are those of sides that end on one another.
    size = np.abs(starts - a).sum(axis=1) + np.abs(ends - a).sum(axis=1) + np.abs(b - a).sum()
    least = 1e-12 * size**2
    of_side = _bend(starts, ends, a), _bend(starts, ends, b)
    of_cut = _bend(a, b, starts), _bend(a, b, ends)
    apart = [((one > least) & (two < -least)) | ((one < -least) & (two > least)) for one, two in (of_side, of_cut)]
    return bool((apart[0] & apart[1]).any())
