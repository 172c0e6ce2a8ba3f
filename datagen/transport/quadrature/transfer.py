"""What a laser point lights, or a pixel sees, cut into cells: the two ends of a light path of four bounces.

Flux per area at y from an end, a few points x of weights that add up to one (a laser point is one, a pixel's patch is
as many as it needs; docs/physics.md):

    w(y) = Σ weight · f₁ cosθ₁ cosθ₂ V / R₁²,     path R₁ on average.

By reciprocity it is also the share of the light leaving y that gets to the sensor by way of the patch. A cell is
halved until it is small against its distance and its light is little; what is partly hidden is halved further. A box
of many small triangles is one cell, whose light, place and normal are the means over a few of its triangles
(`_cluster`). A point for a whole patch is right beside another surface, too: what it sees of a wall depends on the
angle between them, not on its distance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import LAMBERTIAN, MaterialTable, dot, evaluate, evaluate_at_most
from datagen.transport.geometry import above, ball, corner, distance, get, half, less, longest, put
from datagen.transport.sampling import word_of
from datagen.transport.visibility.bvh import CLUSTER, SMALLEST, Hierarchy, one_of
from datagen.transport.visibility.closed_surfaces import inner_side
from datagen.transport.visibility.occluder_rows import Occluders
from datagen.transport.visibility.occlusion import LISTED, hidden, lists, shaded

PARTLY, UNFOUND = 4.0, 0.4
"""Error of a cell that is partly seen, and of one of which three rays found nothing, relative to its light."""

DRAWN = 8
"""Triangles that a cluster's light is taken from at most, one from each of as many equal shares of its area. With
half as many the mesh's part of the secondary has about 1.4 times the noise. One alone where a lobe is too narrow for
a mean normal: a different one for each end is right on average."""
WEIGHT, PATH, SIZE, COLUMNS = 9, 12, 15, 18
"""Columns of a cell: nine coordinates of its vertices, w and path there, and the area of it that is not hidden. Of a
cluster: three points on its triangles, and from `WEIGHT` on the normals there."""
NORMAL, ENERGY, LENGTH, SPAN, ALONG, LONG, BACK, BLUR, CLUSTERED, TURNED, NUMBERS = (
    3, 6, 7, 8, 14, 16, 17, 20, 21, 22, 23,
)  # fmt: skip
"""By what others know it: the middle of its light, its normal towards the end, its light, the path to its middle,
two vectors whose squared products with a slope of the path add up to the variance that this gives, these products for
the path to the end, its longest side, the direction to the end, the variance over its points of the path, 1 for a
cluster and 0 for a triangle, and of a cluster the variance of its normals along a direction across their mean,
relative to the square of that mean."""


UPWARD, TO_DEVICE, SHARE, LONGER = 3, 6, 9, 10
"""Columns of an end's point, whose first three are its position."""


class Ends(NamedTuple):
    """N ends, each of Q points; numbers of all kinds in one array, for each array handed over counts.

    Attributes
    ----------
    point : (N, Q, 11) position, metres (0–2), normal (`UPWARD`) and direction to the device (`TO_DEVICE`), unit
        vectors; its weight (`SHARE`), of which those of an end add up to one or are zero; and what its path is longer
        by than that of the end, metres (`LONGER`).
    part : (N, Q) −1 for a point that is none.
    """

    point: Floats
    part: Ints

    @classmethod
    def of(
        cls, position: Floats, normal: Floats, to_device: Floats, part: Ints, share: Floats, longer: Floats,
    ) -> Ends:  # fmt: skip
        """Of (N, Q, 3) and (N, Q)."""
        numbers = np.stack([share, longer], axis=-1)
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
    ends: Ends, tree: Hierarchy, occluders: Occluders, materials: MaterialTable, sharp: Floats, narrow: Bools,
    coarsest: float,
    error: float, asked: bool, seed: int,
) -> tuple[Reach, int]:  # fmt: skip
    """The cells of some ends, and how many rays were asked for them.

    sharp : (K,) 1/width² of each part's narrowest lobe. narrow : (K,) parts of which one normal does not stand for
        many. coarsest : largest cell, relative to its distance.
    error : what a cell may be wrong by, relative to the light of its end. asked : whether anything may hide a cell.
    """
    room = 128 * (len(ends.part) + 1)
    while True:
        cell, number, part = np.empty((room, COLUMNS)), np.empty((room, NUMBERS)), np.empty(room, np.int64)
        first = np.zeros(len(ends.part) + 1, np.int64)
        rays = _cut(
            ends, tree, occluders, materials.kind, materials.values, sharp, narrow, coarsest, error, asked, seed,
            first, cell, number, part, np.empty(128, np.int64), np.empty((128, 3, 3)), np.empty(128),
            np.empty((DRAWN, 8)), lists(0),
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
            w += share * f * up * down / (square * square)
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
            w += point[q, SHARE] * f * up * down / (square * square)
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
def _cluster(  # type: ignore[no-untyped-def]
    at, p, ends, tree, hides, last, listed, kind, values, word, drawn, cell, number, k
):
    """Make one cell k of the triangles of box `at` that end p lights; returns the rays asked.

    Its light, middle, path and normal are means over the light of some of its triangles, one from each of `DRAWN`
    equal shares of its area, or all where they are fewer, and one by one it is asked what hides them. With Lambert's
    law what leaves towards ω is Σ E n·ω, the same as by the mean normal, as long as all that is lit faces ω.
    """
    corners, normal, area_before = tree.corners, tree.normal, tree.area
    start, end, points = tree.span[at, 0], tree.span[at, 1], ends.part.shape[1]
    count, rays, found = min(end - start, DRAWN), 0, 0
    whole = length = 0.0
    middle = mean = (0.0, 0.0, 0.0)
    x, one = _mean(ends, p)
    for s in range(count):
        f, size = start + s, area_before[start + s + 1] - area_before[start + s]
        if end - start > DRAWN:
            f = one_of(start, end, area_before, (2.0**32 * s + np.float64(word)) / count)
            size = (area_before[end] - area_before[start]) / count
        n = get(normal, f, 0)
        if last > LISTED and _see_inner_side(ends, p, f, n, corners, tree.solid, tree.solid_box):
            continue
        a, b, c = corner(corners, f, 0), corner(corners, f, 1), corner(corners, f, 2)
        y = ((a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3)
        if dot(less(x, y), n) < 0.0:
            n = (-n[0], -n[1], -n[2])
        w, r = lit(y, n, p, ends, kind, values)
        w *= size
        if not w > 0.0:
            continue
        if last > LISTED:
            q = (3 * k + s) % points
            q = q if ends.part[p, q] >= 0 else one
            rays += 1
            if hidden(get(ends.point[p], q, 0), y, f, LISTED, last, hides, listed) > 0:
                continue
        put(drawn, found, 0, y)
        put(drawn, found, 3, n)
        drawn[found, 6], drawn[found, 7] = w, r
        found += 1
        whole, length = whole + w, length + w * r
        middle = (middle[0] + w * y[0], middle[1] + w * y[1], middle[2] + w * y[2])
        mean = (mean[0] + w * n[0], mean[1] + w * n[1], mean[2] + w * n[2])
    number[k, ENERGY] = 0.0
    if found == 0:
        return rays
    per = 1.0 / whole
    y, length = (middle[0] * per, middle[1] * per, middle[2] * per), length * per
    # The mean of unit normals is shorter than one, by as much as less leaves towards each direction.
    number[k, ENERGY] = math.sqrt(dot(mean, mean))
    per = 1.0 / number[k, ENERGY]
    put(number, k, 0, y)
    put(number, k, NORMAL, (mean[0] * per, mean[1] * per, mean[2] * per))
    number[k, TURNED] = 0.5 * max((whole * per) ** 2 - 1.0, 0.0)
    number[k, LENGTH], number[k, CLUSTERED] = length, 1.0
    back = distance(x, y)
    put(number, k, BACK, ((x[0] - y[0]) / back, (x[1] - y[1]) / back, (x[2] - y[2]) / back))
    blur = _blur(y, p, ends, length) if points > 1 else 0.0
    if found == 1:
        # Of one there is no scatter: that of all the box.
        moment, g = tree.moment[tree.cluster[at]], (-number[k, BACK], -number[k, BACK + 1], -number[k, BACK + 2])
        spread = (moment[3], moment[6], moment[7], moment[4], moment[8], moment[5])
        xx, xy, xz, yy, yz, zz = spread
        along = (dot((xx, xy, xz), g), dot((xy, yy, yz), g), dot((xz, yz, zz), g))
    else:
        spread, along = _scatter(drawn, found, y, length, whole)
    number[k, BLUR] = blur + _spans(spread, along, number, k)
    # Three of the points, in the middles of thirds of the light, are where its rays begin.
    at_light, s = 0.0, 0
    for j in range(3):
        while s < found - 1 and at_light + drawn[s, 6] < (j + 0.5) / 3 * whole:
            at_light += drawn[s, 6]
            s += 1
        put(cell, k, 3 * j, get(drawn, s, 0))
        put(cell, k, WEIGHT + 3 * j, get(drawn, s, 3))
    return rays


@compiled(_nrt=False)
def _scatter(drawn, found, y, length, whole):  # type: ignore[no-untyped-def]
    """Covariance of the places of some triangles, weighted with their light, as xx, xy, xz, yy, yz, zz, and of their
    places with their paths; m²."""
    # What lies between the triangles drawn is in none of them: N of them have (N − 1)/N of the variance.
    share = found / max(found - 1, 1) / whole
    xx = xy = xz = yy = yz = zz = rx = ry = rz = 0.0
    for s in range(found):
        d, w = less(get(drawn, s, 0), y), share * drawn[s, 6]
        r = drawn[s, 7] - length
        xx, xy, xz = xx + w * d[0] * d[0], xy + w * d[0] * d[1], xz + w * d[0] * d[2]
        yy, yz, zz = yy + w * d[1] * d[1], yz + w * d[1] * d[2], zz + w * d[2] * d[2]
        rx, ry, rz = rx + w * r * d[0], ry + w * r * d[1], rz + w * r * d[2]
    return (xx, xy, xz, yy, yz, zz), (rx, ry, rz)


@compiled(_nrt=False)
def _spans(spread, along, number, k):  # type: ignore[no-untyped-def]
    """Fill `SPAN`, `ALONG` and `LONG` of cluster k from its covariances; returns the variance along the third
    direction, m², for which there is no column."""
    xx, xy, xz, yy, yz, zz = spread
    rx, ry, rz = along
    number[k, LONG] = math.sqrt(18.0 * (xx + yy + zz))
    for j in range(2):
        # The column of the axis with the largest variance left, as in Cholesky's decomposition with pivots.
        p, path, most = (xx, xy, xz), rx, xx
        if yy >= max(xx, zz):
            p, path, most = (xy, yy, yz), ry, yy
        elif zz > xx:
            p, path, most = (xz, yz, zz), rz, zz
        per = 1.0 / math.sqrt(most) if most > 0.0 else 0.0
        p, path = (per * p[0], per * p[1], per * p[2]), per * path
        put(number, k, SPAN + 3 * j, p)
        number[k, ALONG + j] = path
        xx, xy, xz = xx - p[0] * p[0], xy - p[0] * p[1], xz - p[0] * p[2]
        yy, yz, zz = yy - p[1] * p[1], yz - p[1] * p[2], zz - p[2] * p[2]
        rx, ry, rz = rx - p[0] * path, ry - p[1] * path, rz - p[2] * path
    return max(xx, yy, zz, 0.0)


@compiled(_nrt=False)
def _cut(  # type: ignore[no-untyped-def]
    ends, tree, occluders, kind, values, sharp, narrow, coarsest, error, asked, seed, first, cell, known, part_of,
    boxes, waits, wait_area, drawn, listed,
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
                start, end = span[at, 0], span[at, 1]
                if end - start > CLUSTER:
                    centre, radius = ball(around, at)
                    near, size = distance(centre, x) - radius, area_before[end] - area_before[start]
                    small = 2.0 * radius <= coarsest * near and size <= error * math.pi * near * near
                    if near <= 0.0 or narrow[k] or not small:
                        boxes[closed], boxes[closed + 1] = children[at, 0], children[at, 1]
                        closed += 2
                        continue
                    if count == len(cell):
                        return -1
                    rays += _cluster(
                        at, p, ends, tree, hides, last, listed, kind, values,
                        word_of(seed, p, at), drawn, cell, known, count,
                    )  # fmt: skip
                    if known[count, ENERGY] > 0.0:
                        part_of[count] = k
                        count += 1
                    continue
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
                    for j in range(3):
                        put(waits[0], j, 0, corner(corners, f, j))
                    wait_area[0], top = own, 1
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
                        cut = not near or over * min(keen * across, max(across, 1.0)) > error
                        visible = 1.0
                        if last > LISTED and not cut:
                            seen, u = 0, (0.0, 0.0, 0.0)
                            for j in range(3):
                                y = half(m, get(waits[top], j, 0))
                                q = (3 * count + j) % points
                                q = q if part[p, q] >= 0 else one
                                rays += 1
                                z = get(ends.point[p], q, 0)
                                if hidden(z, y, f, LISTED, last, hides, listed) == 0:
                                    seen, u = seen + 1, (u[0] + y[0], u[1] + y[1], u[2] + y[2])
                            visible = seen / 3
                            cut = seen < 3 and (PARTLY if seen > 0 else UNFOUND) * over > error
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
                        if visible < 1.0:
                            # What is seen of it stands for all of it, so that its middle is not behind what hides it.
                            u = (u[0] / seen - 0.5 * m[0], u[1] / seen - 0.5 * m[1], u[2] / seen - 0.5 * m[2])
                            for j in range(3):
                                y = get(waits[top], j, 0)
                                y = (u[0] + 0.5 * y[0], u[1] + 0.5 * y[1], u[2] + 0.5 * y[2])
                                put(cell, count, 3 * j, y)
                                cell[count, WEIGHT + j], cell[count, PATH + j] = lit(y, n, p, ends, kind, values)
                        cell[count, SIZE], known[count, CLUSTERED] = visible * size, 0.0
                        put(known, count, NORMAL, n)
                        back = distance(x, m)
                        put(known, count, BACK, ((x[0] - m[0]) / back, (x[1] - m[1]) / back, (x[2] - m[2]) / back))
                        known[count, BLUR] = _blur(m, p, ends, r) if points > 1 else 0.0
                        condense(cell, count, known, count, p, ends, kind, values)
                        part_of[count] = k
                        count += 1
    first[len(part)] = count
    return rays
