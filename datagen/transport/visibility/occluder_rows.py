"""The triangles that can hide anything, and the boxes of a BVH over them, as rows of one array."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records import Scene
from datagen.records.arrays import Bools, Floats
from datagen.transport.brdf import dot
from datagen.transport.geometry import corner, cross, get, subtract
from datagen.transport.bvh import ON_PLANE, Hierarchy, boxes_over

FEW_VERTICES = 256
"""Most vertices of a part whose triangles are tested for whether they can hide anything, and of a part each of whose
vertices is tested for whether a wall hides it; larger parts are represented by their bounding box and always count
as occluders. Half of it keeps the walls of rooms with many corners among the occluders."""
MANY_WALLS = 1024
"""Most triangles that hide nothing for which every two are tested for whether one lies on the other; beyond it all
count as occluders. The time of the test grows with the square of it."""
LINK, FIRST, NUMBER, C, NORMAL, COLUMNS = 6, 7, 6, 0, 3, 8
"""Columns of `Occluders.row`: of a box (`LINK`, `FIRST`), of a triangle's first row (`NUMBER`) and of its second row
(`C`, `NORMAL`); and the number of columns."""
HEAD, FLAT = 1, 2
"""The row that belongs to no box and no triangle, and its column that holds `Occluders.flat`."""


class Occluders(NamedTuple):
    """BVH of the F triangles that can hide anything; the walls of a convex room are not among them.

    All numbers are in one array, because each array that is passed to a compiled function takes time.

    Attributes
    ----------
    row : (R, 8) rows of boxes, the first of which holds all triangles, and of triangles.

        - A box has one row: its lowest and highest corner, metres (columns 0–5), and the rows of the two boxes within
          it (`LINK` and `FIRST`); if it is a leaf, minus the number of its triangles (`LINK`) and the row of the
          first of them (`FIRST`).
        - A triangle has two rows: two of its corners, metres (columns 0–5), and its index in the `Hierarchy`
          (`NUMBER`); then its third corner (`C`) and its unit normal (`NORMAL`).
        - Row `HEAD` holds `flat`.
    triangles : F.
    flat : distance from a plane, metres, up to which a point lies on the plane.
    """

    row: Floats
    triangles: int
    flat: float

    @classmethod
    def of(cls, scene: Scene, tree: Hierarchy) -> Occluders:
        """The occluders of a scene, in time nearly linear in its triangles."""
        number = np.flatnonzero(_hides(scene, tree))
        corners = tree.corners[number]
        order, box, children, span = boxes_over(corners.min(axis=1), corners.max(axis=1))
        number, corners = number[order], corners[order]
        # Row HEAD lies between the box that holds all and the others.
        at = np.arange(len(box)) + (np.arange(len(box)) > 0)
        first = len(box) + 1
        flat, leaf = ON_PLANE * tree.extent, children[:, 0] < 0
        row = np.zeros((first + 2 * len(number), COLUMNS))
        row[HEAD, FLAT] = flat
        row[at, :LINK] = box
        row[at, LINK] = np.where(leaf, span[:, 0] - span[:, 1], children[:, 0] + 1)
        row[at, FIRST] = np.where(leaf, first + 2 * span[:, 0], children[:, 1] + 1)
        row[first::2, :NUMBER], row[first::2, NUMBER] = corners[:, :2].reshape(-1, 6), number
        seconds = row[first + 1 :: 2]
        seconds[:, C:NORMAL], seconds[:, NORMAL : NORMAL + 3] = corners[:, 2], tree.normal[number]
        return cls(row, len(number), flat)


def _hides(scene: Scene, tree: Hierarchy) -> Bools:
    """(F,) whether each triangle of the BVH can hide anything: whether some of the scene lies on either side of it.

    Triangles of parts with more than `FEW_VERTICES` vertices count as occluders without a test.
    """
    # Each part is represented by its vertices, or by the corners of its bounding box.
    outline, few = [], np.zeros(len(scene.part_names), np.bool_)
    for part in range(len(few)):
        used = scene.vertices[np.unique(scene.triangles[scene.face_part == part])]
        few[part] = len(used) <= FEW_VERTICES
        if not few[part]:
            ends = np.stack([used.min(axis=0), used.max(axis=0)])
            used = ends[np.indices((2, 2, 2)).reshape(3, -1).T, np.arange(3)]
        outline.append(used)
    points = np.concatenate(outline)
    hides = np.ones(len(tree.corners), np.bool_)
    for f in np.flatnonzero(few[scene.face_part[tree.face]]):
        height = (points - tree.corners[f, 0]) @ tree.normal[f]
        hides[f] = height.min() < -ON_PLANE * tree.extent and height.max() > ON_PLANE * tree.extent
    # Of two triangles in the same place only one is seen, so that either may hide the other.
    walls = np.flatnonzero(~hides)
    if len(walls) <= MANY_WALLS:
        _mark_overlapping(tree.corners, tree.normal, walls, ON_PLANE * tree.extent, hides)
    else:
        hides[walls] = True
    return hides


@compiled()
def _mark_overlapping(corners, normal, walls, near, hides):  # type: ignore[no-untyped-def]
    """Set `hides` to True for those of the triangles `walls` that lie in the plane of another of them and overlap it.

    near : distance, metres, up to which points lie in the plane and triangles only touch.
    """
    for i in walls:
        n = get(normal, i, 0)
        for j in walls:
            apart = i == j
            for v in range(3):
                apart |= abs(dot(subtract(corner(corners, j, v), corner(corners, i, 0)), n)) > near
            if not (apart or _apart_in_plane(corners, normal, i, j, near)):
                hides[i] = True
                break


@compiled()
def _apart_in_plane(corners, normal, f, g, near):  # type: ignore[no-untyped-def]
    """Whether triangles f and g of one plane do not overlap: a side of one of them separates the two, up to
    `near`."""
    for i in range(3):
        out_f, out_g = cross(_side(corners, f, i), get(normal, f, 0)), cross(_side(corners, g, i), get(normal, g, 0))
        if _apart(corners, f, g, out_f, near) or _apart(corners, f, g, out_g, near):
            return True
    return False


@compiled()
def _side(corners, f, i):  # type: ignore[no-untyped-def]
    """The vector along side i (0–2) of triangle f, metres."""
    return subtract(corner(corners, f, (i + 1) % 3), corner(corners, f, i))


@compiled()
def _along(corners, f, g, axis):  # type: ignore[no-untyped-def]
    """Least and greatest coordinate of triangle f along an axis, counted from the first corner of triangle g."""
    a = corner(corners, g, 0)
    one, two, three = (
        dot(subtract(corner(corners, f, 0), a), axis), dot(subtract(corner(corners, f, 1), a), axis),
        dot(subtract(corner(corners, f, 2), a), axis),
    )  # fmt: skip
    return min(one, two, three), max(one, two, three)


@compiled()
def _apart(corners, f, g, axis, near):  # type: ignore[no-untyped-def]
    """Whether triangles f and g do not overlap along an axis, or by at most `near` metres."""
    length = math.sqrt(dot(axis, axis))
    least_f, most_f = _along(corners, f, g, axis)
    least_g, most_g = _along(corners, g, g, axis)
    return length > 0.0 and (most_f <= least_g + near * length or most_g <= least_f + near * length)
