"""The triangles of each part in boxes within boxes, so that a mesh far away costs no more than its detail there.

Triangles are put in the order of a space-filling curve (Morton) and halved again and again (Lauterbach et al., "Fast
BVH construction on GPUs", Computer Graphics Forum 28 (2009)).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records import Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.visibility.closed_surfaces import NONE, bounds, closed, convex, of_boxes, pierced

LEAF = 2
"""Most triangles of a box that is not halved."""
CLUSTER = 4
"""Triangles of a box up to which each is an element of its own; not below `LEAF`."""
SMALLEST = 1e-8
"""Smallest element that is cut, relative to the scene."""
MORTON_BITS = 16
ON_PLANE = 1e-9
"""Distance from a plane, relative to the scene, below which a point lies on it."""


class Hierarchy(NamedTuple):
    """F triangles in the order of their boxes, and N boxes.

    Attributes
    ----------
    corners : (F, 3, 3) metres.
    normal : (F, 3) unit normals.
    area : (F + 1,) area of all triangles before each, m².
    own : (F,) which triangle of the scene it is.
    box : (N, 6) lowest and highest corner, metres.
    children : (N, 2) boxes, −1 in a box that holds its triangles itself.
    span : (N, 2) its triangles, first and behind the last; all those within.
    cluster : (N,) which row of `moment` a box has, −1 for those of at most `CLUSTER` triangles.
    moment : (M, 38) of all the surface of a box: centroid, metres (0–2); covariance of its points about that, m²,
        as xx, yy, zz, xy, xz, yz (3–8); mean of n nᵀ likewise (9–14); direction of the mean normal n̄ (15–17), the
        least cosine of a normal with it (18), and 1 − |n̄|² (19); means of n nᵀ times x, y and z from the centroid,
        metres (20–37).
    roots : (K,) the box of each part.
    solid : (F,) the solid that a triangle bounds with others, its normal outwards, or −1 (`closed_surfaces.py`).
    solid_box : (S, 6) lowest and highest corner of each, metres.
    convex : (S,) whether it is.
    of_box : (N,) the solid of all triangles of a box, −1 if none is of any, else −2.
    extent : the scene's largest side, metres.
    """

    corners: Floats
    normal: Floats
    area: Floats
    own: Ints
    box: Floats
    children: Ints
    span: Ints
    cluster: Ints
    moment: Floats
    roots: Ints
    solid: Ints
    solid_box: Floats
    convex: Bools
    of_box: Ints
    extent: float

    @classmethod
    def of(cls, scene: Scene) -> Hierarchy:
        """That of a scene, in time nearly linear in its triangles."""
        corners, parts = scene.corners, len(scene.part_names)
        order = np.lexsort((_morton(corners.mean(axis=1)), scene.face_part))
        corners = np.ascontiguousarray(corners[order])
        extent = float(np.ptp(scene.vertices, axis=0).max())
        solid, inside_out = closed(
            scene.triangles[order].astype(np.int64),
            scene.vertices,
            scene.face_part[order].astype(np.int64),
            ON_PLANE * extent,
        )
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(doubled, axis=1)
        normal = doubled / length[:, None]
        normal[np.append(inside_out, False)[solid]] *= -1.0
        ends = np.searchsorted(scene.face_part[order], np.arange(parts + 1))
        box, children, span, roots = _boxes(corners, ends.astype(np.int64), LEAF)
        area = np.concatenate([[0.0], np.cumsum(length / 2)])
        found = np.zeros(len(inside_out), np.bool_)
        pierced(corners, normal, box, children, span, roots, solid, ON_PLANE * extent, found)
        solid = np.where(np.append(found, True)[solid], NONE, solid)
        cluster, moment = _moments(corners, normal, length, children, span)
        return cls(
            corners, normal, area, order, box, children, span, cluster, moment, roots, solid,
            bounds(solid, corners, ON_PLANE * extent), convex(solid, corners, normal, ON_PLANE * extent),
            of_boxes(solid, children, span), extent,
        )  # fmt: skip


def _morton(points: Floats) -> NDArray[np.uint64]:
    """Places (n, 3) along a space-filling curve."""
    low = points.min(axis=0)
    size = float(np.ptp(points, axis=0).max()) or 1.0
    cell = np.minimum((points - low) / size * 2**MORTON_BITS, 2**MORTON_BITS - 1).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for bit in range(MORTON_BITS):
        for axis in range(3):
            code |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return code


@compiled()
def _boxes(corners, ends, leaf):  # type: ignore[no-untyped-def]
    parts = len(ends) - 1
    most = 2 * len(corners) + 2
    box, children = np.empty((most, 6)), np.full((most, 2), -1)
    span, roots, n = np.zeros((most, 2), np.int64), np.empty(parts, np.int64), 0
    waiting = np.empty((128, 3), np.int64)
    for part in range(parts):
        roots[part] = n
        top = _wait(waiting, 0, ends[part], ends[part + 1], -1)
        while top > 0:
            top -= 1
            first, last, parent = waiting[top, 0], waiting[top, 1], waiting[top, 2]
            if parent >= 0:
                children[parent, 1 if children[parent, 0] >= 0 else 0] = n
            span[n, 0], span[n, 1] = first, last
            if last - first > leaf:
                middle = (first + last) // 2
                top = _wait(waiting, top, middle, last, n)
                top = _wait(waiting, top, first, middle, n)
            n += 1
    for k in range(n - 1, -1, -1):
        left, right = children[k, 0], children[k, 1]
        for j in range(3):
            if left >= 0:
                box[k, j] = min(box[left, j], box[right, j])
                box[k, 3 + j] = max(box[left, 3 + j], box[right, 3 + j])
                continue
            box[k, j], box[k, 3 + j] = np.inf, -np.inf
            for f in range(span[k, 0], span[k, 1]):
                for v in range(3):
                    box[k, j] = min(box[k, j], corners[f, v, j])
                    box[k, 3 + j] = max(box[k, 3 + j], corners[f, v, j])
    return box[:n], children[:n], span[:n], roots


@compiled()
def _moments(corners, normal, area, children, span):  # type: ignore[no-untyped-def]
    """`Hierarchy.cluster` and `Hierarchy.moment`; `area` (F,) in any unit. Those of two boxes give those of the one
    about them."""
    count = len(children)
    cluster, many = np.full(count, -1), 0
    for k in range(count):
        if span[k, 1] - span[k, 0] > CLUSTER:
            cluster[k] = many
            many += 1
    moment, size, own = np.zeros((many, 38)), np.zeros(many), np.zeros(38)
    for k in range(count - 1, -1, -1):
        row = cluster[k]
        if row < 0:
            continue
        for child in children[k]:
            if cluster[child] >= 0:
                size[row] = _added(moment, size[row], row, moment[cluster[child]], size[cluster[child]])
                continue
            for f in range(span[child, 0], span[child, 1]):
                for j in range(3):
                    own[j] = (corners[f, 0, j] + corners[f, 1, j] + corners[f, 2, j]) / 3
                    own[15 + j] = normal[f, j]
                for m in range(6):
                    i, j = _place(m)
                    own[3 + m], own[9 + m] = 0.0, normal[f, i] * normal[f, j]
                    for v in range(3):
                        own[3 + m] += (corners[f, v, i] - own[i]) * (corners[f, v, j] - own[j]) / 12
                size[row] = _added(moment, size[row], row, own, area[f])
    for k in range(count):
        row = cluster[k]
        if row < 0:
            continue
        square = moment[row, 15] ** 2 + moment[row, 16] ** 2 + moment[row, 17] ** 2
        moment[row, 19], moment[row, 18] = max(1.0 - square, 0.0), 1.0
        for j in range(15, 18):
            moment[row, j] = moment[row, j] / math.sqrt(square) if square > 0.0 else 0.0
        for f in range(span[k, 0], span[k, 1]):
            cosine = moment[row, 15] * normal[f, 0] + moment[row, 16] * normal[f, 1] + moment[row, 17] * normal[f, 2]
            moment[row, 18] = min(moment[row, 18], cosine)
    return cluster, moment


@compiled()
def _added(moment, size, k, other, more):  # type: ignore[no-untyped-def]
    """Add to the moments in row k, of an area of `size`, others of an area of `more`; returns the area of both."""
    both = size + more
    share = more / both
    for axis in range(3):
        apart = other[axis] - moment[k, axis]
        for m in range(6):
            here = moment[k, 20 + 6 * axis + m] - moment[k, 9 + m] * share * apart
            there = other[20 + 6 * axis + m] + other[9 + m] * (1.0 - share) * apart
            moment[k, 20 + 6 * axis + m] = here + share * (there - here)
    for m in range(6):
        i, j = _place(m)
        apart = (other[i] - moment[k, i]) * (other[j] - moment[k, j])
        moment[k, 3 + m] += share * (other[3 + m] - moment[k, 3 + m]) + share * (1.0 - share) * apart
    for j in range(3):
        moment[k, j] += share * (other[j] - moment[k, j])
    for j in range(9, 18):
        moment[k, j] += share * (other[j] - moment[k, j])
    return both


@compiled()
def _place(m):  # type: ignore[no-untyped-def]
    """Row and column of number m of xx, yy, zz, xy, xz, yz."""
    return (m, m) if m < 3 else (0, m - 2) if m < 5 else (1, 2)


@compiled()
def _wait(waiting, top, first, last, parent):  # type: ignore[no-untyped-def]
    waiting[top, 0], waiting[top, 1], waiting[top, 2] = first, last, parent
    return top + 1


@compiled()
def one_of(first, last, area_before, word):  # type: ignore[no-untyped-def]
    """One of the triangles first … last, drawn by area."""
    wanted = area_before[first] + (np.float64(word) + 0.5) * 2.0**-32 * (area_before[last] - area_before[first])
    low, high = first, last
    while high - low > 1:
        middle = (low + high) // 2
        if area_before[middle] <= wanted:
            low = middle
        else:
            high = middle
    return low
