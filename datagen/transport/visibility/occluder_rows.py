"""What can hide anything, as rows of one array: boxes within boxes, their triangles, and the solids these bound."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records import Scene
from datagen.records.arrays import Bools, Floats
from datagen.transport.brdf import dot
from datagen.transport.geometry import ball, corner, get, less
from datagen.transport.visibility.bvh import ON_PLANE, Hierarchy
from datagen.transport.visibility.closed_surfaces import NONE, apart_in_plane
from datagen.transport.visibility.surface_area import boxes_over

FEW_VERTICES = 256
"""Vertices of a part up to which each is asked whether it lies behind a wall; of larger parts their box is."""
MANY_WALLS = 1024
"""Walls that hide nothing up to which each is held against all others, whether it lies on one of them."""
LINK, FIRST, NUMBER, C, NORMAL, SOLID, COLUMNS = 6, 7, 6, 0, 3, 6, 8
"""Columns of `Occluders.row`: those of a box, of a triangle's first row and of its second."""
HEAD, TURNED, SOLIDS, FLAT = 1, 0, 1, 2
"""The row that says where others are, and its columns."""
COSINE, SINE, RADIUS, WHOLE = 3, 4, 5, 6
"""Columns of what else is known of a box."""
CONVEX = 6
"""Column of a solid."""


class Occluders(NamedTuple):
    """BVH of the F triangles that can hide anything; the walls round a convex room are not among them.

    All numbers are rows of one array, for each array that is handed to a compiled function takes time.

    Attributes
    ----------
    row : (R, 8) boxes, the first of which holds all, and triangles.

        - A box: its lowest and highest corner, metres (0–5), and the rows of the two boxes within it (`LINK` and
          `FIRST`); of a leaf minus the number of its triangles (`LINK`) and the row of its first one (`FIRST`).
        - A triangle, two rows: two corners, metres (0–5), and its number in the `Hierarchy` (`NUMBER`); then the
          third corner (`C`), its unit normal (`NORMAL`) and the solid it bounds (`SOLID`).
        - Row `HEAD`: `flat`, and the first rows of the next two.
        - `TURNED` + k: of the triangles in box k the mean normal (0–2), the cosine and the sine of the largest angle
          between a normal and it (`COSINE`, `SINE`), the radius of the box's bounding sphere, metres (`RADIUS`), and
          the solid that all of them bound, −1 if there is none (`WHOLE`).
        - `SOLIDS` + s: the box of solid s, as the `Hierarchy` has it, and whether it is convex (`CONVEX`).
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
        turned = first + 2 * len(number)
        solids, flat = turned + first, ON_PLANE * tree.extent
        row, leaf = np.zeros((solids + len(tree.solid_box), COLUMNS)), children[:, 0] < 0
        row[HEAD, [TURNED, SOLIDS, FLAT]] = turned, solids, flat
        row[at, :LINK] = box
        row[at, LINK] = np.where(leaf, span[:, 0] - span[:, 1], children[:, 0] + 1)
        row[at, FIRST] = np.where(leaf, first + 2 * span[:, 0], children[:, 1] + 1)
        row[first:turned:2, :NUMBER], row[first:turned:2, NUMBER] = corners[:, :2].reshape(-1, 6), number
        seconds = row[first + 1 : turned : 2]
        seconds[:, C:NORMAL], seconds[:, NORMAL:SOLID] = corners[:, 2], tree.normal[number]
        seconds[:, SOLID] = tree.solid[number]
        row[turned + at] = _cones(box, span, tree.normal[number], tree.solid[number])
        row[solids:, :6], row[solids:, CONVEX] = tree.solid_box, tree.convex
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
def _cones(box, span, normal, solid):  # type: ignore[no-untyped-def]
    """Rows `TURNED` … of boxes (N, 6), of which box k holds triangles span[k, 0] … span[k, 1]."""
    found = np.zeros((len(span), COLUMNS))
    for k in range(len(span)):
        first, last = span[k, 0], span[k, 1]
        found[k, WHOLE], found[k, RADIUS] = solid[first] if last > first else NONE, ball(box, k)[1]
        for f in range(first, last):
            found[k, WHOLE] = found[k, WHOLE] if solid[f] == found[k, WHOLE] else NONE
        if found[k, WHOLE] < 0.0:
            continue
        x = y = z = 0.0
        for f in range(first, last):
            x, y, z = x + normal[f, 0], y + normal[f, 1], z + normal[f, 2]
        length, cosine = np.sqrt(x * x + y * y + z * z), 1.0
        axis = (x / length, y / length, z / length) if length > 0.0 else (0.0, 0.0, 0.0)
        for f in range(first, last):
            cosine = min(cosine, dot(axis, get(normal, f, 0)))
        for j in range(3):
            found[k, j] = axis[j]
        found[k, COSINE], found[k, SINE] = cosine, np.sqrt(max(1.0 - cosine * cosine, 0.0))
    return found


@compiled()
def _lie_on_each_other(corners, normal, some, near, found):  # type: ignore[no-untyped-def]
    """Mark those of some triangles that overlap another one of them in its plane."""
    for i in some:
        n = get(normal, i, 0)
        for j in some:
            apart = i == j
            for v in range(3):
                apart |= abs(dot(less(corner(corners, j, v), corner(corners, i, 0)), n)) > near
            if not (apart or apart_in_plane(corners, normal, i, j, near)):
                found[i] = True
                break
