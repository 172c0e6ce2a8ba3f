"""One hierarchy of a scene's triangles: boxes within boxes, part by part, for light and for what hides it.

Triangles of a part are put in the order of a space-filling curve (Morton) and halved again and again (Lauterbach et
al., "Fast BVH construction on GPUs", Computer Graphics Forum 28 (2009)); the parts' boxes are joined likewise.
Everything is in double precision and asks the same on every processor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from datagen.records import Scene
from datagen.records.arrays import Bools, Floats, Ints

LEAF = 2
"""Most triangles of a box that is not halved."""
MORTON_BITS = 16
FEW_VERTICES = 256
"""Vertices of a part up to which each is asked whether it lies behind a wall; of larger parts their box is."""
ON_PLANE = 1e-9
"""Distance from a plane, relative to the scene, below which a point lies on it."""


class Hierarchy(NamedTuple):
    """F triangles in the order of their boxes, and N boxes.

    Attributes
    ----------
    corners : (F, 3, 3) metres.
    normal : (F, 3) unit normals.
    area : (F + 1,) area of all triangles before each, m².
    hides : (F,) whether anything can stand behind the triangle, or lie on it: not so for the walls round a convex
        room.
    own : (F,) which triangle of the scene it is.
    box : (N, 6) lowest and highest corner, metres.
    children : (N, 2) boxes, −1 in a box that holds its triangles itself.
    span : (N, 2) its triangles, first and behind the last; empty for boxes of several parts.
    blocks : (N,) whether any triangle in it hides anything.
    roots : (K,) the box of each part.
    top : the box of all.
    extent : the scene's largest side, metres.
    """

    corners: Floats
    normal: Floats
    area: Floats
    hides: Bools
    own: Ints
    box: Floats
    children: Ints
    span: Ints
    blocks: Bools
    roots: Ints
    top: int
    extent: float

    @classmethod
    def of(cls, scene: Scene) -> Hierarchy:
        """That of a scene, in time nearly linear in its triangles."""
        corners, parts = scene.corners, len(scene.part_names)
        order = np.lexsort((_morton(corners.mean(axis=1)), scene.face_part))
        corners = np.ascontiguousarray(corners[order])
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(doubled, axis=1)
        normal = doubled / length[:, None]
        hides = _hides(scene, corners, normal)
        ends = np.searchsorted(scene.face_part[order], np.arange(parts + 1))
        box, children, span, blocks, roots, top = _boxes(corners, hides, ends.astype(np.int64), LEAF)
        extent = float(np.ptp(scene.vertices, axis=0).max())
        area = np.concatenate([[0.0], np.cumsum(length / 2)])
        return cls(corners, normal, area, hides, order, box, children, span, blocks, roots, int(top), extent)


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


def _hides(scene: Scene, corners: Floats, normal: Floats) -> Bools:
    """Whether a triangle has something of the scene on both its sides. Large meshes say yes unasked."""
    outline, many = [], np.zeros(len(scene.part_names), np.bool_)
    for part in range(len(scene.part_names)):
        used = scene.vertices[np.unique(scene.triangles[scene.face_part == part])]
        many[part] = len(used) > FEW_VERTICES
        if many[part]:
            ends = np.stack([used.min(axis=0), used.max(axis=0)])
            used = ends[np.indices((2, 2, 2)).reshape(3, -1).T, np.arange(3)]
        outline.append(used)
    points = np.concatenate(outline)
    near = ON_PLANE * float(np.ptp(scene.vertices, axis=0).max())
    hides = np.ones(len(corners), np.bool_)
    few = np.flatnonzero(~many[np.sort(scene.face_part)])
    for f in few:
        height = (points - corners[f, 0]) @ normal[f]
        hides[f] = height.min() < -near and height.max() > near
    _lie_on_each_other(corners, normal, few[~hides[few]], near, hides)
    return hides


@njit(cache=True)
def _lie_on_each_other(corners, normal, some, near, found):  # type: ignore[no-untyped-def]
    """Mark those of some triangles that overlap another one of them in its plane."""
    for i in some:
        for j in some:
            n, apart = normal[i], i == j
            for v in range(3):
                apart |= abs(np.dot(corners[j, v] - corners[i, 0], n)) > near
            # Two triangles are apart if a side of either has the other wholly beyond it.
            for pair in ((i, j), (j, i)):
                one, other = corners[pair[0]], corners[pair[1]]
                for side in range(3):
                    a, along = one[side], one[(side + 1) % 3] - one[side]
                    outward = np.cross(along, n)
                    outward /= np.sqrt(np.dot(outward, outward))
                    if np.dot(one[(side + 2) % 3] - a, outward) > 0.0:
                        outward = -outward
                    beyond = True
                    for v in range(3):
                        beyond &= np.dot(other[v] - a, outward) > -near
                    apart |= beyond
                if apart:
                    break
            if not apart:
                found[i] = True
                break


@njit(cache=True)
def _boxes(corners, hides, ends, leaf):  # type: ignore[no-untyped-def]
    parts = len(ends) - 1
    most = 2 * len(corners) + 2 * parts + 2
    box, children = np.empty((most, 6)), np.full((most, 2), -1)
    span, blocks = np.zeros((most, 2), np.int64), np.zeros(most, np.bool_)
    roots, n = np.empty(parts, np.int64), 0
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
        if children[k, 0] < 0:
            for j in range(3):
                box[k, j], box[k, 3 + j] = np.inf, -np.inf
                for f in range(span[k, 0], span[k, 1]):
                    for v in range(3):
                        box[k, j] = min(box[k, j], corners[f, v, j])
                        box[k, 3 + j] = max(box[k, 3 + j], corners[f, v, j])
                    blocks[k] |= hides[f]
        else:
            _join(box, blocks, k, children[k, 0], children[k, 1])
    # The parts' boxes, two and two along the order of the parts, until one is left.
    level = roots.copy()
    while len(level) > 1:
        above = np.empty((len(level) + 1) // 2, np.int64)
        for k in range(len(above)):
            above[k] = level[2 * k]
            if 2 * k + 1 < len(level):
                children[n, 0], children[n, 1] = level[2 * k], level[2 * k + 1]
                _join(box, blocks, n, level[2 * k], level[2 * k + 1])
                above[k] = n
                n += 1
        level = above
    return box[:n], children[:n], span[:n], blocks[:n], roots, level[0]


@njit(cache=True)
def _wait(waiting, top, first, last, parent):  # type: ignore[no-untyped-def]
    waiting[top, 0], waiting[top, 1], waiting[top, 2] = first, last, parent
    return top + 1


@njit(cache=True)
def _join(box, blocks, k, left, right):  # type: ignore[no-untyped-def]
    for j in range(3):
        box[k, j] = min(box[left, j], box[right, j])
        box[k, 3 + j] = max(box[left, 3 + j], box[right, 3 + j])
    blocks[k] = blocks[left] or blocks[right]
