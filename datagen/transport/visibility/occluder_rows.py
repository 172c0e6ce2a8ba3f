"""What can hide anything, as rows of one array: boxes within boxes, and their triangles."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records import Scene
from datagen.records.arrays import Bools, Floats
from datagen.transport.brdf import dot
from datagen.transport.geometry import corner, cross, get, subtract
from datagen.transport.visibility.bvh import ON_PLANE, Hierarchy, boxes_over

FEW_VERTICES = 256
"""Vertices of a part up to which each is asked whether it lies behind a wall; of larger parts their box is."""
MANY_WALLS = 1024
"""Walls that hide nothing up to which each is held against all others, whether it lies on one of them."""
LINK, FIRST, NUMBER, C, NORMAL, COLUMNS = 6, 7, 6, 0, 3, 8
"""Columns of `Occluders.row`: those of a box, of a triangle's first row and of its second."""
HEAD, FLAT = 1, 2
"""The row of what holds for all, and its column of `flat`."""


class Occluders(NamedTuple):
    """BVH of the F triangles that can hide anything; the walls round a convex room are not among them.

    All numbers are rows of one array, for each array that is handed to a compiled function takes time.

    Attributes
    ----------
    row : (R, 8) boxes, the first of which holds all, and triangles.

        - A box: its lowest and highest corner, metres (0–5), and the rows of the two boxes within it (`LINK` and
          `FIRST`); of a leaf minus the number of its triangles (`LINK`) and the row of its first one (`FIRST`).
        - A triangle, two rows: two corners, metres (0–5), and its number in the `Hierarchy` (`NUMBER`); then the
          third corner (`C`) and its unit normal (`NORMAL`).
        - Row `HEAD`: `flat`.
    triangles : F.
    flat : distance from a plane within which a point lies on it, metres.
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

    @property
    def any(self) -> bool:
        """Whether anything can be hidden."""
        return self.triangles > 0


def _hides(scene: Scene, tree: Hierarchy) -> Bools:
    """(F,) whether a triangle has something of the scene on both its sides. Large meshes say yes unasked."""
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
    for f in np.flatnonzero(few[scene.face_part[tree.own]]):
        height = (points - tree.corners[f, 0]) @ tree.normal[f]
        hides[f] = height.min() < -ON_PLANE * tree.extent and height.max() > ON_PLANE * tree.extent
    walls = np.flatnonzero(~hides)
    if len(walls) <= MANY_WALLS:
        _lie_on_each_other(tree.corners, tree.normal, walls, ON_PLANE * tree.extent, hides)
    else:
        hides[walls] = True
    return hides


@compiled()
def _lie_on_each_other(corners, normal, some, near, found):  # type: ignore[no-untyped-def]
    """Mark those of some triangles that overlap another one of them in its plane."""
    for i in some:
        n = get(normal, i, 0)
        for j in some:
            apart = i == j
            for v in range(3):
                apart |= abs(dot(subtract(corner(corners, j, v), corner(corners, i, 0)), n)) > near
            if not (apart or _apart_in_plane(corners, normal, i, j, near)):
                found[i] = True
                break


@compiled()
def _apart_in_plane(corners, normal, f, g, near):  # type: ignore[no-untyped-def]
    """Whether a side of triangle f or g has the other wholly beyond it, but for touching."""
    for i in range(3):
        out_f, out_g = cross(_side(corners, f, i), get(normal, f, 0)), cross(_side(corners, g, i), get(normal, g, 0))
        if _apart(corners, f, g, out_f, near) or _apart(corners, f, g, out_g, near):
            return True
    return False


@compiled()
def _side(corners, f, i):  # type: ignore[no-untyped-def]
    return subtract(corner(corners, f, (i + 1) % 3), corner(corners, f, i))


@compiled()
def _along(corners, f, g, axis):  # type: ignore[no-untyped-def]
    """Least and greatest place of triangle f along an axis, from the first corner of g."""
    a = corner(corners, g, 0)
    one, two, three = (
        dot(subtract(corner(corners, f, 0), a), axis), dot(subtract(corner(corners, f, 1), a), axis),
        dot(subtract(corner(corners, f, 2), a), axis),
    )  # fmt: skip
    return min(one, two, three), max(one, two, three)


@compiled()
def _apart(corners, f, g, axis, near):  # type: ignore[no-untyped-def]
    """Whether two triangles are beyond each other along an axis, but for touching."""
    length = math.sqrt(dot(axis, axis))
    least_f, most_f = _along(corners, f, g, axis)
    least_g, most_g = _along(corners, g, g, axis)
    return length > 0.0 and (most_f <= least_g + near * length or most_g <= least_f + near * length)
