"""The surface elements that a laser point lights, or a pixel sees: the two ends of a light path of four bounces.

Flux per area at y from an end, a few points x of weights that add up to one (a laser point is one, a pixel's
footprint is as many as it needs; docs/physics.md):

    w(y) = Σ weight · f₁ cosθ₁ cosθ₂ V / R₁²,     path R₁ on average.

By reciprocity w is also the share of the light leaving y that gets to the sensor by way of the footprint. An element
is halved until it is small against its distance and its light is little; what is partly hidden is halved further. A
box of many small triangles is one element, whose light, place and normal are the means over a few of its triangles
(`_cluster`). A single point for a whole footprint would be wrong beside another surface: what it sees of a wall
depends on the angle between them, not on its distance.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import LAMBERTIAN, dot, evaluate, evaluate_at_most
from datagen.transport.geometry import above, bounding_sphere, corner, distance, get, half, longest, put, subtract
from datagen.transport.sampling import word_of
from datagen.transport.visibility.bvh import CLUSTER, SMALLEST, Hierarchy, one_of
from datagen.transport.visibility.occluder_rows import Occluders
from datagen.transport.visibility.occlusion import LISTED, hidden, lists

PARTLY, UNFOUND = 4.0, 0.4
"""Error of an element that is partly seen, and of one of which three rays found nothing, relative to its light. With
half of them shadows' edges are cut once less."""
DRAWN = 8
"""Triangles that a cluster's light is taken from at most, one from each of as many equal shares of its area. With
half as many the mesh's part of the secondary has about 1.4 times the noise."""
DEEPEST = 120
"""Parts of a triangle that wait to be looked at, at most; halvings end far earlier."""
SPARE = 1 << 14
"""Rows for halves that pairs of elements ask for. With half as many they are forgotten, and made anew, more often."""

WEIGHT, PATH, SIZE, COLUMNS = 9, 12, 15, 18
"""Columns of `Elements.corner`: three vertices (0–8), w and path at each, and the area that is not hidden. Of a
cluster: three points on its triangles, and from `WEIGHT` on the normals there."""
NORMAL, ENERGY, LENGTH, SPAN, ALONG, LONG, BACK, BLUR, CLUSTERED, TURNED, NUMBERS = (
    3, 6, 7, 8, 14, 16, 17, 20, 21, 22, 23,
)  # fmt: skip
"""Columns of `Elements.known`: the middle of its light (0–2), its normal towards the end, its light, the path to its
middle, two vectors whose squared products with a slope of the path add up to the variance that this gives, these
products for the path to the end, its longest side, the direction to the end, the variance over its points of the
path, 1 for a cluster and 0 for a triangle, and of a cluster the variance of its normals along a direction across
their mean, relative to the square of that mean."""
UPWARD, TO_DEVICE, SHARE, LONGER = 3, 6, 9, 10
"""Columns of an end's point, whose first three are its position."""


class Ends(NamedTuple):
    """N ends, each of Q points; numbers of all kinds in one array, because each array handed to a kernel costs time.

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
        cls, position: Floats, normal: Floats, to_device: Floats, part: Ints, share: Floats, longer: Floats
    ) -> Ends:
        """Ends from arrays (N, Q, 3) and (N, Q)."""
        numbers = np.stack([share, longer], axis=-1)
        return cls(np.concatenate([position, normal, to_device, numbers], axis=-1), np.ascontiguousarray(part))


class Optics(NamedTuple):
    """kind (K,) and values (K, n) of each part's BRDF, as in `MaterialTable`; sharp (K,) 1/width² of its narrowest
    lobe; narrow (K,) whether that is too narrow for one normal to stand for many."""

    kind: Ints | NDArray[np.uint8]
    values: Floats
    sharp: Floats
    narrow: Bools


class Fineness(NamedTuple):
    """coarsest : largest element, relative to its distance. error : what an element may be wrong by, relative to the
    light of its end. shadows : whether anything may hide an element. seed : of clusters' random triangles."""

    coarsest: float
    error: float
    shadows: bool
    seed: int


class Elements(NamedTuple):
    """The surface elements of N ends, and behind them the halves into which pairs of elements have cut some so far.

    Attributes
    ----------
    first : (N + 1,) those of end n are first[n] … first[n + 1].
    corner : (M, COLUMNS) and known : (M, NUMBERS) as the columns say.
    part : (M,) their parts.
    halves : (M,) the first of an element's two halves, which follow each other; −1 before it is cut.
    used : (1,) rows in use, halves with them.
    """

    first: Ints
    corner: Floats
    known: Floats
    part: Ints
    halves: Ints
    used: Ints


class _Scratch(NamedTuple):
    """Boxes and pieces of a triangle that wait, with their areas; what a cluster has drawn; the lists of
    `occlusion.py`."""

    boxes: Ints
    corners: Floats
    area: Floats
    drawn: Floats
    listed: Ints


def elements_of(
    ends: Ends, tree: Hierarchy, occluders: Occluders, optics: Optics, fineness: Fineness
) -> tuple[Elements, int]:
    """The surface elements of some ends, and how many rays were asked for them."""
    scratch = _Scratch(
        np.empty(DEEPEST + 8, np.int64), np.empty((DEEPEST + 8, 3, 3)), np.empty(DEEPEST + 8), np.empty((DRAWN, 8)),
        lists(0),
    )  # fmt: skip
    room = 128 * (len(ends.part) + 1)
    while True:
        rows = room + SPARE
        found = Elements(
            np.zeros(len(ends.part) + 1, np.int64), np.empty((rows, COLUMNS)), np.empty((rows, NUMBERS)),
            np.empty(rows, np.int64), np.full(rows, -1), np.zeros(1, np.int64),
        )  # fmt: skip
        rays = _cut(ends, tree, occluders, optics, fineness, found, scratch)
        if rays >= 0:
            return found, rays
        room *= 4


@compiled(_nrt=False)
def lit(y, n, p, ends, optics):  # type: ignore[no-untyped-def]
    """w(y) but for what hides it, and the path, for a surface with its normal n towards end p."""
    point, part = ends.point[p], ends.part
    w = path = whole = 0.0
    for q in range(part.shape[1]):
        k = part[p, q]
        if k < 0:
            continue
        d, n1 = subtract(y, get(point, q, 0)), get(point, q, UPWARD)
        square = dot(d, d)
        r, up, down = math.sqrt(square), dot(d, n1), -dot(d, n)
        share = point[q, SHARE]
        path += share * (r + point[q, LONGER])
        whole += share
        if up > 0.0 and down > 0.0:
            per = 1.0 / r
            onward = (d[0] * per, d[1] * per, d[2] * per)
            f = evaluate(optics.kind[k], optics.values[k], n1, get(point, q, TO_DEVICE), onward)
            w += share * f * up * down / (square * square)
    return w, path / whole


@compiled(_nrt=False)
def _lit_at_most(y, n, h, p, ends, optics):  # type: ignore[no-untyped-def]
    """The largest w that the BRDFs at end p allow within an element about y that is h long."""
    point, part, w = ends.point[p], ends.part, 0.0
    for q in range(part.shape[1]):
        k = part[p, q]
        if k < 0:
            continue
        d, n1 = subtract(y, get(point, q, 0)), get(point, q, UPWARD)
        square = dot(d, d)
        r, up, down = math.sqrt(square), dot(d, n1), -dot(d, n)
        if up > 0.0 and down > 0.0:
            per = 1.0 / r
            onward = (d[0] * per, d[1] * per, d[2] * per)
            f = evaluate_at_most(optics.kind[k], optics.values[k], n1, get(point, q, TO_DEVICE), onward, h * per, 0.0)
            w += point[q, SHARE] * f * up * down / (square * square)
    return w


@compiled(_nrt=False)
def condense(elements, k, p, ends, optics):  # type: ignore[no-untyped-def]
    """Fill what other elements know of element k of end p, but for its normal, the direction to its end and the blur.

    Light and its mean position and path by a rule of third degree: middle, vertices, middles of the sides. The
    variance of a linear function over a triangle is ((∇·e)²/2 + 2 (∇·s)²/3)/12, e a side and s from its middle
    to the third vertex.
    """
    corner, known = elements.corner, elements.known
    n, a, b, c = get(known, k, NORMAL), get(corner, k, 0), get(corner, k, 3), get(corner, k, 6)
    ra, rb, rc = get(corner, k, PATH)
    whole = length = 0.0
    middle = (0.0, 0.0, 0.0)
    for j in range(7):
        y, w, path, share = a, 0.0, 0.0, 0.45
        if j < 3:
            # Vertices are shared with the other half, and their light is known.
            y, w, path, share = get(corner, k, 3 * j), corner[k, WEIGHT + j], corner[k, PATH + j], 0.05
        else:
            if j < 6:
                y, share = half(get(corner, k, 3 * (j - 3)), get(corner, k, 3 * ((j - 2) % 3))), 2.0 / 15.0
            else:
                y = ((a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3)
            w, path = lit(y, n, p, ends, optics)
        w *= share
        whole, length = whole + w, length + w * path
        middle = (middle[0] + w * y[0], middle[1] + w * y[1], middle[2] + w * y[2])
    per = 1.0 / whole if whole > 0.0 else 0.0
    put(known, k, 0, (middle[0] * per, middle[1] * per, middle[2] * per))
    known[k, ENERGY], known[k, LENGTH] = corner[k, SIZE] * whole, length * per
    e, s = subtract(b, a), subtract(c, half(a, b))
    one, two = math.sqrt(1 / 24), math.sqrt(1 / 18)
    put(known, k, SPAN, (one * e[0], one * e[1], one * e[2]))
    put(known, k, SPAN + 3, (two * s[0], two * s[1], two * s[2]))
    known[k, ALONG], known[k, ALONG + 1] = one * (rb - ra), two * (rc - 0.5 * (ra + rb))
    _, known[k, LONG] = longest(a, b, c)


@compiled()
def halves_of(elements, k, p, ends, optics):  # type: ignore[no-untyped-def]
    """The first of the two halves of element k of end p, which follow each other: cut on its longest side the first
    time that a pair asks for them. −1 if there is no room for them."""
    corner, known, first = elements.corner, elements.known, elements.halves[k]
    if first >= 0 or elements.used[0] + 2 > len(corner):
        return first
    first = elements.used[0]
    elements.halves[k], elements.used[0] = first, first + 2
    side, _ = longest(get(corner, k, 0), get(corner, k, 3), get(corner, k, 6))
    other = (side + 1) % 3
    y = half(get(corner, k, 3 * side), get(corner, k, 3 * other))
    w, path = lit(y, get(known, k, NORMAL), p, ends, optics)
    for to, vertex in ((first, side), (first + 1, other)):
        # Each half is the element with one vertex moved to the middle of the side.
        for column in range(COLUMNS):
            corner[to, column] = corner[k, column]
        for column in range(NUMBERS):
            known[to, column] = known[k, column]
        elements.halves[to] = -1
        corner[to, SIZE] *= 0.5
        put(corner, to, 3 * vertex, y)
        corner[to, WEIGHT + vertex], corner[to, PATH + vertex] = w, path
        condense(elements, to, p, ends, optics)
    return first


@compiled()
def forget_halves(elements):  # type: ignore[no-untyped-def]
    """Forget all halves if they fill more than half of their room, so that memory stays bounded."""
    own, rows = elements.first[-1], len(elements.halves)
    if 2 * (elements.used[0] - own) > rows - own:
        for k in range(own):
            elements.halves[k] = -1
        elements.used[0] = own


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
def _blur(y, p, ends, mean):  # type: ignore[no-untyped-def]
    """Variance of the path to y over an end's points, m²."""
    variance, points = 0.0, ends.part.shape[1]
    if points == 1:
        return variance
    for q in range(points):
        if ends.part[p, q] >= 0:
            apart = distance(y, get(ends.point[p], q, 0)) + ends.point[p, q, LONGER] - mean
            variance += ends.point[p, q, SHARE] * apart * apart
    # Each of Q points stands for a patch whose own variance is a Q-th of the whole's, nearly.
    return variance * points / max(points - 1, 1)


@compiled(_nrt=False)
def _point_in_turn(turn, p, one, ends):  # type: ignore[no-untyped-def]
    """A point of end p, another one each turn, so that rays to an element come from all over a footprint."""
    q = turn % ends.part.shape[1]
    return get(ends.point[p], q if ends.part[p, q] >= 0 else one, 0)


@compiled(_nrt=False)
def _draw(at, p, end, turn, ends, tree, hides, optics, seed, scratch):  # type: ignore[no-untyped-def]
    """Draw triangles of box `at`, one from each of `DRAWN` equal shares of its area, or all where they are fewer.

    Puts place, normal towards the end, light and path of those that end p lights into `scratch.drawn`; returns how
    many these are, their light, and the rays asked for what hides them.
    """
    first, behind, area, drawn = tree.span[at, 0], tree.span[at, 1], tree.area, scratch.drawn
    (x, one, last), word = end, np.float64(word_of(seed, p, at))
    count, rays, found, whole = min(behind - first, DRAWN), 0, 0, 0.0
    for s in range(count):
        f, size = first + s, area[first + s + 1] - area[first + s]
        if behind - first > DRAWN:
            f = one_of(first, behind, area, (2.0**32 * s + word) / count)
            size = (area[behind] - area[first]) / count
        n = get(tree.normal, f, 0)
        a, b, c = corner(tree.corners, f, 0), corner(tree.corners, f, 1), corner(tree.corners, f, 2)
        y = ((a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3)
        if dot(subtract(x, y), n) < 0.0:
            n = (-n[0], -n[1], -n[2])
        w, path = lit(y, n, p, ends, optics)
        w *= size
        if not w > 0.0:
            continue
        if last > LISTED:
            rays += 1
            z = _point_in_turn(3 * turn + s, p, one, ends)
            if hidden(z, y, f, LISTED, last, hides, scratch.listed) > 0:
                continue
        put(drawn, found, 0, y)
        put(drawn, found, 3, n)
        drawn[found, 6], drawn[found, 7] = w, path
        found, whole = found + 1, whole + w
    return found, whole, rays


@compiled(_nrt=False)
def _cluster(at, p, end, ends, tree, hides, optics, seed, out, scratch):  # type: ignore[no-untyped-def]
    """Make one element of the triangles of box `at` that end p lights, in the next row of `out`; returns the rays
    asked. Its light is 0 if none of the triangles drawn is lit.

    With Lambert's law what leaves towards ω is Σ E n·ω, the same as by the mean normal, as long as all that is lit
    faces ω.
    """
    k, known, drawn = out.used[0], out.known, scratch.drawn
    found, whole, rays = _draw(at, p, end, k, ends, tree, hides, optics, seed, scratch)
    known[k, ENERGY] = 0.0
    if found == 0:
        return rays
    length, y, mean = 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for s in range(found):
        w, z, n = drawn[s, 6] / whole, get(drawn, s, 0), get(drawn, s, 3)
        length += w * drawn[s, 7]
        y = (y[0] + w * z[0], y[1] + w * z[1], y[2] + w * z[2])
        mean = (mean[0] + w * n[0], mean[1] + w * n[1], mean[2] + w * n[2])
    # The mean of unit normals is shorter than one, by as much as less leaves towards each direction.
    short = math.sqrt(dot(mean, mean))
    known[k, ENERGY] = short * whole
    put(known, k, 0, y)
    put(known, k, NORMAL, (mean[0] / short, mean[1] / short, mean[2] / short))
    known[k, TURNED] = 0.5 * max(1.0 / (short * short) - 1.0, 0.0)
    known[k, LENGTH], known[k, CLUSTERED] = length, 1.0
    back = _towards(y, end[0])
    put(known, k, BACK, back)
    if found == 1:
        # One point has no scatter: that of places evenly in its box stands for it.
        g, box = (-back[0], -back[1], -back[2]), tree.box
        xx, yy, zz = (box[at, 3] - box[at, 0]) ** 2, (box[at, 4] - box[at, 1]) ** 2, (box[at, 5] - box[at, 2]) ** 2
        spread = (xx / 12, 0.0, 0.0, yy / 12, 0.0, zz / 12)
        along = (spread[0] * g[0], spread[3] * g[1], spread[5] * g[2])
    else:
        spread, along = _scatter(drawn, found, y, length, whole)
    known[k, BLUR] = _blur(y, p, ends, length) + _spans(spread, along, known, k)
    # Three of the points, in the middles of thirds of the light, are where its rays to other elements begin.
    passed, s = 0.0, 0
    for j in range(3):
        while s < found - 1 and passed + drawn[s, 6] < (j + 0.5) / 3 * whole:
            passed += drawn[s, 6]
            s += 1
        put(out.corner, k, 3 * j, get(drawn, s, 0))
        put(out.corner, k, WEIGHT + 3 * j, get(drawn, s, 3))
    return rays


@compiled(_nrt=False)
def _towards(y, x):  # type: ignore[no-untyped-def]
    """The direction from y to x."""
    d = distance(x, y)
    return ((x[0] - y[0]) / d, (x[1] - y[1]) / d, (x[2] - y[2]) / d)


@compiled(_nrt=False)
def _scatter(drawn, found, y, length, whole):  # type: ignore[no-untyped-def]
    """Covariance of the places of some triangles, weighted with their light, as xx, xy, xz, yy, yz, zz, and of their
    places with their paths; m²."""
    # What lies between the triangles drawn is in none of them: N of them have (N − 1)/N of the variance.
    share = found / max(found - 1, 1) / whole
    xx = xy = xz = yy = yz = zz = rx = ry = rz = 0.0
    for s in range(found):
        d, w = subtract(get(drawn, s, 0), y), share * drawn[s, 6]
        r = drawn[s, 7] - length
        xx, xy, xz = xx + w * d[0] * d[0], xy + w * d[0] * d[1], xz + w * d[0] * d[2]
        yy, yz, zz = yy + w * d[1] * d[1], yz + w * d[1] * d[2], zz + w * d[2] * d[2]
        rx, ry, rz = rx + w * r * d[0], ry + w * r * d[1], rz + w * r * d[2]
    return (xx, xy, xz, yy, yz, zz), (rx, ry, rz)


@compiled(_nrt=False)
def _spans(spread, along, known, k):  # type: ignore[no-untyped-def]
    """Fill `SPAN`, `ALONG` and `LONG` of cluster k from its covariances; returns the variance along the third
    direction, m², for which there is no column."""
    xx, xy, xz, yy, yz, zz = spread
    rx, ry, rz = along
    known[k, LONG] = math.sqrt(18.0 * (xx + yy + zz))
    for j in range(2):
        # The column of the axis with the largest variance left, as in Cholesky's decomposition with pivots.
        p, path, most = (xx, xy, xz), rx, xx
        if yy >= max(xx, zz):
            p, path, most = (xy, yy, yz), ry, yy
        elif zz > xx:
            p, path, most = (xz, yz, zz), rz, zz
        per = 1.0 / math.sqrt(most) if most > 0.0 else 0.0
        p, path = (per * p[0], per * p[1], per * p[2]), per * path
        put(known, k, SPAN + 3 * j, p)
        known[k, ALONG + j] = path
        xx, xy, xz = xx - p[0] * p[0], xy - p[0] * p[1], xz - p[0] * p[2]
        yy, yz, zz = yy - p[1] * p[1], yz - p[1] * p[2], zz - p[2] * p[2]
        rx, ry, rz = rx - p[0] * path, ry - p[1] * path, rz - p[2] * path
    return max(xx, yy, zz, 0.0)


@compiled(_nrt=False)
def _cut(ends, tree, occluders, optics, fineness, out, scratch):  # type: ignore[no-untyped-def]
    """Fill `out` with the elements of all ends; returns the rays asked, or −1 where there is no room."""
    rays, room = 0, len(out.part) - SPARE
    last = LISTED + (min(occluders.triangles, 1) if fineness.shadows else 0)
    for p in range(len(ends.part)):
        out.first[p] = out.used[0]
        x, one = _mean(ends, p)
        if one < 0:
            continue
        for k in range(len(tree.roots)):
            scratch.boxes[0], left = tree.roots[k], 1
            while left > 0:
                left -= 1
                at = scratch.boxes[left]
                # A box may become one element more, a triangle checks for itself.
                if out.used[0] == room:
                    return -1
                if not _faces_any(tree.box, at, ends, p):
                    continue
                start, end = tree.span[at, 0], tree.span[at, 1]
                if end - start <= CLUSTER:
                    for f in range(start, end):
                        asked = _cut_triangle(
                            f, p, k, (x, one, last), ends, tree, occluders, optics, fineness, out, scratch
                        )
                        if asked < 0:
                            return -1
                        rays += asked
                    continue
                centre, radius = bounding_sphere(tree.box, at)
                near, size = distance(centre, x) - radius, tree.area[end] - tree.area[start]
                small = 2.0 * radius <= fineness.coarsest * near and size <= fineness.error * math.pi * near * near
                if near <= 0.0 or optics.narrow[k] or not small:
                    scratch.boxes[left], scratch.boxes[left + 1] = tree.children[at, 0], tree.children[at, 1]
                    left += 2
                    continue
                rays += _cluster(
                    at, p, (x, one, last), ends, tree, occluders.row, optics, fineness.seed, out, scratch
                )
                if out.known[out.used[0], ENERGY] > 0.0:
                    out.part[out.used[0]] = k
                    out.used[0] += 1
    out.first[len(ends.part)] = out.used[0]
    return rays


@compiled(_nrt=False)
def _cut_triangle(f, p, k, end, ends, tree, occluders, optics, fineness, out, scratch):  # type: ignore[no-untyped-def]
    """Halve triangle f of part k until its pieces are elements of end p, and put those that are lit into `out`.

    end : the middle of the end, a point of it, and the end of the list of occluders to be asked. Returns the rays
    asked, or −1 where there is no room.
    """
    (x, one, last), points, part, rays = end, ends.part.shape[1], ends.part, 0
    waits, area, error, smallest = scratch.corners, scratch.area, fineness.error, SMALLEST * tree.extent
    n = get(tree.normal, f, 0)
    height = dot(subtract(x, corner(tree.corners, f, 0)), n)
    # A single point in the triangle's own plane lights none of it; a footprint may reach above that.
    if abs(height) < occluders.flat and points == 1:
        return rays
    if height < 0.0:
        n = (-n[0], -n[1], -n[2])
    keen, lobed = 1.0, False
    for q in range(points):
        if part[p, q] >= 0:
            keen, lobed = max(keen, optics.sharp[part[p, q]]), lobed or optics.kind[part[p, q]] != LAMBERTIAN
    for j in range(3):
        put(waits[0], j, 0, corner(tree.corners, f, j))
    area[0], top = tree.area[f + 1] - tree.area[f], 1
    while top > 0:
        top -= 1
        to = out.used[0]
        if to == len(out.part) - SPARE:
            return -1
        a, b, c = get(waits[top], 0, 0), get(waits[top], 1, 0), get(waits[top], 2, 0)
        m = ((a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3)
        side, h = longest(a, b, c)
        brightest, path = lit(m, n, p, ends, optics)
        # Written where it will stand if it stays.
        brightest = max(brightest, _put_vertices(out, to, (a, b, c), n, p, ends, optics))
        if lobed:
            brightest = max(brightest, _lit_at_most(m, n, h, p, ends, optics))
        size, across = area[top], (h / distance(m, x)) ** 2
        over, near = size * brightest, across < fineness.coarsest * fineness.coarsest
        if not over > 0.0 and near:
            continue
        cut, visible = not near or over * min(keen * across, max(across, 1.0)) > error, 1.0
        if last > LISTED and not cut:
            # Three points, half way from the middle to the vertices, tell whether it is partly hidden.
            seen, u = 0, (0.0, 0.0, 0.0)
            for j in range(3):
                y = half(m, get(waits[top], j, 0))
                rays += 1
                z = _point_in_turn(3 * to + j, p, one, ends)
                if hidden(z, y, f, LISTED, last, occluders.row, scratch.listed) == 0:
                    seen, u = seen + 1, (u[0] + y[0], u[1] + y[1], u[2] + y[2])
            visible = seen / 3
            cut = seen < 3 and (PARTLY if seen > 0 else UNFOUND) * over > error
            if seen == 0 and not cut:
                continue
        if cut:
            if h > smallest and top <= DEEPEST:
                _halve(waits, area, top, side)
                top += 2
            continue
        if visible < 1.0:
            # What is seen of it stands for all of it, so that its middle is not behind what hides it.
            u = (u[0] / seen - 0.5 * m[0], u[1] / seen - 0.5 * m[1], u[2] / seen - 0.5 * m[2])
            a = (u[0] + 0.5 * a[0], u[1] + 0.5 * a[1], u[2] + 0.5 * a[2])
            b = (u[0] + 0.5 * b[0], u[1] + 0.5 * b[1], u[2] + 0.5 * b[2])
            c = (u[0] + 0.5 * c[0], u[1] + 0.5 * c[1], u[2] + 0.5 * c[2])
            _put_vertices(out, to, (a, b, c), n, p, ends, optics)
        out.corner[to, SIZE], out.known[to, CLUSTERED], out.part[to] = visible * size, 0.0, k
        put(out.known, to, NORMAL, n)
        put(out.known, to, BACK, _towards(m, x))
        out.known[to, BLUR] = _blur(m, p, ends, path)
        condense(out, to, p, ends, optics)
        out.used[0] += 1
    return rays


@compiled(_nrt=False)
def _put_vertices(out, to, vertices, n, p, ends, optics):  # type: ignore[no-untyped-def]
    """Put three vertices and the light and path there into row `to`; returns the brightest light."""
    brightest = 0.0
    for j in range(3):
        y = vertices[j]
        put(out.corner, to, 3 * j, y)
        out.corner[to, WEIGHT + j], out.corner[to, PATH + j] = lit(y, n, p, ends, optics)
        brightest = max(brightest, out.corner[to, WEIGHT + j])
    return brightest


@compiled(_nrt=False)
def _halve(waits, area, top, side):  # type: ignore[no-untyped-def]
    """The halves of the piece at `top`, cut in the middle of a side, at `top` and behind it."""
    y = half(get(waits[top], side, 0), get(waits[top], (side + 1) % 3, 0))
    area[top] *= 0.5
    area[top + 1] = area[top]
    for j in range(3):
        put(waits[top + 1], j, 0, get(waits[top], j, 0))
    put(waits[top], side, 0, y)
    put(waits[top + 1], (side + 1) % 3, 0, y)
