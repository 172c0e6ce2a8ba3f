"""The surface elements that a laser point lights, or that a pixel sees: the first or last leg of a four-bounce path.

An *end* of such a path is a set of points x with weights that add up to one: one point for a laser point, and as many
as it needs for a pixel's footprint. The flux per area that an end sends to a surface point y (docs/physics.md) is

    w(y) = Σ weight · f₁ cosθ₁ cosθ₂ V / R₁²,     after a path of R₁ on average.

By reciprocity w is also the fraction of the light leaving y that reaches the sensor by way of the footprint.
Triangles are halved until each element is small against its distance and brings little light; elements that are
partly hidden are halved further. A box of many small triangles is one element, a *cluster*, whose light, place and
normal are the means over a few of its triangles (`_cluster`). A single point for a whole footprint would be wrong
beside another surface: how much of a wall such a footprint sees depends on the angle between them, not on the
distance.
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
from datagen.transport.visibility.bvh import CLUSTER, SMALLEST, Hierarchy, triangle_by_area
from datagen.transport.visibility.occluder_rows import Occluders
from datagen.transport.visibility.occlusion import LISTED, hidden, lists

PARTLY, UNFOUND = 4.0, 0.4
"""Error of an element of which some of three shadow rays are blocked, and of one of which all three are, relative to
the element's unoccluded light. With half of them elements at the edges of shadows are halved once less."""
DRAWN = 8
"""Most triangles that a cluster's light is computed from, one from each of as many equal shares of the cluster's
area. With half as many, the light of meshes in the secondary has about 1.4 times the noise."""
DEEPEST = 120
"""Most pieces of a triangle on the stack. Halving ends after some 55 levels (`SMALLEST`), so that the stack never
fills."""
SPARE = 1 << 14
"""Rows for the halves of elements that pairs of elements need. With half as many, halves are dropped and computed
anew more often."""

WEIGHT, PATH, SIZE, COLUMNS = 9, 12, 15, 18
"""Columns of `Elements.corner`. Of a triangle: three vertices (0–8), w and the path at each vertex (from `WEIGHT` and
from `PATH` on), and the area that is not hidden (`SIZE`). Of a cluster: three points on its triangles (0–8), and the
normals there (from `WEIGHT` on)."""
NORMAL, ENERGY, LENGTH, SPAN, ALONG, LONG, BACK, BLUR, CLUSTERED, TURNED, NUMBERS = (
    3, 6, 7, 8, 14, 16, 17, 20, 21, 22, 23,
)  # fmt: skip
"""Columns of `Elements.known`, all of one element; vectors have three columns each.

0–2: mean position of its light, metres. `NORMAL`: unit normal on the end's side. `ENERGY`: its light, w times area.
`LENGTH`: mean path to the end. `SPAN`: two vectors p, q with p pᵀ + q qᵀ the covariance of its points, so that a path
of slope g varies by (g·p)² + (g·q)². `ALONG`: g·p and g·q for the path to the end. `LONG`: longest side. `BACK`: unit
vector to the end. `BLUR`: variance of the path over the end's points, m². `CLUSTERED`: 1 for a cluster, 0 for a
triangle. `TURNED`: of a cluster, variance of its normals along a direction across their mean, relative to the square
of that mean. `NUMBERS`: number of columns."""
UPWARD, TO_DEVICE, SHARE, LONGER = 3, 6, 9, 10
"""Columns of `Ends.point` behind the position (0–2)."""


class Ends(NamedTuple):
    """N ends, each of Q points; numbers of all kinds in one array, because each array handed to a kernel costs time.

    Attributes
    ----------
    point : (N, Q, 11) position, metres (0–2); normal (`UPWARD`) and direction to the device (`TO_DEVICE`), unit
        vectors; weight (`SHARE`), where the weights of an end add up to one or are all zero; and by how much the path
        between device and point is longer than the end's mean, metres (`LONGER`).
    part : (N, Q) index of the part that the point lies on, −1 where there is no point.
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
    """BRDFs of the K parts.

    Attributes
    ----------
    kind, values : (K,) and (K, n) model and parameters, as in `MaterialTable`.
    sharp : (K,) 1/width² of the narrowest lobe.
    narrow : (K,) whether that lobe is too narrow for a cluster's mean normal to stand for its normals.
    """

    kind: Ints | NDArray[np.uint8]
    values: Floats
    sharp: Floats
    narrow: Bools


class Fineness(NamedTuple):
    """How finely surfaces are cut into elements.

    Attributes
    ----------
    coarsest : largest element, relative to its distance.
    error : error that an element may make, relative to the light of its end.
    shadows : whether shadow rays are cast.
    seed : seed of the triangles that are drawn from clusters.
    """

    coarsest: float
    error: float
    shadows: bool
    seed: int


class Elements(NamedTuple):
    """The surface elements of N ends, and behind them the halves into which pairs of elements have cut some so far.

    Attributes
    ----------
    first : (N + 1,) the elements of end n are the rows first[n] … first[n + 1] − 1.
    corner, known : (M, COLUMNS) and (M, NUMBERS) numbers of each element, by the columns above.
    part : (M,) index of the part that the element lies on.
    halves : (M,) row of the first of an element's two halves, which follow each other; −1 before it is halved.
    used : (1,) number of rows in use, halves included.
    """

    first: Ints
    corner: Floats
    known: Floats
    part: Ints
    halves: Ints
    used: Ints


class _Scratch(NamedTuple):
    """Memory that `_cut` reuses: a stack of boxes; a stack of a triangle's pieces (`corners`) with their areas; the
    triangles `drawn` from a cluster; and the lists of `occlusion.py`."""

    boxes: Ints
    corners: Floats
    area: Floats
    drawn: Floats
    listed: Ints


def elements_of(
    ends: Ends, tree: Hierarchy, occluders: Occluders, optics: Optics, fineness: Fineness
) -> tuple[Elements, int]:
    """The surface elements of some ends, and the number of shadow rays cast for them."""
    scratch = _Scratch(
        np.empty(DEEPEST + 8, np.int64), np.empty((DEEPEST + 8, 3, 3)), np.empty(DEEPEST + 8), np.empty((DRAWN, 8)),
        lists(0),
    )  # fmt: skip
    room = 128 * (len(ends.part) + 1)
    # How many elements there are is known only once they are made: too little room is quadrupled.
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
    """w(y) of end p without occlusion, and the mean path, for a surface at y whose normal n is on the end's side."""
    point, part = ends.point[p], ends.part
    # The weights of missing points count in no mean, so their sum is taken along.
    w = path = whole = 0.0
    for q in range(part.shape[1]):
        k = part[p, q]
        if k < 0:
            continue
        d, n1 = subtract(y, get(point, q, 0)), get(point, q, UPWARD)
        square = dot(d, d)
        r, up, down = math.sqrt(square), dot(d, n1), -dot(d, n)
        share = point[q, SHARE]
        # The path is averaged over all points, dark ones too: else it would jump where a point sets below y's plane.
        path += share * (r + point[q, LONGER])
        whole += share
        if up > 0.0 and down > 0.0:
            per = 1.0 / r
            onward = (d[0] * per, d[1] * per, d[2] * per)
            f = evaluate(optics.kind[k], optics.values[k], n1, get(point, q, TO_DEVICE), onward)
            # `up` and `down` are R cosθ: cosθ₁ cosθ₂ / R² without a division for each.
            w += share * f * up * down / (square * square)
    return w, path / whole


@compiled(_nrt=False)
def _lit_at_most(y, n, h, p, ends, optics):  # type: ignore[no-untyped-def]
    """Upper bound of w over an element of length h about y, if the lobes at end p point anywhere within it."""
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
            # Seen from x, directions within the element differ from that to y by up to about h / R.
            f = evaluate_at_most(optics.kind[k], optics.values[k], n1, get(point, q, TO_DEVICE), onward, h * per, 0.0)
            w += point[q, SHARE] * f * up * down / (square * square)
    return w


@compiled(_nrt=False)
def condense(elements, k, p, ends, optics):  # type: ignore[no-untyped-def]
    """Fill the columns of `known` of triangle k of end p from `corner`, except `NORMAL`, `BACK` and `BLUR`.

    The light and its mean position and path are integrals by a rule of third degree: centroid, vertices, midpoints of
    the sides. The variance of a linear function over a triangle is ((∇·e)²/2 + 2 (∇·s)²/3)/12, with e a side and s
    the vector from its midpoint to the third vertex.
    """
    corner, known = elements.corner, elements.known
    n, a, b, c = get(known, k, NORMAL), get(corner, k, 0), get(corner, k, 3), get(corner, k, 6)
    ra, rb, rc = get(corner, k, PATH)
    whole = length = 0.0
    middle = (0.0, 0.0, 0.0)
    # Seven points with weights 1/20, 2/15 and 9/20: fewer would not see that light falls off across an element.
    for j in range(7):
        y, w, path, share = a, 0.0, 0.0, 0.45
        if j < 3:
            # The light at the vertices is stored already: halves share two of them with their parent.
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
    # Two vectors hold the covariance of the triangle's points: all that the spread of arrival times depends on.
    e, s = subtract(b, a), subtract(c, half(a, b))
    one, two = math.sqrt(1 / 24), math.sqrt(1 / 18)
    put(known, k, SPAN, (one * e[0], one * e[1], one * e[2]))
    put(known, k, SPAN + 3, (two * s[0], two * s[1], two * s[2]))
    known[k, ALONG], known[k, ALONG + 1] = one * (rb - ra), two * (rc - 0.5 * (ra + rb))
    _, known[k, LONG] = longest(a, b, c)


@compiled()
def halves_of(elements, k, p, ends, optics):  # type: ignore[no-untyped-def]
    """Row of the first of the two halves of element k of end p, which follow each other; −1 if there is no room.

    The element is halved on its longest side the first time that a pair needs the halves.
    """
    corner, known, first = elements.corner, elements.known, elements.halves[k]
    if first >= 0 or elements.used[0] + 2 > len(corner):
        return first
    first = elements.used[0]
    elements.halves[k], elements.used[0] = first, first + 2
    side, _ = longest(get(corner, k, 0), get(corner, k, 3), get(corner, k, 6))
    other = (side + 1) % 3
    y = half(get(corner, k, 3 * side), get(corner, k, 3 * other))
    # The new vertex belongs to both halves: its light is computed once.
    w, path = lit(y, get(known, k, NORMAL), p, ends, optics)
    for to, vertex in ((first, side), (first + 1, other)):
        # Each half is the element with one vertex moved to the midpoint of the side.
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
    """Drop all halves if they fill more than half of their room, so that memory stays bounded."""
    whole, rows = elements.first[-1], len(elements.halves)
    # Between two pairs only: within one, rows of halves are on the stack.
    if 2 * (elements.used[0] - whole) > rows - whole:
        for k in range(whole):
            elements.halves[k] = -1
        elements.used[0] = whole


@compiled(_nrt=False)
def _mean(ends, p):  # type: ignore[no-untyped-def]
    """Mean position of an end's points, and the index of one of the points, −1 if the end has none."""
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
    """Whether any of box `at` lies above the surface at any point of end p."""
    for q in range(ends.part.shape[1]):
        # A box below the plane of every point gets no light: nothing in it has to be visited.
        if ends.part[p, q] >= 0 and above(box, at, get(ends.point[p], q, 0), get(ends.point[p], q, UPWARD)) > 0.0:
            return True
    return False


@compiled(_nrt=False)
def _blur(y, p, ends, mean):  # type: ignore[no-untyped-def]
    """Variance of the path to y over the points of end p, m²; `mean` is the mean path."""
    variance, points = 0.0, ends.part.shape[1]
    # A laser point has no extent, and `points − 1` below no meaning.
    if points == 1:
        return variance
    for q in range(points):
        if ends.part[p, q] >= 0:
            apart = distance(y, get(ends.point[p], q, 0)) + ends.point[p, q, LONGER] - mean
            variance += ends.point[p, q, SHARE] * apart * apart
    # Each of Q points stands for a patch whose own variance is about a Q-th of the footprint's.
    return variance * points / max(points - 1, 1)


@compiled(_nrt=False)
def _point_in_turn(turn, p, one, ends):  # type: ignore[no-untyped-def]
    """Position of a point of end p, another one for each `turn`, so that rays come from all over a footprint."""
    # A missing point is replaced by point `one`, which exists.
    q = turn % ends.part.shape[1]
    return get(ends.point[p], q if ends.part[p, q] >= 0 else one, 0)


@compiled(_nrt=False)
def _draw(at, p, end, turn, ends, tree, hides, optics, seed, scratch):  # type: ignore[no-untyped-def]
    """Draw triangles of box `at`, one from each of `DRAWN` equal shares of its area, or all if there are fewer.

    Puts the centroid, the normal on the end's side, the light and the path of triangles that end p lights into
    `scratch.drawn`. Returns the number of these triangles, their light, and the number of shadow rays.

    end : mean position of the end, index of one of its points, and the end of the list of occluders.
    turn : selects the points of the end that shadow rays start from.
    """
    first, behind, area, drawn = tree.span[at, 0], tree.span[at, 1], tree.area, scratch.drawn
    (x, one, last), word = end, np.float64(word_of(seed, p, at))
    count, rays, found, whole = min(behind - first, DRAWN), 0, 0, 0.0
    for s in range(count):
        f, size = first + s, area[first + s + 1] - area[first + s]
        # One random triangle from each equal share of area, which it then stands for: less noise than free draws.
        if behind - first > DRAWN:
            f = triangle_by_area(first, behind, area, (2.0**32 * s + word) / count)
            size = (area[behind] - area[first]) / count
        n = get(tree.normal, f, 0)
        a, b, c = corner(tree.corners, f, 0), corner(tree.corners, f, 1), corner(tree.corners, f, 2)
        y = ((a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3)
        # Surfaces reflect on both sides: the normal is turned to the side of the end.
        if dot(subtract(x, y), n) < 0.0:
            n = (-n[0], -n[1], -n[2])
        w, path = lit(y, n, p, ends, optics)
        w *= size
        # Dark triangles need no shadow ray.
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
    """Make one element of the triangles of box `at` that end p lights, in the next row of `out`; returns the number
    of shadow rays. The element's light is 0 if none of the drawn triangles is lit.

    By Lambert's law the light that leaves towards ω is Σ E n·ω, the same as that by the mean normal, as long as all
    lit triangles face ω.
    """
    k, known, drawn = out.used[0], out.known, scratch.drawn
    found, whole, rays = _draw(at, p, end, k, ends, tree, hides, optics, seed, scratch)
    known[k, ENERGY] = 0.0
    if found == 0:
        return rays
    length, y, mean = 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    # Means weighted by the light of each triangle, as of the light that the cluster sends on.
    for s in range(found):
        w, z, n = drawn[s, 6] / whole, get(drawn, s, 0), get(drawn, s, 3)
        length += w * drawn[s, 7]
        y = (y[0] + w * z[0], y[1] + w * z[1], y[2] + w * z[2])
        mean = (mean[0] + w * n[0], mean[1] + w * n[1], mean[2] + w * n[2])
    # The mean of unit normals is shorter than 1, and so much less light leaves than from a plane: Σ E n·ω again.
    short = math.sqrt(dot(mean, mean))
    known[k, ENERGY] = short * whole
    put(known, k, 0, y)
    put(known, k, NORMAL, (mean[0] / short, mean[1] / short, mean[2] / short))
    known[k, TURNED] = 0.5 * max(1.0 / (short * short) - 1.0, 0.0)
    known[k, LENGTH], known[k, CLUSTERED] = length, 1.0
    back = _towards(y, end[0])
    put(known, k, BACK, back)
    if found == 1:
        # One point has no scatter: the variance of points that fill the box evenly is taken instead.
        g, box = (-back[0], -back[1], -back[2]), tree.box
        xx, yy, zz = (box[at, 3] - box[at, 0]) ** 2, (box[at, 4] - box[at, 1]) ** 2, (box[at, 5] - box[at, 2]) ** 2
        spread = (xx / 12, 0.0, 0.0, yy / 12, 0.0, zz / 12)
        along = (spread[0] * g[0], spread[3] * g[1], spread[5] * g[2])
    else:
        spread, along = _scatter(drawn, found, y, length, whole)
    known[k, BLUR] = _blur(y, p, ends, length) + _spans(spread, along, known, k)
    # Shadow rays to other elements start from three of the triangles, at 1/6, 1/2 and 5/6 of the light: the mean
    # position may lie inside a solid.
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
    """The unit vector from y to x."""
    d = distance(x, y)
    return ((x[0] - y[0]) / d, (x[1] - y[1]) / d, (x[2] - y[2]) / d)


@compiled(_nrt=False)
def _scatter(drawn, found, y, length, whole):  # type: ignore[no-untyped-def]
    """Covariance of the positions of drawn triangles, weighted with their light, as xx, xy, xz, yy, yz, zz; and the
    covariance of position and path, as x, y, z; all in m². `y`, `length` and `whole` are mean position, mean path and
    total light."""
    # N draws about their own mean have (N − 1)/N of the variance of what they are drawn from.
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
    direction, m², for which there is no column: the caller adds it to `BLUR`."""
    xx, xy, xz, yy, yz, zz = spread
    rx, ry, rz = along
    # A cluster's size is defined by the variance of its points, so that `element_pairs.py` can go back to that.
    known[k, LONG] = math.sqrt(18.0 * (xx + yy + zz))
    for j in range(2):
        # Cholesky's decomposition with pivots: the axis with the largest variance left gives the next vector.
        p, path, most = (xx, xy, xz), rx, xx
        if yy >= max(xx, zz):
            p, path, most = (xy, yy, yz), ry, yy
        elif zz > xx:
            p, path, most = (xz, yz, zz), rz, zz
        per = 1.0 / math.sqrt(most) if most > 0.0 else 0.0
        p, path = (per * p[0], per * p[1], per * p[2]), per * path
        put(known, k, SPAN + 3 * j, p)
        known[k, ALONG + j] = path
        # What this vector explains is taken off before the next one is chosen.
        xx, xy, xz = xx - p[0] * p[0], xy - p[0] * p[1], xz - p[0] * p[2]
        yy, yz, zz = yy - p[1] * p[1], yz - p[1] * p[2], zz - p[2] * p[2]
        rx, ry, rz = rx - p[0] * path, ry - p[1] * path, rz - p[2] * path
    return max(xx, yy, zz, 0.0)


@compiled(_nrt=False)
def _cut(ends, tree, occluders, optics, fineness, out, scratch):  # type: ignore[no-untyped-def]
    """Fill `out` with the elements of all ends; returns the number of shadow rays, or −1 if there is no room."""
    rays, room = 0, len(out.part) - SPARE
    last = LISTED + (min(occluders.triangles, 1) if fineness.shadows else 0)
    for p in range(len(ends.part)):
        out.first[p] = out.used[0]
        x, one = _mean(ends, p)
        # The laser ray or the pixel meets nothing: the end has no elements.
        if one < 0:
            continue
        # Each part has its own BVH, so that an element belongs to one part.
        for k in range(len(tree.roots)):
            scratch.boxes[0], left = tree.roots[k], 1
            while left > 0:
                left -= 1
                at = scratch.boxes[left]
                # A box becomes one element at most; `_cut_triangle` checks the room for each of its pieces.
                if out.used[0] == room:
                    return -1
                if not _faces_any(tree.box, at, ends, p):
                    continue
                start, end = tree.span[at, 0], tree.span[at, 1]
                # Few triangles cost less one by one than as a cluster.
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
                # Measured from the nearest point of the bounding sphere: no triangle of the box is nearer.
                near, size = distance(centre, x) - radius, tree.area[end] - tree.area[start]
                small = 2.0 * radius <= fineness.coarsest * near and size <= fineness.error * math.pi * near * near
                # A narrow lobe needs each triangle's own normal: such parts are never clustered.
                if near <= 0.0 or optics.narrow[k] or not small:
                    scratch.boxes[left], scratch.boxes[left + 1] = tree.children[at, 0], tree.children[at, 1]
                    left += 2
                    continue
                rays += _cluster(
                    at, p, (x, one, last), ends, tree, occluders.row, optics, fineness.seed, out, scratch
                )
                # A dark cluster leaves its row to the next element.
                if out.known[out.used[0], ENERGY] > 0.0:
                    out.part[out.used[0]] = k
                    out.used[0] += 1
    out.first[len(ends.part)] = out.used[0]
    return rays


@compiled(_nrt=False)
def _cut_triangle(f, p, k, end, ends, tree, occluders, optics, fineness, out, scratch):  # type: ignore[no-untyped-def]
    """Halve triangle f of part k until its pieces are elements of end p, and put those that are lit into `out`.

    Returns the number of shadow rays, or −1 if there is no room.

    end : mean position of the end, index of one of its points, and the end of the list of occluders.
    """
    (x, one, last), points, part, rays = end, ends.part.shape[1], ends.part, 0
    waits, area, error, smallest = scratch.corners, scratch.area, fineness.error, SMALLEST * tree.extent
    n = get(tree.normal, f, 0)
    height = dot(subtract(x, corner(tree.corners, f, 0)), n)
    # A single point in the triangle's own plane lights none of it; a footprint may reach above that.
    if abs(height) < occluders.flat and points == 1:
        return rays
    # Surfaces reflect on both sides: the normal is turned to the side of the end.
    if height < 0.0:
        n = (-n[0], -n[1], -n[2])
    # The narrowest lobe at the end sets how fast w may change across an element.
    sharpest, lobed = 1.0, False
    for q in range(points):
        if part[p, q] >= 0:
            sharpest, lobed = max(sharpest, optics.sharp[part[p, q]]), lobed or optics.kind[part[p, q]] != LAMBERTIAN
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
        # The vertices go straight into the next free row: if the piece is dropped or halved, they are overwritten.
        brightest = max(brightest, _put_vertices(out, to, (a, b, c), n, p, ends, optics))
        # A lobe may pass between the four points.
        if lobed:
            brightest = max(brightest, _lit_at_most(m, n, h, p, ends, optics))
        size, across = area[top], (h / distance(m, x)) ** 2
        over, near = size * brightest, across < fineness.coarsest * fineness.coarsest
        # Dark, and small enough to be sure of that.
        if not over > 0.0 and near:
            continue
        # The relative error of a piece is of second order in its size over distance and width of lobe.
        cut, visible = not near or over * min(sharpest * across, max(across, 1.0)) > error, 1.0
        if last > LISTED and not cut:
            # Rays to three points, half way from the centroid to the vertices, show whether the piece is partly
            # hidden.
            seen, u = 0, (0.0, 0.0, 0.0)
            for j in range(3):
                y = half(m, get(waits[top], j, 0))
                rays += 1
                z = _point_in_turn(3 * to + j, p, one, ends)
                if hidden(z, y, f, LISTED, last, occluders.row, scratch.listed) == 0:
                    seen, u = seen + 1, (u[0] + y[0], u[1] + y[1], u[2] + y[2])
            # Even if all three are blocked, some of a bright piece may be seen: it is halved, too.
            visible = seen / 3
            cut = seen < 3 and (PARTLY if seen > 0 else UNFOUND) * over > error
            if seen == 0 and not cut:
                continue
        # A piece that cannot be halved any more is dropped: its light is negligible.
        if cut:
            if h > smallest and top <= DEEPEST:
                _halve(waits, area, top, side)
                top += 2
            continue
        if visible < 1.0:
            # A triangle of half the size about the visible points stands for the piece, so that the mean position of
            # its light is not behind what hides the rest.
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
    """Put three vertices, and w and the path at each, into row `to`; returns the largest w."""
    brightest = 0.0
    for j in range(3):
        y = vertices[j]
        put(out.corner, to, 3 * j, y)
        out.corner[to, WEIGHT + j], out.corner[to, PATH + j] = lit(y, n, p, ends, optics)
        brightest = max(brightest, out.corner[to, WEIGHT + j])
    return brightest


@compiled(_nrt=False)
def _halve(waits, area, top, side):  # type: ignore[no-untyped-def]
    """Replace the piece at `top` of the stack by its two halves, at `top` and `top + 1`, cut at the midpoint of
    `side`."""
    y = half(get(waits[top], side, 0), get(waits[top], (side + 1) % 3, 0))
    area[top] *= 0.5
    area[top + 1] = area[top]
    for j in range(3):
        put(waits[top + 1], j, 0, get(waits[top], j, 0))
    put(waits[top], side, 0, y)
    put(waits[top + 1], (side + 1) % 3, 0, y)
