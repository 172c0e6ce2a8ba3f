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
HEAD, TURNED, SOLIDS, FLAT, WIDE = 1, 0, 1, 2, 3
"""The row that says where others are, and its columns."""
AT_ONCE, WIDE_ROWS = 8, 7
"""Boxes that a line is held against at once, and rows that they fill: six bounds of each, and what they hold."""
COSINE, SINE, RADIUS, WHOLE = 3, 4, 5, 6
"""Columns of what else is known of a box."""
CONVEX = 6
"""Column of a solid."""
LINE = 128
"""Bytes, a power of two, that processors fetch at once: two boxes."""


class Occluders(NamedTuple):
    """F triangles that can hide anything, in N boxes; the walls round a convex room are not among them.

    All are rows of one array, as columns say, for in loops that ask for one line each array handed over counts.

    Attributes
    ----------
    row : (R, 8) boxes, the first of which holds all, and triangles, each of them two rows. Of a box its lowest and
        highest corner, metres (0–5), the first of the two boxes in it or, in one that holds its triangles itself,
        their −number (`LINK`), and the first of its triangles (`FIRST`); of a triangle two corners, metres (0–5),
        and its number in the `Hierarchy` (`NUMBER`), then the third corner (`C`), its unit normal (`NORMAL`) and the
        solid it bounds (`SOLID`).
        Row `HEAD` has `flat` and the numbers of two rows. `TURNED` + k has of the triangles in box k the mean normal
        (0–2), the cosine and the sine of the largest angle of a normal with it (`COSINE`, `SINE`), the radius of the
        ball round the box, metres (`RADIUS`), and the solid that all of them bound, −1 if there is none (`WHOLE`);
        `WIDE` + 7 k has up to eight boxes that together hold what box k does, one in each column: their lowest and
        highest corners in six rows, and what is in them in the seventh: the number of a box, or of one that holds its
        triangles itself −(4 times the first of them + their number), or 0 where there is none.
        `SOLIDS` + s has the box of solid s, as the `Hierarchy` has it, and whether that is convex (`CONVEX`).
    triangles : F.
    flat : distance from a plane within which a point lies on it, metres.
    """

    row: Floats
    triangles: int
    flat: float

    @classmethod
    def of(cls, scene: Scene, tree: Hierarchy) -> Occluders:
        """Those of a scene, in time nearly linear in its triangles."""
        number = np.flatnonzero(_hides(scene, tree))
        corners = tree.corners[number]
        order, box, link = boxes_over(corners.min(axis=1), corners.max(axis=1))
        number, corners = number[order], corners[order]
        # The two boxes in one, as the two rows of a triangle, share a line of memory, for row 1 is another.
        at = np.maximum(np.arange(1, len(box) + 1), 2)
        at[0] = 0
        first = (at[-1] + 2) & ~1
        turned = first + 2 * len(number)
        wide, flat = turned + first, ON_PLANE * tree.extent
        solids = wide + WIDE_ROWS * first
        row = _in_lines(solids + len(tree.solid_box))
        row[HEAD, [TURNED, SOLIDS, FLAT, WIDE]] = turned, solids, flat, wide
        row[at, :LINK] = box
        row[at, LINK] = np.where(link[:, 0] < 0, link[:, 1] - link[:, 2], link[:, 0] + 1)
        row[at, FIRST] = first + 2 * link[:, 1]
        row[first:turned:2, :NUMBER], row[first:turned:2, NUMBER] = corners[:, :2].reshape(-1, 6), number
        seconds = row[first + 1 : turned : 2]
        seconds[:, C:NORMAL], seconds[:, NORMAL:SOLID] = corners[:, 2], tree.normal[number]
        seconds[:, SOLID] = tree.solid[number]
        row[turned + at] = _cones(box, link, tree.normal[number], tree.solid[number])
        _widen(row, at, wide)
        row[solids:, :6], row[solids:, CONVEX] = tree.solid_box, tree.convex
        return cls(row, len(number), flat)

    @property
    def any(self) -> bool:
        """Whether anything can be hidden."""
        return self.triangles > 0


def _in_lines(rows: int) -> Floats:
    """(rows, 8) zeros that start where a line of the processor's memory does."""
    room = np.zeros(rows * COLUMNS + LINE // 8)
    start = -room.ctypes.data % LINE // 8
    return room[start : start + rows * COLUMNS].reshape(rows, COLUMNS)


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
def _cones(box, link, normal, solid):  # type: ignore[no-untyped-def]
    """Rows `TURNED` … of boxes (N, 6) that hold triangles link[k, 1] … link[k, 2]."""
    found = np.zeros((len(link), COLUMNS))
    for k in range(len(link)):
        first, last = link[k, 1], link[k, 2]
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
def _widen(row, boxes, wide):  # type: ignore[no-untyped-def]
    """Fill the rows `WIDE` … of some boxes: of those within, the largest are opened first."""
    within = np.empty(AT_ONCE, np.int64)
    for k in boxes:
        if row[k, LINK] <= 0.0:
            continue
        within[0], count = k, 1
        while count < AT_ONCE:
            most, largest = -1, -1.0
            for j in range(count):
                m = within[j]
                a, b, c = row[m, 3] - row[m, 0], row[m, 4] - row[m, 1], row[m, 5] - row[m, 2]
                if row[m, LINK] > 0.0 and a * b + b * c + c * a > largest:
                    most, largest = j, a * b + b * c + c * a
            if most < 0:
                break
            first = int(row[within[most], LINK])
            within[most], within[count] = first, first + 1
            count += 1
        at = wide + WIDE_ROWS * k
        for j in range(count):
            m = within[j]
            for i in range(6):
                row[at + i, j] = row[m, i]
            row[at + 6, j] = m if row[m, LINK] > 0.0 else 4.0 * -row[m, FIRST] + row[m, LINK]


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
