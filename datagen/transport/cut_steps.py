"""The compiled steps of `cuts.py`: how surfaces and pixels are cut into elements, and what is drawn from each.

What waits to be cut lies on a stack: a box of triangles or a piece of a triangle, and a cluster of FoV points. It is
cut until its light is at most δ photons, times the root of the number of bins that it spreads over.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints
from datagen.transport.arrival_times import pour, tent, widened
from datagen.transport.brdf import LAMBERTIAN, dot, evaluate_at_most
from datagen.transport.bvh import CLUSTER, triangle_by_area
from datagen.transport.geometry import (
    above,
    bounding_sphere,
    corner,
    cross,
    distance,
    get,
    longest,
    put,
    subtract,
    transmittance,
)
from datagen.transport.laser_points import LaserPoints
from datagen.transport.rays import lifted_and_scaled
from datagen.transport.sampling import mix
from datagen.transport.weights import weight

COARSEST = 1.0
"""Largest size of an element relative to its distance, whatever its light."""
COARSEST_CLUSTER = 0.7
"""The same of a cluster of FoV points, and relative to the narrowest lobe on the way, too."""
BENT = 30.0
"""An element's light is taken for so many times more as its arrival times are bent, relative to their span."""
LEAST = 0.1
"""Least density of the hidden point on an element, relative to the largest: bounds the weight where a guess is 0."""
BACK = 0.02
"""What the light on the inner side of a closed mesh is taken for: almost always none, but a device may be inside."""
BLACK = 1e-3
"""BRDF that a cluster of FoV points is taken for at least, as its points may be of several materials, 1/sr."""
BLURRED = 0.25
"""Span of arrival times over a cluster that is not flat, relative to that over the element, and angle that it is seen
by, from which on a sample has several FoV points."""
MOST_POINTS = 4
"""Most FoV points of a sample, a power of 4."""
STRAIGHT, EVEN, LEVELS = 0.02, 0.5, 2
"""Bend of the arrival times over an element, relative to their span, up to which they count as linear; square of its
size over its distance up to which its weights do; and most times that an element with more is quartered for the
spread of its light: such errors are alike in all replicates."""
WIDE = 0.3
"""Variance of the arrival times over a cluster, relative to that over an element or a bin, from which on it is
spread by quarters: of a spread only mean and variance are known."""
SAGITTA = 0.1
"""Arc of the arrival times over a cluster, bins, up to which they count as linear."""
MOST_SAMPLES = 1 << 17
"""Samples of a part in a histogram from which on only what is near is cut."""
COARSE = 1e300
"""A δ with which only what is near is cut."""
STACK = 4096
"""Room for what waits: boxes are divided 128 times at most, triangles some 54 times, clusters four."""
BOX, PIECE = 0, 1
"""What waits."""
NOTHING, CLUSTER_FIRST, HALVES, SAMPLE = range(4)
"""What becomes of it."""
STEPS = (0.8191725133961645, 0.6710436067037893, 0.5497004779019703)
"""Steps of additive recurrences (Roberts 2018), which spread the hidden and the FoV points of a pair evenly."""


class Room(NamedTuple):
    """What all pairs share.

    kind, values : of the materials. peak, lobe : (K,) largest BRDF of each part, 1/sr, and half width of its
    narrowest lobe, rad. outer : (K,) 1 for closed meshes whose normals point outward, −1 inward, 0 for other meshes.
    lasers, power : laser points, and the share of light that air lets through to them. per_metre, start, bins : bins
    of a metre of path, number of the first bin, and of all bins. device : whether the legs to laser and sensor count.
    air : attenuation, 1/m. plane : distance within which a point lies on a plane, m. smallest : side of the smallest
    piece that is cut, m. frame, offset : of embree, and by how much rays begin off their surfaces, m.
    """

    kind: Ints | NDArray[np.uint8]
    values: Floats
    peak: Floats
    lobe: Floats
    outer: Floats
    lasers: LaserPoints
    power: Floats
    per_metre: float
    start: float
    bins: float
    device: bool
    air: float
    plane: float
    smallest: float
    frame: Floats
    offset: float


class Batch(NamedTuple):
    """Samples that wait for their rays.

    ends : (n, 3, 3) laser point, hidden point and FoV point in embree's frame. row : (n,) of the histogram. light :
    (n,) photons. level : (n,) of the 4^level equal parts of a triangle that the light is spread over. time, at :
    (n, 15) arrival times by way of the corners of these parts, bins, and guessed light there: corner i, j, which lies
    i/2^level and j/2^level of the way to two corners of the triangle, is number `_place(i, j)`. change : (n, 2) change
    of the times along the two sides of the cluster, bins.
    """

    ends: NDArray[np.float32]
    row: Ints
    light: Floats
    level: Ints
    time: Floats
    at: Floats
    change: Floats

    @classmethod
    def of(cls, n: int) -> Batch:
        """Room for n samples."""
        corners = (2**LEVELS + 1) * (2**LEVELS + 2) // 2
        return cls(
            np.empty((n, 3, 3), np.float32), np.empty(n, np.int64), np.empty(n), np.empty(n, np.int64),
            np.empty((n, corners)), np.empty((n, corners)), np.empty((n, 2)),
        )  # fmt: skip


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _random(state):  # type: ignore[no-untyped-def]
    """The next number in 0 … 1 of a stream, whose state is state[0] (Knuth's linear congruential generator)."""
    state[0] = state[0] * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
    return (np.float64(state[0] >> np.uint64(33)) + 0.5) * 2.0**-31


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _brdf(kind, values, n, a, b, turn, tilt):  # type: ignore[no-untyped-def]
    """A guess of the largest BRDF near two directions, never 0 unless the surface is black."""
    if kind == LAMBERTIAN:
        return values[0] / math.pi
    f = evaluate_at_most(kind, values, n, a, b, turn, tilt)
    return f if f > 0.0 else values[0] / math.pi


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _seen_by(pool, p, c, kind, values):  # type: ignore[no-untyped-def]
    """Cluster c of pixel p: middle, mean normal, radius, sine and thickness, and direction to the sensor and BRDF of
    one of its points."""
    row, q = pool.cluster[p], int(pool.cluster[p, c, 10])
    k, back = pool.part[q], get(pool.to_sensor, q, 0)
    return get(row, c, 0), get(row, c, 3), row[c, 6], row[c, 7], row[c, 8], back, kind[k], values[k]


@compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})
def _guess(y, n, surface, lit, seen, air, plane, turn):  # type: ignore[no-untyped-def]
    """A guess of the light at point y, for each m² and unit of gain, and the distance to the laser point.

    n : normal at y. surface : BRDF there, and whether its mesh is closed. lit, seen : laser point and cluster. turn :
    how far y may be off, metres.
    """
    (kind2, values2, outer), (x, n1, to_laser, kind1, values1) = surface, lit
    z, axis, size, sine, thick, to_sensor, kind3, values3 = seen
    d1, d3 = subtract(y, x), subtract(y, z)
    square1, square3 = dot(d1, d1), dot(d3, d3)
    r1, r3 = math.sqrt(square1), math.sqrt(square3)
    up1, up3 = dot(d1, n1), min(dot(d3, axis) + thick + sine * (r3 + size), r3 + size)
    # The mean height of the cluster's points over the lit side of the element.
    in2 = -dot(d1, n)
    out2 = -dot(d3, n) if in2 > 0.0 else dot(d3, n)
    out2 = out2 if out2 >= size else (out2 + size) ** 2 / (4.0 * size) if out2 > -size else 0.0
    if up1 <= plane or up3 <= plane or abs(in2) <= plane or out2 <= plane:
        return 0.0, r1
    f = abs(in2) * up1 * up3 * out2 * transmittance(air, r1 + r3) * (BACK if in2 * outer < 0.0 else 1.0)
    if in2 < 0.0:
        n = (-n[0], -n[1], -n[2])
    square3 += 0.25 * size * size
    w1, w3 = (d1[0] / r1, d1[1] / r1, d1[2] / r1), (d3[0] / r3, d3[1] / r3, d3[2] / r3)
    f *= _brdf(kind1, values1, n1, to_laser, w1, turn / r1, 0.0)
    f *= _brdf(kind2, values2, n, (-w1[0], -w1[1], -w1[2]), (-w3[0], -w3[1], -w3[2]), turn / r1 + turn / r3, 0.0)
    f *= max(_brdf(kind3, values3, axis, w3, to_sensor, turn / r3, 0.0), BLACK)
    return f / (square1 * square1 * square3 * square3), r1


@compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})
def _facing(m, radius, axis, cosine, sine, x, rise):  # type: ignore[no-untyped-def]
    """Upper bound of the product of the cosines at x and at a box's surface, on any line between them.

    m, radius : bounding sphere of the box, metres. axis, cosine, sine : cone of the box's normals. rise : height of
    the box above the surface at x, metres.

    A normal within an angle α of the axis has a component of at most |axis · d| + |d × axis| sin α along d.
    """
    d = subtract(m, x)
    square, along = dot(d, d), abs(dot(d, axis))
    near = math.sqrt(square) - radius
    # Inside the sphere every direction is possible.
    if near <= 0.0:
        return 1.0
    across = math.sqrt(max(square - along * along, 0.0)) * (sine if cosine > 0.0 else 1.0)
    return min(1.0, rise / near) * min(1.0, (along + across + radius) / near)


@compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})
def _light_of_box(tree, at, surface, peak, lit, seen, air, plane):  # type: ignore[no-untyped-def]
    """About the most light of box `at`, for each unit of gain: −1 if no point of the cluster or no laser light gets
    there, infinite if it is near or holds few triangles. peak : largest BRDF of the box, 1/sr."""
    (kind2, values2, outer), (x, n1, to_laser, kind1, values1) = surface, lit
    z, axis3, size, sine3, thick, to_sensor, kind3, values3 = seen
    m, r = bounding_sphere(tree.box, at)
    d1, d3 = distance(m, x), distance(m, z)
    rise1, rise3 = above(tree.box, at, x, n1), above(tree.box, at, z, axis3) + thick + sine3 * (d3 + r + size)
    near1, near3 = d1 - r, d3 - r - size
    if rise1 <= plane or rise3 <= plane:
        return -1.0
    if tree.span[at, 1] - tree.span[at, 0] <= CLUSTER or 2 * r > COARSEST * min(near1, near3):
        return np.inf
    axis, cosine = get(tree.cone, at, 0), tree.cone[at, 3]
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    a, b = subtract(x, m), subtract(z, m)
    a, b = (a[0] / d1, a[1] / d1, a[2] / d1), (b[0] / d3, b[1] / d3, b[2] / d3)
    f, turn1, turn3 = peak, r / near1, (r + size) / near3
    if cosine > 0.5:
        toward = dot(a, axis)
        s = 1.0 if toward > 0.0 else -1.0
        n = (s * axis[0], s * axis[1], s * axis[2])
        f = _brdf(kind2, values2, n, a, b, turn1 + turn3, math.acos(min(cosine, 1.0)))
        # All triangles turn their inner side to the laser point.
        f *= BACK if s * outer < 0.0 and abs(toward) > sine + turn1 else 1.0
    f *= _brdf(kind1, values1, n1, to_laser, (-a[0], -a[1], -a[2]), turn1, 0.0)
    tilt3 = math.asin(min(sine3, 1.0))
    f *= max(_brdf(kind3, values3, axis3, (-b[0], -b[1], -b[2]), to_sensor, turn3, tilt3), BLACK)
    f *= _facing(m, r, axis, cosine, sine, x, rise1) * _facing(m, r + size, axis, cosine, sine, z, rise3)
    area = tree.area[tree.span[at, 1]] - tree.area[tree.span[at, 0]]
    return area * f * transmittance(air, near1 + near3) / (near1 * near3) ** 2


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _push(tag, top, what, at, c, q, many):  # type: ignore[no-untyped-def]
    """Lets a box or piece and a cluster wait at `top`."""
    tag[top, 0], tag[top, 1], tag[top, 2], tag[top, 3], tag[top, 4] = what, at, c, q, many


@compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})
def _set_corner(piece, top, v, y, n, surface, lit, seen, air, plane):  # type: ignore[no-untyped-def]
    """Sets corner v of a piece: its place, the guess of its light, and its distance from the laser point."""
    put(piece, top, 3 * v, y)
    piece[top, 9 + v], piece[top, 12 + v] = _guess(y, n, surface, lit, seen, air, plane, 0.0)


@compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})
def _open_box(tree, tag, piece, top, surface, lit, seen, air, plane):  # type: ignore[no-untyped-def]
    """Lets the halves of the box at `top` wait in its place, or its triangles; returns the new top."""
    at, c, q, many = tag[top, 1], tag[top, 2], tag[top, 3], tag[top, 4]
    if tree.children[at, 0] >= 0:
        _push(tag, top, BOX, tree.children[at, 0], c, q, many)
        _push(tag, top + 1, BOX, tree.children[at, 1], c, q, many)
        return top + 2
    for f in range(tree.span[at, 0], tree.span[at, 1]):
        _push(tag, top, PIECE, f, c, q, many)
        for v in range(3):
            _set_corner(
                piece, top, v, corner(tree.corners, f, v), get(tree.normal, f, 0), surface, lit, seen, air, plane
            )
        top += 1
    return top


@compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})
def _open_cluster(tag, piece, top, n, surface, lit, pool, p, kind, values, air, plane):  # type: ignore[no-untyped-def]
    """Lets the piece at `top`, with normal n, wait with each quarter of its cluster; returns the new top."""
    f, c, q, many = tag[top, 1], tag[top, 2], tag[top, 3], tag[top, 4] // 4
    y0, y1, y2 = get(piece, top, 0), get(piece, top, 3), get(piece, top, 6)
    for j in range(4):
        inner = 4 * c + 1 + j
        if pool.cluster[p, inner, 9] > 0.0:
            _push(tag, top, PIECE, f, inner, q + j * many, many)
            seen = _seen_by(pool, p, inner, kind, values)
            for v in range(3):
                y = y0 if v == 0 else y1 if v == 1 else y2
                _set_corner(piece, top, v, y, n, surface, lit, seen, air, plane)
            top += 1
    return top


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _halve(tag, piece, top, share, n, surface, lit, seen, air, plane):  # type: ignore[no-untyped-def]
    """Lets the two parts of the piece at `top`, with normal n, wait, divided across its longest side; returns the new
    top."""
    o, _ = longest(get(piece, top, 0), get(piece, top, 3), get(piece, top, 6))
    e = (o + 1) % 3
    one, two = get(piece, top, 3 * o), get(piece, top, 3 * e)
    y = (one[0] + share * (two[0] - one[0]), one[1] + share * (two[1] - one[1]), one[2] + share * (two[2] - one[2]))
    for j in range(15):
        piece[top + 1, j] = piece[top, j]
    _push(tag, top + 1, PIECE, tag[top, 1], tag[top, 2], tag[top, 3], tag[top, 4])
    _set_corner(piece, top, o, y, n, surface, lit, seen, air, plane)
    put(piece, top + 1, 3 * e, y)
    piece[top + 1, 9 + e], piece[top + 1, 12 + e] = piece[top, 9 + o], piece[top, 12 + o]
    return top + 2


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _is_hidden(y0, y1, y2, n, lit, seen, plane):  # type: ignore[no-untyped-def]
    """Whether all of a triangle lies below the surface at the laser point, or below that of all FoV points, or all of
    them on the other side of the triangle than the laser point.

    Each height is a convex function of the place, so that the corners decide; but each height by itself, as a corner
    may be below the one surface and its neighbour below the other.
    """
    x, n1 = lit[0], lit[1]
    z, axis, size, sine, thick = seen[0], seen[1], seen[2], seen[3], seen[4]
    in2, out2 = dot(subtract(x, y0), n), dot(subtract(z, y0), n)
    if abs(in2) <= plane or (out2 if in2 > 0.0 else -out2) <= plane - size:
        return True
    up1 = max(dot(subtract(y0, x), n1), dot(subtract(y1, x), n1), dot(subtract(y2, x), n1))
    d0, d1, d2 = subtract(y0, z), subtract(y1, z), subtract(y2, z)
    far = math.sqrt(max(dot(d0, d0), dot(d1, d1), dot(d2, d2))) if sine > 0.0 else 0.0
    up3 = max(dot(d0, axis), dot(d1, axis), dot(d2, axis)) + thick + sine * (far + size)
    return up1 <= plane or up3 <= plane


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _judged(piece, top, n, many, surface, delta, gain, leg, last_leg, lobe, room, lit, seen):  # type: ignore[no-untyped-def]
    """What becomes of the piece at `top`, and: largest guess on it, its area, m², the bins it spreads over, by how
    much the mean of the times at its corners is later than the time at its middle, bins, and the square of its size
    over its distance from the laser point and the cluster.

    leg, last_leg : from the laser, and to the sensor, metres. lobe : narrowest at the piece and the cluster, rad.
    """
    x, z, size = lit[0], seen[0], seen[2]
    y0, y1, y2 = get(piece, top, 0), get(piece, top, 3), get(piece, top, 6)
    if _is_hidden(y0, y1, y2, n, lit, seen, room.plane):
        return NOTHING, 0.0, 0.0, 1.0, 0.0, 0.0
    m = ((y0[0] + y1[0] + y2[0]) / 3, (y0[1] + y1[1] + y2[1]) / 3, (y0[2] + y1[2] + y2[2]) / 3)
    h, d1, d3 = longest(y0, y1, y2)[1], distance(m, x), distance(m, z)
    # Over a cluster times must be linear, too.
    is_near = size > COARSEST_CLUSTER * lobe * d3 and size > 0.5 * lobe * h
    if many > 1 and (is_near or 0.25 * size * size * room.per_metre > SAGITTA * min(d3, last_leg)):
        return CLUSTER_FIRST, 0.0, 0.0, 1.0, 0.0, 0.0
    may_halve = h > room.smallest
    if may_halve and h > COARSEST * min(d1, math.sqrt(d3 * d3 + size * size)):
        return HALVES, 0.0, 0.0, 1.0, 0.0, 0.0
    most = max(piece[top, 9], piece[top, 10], piece[top, 11])
    # A lobe may be bright between the corners; and corners may be below either surface and the middle above both.
    if most <= 0.0 or lit[3] != LAMBERTIAN or seen[6] != LAMBERTIAN or surface[0] != LAMBERTIAN:
        most = max(most, _guess(m, n, surface, lit, seen, room.air, room.plane, h + size)[0])
    normal = cross(subtract(y1, y0), subtract(y2, y0))
    area = 0.5 * math.sqrt(dot(normal, normal))
    t0, t1, t2 = (
        piece[top, 12] + distance(y0, z), piece[top, 13] + distance(y1, z), piece[top, 14] + distance(y2, z),
    )  # fmt: skip
    late, early, middle = max(t0, t1, t2), min(t0, t1, t2), d1 + d3
    width = max(1.0, (late - early) * room.per_metre)
    bend = ((t0 + t1 + t2) / 3 - middle) * room.per_metre
    # What arrives outside the window only counts as a sum.
    leg += last_leg if room.device else 0.0
    is_inside = (late + 2 * size + leg) * room.per_metre > room.start
    is_inside &= (middle - h - 2 * size + leg) * room.per_metre < room.start + room.bins
    across = (h / d1) ** 2 + h * h / (d3 * d3 + size * size)
    is_bright = gain * area * most * (1.0 + BENT * bend / width) > delta * math.sqrt(width)
    return HALVES if may_halve and is_inside and is_bright else SAMPLE, most, area, width, bend, across


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _barycentric(u, v, w0, w1, w2):  # type: ignore[no-untyped-def]
    """A point of a triangle, drawn with a density that is linear between its corners, from (u, v) in the unit
    square."""
    # One corner, by its weight; the coordinate of that corner has the density 6 t (1 − t), the rest is uniform.
    u *= w0 + w1 + w2
    which = 0 if u < w0 else 1 if u < w0 + w1 else 2
    inner = u / w0 if which == 0 else (u - w0) / w1 if which == 1 else min((u - w0 - w1) / w2, 1.0)
    t = 0.5 - math.sin(math.asin(1.0 - 2.0 * inner) / 3.0)
    a, b = (1.0 - t) * v, (1.0 - t) * (1.0 - v)
    return t if which == 0 else a, t if which == 1 else a if which == 0 else b, t if which == 2 else b


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _change_over_cluster(y, n, z, n3, to_sensor, sides, last_leg):  # type: ignore[no-untyped-def]
    """Mean change of the path by way of y over a flat cluster with the middle z, and its changes along the two sides,
    metres.

    n3, sides : normal and sides of the cluster, metres. last_leg : to the sensor, metres; infinite if it does not
    count.

    Along each side, weights change by κ and paths by τ. With weights 1 + κ u for u from −½ to ½ paths have the mean
    κ τ/12, and that of a leg of length r, which is bent, grows by (s² − (s · w)²)/(24 r) for a side s and its
    direction w. κ is that of matt surfaces.
    """
    d = subtract(y, z)
    square, up, out, last = dot(d, d), dot(d, n3), dot(d, n), 1.0 if last_leg < np.inf else 0.0
    r, mean = math.sqrt(square), 0.0
    s1, s2 = (sides[0], sides[1], sides[2]), (sides[3], sides[4], sides[5])
    one, two = -dot(d, s1) / r - last * dot(to_sensor, s1), -dot(d, s2) / r - last * dot(to_sensor, s2)
    for s, tau in ((s1, one), (s2, two)):
        kappa = 4.0 * dot(d, s) / square - dot(n3, s) / up - dot(n, s) / out
        mean += max(min(kappa, 2.0), -2.0) * tau / 12.0
        mean += (dot(s, s) - (dot(d, s) / r) ** 2) / (24.0 * r)
        mean += (dot(s, s) - dot(to_sensor, s) ** 2) / (24.0 * last_leg)
    return mean, one, two


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _place(i, j, parts):  # type: ignore[no-untyped-def]
    """Number of the corner i, j of a triangle whose sides are divided into so many parts."""
    return i * (2 * parts + 3 - i) // 2 + j


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _corners_of_part(i, j, down, parts):  # type: ignore[no-untyped-def]
    """Numbers of the corners of part i, j: the one that stands upright, or the one beside it that is upside down."""
    return _place(i + down, j, parts), _place(i + 1, j + down, parts), _place(i, j + 1, parts)


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _drawn_part(at, parts, u):  # type: ignore[no-untyped-def]
    """A part, drawn by its light; u as a new random number; and three times the light of all parts, each of which has
    the unit of area."""
    total = 0.0
    for i in range(parts):
        for j in range(parts - i):
            for down in range(2 if j < parts - i - 1 else 1):
                a, b, c = _corners_of_part(i, j, down, parts)
                total += at[a] + at[b] + at[c]
    before, rest = 0.0, u * total
    i = j = down = 0
    for i in range(parts):
        for j in range(parts - i):
            for down in range(2 if j < parts - i - 1 else 1):
                a, b, c = _corners_of_part(i, j, down, parts)
                own = at[a] + at[b] + at[c]
                if rest < before + own or i == parts - 1:
                    return i, j, down, min(max((rest - before) / own, 0.0), 1.0), total
                before += own
    return i, j, down, 0.5, total


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _join(  # type: ignore[no-untyped-def]
    y, n, surface, lit, seen, density, corners, level, bend, replicate, u, c, q, many, points, pool, p, room,
    leg, power, state, batch, used,
):  # fmt: skip
    """Sets sample `used` of the batch to that of hidden point y, joined to some FoV points of a cluster; returns
    whether it brings light.

    density : 1/m², with which y is drawn. corners : of the piece that y lies on; its times are taken for linear on
    each of 4^level parts, which are `bend` bins late. u : random number that chooses the FoV points. c, q, many,
    points : cluster, its first square, number of its squares, and how many points.
    """
    row, first = pool.cluster[p, c], p * (len(pool.part) // len(pool.cluster))
    each, total, chosen, per = many // points, 0.0, -1, room.per_metre
    for m in range(points):
        j = first + 2 * (q + m * each + min(int(u * each), each - 1)) + replicate
        k3 = pool.part[j]
        if k3 < 0:
            continue
        z, n3, back = get(pool.position, j, 0), get(pool.normal, j, 0), get(pool.to_sensor, j, 0)
        at = (z, n3, back, room.kind[k3], room.values[k3])
        w, _, _ = weight(y, n, surface[0], surface[1], lit, at, 0.0, room.air)
        light = power * each * w * pool.weight[j] / density
        # One of them, drawn by its light, stands for all.
        total += light
        if light > 0.0 and (total == light or _random(state) * total < light):
            chosen = j
    if chosen < 0:
        return False
    z, n3, last_leg = get(pool.position, chosen, 0), get(pool.normal, chosen, 0), pool.leg[chosen]
    side = room.offset if dot(subtract(lit[0], y), n) > 0.0 else -room.offset
    ends = batch.ends[used]
    ends[0, 0], ends[0, 1], ends[0, 2] = lifted_and_scaled(lit[0], lit[1], room.offset, room.frame)
    ends[1, 0], ends[1, 1], ends[1, 2] = lifted_and_scaled(y, n, side, room.frame)
    ends[2, 0], ends[2, 1], ends[2, 2] = lifted_and_scaled(z, n3, room.offset, room.frame)
    mean = one = two = 0.0
    if row[17] > 0.0:
        # Times, which change most over a pixel, are those of all of a flat cluster.
        z, last_leg = seen[0], row[17]
        sides = (row[11], row[12], row[13], row[14], row[15], row[16])
        mean, one, two = _change_over_cluster(y, n, z, seen[1], seen[5], sides, last_leg if room.device else np.inf)
    # Times over a triangle that change by their squares are, on average, ¾ of the bend earlier than linear ones.
    path = leg + (last_leg if room.device else 0.0) + mean - (room.start + 0.75 * bend) / per
    (y0, y1, y2), parts = corners, 1 << level
    for i in range(parts + 1):
        for j in range(parts + 1 - i):
            y = _between(y0, y1, y2, 1.0 - (i + j) / parts, i / parts, j / parts)
            batch.time[used, _place(i, j, parts)] = (distance(y, lit[0]) + distance(y, z) + path) * per
    batch.light[used], batch.level[used] = total, level
    batch.change[used, 0], batch.change[used, 1] = one * per, two * per
    return True


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _between(y0, y1, y2, s0, s1, s2):  # type: ignore[no-untyped-def]
    """The point of a triangle with some barycentric coordinates."""
    return (
        s0 * y0[0] + s1 * y1[0] + s2 * y2[0], s0 * y0[1] + s1 * y1[1] + s2 * y2[1],
        s0 * y0[2] + s1 * y1[2] + s2 * y2[2],
    )  # fmt: skip


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _fraction(u):  # type: ignore[no-untyped-def]
    """The part of u ≥ 0 after the point."""
    return u - math.floor(u)


@compiled(forceinline=True, fastmath={"reassoc", "contract", "arcp", "nsz"})
def _sample(  # type: ignore[no-untyped-def]
    tree, tag, piece, top, judged, surface, lit, seen, lobe, numbers, replicate, pool, p, room, leg, power, state,
    expected, batch, used,
):  # fmt: skip
    """Sets sample `used` of the batch to one of the box or piece at `top`; returns whether it brings light.

    judged : what `_judged` has found of a piece. numbers : (3,) random numbers for the hidden and the FoV point.
    """
    (most, area, width, bend, across), f, at = judged, tag[top, 1], batch.at[used]
    level = 0
    if tag[top, 0] == BOX:
        low, high = tree.span[f, 0], tree.span[f, 1]
        area = tree.area[high] - tree.area[low]
        f = triangle_by_area(low, high, tree.area, np.uint64(_random(state) * 4294967296.0))
        y0, y1, y2 = corner(tree.corners, f, 0), corner(tree.corners, f, 1), corner(tree.corners, f, 2)
        at[0] = at[1] = at[2] = 1.0
        n = get(tree.normal, f, 0)
    else:
        n = get(tree.normal, f, 0)
        y0, y1, y2 = get(piece, top, 0), get(piece, top, 3), get(piece, top, 6)
        least = LEAST * most if most > 0.0 else 1.0
        w0, w1, w2 = max(piece[top, 9], least), max(piece[top, 10], least), max(piece[top, 11], least)
        while (bend > STRAIGHT * width or across > EVEN) and level < LEVELS:
            level, bend, across = level + 1, 0.25 * bend, 0.25 * across
        parts = 1 << level
        for i in range(parts + 1):
            for j in range(parts + 1 - i):
                s1, s2 = i / parts, j / parts
                s0 = 1.0 - s1 - s2
                linear = s0 * w0 + s1 * w1 + s2 * w2
                if max(i, j, parts - i - j) < parts:
                    y = _between(y0, y1, y2, s0, s1, s2)
                    linear = max(_guess(y, n, surface, lit, seen, room.air, room.plane, 0.0)[0], LEAST * linear)
                at[_place(i, j, parts)] = linear
    parts = 1 << level
    i, j, down, u, total = _drawn_part(at, parts, numbers[0])
    a, b, c = _corners_of_part(i, j, down, parts)
    t0, t1, t2 = _barycentric(u, numbers[1], at[a], at[b], at[c])
    s1, s2 = (t0 * (i + down) + t1 * (i + 1) + t2 * i) / parts, (t0 * j + t1 * (j + down) + t2 * (j + 1)) / parts
    y = _between(y0, y1, y2, 1.0 - s1 - s2, s1, s2)
    density = 3.0 * (t0 * at[a] + t1 * at[b] + t2 * at[c]) * parts * parts / (area * total)
    if tag[top, 0] == BOX:
        # All of a small box's light arrives at one time.
        y0 = y1 = y2 = y
    c, q, many = tag[top, 2], tag[top, 3], tag[top, 4]
    # What is expected of all elements, and of those whose FoV points are far apart for their distance.
    gain = power * pool.cluster[p, c, 9]
    expected[0] += gain * area * most
    expected[1] += (
        gain * area * most if many == 1 and seen[2] > COARSEST_CLUSTER * lobe * distance(y, seen[0]) else 0.0
    )
    points = min(many, MOST_POINTS)
    return _join(
        y, n, surface, lit, seen, density, (y0, y1, y2), level, bend, replicate, numbers[2], c,
        q, many, points, pool, p, room, leg, power, state, batch, used,
    )  # fmt: skip


@compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})
def emit(  # type: ignore[no-untyped-def]
    pairs, delta, slot, replicate, seed, tree, room, pool, tag, piece, at, numbers, state, expected, batch
):  # fmt: skip
    """Fills the batch with a sample of each element of some pairs; returns the number of samples.

    pairs : (n, 2) laser point, and index of the pixel in `pool`. delta : (K,) photons. slot : (K,) place of each
    part's rows, −1 for parts that are left out. replicate : 0 or 1. tag, piece : what waits, (STACK, 5) BOX or PIECE,
    its index, the cluster, its first square and their number; (STACK, 15) corners of a piece, and the guessed weights
    and distances to the laser point there. at : (4,) pair, part and height of the stack at which to go on, and
    samples of that part, zeros at first; pair is n when all is done. numbers, state : (3,) and (1,) random numbers,
    and the state of their stream. expected : (2,) photons as guessed, added up: of all pieces, and of those whose FoV
    points are far apart for their distance.
    """
    used = 0
    kind, values, lasers = room.kind, room.values, room.lasers
    for pair in range(at[0], len(pairs)):
        i, p = pairs[pair, 0], pairs[pair, 1]
        if lasers.part[i] < 0 or pool.cluster[p, 0, 9] <= 0.0:
            continue
        k1, leg, power = lasers.part[i], lasers.leg[i] if room.device else 0.0, room.power[i]
        lit = (get(lasers.position, i, 0), get(lasers.normal, i, 0), get(lasers.to_laser, i, 0), kind[k1], values[k1])
        if at[1] == 0 and at[2] == 0:
            state[0] = mix(mix(np.uint64(seed), np.uint64(i)), np.uint64(p))
            state[0] = (state[0] << np.uint64(32)) | mix(state[0], np.uint64(pair))
            for d in range(3):
                numbers[d] = _random(state)
        for k in range(at[1], len(tree.roots)):
            top, at[2] = at[2], 0
            if slot[k] < 0:
                continue
            surface = (kind[k], values[k], room.outer[k])
            if top == 0:
                at[3] = 0
                _push(tag, 0, BOX, tree.roots[k], 0, 0, len(pool.part) // (2 * len(pool.cluster)))
                top = 1
            while top > 0:
                top -= 1
                c = tag[top, 2]
                # Guesses of lobes may be brighter than all light that there is.
                enough = delta[k] if at[3] < MOST_SAMPLES else COARSE
                gain, seen = power * pool.cluster[p, c, 9], _seen_by(pool, p, c, kind, values)
                lobe = min(room.lobe[k], room.lobe[pool.part[int(pool.cluster[p, c, 10])]])
                most, area, width, bend, across = 0.0, 0.0, 1.0, 0.0, 0.0
                if tag[top, 0] == BOX:
                    light = _light_of_box(tree, tag[top, 1], surface, room.peak[k], lit, seen, room.air, room.plane)
                    if light < 0.0:
                        continue
                    if gain * light > enough:
                        top = _open_box(tree, tag, piece, top, surface, lit, seen, room.air, room.plane)
                        continue
                else:
                    n = get(tree.normal, tag[top, 1], 0)
                    last_leg = pool.leg[int(pool.cluster[p, c, 10])]
                    verdict, most, area, width, bend, across = _judged(
                        piece, top, n, tag[top, 4], surface, enough, gain, leg, last_leg, lobe, room, lit, seen
                    )
                    if verdict == CLUSTER_FIRST:
                        top = _open_cluster(
                            tag, piece, top, n, surface, lit, pool, p, kind, values, room.air, room.plane
                        )
                    elif verdict == HALVES:
                        # At a random place, so that no two replicates have the same elements.
                        share = 0.4 + 0.2 * _random(state)
                        top = _halve(tag, piece, top, share, n, surface, lit, seen, room.air, room.plane)
                    if verdict != SAMPLE:
                        continue
                if used == len(batch.row):
                    at[0], at[1], at[2] = pair, k, top + 1
                    return used
                at[3] += 1
                for d in range(3):
                    numbers[d] = _fraction(numbers[d] + STEPS[d])
                if _sample(
                    tree, tag, piece, top, (most, area, width, bend, across), surface, lit, seen, lobe,
                    numbers, replicate, pool, p, room, leg, power, state, expected, batch, used,
                ):  # fmt: skip
                    batch.row[used] = slot[k] * len(pairs) + pair
                    used += 1
        at[1] = 0
    at[0] = len(pairs)
    return used


@compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})
def legs_of(batch, rows, leg, origin, span):  # type: ignore[no-untyped-def]
    """Sets origins and spans (…, 3) of the rays from the hidden points of some samples to the laser point (leg 0) or
    the FoV point (leg 1)."""
    for n in range(len(rows)):
        ends = batch.ends[rows[n]]
        for c in range(3):
            origin[n, c], span[n, c] = ends[1, c], ends[2 * leg, c] - ends[1, c]


@compiled(fastmath={"reassoc", "contract", "arcp", "nsz"})
def pour_all(batch, rows, histogram, outside):  # type: ignore[no-untyped-def]
    """Adds the light of some samples to their rows of histogram (…, T), and what is outside of it to outside (…).

    The light of a sample is spread over the arrival times of its parts in proportion to their guessed light.
    """
    for s in rows:
        parts, at, time, row = 1 << batch.level[s], batch.at[s], batch.time[s], batch.row[s]
        one, two, total = batch.change[s, 0], batch.change[s, 1], 0.0
        for i in range(parts):
            for j in range(parts - i):
                for down in range(2 if j < parts - i - 1 else 1):
                    a, b, c = _corners_of_part(i, j, down, parts)
                    total += at[a] + at[b] + at[c]
        # A cluster over which times change by more than over the piece is spread by its quarters.
        t0, t1, t2 = time[0], time[_place(parts, 0, parts)], time[_place(0, parts, parts)]
        m, variance = (t0 + t1 + t2) / 3.0, (one * one + two * two) / 12.0
        quarters = 2 if variance > WIDE * max((t0 - m) ** 2 + (t1 - m) ** 2 + (t2 - m) ** 2, 1.0) / 12.0 else 1
        variance, share = variance / quarters**2, batch.light[s] / (total * quarters**2)
        for q in range(quarters * quarters):
            later = 0.25 * (one * (2 * (q % 2) - 1) + two * (2 * (q // 2) - 1)) if quarters > 1 else 0.0
            for i in range(parts):
                for j in range(parts - i):
                    for down in range(2 if j < parts - i - 1 else 1):
                        a, b, c = _corners_of_part(i, j, down, parts)
                        t0, t1, t2 = widened(time[a] + later, time[b] + later, time[c] + later, variance)
                        light = (at[a] + at[b] + at[c]) * share
                        outside[row] += pour(histogram, row, tent(t0, t1, t2, at[a], at[b], at[c], light), light)
