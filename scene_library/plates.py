"""Plates cut to any outline: the union of plane polygons, extruded into one closed solid without inner walls.

The union is found by sweeping: between two neighbouring heights at which edges start, end or cross, no edges cross,
so they sort from left to right and the winding number says what is inside.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from scene_library.arrays import Floats
from scene_library.polygons import Polygon, cross, segments_of
from scene_library.solids import Surface

_SAME = 1e-9
_Trapezoid = tuple[float, float, float, float, float, float]
"""(y0, y1, left at y0, left at y1, right at y0, right at y1)."""


def union_plate(polygons: list[Polygon], thickness_m: float) -> Surface:
    """Extrude the union of polygons, given in (x, z), by `thickness_m` along y; the front is at −y.

    A clockwise polygon cuts a hole into the counter-clockwise one around it (non-zero winding rule).
    """
    pieces = _trapezoids(polygons)
    quads = []
    half = thickness_m / 2
    for y0, y1, a0, a1, b0, b1 in pieces:
        low_left, low_right, top_right, top_left = (a0, y0), (b0, y0), (b1, y1), (a1, y1)
        quads.append([_at(p, -half) for p in (low_left, low_right, top_right, top_left)])
        quads.append([_at(p, half) for p in (top_left, top_right, low_right, low_left)])
        quads.append(_side(low_left, top_left, half))
        quads.append(_side(top_right, low_right, half))
    for y in sorted({p[0] for p in pieces} | {p[1] for p in pieces}):
        above = [(p[2], p[4]) for p in pieces if p[0] == y]
        below = [(p[3], p[5]) for p in pieces if p[1] == y]
        quads += [_side((b, y), (a, y), half) for a, b in _without(above, below)]
        quads += [_side((a, y), (b, y), half) for a, b in _without(below, above)]
    corners = np.array(quads)
    triangles = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    area = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    triangles = triangles[area > 1e-12 * np.ptp(corners.reshape(-1, 3), axis=0).max() ** 2]
    vertices, index = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    return vertices, index.reshape(-1, 3).astype(np.int64)


def _at(point: tuple[float, float], y: float) -> tuple[float, float, float]:
    return point[0], y, point[1]


def _side(a: tuple[float, float], b: tuple[float, float], half: float) -> list[tuple[float, float, float]]:
    """The quad over the boundary piece a → b that has the solid on its right in (x, z)."""
    return [_at(a, -half), _at(b, -half), _at(b, half), _at(a, half)]


def _trapezoids(polygons: list[Polygon]) -> list[_Trapezoid]:
    edges = np.concatenate([segments_of(p) for p in polygons])
    edges = edges[np.abs(edges[:, 1, 1] - edges[:, 0, 1]) > _SAME]
    up = edges[:, 1, 1] > edges[:, 0, 1]
    low = np.where(up[:, None], edges[:, 0], edges[:, 1])
    high = np.where(up[:, None], edges[:, 1], edges[:, 0])
    levels = _levels(low, high)
    pieces: list[_Trapezoid] = []
    for y0, y1 in pairwise(levels):
        middle = (y0 + y1) / 2
        active = (low[:, 1] < middle) & (high[:, 1] > middle)
        a, b, sign = low[active], high[active], np.where(up[active], -1, 1)
        slope = (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
        order = np.argsort(a[:, 0] + (middle - a[:, 1]) * slope, kind="stable")
        x0, x1 = (a[:, 0] + (y - a[:, 1]) * slope for y in (y0, y1))
        winding = np.cumsum(sign[order])
        start = -1
        for k, w in zip(order, winding, strict=True):
            if start < 0 and w != 0:
                start = k
            elif start >= 0 and w == 0:
                pieces.append((y0, y1, float(x0[start]), float(x1[start]), float(x0[k]), float(x1[k])))
                start = -1
    return pieces


def _levels(low: Floats, high: Floats) -> list[float]:
    """Heights of all corners and of all crossings of two edges, without near repeats."""
    along = high - low
    det = cross(along[:, None], along[None])
    offset = low[None] - low[:, None]
    safe = np.where(np.abs(det) < 1e-15, 1.0, det)
    s = cross(offset, np.broadcast_to(along[None], offset.shape)) / safe
    t = cross(offset, np.broadcast_to(along[:, None], offset.shape)) / safe
    meet = (np.abs(det) >= 1e-15) & (s > 0) & (s < 1) & (t > 0) & (t < 1)
    crossings = (low[:, None, 1] + s * along[:, None, 1])[meet]
    levels: list[float] = []
    for y in np.sort(np.concatenate([low[:, 1], high[:, 1], crossings])):
        if not levels or y - levels[-1] > _SAME:
            levels.append(float(y))
    return levels


def _without(intervals: list[tuple[float, float]], others: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The intervals of the first list, less those of the second."""
    left = intervals
    for low, high in others:
        left = [
            piece
            for a, b in left
            for piece in ((a, min(b, low)), (max(a, high), b))
            if piece[1] - piece[0] > _SAME
        ]  # fmt: skip
    return left
