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
from datagen.records.arrays import Floats, Ints

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
    cone : (N, 4) direction of the mean normal of each box's triangles, weighted by area, and the least cosine of a
        normal with it.
    roots : (K,) the box of each part.
    extent : the scene's largest side, metres.
    """

    corners: Floats
    normal: Floats
    area: Floats
    own: Ints
    box: Floats
    children: Ints
    span: Ints
    cone: Floats
    roots: Ints
    extent: float

    @classmethod
    def of(cls, scene: Scene) -> Hierarchy:
        """That of a scene, in time nearly linear in its triangles."""
        corners, parts = scene.corners, len(scene.part_names)
        order = np.lexsort((_morton(corners.mean(axis=1)), scene.face_part))
        corners = np.ascontiguousarray(corners[order])
        extent = float(np.ptp(scene.vertices, axis=0).max())
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(doubled, axis=1)
        normal = doubled / length[:, None]
        ends = np.searchsorted(scene.face_part[order], np.arange(parts + 1))
        box, children, span, roots = _boxes(corners, ends.astype(np.int64), LEAF)
        area = np.concatenate([[0.0], np.cumsum(length / 2)])
        return cls(corners, normal, area, order, box, children, span, _cones(normal, area, span), roots, extent)


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
def _cones(normal, area, span):  # type: ignore[no-untyped-def]
    """`Hierarchy.cone` of boxes that hold triangles span[k, 0] … span[k, 1]."""
    cone = np.zeros((len(span), 4))
    for k in range(len(span)):
        for f in range(span[k, 0], span[k, 1]):
            for j in range(3):
                cone[k, j] += (area[f + 1] - area[f]) * normal[f, j]
        length = math.sqrt(cone[k, 0] ** 2 + cone[k, 1] ** 2 + cone[k, 2] ** 2)
        for j in range(3):
            cone[k, j] = cone[k, j] / length if length > 0.0 else 0.0
        cone[k, 3] = 1.0
        for f in range(span[k, 0], span[k, 1]):
            cosine = cone[k, 0] * normal[f, 0] + cone[k, 1] * normal[f, 1] + cone[k, 2] * normal[f, 2]
            cone[k, 3] = min(cone[k, 3], cosine)
    return cone


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
