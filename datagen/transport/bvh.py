"""BVH: the triangles of each part in boxes within boxes, divided by the surface area heuristic in bins.

Wald, "On fast construction of SAH-based bounding volume hierarchies", IEEE Symposium on Interactive Ray Tracing 2007.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records import Scene
from datagen.records.arrays import Floats, Ints

LEAF = 3
"""Most triangles of a box that is not divided: fewer would make more boxes for the same triangles."""
BINS = 12
"""Bins along a box's longest side, between which it is divided: with halves along a space-filling curve instead,
rooms take 1.15 to 1.34 times as long."""
DEEPEST = 64
"""Level from which on boxes are divided by the number of their triangles alone, because stacks of loops over the tree
have room for about twice this level."""
CLUSTER = 4
"""Triangles up to which a box is opened whatever its light, so that each triangle is a piece of its own, whose light
cuts spread over the arrival times of its corners. It is at least `LEAF`, as a leaf has no boxes within."""
SMALLEST = 1e-8
"""Longest side of the smallest piece of a triangle that is cut, relative to the scene's largest side: far above the
rounding error of coordinates."""
ON_PLANE = 1e-9
"""Distance from a plane, relative to the scene's largest side, below which a point lies on the plane: far above the
rounding error of coordinates."""


class Hierarchy(NamedTuple):
    """F triangles in the order of their boxes, and N boxes.

    Attributes
    ----------
    corners : (F, 3, 3) metres.
    normal : (F, 3) unit normals.
    area : (F + 1,) area of all triangles before each, m².
    face : (F,) index of each triangle in the scene.
    box : (N, 6) lowest and highest corner, metres.
    children : (N, 2) indices of the two boxes within each box, −1 in a leaf.
    span : (N, 2) index of the first triangle within each box, and one more than that of the last.
    cone : (N, 4) direction of the mean normal of each box's triangles, weighted by area, and the least cosine of a
        normal with it.
    roots : (K,) the box of each part.
    extent : the scene's largest side, metres.
    """

    corners: Floats
    normal: Floats
    area: Floats
    face: Ints
    box: Floats
    children: Ints
    span: Ints
    cone: Floats
    roots: Ints
    extent: float

    @classmethod
    def of(cls, scene: Scene) -> Hierarchy:
        """The BVH of a scene, built in time nearly linear in its triangles."""
        low, high = scene.corners.min(axis=1), scene.corners.max(axis=1)
        orders, boxes, children, spans, roots = [], [], [], [], np.empty(len(scene.part_names), np.int64)
        # Each numpy function that a kernel calls is compiled with it: arrays are made, and joined, here.
        members, bounds, cost = np.empty(BINS, np.int64), np.empty((BINS + 1, 6)), np.empty(BINS)
        triangles = count = 0
        for part in range(len(roots)):
            faces = np.flatnonzero(scene.face_part == part)
            own, most = np.arange(len(faces)), max(2 * len(faces), 1)
            box, link = np.empty((most, 6)), np.zeros((most, 4), np.int64)
            n = _divide(low[faces], high[faces], own, box, link, np.empty_like(own), members, bounds, cost)
            roots[part] = count
            orders.append(faces[own])
            boxes.append(box[:n])
            lower = link[:n, :1]
            children.append(np.where(lower < 0, -1, count + lower + [0, 1]))
            spans.append(triangles + link[:n, 1:3])
            triangles, count = triangles + len(faces), count + n
        order, span = np.concatenate(orders), np.concatenate(spans)
        corners = np.ascontiguousarray(scene.corners[order])
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(doubled, axis=1)
        normal, area = doubled / length[:, None], np.concatenate([[0.0], np.cumsum(length / 2)])
        cone = np.empty((len(span), 4))
        _set_cones(normal, area, span, cone)
        return cls(
            corners, normal, area, order, np.concatenate(boxes), np.concatenate(children), span, cone, roots,
            float(np.ptp(scene.vertices, axis=0).max()),
        )  # fmt: skip


@compiled(allocates=False)
def _divide(low, high, order, box, link, spare, members, bounds, cost):  # type: ignore[no-untyped-def]
    """Number of boxes; the arguments that follow are set.

    low, high : (F, 3) lowest and highest corners of the triangles' own boxes, metres. order : (F,) 0 … F − 1, put in
    order. box : (2 F, 6) corners of the boxes. link : (2 F, 4) zeros; set to the index of a box's lower half, or −1;
    to the range of its triangles in `order`; and to the number of boxes that contain it. spare (F,), members (BINS,),
    bounds (BINS + 1, 6), cost (BINS,) : room for what is computed of the bins.

    A box is divided where the sum, over both halves, of the number of triangles times the area of their box is least:
    that area is proportional to the probability that a line meets the half.
    """
    link[0, 2], n, k = len(low), 1, 0
    # Boxes k … n − 1 still have to be measured and divided; a divided box adds its halves at the end.
    while k < n:
        link[k, 0], first, last = -1, link[k, 1], link[k, 2]
        axis, smallest, largest = 0, 0.0, -1.0
        for j in range(3):
            box[k, j], box[k, 3 + j], least, greatest = np.inf, -np.inf, np.inf, -np.inf
            for f in order[first:last]:
                box[k, j], box[k, 3 + j] = min(box[k, j], low[f, j]), max(box[k, 3 + j], high[f, j])
                least, greatest = min(least, low[f, j] + high[f, j]), max(greatest, low[f, j] + high[f, j])
            # The longest side is that of the triangles' middles, so that not all of them fall into one bin.
            if greatest - least > largest:
                axis, smallest, largest = j, least, greatest - least
        if last - first > LEAF:
            members[:] = 0
            for m in range(BINS):
                for j in range(3):
                    bounds[m, j], bounds[m, 3 + j] = np.inf, -np.inf
            for f in order[first:last]:
                m = _bin(low, high, f, axis, smallest, largest)
                members[m] += 1
                for j in range(3):
                    bounds[m, j] = min(bounds[m, j], low[f, j])
                    bounds[m, 3 + j] = max(bounds[m, 3 + j], high[f, j])
            # One sweep over the bins adds the cost of the lower halves, the other that of the upper ones.
            cost[:] = 0.0
            for step in (1, -1):
                _add_costs(members, bounds, cost, step)
            best = 1
            for m in range(2, BINS):
                if cost[m] < cost[best]:
                    best = m
            # The order within each half stays, so that it does not depend on anything but the triangles.
            middle, rest = first, 0
            for f in order[first:last]:
                if _bin(low, high, f, axis, smallest, largest) < best:
                    order[middle] = f
                    middle += 1
                else:
                    spare[rest] = f
                    rest += 1
            for m in range(rest):
                order[middle + m] = spare[m]
            # Halves of equal number end what might else go on without end: triangles that are all in one place, or
            # boxes that lose only one triangle at each division.
            if middle in (first, last) or link[k, 3] >= DEEPEST:
                middle = (first + last) // 2
            link[n, 3] = link[n + 1, 3] = link[k, 3] + 1
            link[k, 0] = n
            link[n, 1], link[n, 2], link[n + 1, 1], link[n + 1, 2] = first, middle, middle, last
            n += 2
        k += 1
    return n


@compiled(allocates=False)
def _bin(low, high, f, axis, smallest, largest):  # type: ignore[no-untyped-def]
    """Index of the bin, along an axis, of the middle of triangle f.

    smallest, largest : least of all sums low + high along the axis, and their range, metres.
    """
    # All middles may be level, as in a wall.
    if largest <= 0.0:
        return 0
    return min(int((low[f, axis] + high[f, axis] - smallest) / largest * BINS), BINS - 1)


@compiled(allocates=False)
def _add_costs(members, bounds, cost, step):  # type: ignore[no-untyped-def]
    """Add to `cost` (BINS,), for the cut below each bin, the number of triangles times the area of the box about them
    on one side of the cut: the lower side for step 1, the upper side for step −1.

    members : (BINS,) number of triangles in each bin. bounds : (BINS + 1, 6) lowest and highest corner of their box,
    and a last row for the box about those met so far.
    """
    total = 0
    about = bounds[BINS]
    for j in range(3):
        about[j], about[3 + j] = np.inf, -np.inf
    for turn in range(BINS):
        m = turn if step > 0 else BINS - 1 - turn
        cut = m if step > 0 else m + 1
        a, b, c = about[3] - about[0], about[4] - about[1], about[5] - about[2]
        if 0 < cut < BINS and total > 0:
            cost[cut] += total * (a * b + b * c + c * a)
        elif 0 < cut < BINS:
            # A cut with nothing on one side divides nothing.
            cost[cut] += np.inf
        total += members[m]
        for j in range(3):
            about[j], about[3 + j] = min(about[j], bounds[m, j]), max(about[3 + j], bounds[m, 3 + j])


@compiled(allocates=False)
def _set_cones(normal, area, span, cone):  # type: ignore[no-untyped-def]
    """Set the field `cone` (N, 4) of `Hierarchy`: mean normal of each box's triangles, weighted by area, and the
    least cosine of a normal with it.

    normal : (F, 3) unit normals. area : (F + 1,) running sum of areas, m². span : (N, 2) triangles of each box.
    """
    for k in range(len(span)):
        for j in range(3):
            cone[k, j] = 0.0
        for f in range(span[k, 0], span[k, 1]):
            for j in range(3):
                cone[k, j] += (area[f + 1] - area[f]) * normal[f, j]
        # Normals of a closed surface cancel: then there is no axis, and the cone holds all directions.
        length = math.sqrt(cone[k, 0] ** 2 + cone[k, 1] ** 2 + cone[k, 2] ** 2)
        for j in range(3):
            cone[k, j] = cone[k, j] / length if length > 0.0 else 0.0
        cone[k, 3] = 1.0
        for f in range(span[k, 0], span[k, 1]):
            cosine = cone[k, 0] * normal[f, 0] + cone[k, 1] * normal[f, 1] + cone[k, 2] * normal[f, 2]
            cone[k, 3] = min(cone[k, 3], cosine)


@compiled(allocates=False)
def triangle_by_area(first, last, area_before, word):  # type: ignore[no-untyped-def]
    """Index of one of the triangles first … last − 1, drawn with a probability proportional to its area.

    area_before : (F + 1,) running sum of areas, m². word : random word.
    """
    wanted = area_before[first] + (np.float64(word) + 0.5) * 2.0**-32 * (area_before[last] - area_before[first])
    low, high = first, last
    while high - low > 1:
        middle = (low + high) // 2
        if area_before[middle] <= wanted:
            low = middle
        else:
            high = middle
    return low
