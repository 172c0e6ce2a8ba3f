"""What a laser point lights, or a pixel sees, cut into cells: the two ends of a light path of four bounces.

Flux per area at y from an end, a few points x of weights that add up to one (a laser point is one, a pixel's patch is
as many as it needs; docs/physics.md):

    w(y) = Σ weight · f₁ cosθ₁ cosθ₂ V / (R₁² + a/π),     path R₁ on average,

a the wall area that a point of a patch stands for. By reciprocity it is also the share of the light leaving y that
gets to the sensor by way of the patch. A cell is halved until it is small against its distance and its light is
little; what is partly hidden is halved further. Boxes of many small triangles are stood for by one of them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import LAMBERTIAN, MaterialTable, dot, evaluate, evaluate_at_most
from datagen.transport.cells.geometry import above, ball, corner, distance, get, half, less, longest, put
from datagen.transport.cells.hierarchy import CLUSTER, SMALLEST, Hierarchy, one_of
from datagen.transport.cells.occluders import Occluders
from datagen.transport.cells.occlusion import LISTED, hidden, lists, shaded
from datagen.transport.cells.solids import inner_side
from datagen.transport.sampling import word_of

PARTLY, UNFOUND = 4.0, 0.4
"""Error of a cell that is partly seen, and of one of which three rays found nothing, relative to its light."""

WEIGHT, PATH, SIZE, COLUMNS = 9, 12, 15, 16
"""Columns of a cell: nine coordinates of its vertices, w and path there, and the area of it that is not hidden."""
NORMAL, ENERGY, LENGTH, SPAN, ALONG, LONG, BACK, BLUR, NUMBERS = 3, 6, 7, 8, 14, 16, 17, 20, 21
"""By what others know it: the middle of its light, its normal towards the end, its light, the path to its middle,
two vectors whose squared products with a slope of the path add up to the variance that this gives, these products for
the path to the end, its longest side, the direction to the end, and the variance over its points of the path."""


UPWARD, TO_DEVICE, SHARE, LONGER, FOOTPRINT = 3, 6, 9, 10, 11
"""Columns of an end's point, whose first three are its position."""


class Ends(NamedTuple):
    """N ends, each of Q points; numbers of all kinds in one array, for each array handed over counts.

    Attributes
    ----------
    point : (N, Q, 12) position, metres (0–2), normal (`UPWARD`) and direction to the device (`TO_DEVICE`), unit
        vectors; its weight (`SHARE`), of which those of an end add up to one or are zero; what its path is longer by
        than that of the end, metres (`LONGER`); and the wall area that it stands for, m² (`FOOTPRINT`).
    part : (N, Q) −1 for a point that is none.
    """

    point: Floats
    part: Ints

    @classmethod
    def of(
        cls, position: Floats, normal: Floats, to_device: Floats, part: Ints, share: Floats, longer: Floats,
        footprint: Floats,
    ) -> Ends:  # fmt: skip
        """Of (N, Q, 3) and (N, Q)."""
        numbers = np.stack([share, longer, footprint], axis=-1)
        return cls(np.concatenate([position, normal, to_device, numbers], axis=-1), np.ascontiguousarray(part))


class Reach(NamedTuple):
    """The cells of N ends.

    Attributes
    ----------
    first : (N + 1,) those of end n are first[n] … first[n + 1].
    cell : (M, COLUMNS) and number : (M, NUMBERS) as the columns say.
    part : (M,) their parts.
    """

    first: Ints
    cell: Floats
    number: Floats
    part: Ints


def reach_of(
    ends: Ends, tree: Hierarchy, occluders: Occluders, materials: MaterialTable, sharp: Floats, coarsest: float,
    error: float, asked: bool, seed: int,
) -> tuple[Reach, int]:  # fmt: skip
    """The cells of some ends, and how many rays were asked for them.

    sharp : (K,) 1/width² of each part's narrowest lobe. coarsest : largest cell, relative to its distance.
    error : what a cell may be wrong by, relative to the light of its end. asked : whether anything may hide a cell.
    """
    room = 128 * (len(ends.part) + 1)
    while True:
        cell, number, part = np.empty((room, COLUMNS)), np.empty((room, NUMBERS)), np.empty(room, np.int64)
        first = np.zeros(len(ends.part) + 1, np.int64)
        rays = _cut(
            ends, tree, occluders, materials.kind, materials.values, sharp, coarsest, error, asked, seed, first, cell,
            number, part, np.empty(128, np.int64), np.empty((128, 3, 3)), np.empty(128), lists(0),
        )  # fmt: skip
        if rays >= 0:
            return Reach(first, cell[: first[-1]], number[: first[-1]], part[: first[-1]]), rays
        room *= 4


@compiled(_nrt=False)
def lit(y, n, p, ends, kind, values):  # type: ignore[no-untyped-def]
    """w(y) but for what hides it, and the path, for a surface with its normal n towards end p."""
    point, part = ends.point[p], ends.part
    w = path = whole = 0.0
    for q in range(part.shape[1]):
        k = part[p, q]
        if k < 0:
            continue
        d, n1 = less(y, get(point, q, 0)), get(point, q, UPWARD)
        square = dot(d, d)
        r, up, down = math.sqrt(square), dot(d, n1), -dot(d, n)
        share = point[q, SHARE]
        path += share * (r + point[q, LONGER])
        whole += share
        if up > 0.0 and down > 0.0:
            per = 1.0 / r
            f = evaluate(kind[k], values[k], n1, get(point, q, TO_DEVICE), (d[0] * per, d[1] * per, d[2] * per))
            w += share * f * up * down / (square * (square + point[q, FOOTPRINT] / math.pi))
    return w, path / whole


@compiled(_nrt=False)
def lit_at_most(y, n, h, p, ends, kind, values):  # type: ignore[no-untyped-def]
    """The largest w that the BRDFs at end p allow within a cell about y that is h long."""
    point, part, w = ends.point[p], ends.part, 0.0
    for q in range(part.shape[1]):
        k = part[p, q]
        if k < 0:
            continue
        d, n1 = less(y, get(point, q, 0)), get(point, q, UPWARD)
        square = dot(d, d)
        r, up, down = math.sqrt(square), dot(d, n1), -dot(d, n)
        if up > 0.0 and down > 0.0:
            per = 1.0 / r
            w1 = (d[0] * per, d[1] * per, d[2] * per)
            f = evaluate_at_most(kind[k], values[k], n1, get(point, q, TO_DEVICE), w1, h * per, 0.0)
            w += point[q, SHARE] * f * up * down / (square * (square + point[q, FOOTPRINT] / math.pi))
    return w


@compiled(_nrt=False)
def condense(cell, k, number, to, p, ends, kind, values):  # type: ignore[no-untyped-def]
    """What other cells know of cell k of end p, but for its normal, the direction to its end and the blur.

    Light and its mean position and path by a rule of third degree: middle, vertices, middles of the sides. The
    variance of a linear function over a triangle is ((∇·e)²/2 + 2 (∇·s)²/3)/12, e a side and s from its middle
    to the third vertex.
    """
    n, a, b, c = get(number, to, NORMAL), get(cell, k, 0), get(cell, k, 3), get(cell, k, 6)
    ra, rb, rc = get(cell, k, PATH)
    whole = length = 0.0
    middle = (0.0, 0.0, 0.0)
    for j in range(7):
        y, w, path, share = a, 0.0, 0.0, 0.45
        if j < 3:
            y, w, path, share = get(cell, k, 3 * j), cell[k, WEIGHT + j], cell[k, PATH + j], 0.05
        else:
            if j < 6:
                y, share = half(get(cell, k, 3 * (j - 3)), get(cell, k, 3 * ((j - 2) % 3))), 2.0 / 15.0
            else:
                y = ((a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3)
            w, path = lit(y, n, p, ends, kind, values)
        w *= share
        whole, length = whole + w, length + w * path
        middle = (middle[0] + w * y[0], middle[1] + w * y[1], middle[2] + w * y[2])
    per = 1.0 / whole if whole > 0.0 else 0.0
    put(number, to, 0, (middle[0] * per, middle[1] * per, middle[2] * per))
    number[to, ENERGY], number[to, LENGTH] = cell[k, SIZE] * whole, length * per
    e, s = less(b, a), less(c, half(a, b))
    one, two = math.sqrt(1 / 24), math.sqrt(1 / 18)
    put(number, to, SPAN, (one * e[0], one * e[1], one * e[2]))
    put(number, to, SPAN + 3, (two * s[0], two * s[1], two * s[2]))
    number[to, ALONG], number[to, ALONG + 1] = one * (rb - ra), two * (rc - 0.5 * (ra + rb))
    _, number[to, LONG] = longest(a, b, c)


@compiled(_nrt=False)
def _mean(ends, p):  # type: ignore[no-untyped-def]
    """The middle of an end, and the number of a point of it, −1 if it has none."""
    point, part = ends.point[p], ends.part
    x = y = z = 0.0
    one = -1
    for q in range(part.shape[1]):
        share = point[q, SHARE]
        if part[p, q] >= 0 and share > 0.0:
            one = q
            x += share * point[q, 0]
            y += share * point[q, 1]
            z += share * point[q, 2]
    return (x, y, z), one


@compiled(_nrt=False)
def _faces_any(box, at, ends, p):  # type: ignore[no-untyped-def]
    """Whether some of a box lies above the surface at any point of an end."""
    for q in range(ends.part.shape[1]):
        if ends.part[p, q] >= 0 and above(box, at, get(ends.point[p], q, 0), get(ends.point[p], q, UPWARD)) > 0.0:
            return True
    return False


@compiled(_nrt=False)
def _see_inner_side(ends, p, f, n, corners, solid, solid_box):  # type: ignore[no-untyped-def]
    """Whether triangle f turns the inner side of a solid to all points of an end."""
    for q in range(ends.part.shape[1]):
        if ends.part[p, q] >= 0 and not inner_side(get(ends.point[p], q, 0), n, corners, f, solid, solid_box):
            return False
    return True


@compiled(_nrt=False)
def _blur(y, p, ends, mean):  # type: ignore[no-untyped-def]
    """Variance of the path to y over an end's points, m²."""
    variance, points = 0.0, ends.part.shape[1]
    for q in range(points):
        if ends.part[p, q] >= 0:
            apart = distance(y, get(ends.point[p], q, 0)) + ends.point[p, q, LONGER] - mean
            variance += ends.point[p, q, SHARE] * apart * apart
    # Each of Q points stands for a patch whose own variance is a Q-th of the whole's, nearly.
    return variance * points / max(points - 1, 1)


@compiled(_nrt=False)
def _cut(  # type: ignore[no-untyped-def]
    ends, tree, occluders, kind, values, sharp, coarsest, error, asked, seed, first, cell, known, part_of, boxes,
    waits, wait_area, listed,
):  # fmt: skip
    """Fill `first`, `cell`, `known` and `part_of`; returns the rays asked, or −1 where there is no room."""
    corners, normal, area_before, around, children = tree.corners, tree.normal, tree.area, tree.box, tree.children
    span, roots, smallest, flat = tree.span, tree.roots, SMALLEST * tree.extent, occluders.flat
    hides, solid, solid_box = occluders.row, tree.solid, tree.solid_box
    part = ends.part
    last = LISTED + (min(occluders.triangles, 1) if asked else 0)
    count, rays, points = 0, 0, part.shape[1]
    for p in range(len(part)):
        first[p] = count
        x, one = _mean(ends, p)
        if one < 0:
            continue
        keen, lobed = 1.0, False
        for q in range(points):
            if part[p, q] >= 0:
                keen, lobed = max(keen, sharp[part[p, q]]), lobed or kind[part[p, q]] != LAMBERTIAN
        for k in range(len(roots)):
            boxes[0], closed = roots[k], 1
            while closed > 0:
                closed -= 1
                at = boxes[closed]
                if not _faces_any(around, at, ends, p):
                    continue
                start, end, cluster = span[at, 0], span[at, 1], 0.0
                if end - start > CLUSTER:
                    centre, radius = ball(around, at)
                    near, cluster = distance(centre, x) - radius, area_before[end] - area_before[start]
                    if near <= 0.0 or 2.0 * radius > coarsest * near or cluster > error * math.pi * near * near:
                        boxes[closed], boxes[closed + 1] = children[at, 0], children[at, 1]
                        closed += 2
                        continue
                    word = word_of(seed, p, at)
                    start = one_of(start, end, area_before, word)
                    end = start + 1
                for f in range(start, end):
                    n = get(normal, f, 0)
                    if last > LISTED and _see_inner_side(ends, p, f, n, corners, solid, solid_box):
                        continue
                    height = dot(less(x, corner(corners, f, 0)), n)
                    if abs(height) < flat and points == 1:
                        continue
                    if height < 0.0:
                        n = (-n[0], -n[1], -n[2])
                    own = area_before[f + 1] - area_before[f]
                    a, b, c = corner(corners, f, 0), corner(corners, f, 1), corner(corners, f, 2)
                    m = ((a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3)
                    # What stands for a box is as large as all in it.
                    grown = math.sqrt(cluster / own) if cluster > 0.0 else 1.0
                    for j in range(3):
                        for i in range(3):
                            waits[0, j, i] = m[i] + grown * (corners[f, j, i] - m[i])
                    wait_area[0], top = max(cluster, own), 1
                    while top > 0:
                        top -= 1
                        a, b, c = get(waits[top], 0, 0), get(waits[top], 1, 0), get(waits[top], 2, 0)
                        m = ((a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3)
                        side, h = longest(a, b, c)
                        if count == len(cell):
                            return -1
                        # It is written where it will stand if it stays.
                        brightest, r = lit(m, n, p, ends, kind, values)
                        for j in range(3):
                            y = get(waits[top], j, 0)
                            put(cell, count, 3 * j, y)
                            cell[count, WEIGHT + j], cell[count, PATH + j] = lit(y, n, p, ends, kind, values)
                            brightest = max(brightest, cell[count, WEIGHT + j])
                        size, across = wait_area[top], (h / distance(m, x)) ** 2
                        if lobed:
                            brightest = max(brightest, lit_at_most(m, n, h, p, ends, kind, values))
                        over, near = size * brightest, across < coarsest * coarsest
                        if not over > 0.0 and near:
                            continue
                        cut = cluster == 0.0 and (not near or over * min(keen * across, max(across, 1.0)) > error)
                        visible = 1.0
                        if last > LISTED and not cut:
                            seen, u = 0, (0.0, 0.0, 0.0)
                            for j in range(3):
                                y = half(m, get(waits[top], j, 0)) if cluster == 0.0 else m
                                q = (3 * count + j) % points
                                q = q if part[p, q] >= 0 else one
                                rays += 1
                                z = get(ends.point[p], q, 0)
                                if hidden(z, y, f, LISTED, last, hides, listed) == 0:
                                    seen, u = seen + 1, (u[0] + y[0], u[1] + y[1], u[2] + y[2])
                            visible = seen / 3
                            cut = seen < 3 and cluster == 0.0 and (PARTLY if seen > 0 else UNFOUND) * over > error
                            if seen == 0 and not cut:
                                continue
                        if cut:
                            none = h <= smallest
                            if last > LISTED and points == 1 and not none:
                                none = shaded(x, a, b, c, f, LISTED, last, hides, listed)
                            if none or top > 120:
                                continue
                            y = half(get(waits[top], side, 0), get(waits[top], (side + 1) % 3, 0))
                            wait_area[top] *= 0.5
                            wait_area[top + 1] = wait_area[top]
                            for j in range(3):
                                put(waits[top + 1], j, 0, get(waits[top], j, 0))
                            put(waits[top], side, 0, y)
                            put(waits[top + 1], (side + 1) % 3, 0, y)
                            top += 2
                            continue
                        if visible < 1.0 and cluster == 0.0:
                            # What is seen of it stands for all of it, so that its middle is not behind what hides it.
                            u = (u[0] / seen - 0.5 * m[0], u[1] / seen - 0.5 * m[1], u[2] / seen - 0.5 * m[2])
                            for j in range(3):
                                y = get(waits[top], j, 0)
                                y = (u[0] + 0.5 * y[0], u[1] + 0.5 * y[1], u[2] + 0.5 * y[2])
                                put(cell, count, 3 * j, y)
                                cell[count, WEIGHT + j], cell[count, PATH + j] = lit(y, n, p, ends, kind, values)
                        cell[count, SIZE] = visible * size
                        put(known, count, NORMAL, n)
                        back = distance(x, m)
                        put(known, count, BACK, ((x[0] - m[0]) / back, (x[1] - m[1]) / back, (x[2] - m[2]) / back))
                        known[count, BLUR] = _blur(m, p, ends, r) if points > 1 else 0.0
                        condense(cell, count, known, count, p, ends, kind, values)
                        part_of[count] = k
                        count += 1
    first[len(part)] = count
    return rays
