"""Elements of cuts: what a box of triangles or a piece of one is guessed to bring to a cluster of FoV points, and
when it is cut further.

What waits to be cut lies on a stack (`Walk`). It is cut until its light is at most δ photons, times the root of the
number of bins that it spreads over.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints
from datagen.transport.arrival_times import LEVELS
from datagen.transport.brdf import LAMBERTIAN, Vector, dot, evaluate_at_most
from datagen.transport.bvh import CLUSTER, Hierarchy
from datagen.transport.fov_clusters import SAGITTA
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
from datagen.transport.scene_numbers import SceneNumbers
from datagen.transport.weights import Brdf, End, brdf_of

COARSEST = 1.2
"""Largest size of an element relative to its distance, whatever its light; of larger ones a few in corners have most
of the light (at 1.5 a room of boxes errs twice as much for the same time)."""
COARSEST_CLUSTER = 0.7
"""Largest size of a cluster of FoV points relative to its distance, times the half width of the narrowest lobe on the
way, rad, at most 1."""
BENT = 30.0
"""An element's light is taken for so many times more as its arrival times are bent, relative to their span."""
EVEN = 0.05
"""Square of an element's size over its distance up to which its weights count as linear, for an element of as much
light as its histogram may err by, and less in proportion for one of more: replicates cannot see what is wrong with
shapes, which is 0.2 % where 2 % are asked."""
CURVED = 0.04
"""Bend of the arrival times over the smallest parts of an element, relative to their span, from which on it is
halved, for the same element: without, a needle of two triangles erred by 3.2 %, and rooms by half as much again for
the same time."""
BACK = 0.02
"""What the light on the inner side of a closed mesh is taken for: almost always none, but a device may be inside."""
BLACK = 1e-3
"""BRDF that a cluster of FoV points is taken for at least, as its points may be of several materials, 1/sr."""
STACK = 4096
"""Most that may wait: boxes are divided 128 times at most, triangles some 54 times, clusters four."""


class Waiting(IntEnum):
    """What waits to be cut."""

    BOX = 0
    PIECE = 1


class Verdict(IntEnum):
    """What becomes of a box or piece and its cluster: they are left out, cut in one of two ways, or an element, which
    gives a sample."""

    NOTHING = 0
    QUARTERS_OF_CLUSTER = 1
    HALVES = 2
    SAMPLE = 3


class CutSetup(NamedTuple):
    """What all pairs of laser point and pixel share.

    scene : its numbers. tree : of boxes of triangles. peak, lobe : (K,) largest BRDF of each part, 1/sr, and half
    width of its narrowest lobe, rad. outer : (K,) 1 for closed meshes whose normals point outward, −1 inward, 0 for
    other meshes. lasers, power : laser points, and the share of light that air lets through to them. per_metre,
    start, bins : bins of a metre of path, number of the first bin, and of all bins. plane : distance within which a
    point lies on a plane, m. smallest : side of the smallest piece that is cut, m. uneven : whether pixels are not as
    sensitive everywhere.
    """

    scene: SceneNumbers
    tree: Hierarchy
    peak: Floats
    lobe: Floats
    outer: Floats
    lasers: LaserPoints
    power: Floats
    per_metre: float
    start: float
    bins: float
    plane: float
    smallest: float
    uneven: bool


class Surface(NamedTuple):
    """The part that is cut: its BRDF, and `outer`, `peak` and `lobe` of `CutSetup`."""

    brdf: Brdf
    outer: float
    peak: float
    lobe: float


class Cluster(NamedTuple):
    """A cluster of FoV points.

    middle, normal : of all, metres, mean. size : radius, m. sine : of the largest angle of a normal with the mean.
    thick : distance from the plane through the middle, m. gain : photons at the sensor for each unit of weight and m²
    of hidden surface. one : index of one of its points. back, brdf, lobe : direction to the sensor, BRDF and
    narrowest lobe, rad, there.
    """

    middle: Vector
    normal: Vector
    size: float
    sine: float
    thick: float
    gain: float
    one: int
    back: Vector
    brdf: Brdf
    lobe: float


class Way(NamedTuple):
    """What a guess of light needs: the part that is cut, the laser point, the cluster; `values` and `air` of
    `SceneNumbers`, and `plane` of `CutSetup`."""

    surface: Surface
    lit: End
    seen: Cluster
    values: Floats
    air: float
    plane: float


class Piece(NamedTuple):
    """What is known of a piece of a triangle, or of a box, and a cluster.

    verdict : what becomes of it. most : largest guess on it. area : m²; 1 for a box, whose guess is that of all of
    it. width : bins that its light spreads over. bend : by how much the mean of the times at its corners is later
    than the time at its middle, bins. across : square of its size over its distance from the laser point and the
    cluster. inside : whether its light may arrive within the window. even : square of its size over its distance up
    to which its weights count as linear.
    """

    verdict: Verdict
    most: float
    area: float
    width: float
    bend: float
    across: float
    inside: bool
    even: float


class Walk(NamedTuple):
    """Where a walk through the elements of some pairs is, so that it goes on when a batch has been emptied.

    tag : (STACK, 5) what waits: `Waiting`, its index, the cluster, its first square and their number. piece :
    (STACK, 15) corners of a piece, and the guesses and distances to the laser point there. at : (4,) pair, part and
    height of the stack at which to go on, and elements so far; all 0 at first. numbers : (4,) random numbers, of
    which the last, a random one at first, tells when an element is drawn. state : (1,) of their stream.
    """

    tag: Ints
    piece: Floats
    at: Ints
    numbers: Floats
    state: NDArray[np.uint64]

    @classmethod
    def of(cls, u: float) -> Walk:
        """A walk that has not begun. u : a random number in 0 … 1."""
        return cls(
            np.empty((STACK, 5), np.int64), np.empty((STACK, 15)), np.zeros(4, np.int64), np.full(4, u),
            np.empty(1, np.uint64),
        )  # fmt: skip


@compiled(forceinline=True, allocates=False)
def cluster_of(setup, pool, p, c, power):  # type: ignore[no-untyped-def]
    """Cluster c of pixel p, lit with some power."""
    row = pool.cluster[p, c]
    one = int(row[10])
    k = pool.part[one]
    return Cluster(
        get(pool.cluster[p], c, 0), get(pool.cluster[p], c, 3), row[6], row[7], row[8], power * row[9], one,
        get(pool.to_sensor, one, 0), brdf_of(setup.scene, k), setup.lobe[k],
    )  # fmt: skip


@compiled(forceinline=True, allocates=False)
def way_to(way, seen):  # type: ignore[no-untyped-def]
    """The way to another cluster."""
    return Way(way.surface, way.lit, seen, way.values, way.air, way.plane)


@compiled(forceinline=True, allocates=False)
def _most(brdf, values, n, a, b, turn, tilt):  # type: ignore[no-untyped-def]
    """A guess of the largest BRDF near two directions, never 0 unless the surface is black."""
    if brdf.kind == LAMBERTIAN:
        return brdf.albedo / math.pi
    f = evaluate_at_most(brdf.kind, values[brdf.row], n, a, b, turn, tilt)
    return f if f > 0.0 else brdf.albedo / math.pi


@compiled(allocates=False)
def guess(y, n, way, turn):  # type: ignore[no-untyped-def]
    """A guess of the light at point y, for each m² and unit of gain, and the distance to the laser point.

    n : normal at y. turn : how far y may be off, metres.
    """
    surface, lit, seen, values, air, plane = way
    size, d1, d3 = seen.size, subtract(y, lit.point), subtract(y, seen.middle)
    square1, square3 = dot(d1, d1), dot(d3, d3)
    r1, r3 = math.sqrt(square1), math.sqrt(square3)
    up1, up3 = dot(d1, lit.normal), min(dot(d3, seen.normal) + seen.thick + seen.sine * (r3 + size), r3 + size)
    # The mean height of the cluster's points over the lit side of the element.
    in2 = -dot(d1, n)
    out2 = -dot(d3, n) if in2 > 0.0 else dot(d3, n)
    out2 = out2 if out2 >= size else (out2 + size) ** 2 / (4.0 * size) if out2 > -size else 0.0
    if up1 <= plane or up3 <= plane or abs(in2) <= plane or out2 <= plane:
        return 0.0, r1
    f = abs(in2) * up1 * up3 * out2 * transmittance(air, r1 + r3) * (BACK if in2 * surface.outer < 0.0 else 1.0)
    if in2 < 0.0:
        n = (-n[0], -n[1], -n[2])
    square3 += 0.25 * size * size
    w1, w3 = (d1[0] / r1, d1[1] / r1, d1[2] / r1), (d3[0] / r3, d3[1] / r3, d3[2] / r3)
    back1, back3 = (-w1[0], -w1[1], -w1[2]), (-w3[0], -w3[1], -w3[2])
    f *= _most(lit.brdf, values, lit.normal, lit.back, w1, turn / r1, 0.0)
    f *= _most(surface.brdf, values, n, back1, back3, turn / r1 + turn / r3, 0.0)
    f *= max(_most(seen.brdf, values, seen.normal, w3, seen.back, turn / r3, 0.0), BLACK)
    return f / (square1 * square1 * square3 * square3), r1


@compiled(allocates=False)
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


@compiled(forceinline=True, allocates=False)
def _light_of_box(tree, at, way):  # type: ignore[no-untyped-def]
    """About the most light of box `at`, for each unit of gain: −1 if no point of the cluster or no laser light gets
    there, infinite if it is near or holds few triangles."""
    surface, lit, seen, values, air, plane = way
    x, z, size = lit.point, seen.middle, seen.size
    m, r = bounding_sphere(tree.box, at)
    d1, d3 = distance(m, x), distance(m, z)
    rise1 = above(tree.box, at, x, lit.normal)
    rise3 = above(tree.box, at, z, seen.normal) + seen.thick + seen.sine * (d3 + r + size)
    near1, near3 = d1 - r, d3 - r - size
    if rise1 <= plane or rise3 <= plane:
        return -1.0
    if tree.span[at, 1] - tree.span[at, 0] <= CLUSTER or 2 * r > COARSEST * min(near1, near3):
        return np.inf
    axis, cosine = get(tree.cone, at, 0), tree.cone[at, 3]
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    a, b = subtract(x, m), subtract(z, m)
    a, b = (a[0] / d1, a[1] / d1, a[2] / d1), (b[0] / d3, b[1] / d3, b[2] / d3)
    f, turn1, turn3 = surface.peak, r / near1, (r + size) / near3
    if cosine > 0.5:
        toward = dot(a, axis)
        s = 1.0 if toward > 0.0 else -1.0
        n = (s * axis[0], s * axis[1], s * axis[2])
        f = _most(surface.brdf, values, n, a, b, turn1 + turn3, math.acos(min(cosine, 1.0)))
        # All triangles turn their inner side to the laser point.
        f *= BACK if s * surface.outer < 0.0 and abs(toward) > sine + turn1 else 1.0
    f *= _most(lit.brdf, values, lit.normal, lit.back, (-a[0], -a[1], -a[2]), turn1, 0.0)
    back3, tilt3 = (-b[0], -b[1], -b[2]), math.asin(min(seen.sine, 1.0))
    f *= max(_most(seen.brdf, values, seen.normal, back3, seen.back, turn3, tilt3), BLACK)
    f *= _facing(m, r, axis, cosine, sine, x, rise1) * _facing(m, r + size, axis, cosine, sine, z, rise3)
    area = tree.area[tree.span[at, 1]] - tree.area[tree.span[at, 0]]
    return area * f * transmittance(air, near1 + near3) / (near1 * near3) ** 2


@compiled(forceinline=True, allocates=False)
def _may_arrive(early, late, setup):  # type: ignore[no-untyped-def]
    """Whether light on paths of some lengths, metres, may arrive within the window."""
    return late * setup.per_metre > setup.start and early * setup.per_metre < setup.start + setup.bins


@compiled(forceinline=True, allocates=False)
def judge_box(tree, at, enough, leg, setup, way):  # type: ignore[no-untyped-def]
    """Box `at` as a `Piece`, where elements bring at most `enough` photons.

    leg : from the laser and to the sensor, metres.
    """
    light = _light_of_box(tree, at, way)
    if light < 0.0:
        return Piece(Verdict.NOTHING, 0.0, 0.0, 1.0, 0.0, 0.0, False, 0.0)
    m, r = bounding_sphere(tree.box, at)
    middle = distance(m, way.lit.point) + distance(m, way.seen.middle) + leg
    off = 2.0 * (r + way.seen.size)
    is_inside = _may_arrive(middle - off, middle + off, setup)
    # What is near is cut wherever its light arrives.
    is_cut = light == np.inf or (is_inside and way.seen.gain * light > enough)
    return Piece(Verdict.HALVES if is_cut else Verdict.SAMPLE, light, 1.0, 1.0, 0.0, 0.0, is_inside, 0.0)


@compiled(forceinline=True, allocates=False)
def push(tag, top, what, at, c, q, many):  # type: ignore[no-untyped-def]
    """Lets a box or piece and a cluster wait at `top`."""
    tag[top, 0], tag[top, 1], tag[top, 2], tag[top, 3], tag[top, 4] = what, at, c, q, many


@compiled(allocates=False)
def _set_corner(piece, top, v, y, n, way):  # type: ignore[no-untyped-def]
    """Sets corner v of a piece: its place, the guess of its light, and its distance from the laser point."""
    put(piece, top, 3 * v, y)
    piece[top, 9 + v], piece[top, 12 + v] = guess(y, n, way, 0.0)


@compiled(forceinline=True, allocates=False)
def open_box(walk, top, setup, way):  # type: ignore[no-untyped-def]
    """Lets the halves of the box at `top` wait in its place, or its triangles; returns the new top."""
    tag, tree = walk.tag, setup.tree
    at, c, q, many = tag[top, 1], tag[top, 2], tag[top, 3], tag[top, 4]
    if tree.children[at, 0] >= 0:
        push(tag, top, Waiting.BOX, tree.children[at, 0], c, q, many)
        push(tag, top + 1, Waiting.BOX, tree.children[at, 1], c, q, many)
        return top + 2
    for f in range(tree.span[at, 0], tree.span[at, 1]):
        push(tag, top, Waiting.PIECE, f, c, q, many)
        for v in range(3):
            y, n = corner(tree.corners, f, v), get(tree.normal, f, 0)
            _set_corner(walk.piece, top, v, y, n, way)
        top += 1
    return top


@compiled(forceinline=True, allocates=False)
def open_cluster(walk, top, n, setup, pool, p, power, way):  # type: ignore[no-untyped-def]
    """Lets the piece at `top`, with normal n, wait with each quarter of its cluster; returns the new top."""
    tag, piece = walk.tag, walk.piece
    f, c, q, many = tag[top, 1], tag[top, 2], tag[top, 3], tag[top, 4] // 4
    y0, y1, y2 = get(piece, top, 0), get(piece, top, 3), get(piece, top, 6)
    for j in range(4):
        inner = 4 * c + 1 + j
        if pool.cluster[p, inner, 9] > 0.0:
            push(tag, top, Waiting.PIECE, f, inner, q + j * many, many)
            inner_way = way_to(way, cluster_of(setup, pool, p, inner, power))
            for v in range(3):
                y = y0 if v == 0 else y1 if v == 1 else y2
                _set_corner(piece, top, v, y, n, inner_way)
            top += 1
    return top


@compiled(forceinline=True, allocates=False)
def halve(walk, top, share, n, way):  # type: ignore[no-untyped-def]
    """Lets the two parts of the piece at `top`, with normal n, wait, divided across its longest side; returns the new
    top."""
    tag, piece = walk.tag, walk.piece
    o, _ = longest(get(piece, top, 0), get(piece, top, 3), get(piece, top, 6))
    e = (o + 1) % 3
    one, two = get(piece, top, 3 * o), get(piece, top, 3 * e)
    y = (one[0] + share * (two[0] - one[0]), one[1] + share * (two[1] - one[1]), one[2] + share * (two[2] - one[2]))
    for j in range(15):
        piece[top + 1, j] = piece[top, j]
    push(tag, top + 1, Waiting.PIECE, tag[top, 1], tag[top, 2], tag[top, 3], tag[top, 4])
    _set_corner(piece, top, o, y, n, way)
    put(piece, top + 1, 3 * e, y)
    piece[top + 1, 9 + e], piece[top + 1, 12 + e] = piece[top, 9 + o], piece[top, 12 + o]
    return top + 2


@compiled(forceinline=True, allocates=False)
def _is_hidden(y0, y1, y2, n, lit, seen, plane):  # type: ignore[no-untyped-def]
    """Whether all of a triangle lies below the surface at the laser point, or below that of all FoV points, or all of
    them on the other side of the triangle than the laser point.

    Each height is a convex function of the place, so that the corners decide; but each height by itself, as a corner
    may be below the one surface and its neighbour below the other.
    """
    x, n1, z, axis = lit.point, lit.normal, seen.middle, seen.normal
    in2, out2 = dot(subtract(x, y0), n), dot(subtract(z, y0), n)
    if abs(in2) <= plane or (out2 if in2 > 0.0 else -out2) <= plane - seen.size:
        return True
    up1 = max(dot(subtract(y0, x), n1), dot(subtract(y1, x), n1), dot(subtract(y2, x), n1))
    d0, d1, d2 = subtract(y0, z), subtract(y1, z), subtract(y2, z)
    far = math.sqrt(max(dot(d0, d0), dot(d1, d1), dot(d2, d2))) if seen.sine > 0.0 else 0.0
    up3 = max(dot(d0, axis), dot(d1, axis), dot(d2, axis)) + seen.thick + seen.sine * (far + seen.size)
    return up1 <= plane or up3 <= plane


@compiled(forceinline=True, allocates=False)
def judge(walk, top, n, delta, error, straight, leg, last_leg, setup, way):  # type: ignore[no-untyped-def]
    """The `Piece` at `top`, with normal n, where elements bring at most δ photons.

    error : L2 error that is asked of a histogram, photons. straight : of `Asked`. leg, last_leg : from the laser, and
    to the sensor, metres.
    """
    surface, lit, seen = way.surface, way.lit, way.seen
    piece, x, z, size, lobe = walk.piece, lit.point, seen.middle, seen.size, min(surface.lobe, seen.lobe)
    y0, y1, y2 = get(piece, top, 0), get(piece, top, 3), get(piece, top, 6)
    if _is_hidden(y0, y1, y2, n, lit, seen, setup.plane):
        return Piece(Verdict.NOTHING, 0.0, 0.0, 1.0, 0.0, 0.0, False, 0.0)
    m = ((y0[0] + y1[0] + y2[0]) / 3, (y0[1] + y1[1] + y2[1]) / 3, (y0[2] + y1[2] + y2[2]) / 3)
    h, d1, d3 = longest(y0, y1, y2)[1], distance(m, x), distance(m, z)
    may_open, may_halve = walk.tag[top, 4] > 1, h > setup.smallest
    # Over a cluster the light must be linear.
    if may_open and size > COARSEST_CLUSTER * lobe * d3 and size > 0.5 * lobe * h:
        return Piece(Verdict.QUARTERS_OF_CLUSTER, 0.0, 0.0, 1.0, 0.0, 0.0, False, 0.0)
    t0, t1, t2 = (
        piece[top, 12] + distance(y0, z), piece[top, 13] + distance(y1, z), piece[top, 14] + distance(y2, z),
    )  # fmt: skip
    late, early, middle = max(t0, t1, t2), min(t0, t1, t2), d1 + d3
    leg += last_leg if setup.scene.from_source else 0.0
    is_inside = _may_arrive(middle - 4 * h / 3 - 2 * size + leg, late + 2 * size + leg, setup)
    if may_halve and h > COARSEST * min(d1, math.sqrt(d3 * d3 + size * size)):
        return Piece(Verdict.HALVES, 0.0, 0.0, 1.0, 0.0, 0.0, is_inside, 0.0)
    most = max(piece[top, 9], piece[top, 10], piece[top, 11])
    # A lobe may be bright between the corners; and corners may be below either surface and the middle above both.
    is_matt = lit.brdf.kind == LAMBERTIAN and seen.brdf.kind == LAMBERTIAN and surface.brdf.kind == LAMBERTIAN
    if most <= 0.0 or not is_matt:
        most = max(most, guess(m, n, way, h + size)[0])
    normal = cross(subtract(y1, y0), subtract(y2, y0))
    area = 0.5 * math.sqrt(dot(normal, normal))
    width = max(1.0, (late - early) * setup.per_metre)
    bend = ((t0 + t1 + t2) / 3 - middle) * setup.per_metre
    across = (h / d1) ** 2 + h * h / (d3 * d3 + size * size)
    # What arrives outside the window only counts as a sum, for which what is near has been cut enough.
    verdict, light, worth = Verdict.SAMPLE, seen.gain * area * most, delta * math.sqrt(width)
    slack = error * math.sqrt(width) / light if light > 0.0 else np.inf
    bent = 4.0**LEVELS * max(CURVED * slack, straight) * width
    if is_inside:
        arc = 0.25 * size * size * setup.per_metre / min(d3, last_leg)
        if may_open and arc > SAGITTA and light * BENT * arc > worth * width:
            verdict = Verdict.QUARTERS_OF_CLUSTER
        elif may_halve and (light * (1.0 + BENT * bend / width) > worth or bend > bent):
            verdict = Verdict.HALVES
    return Piece(verdict, most, area, width, bend, across, is_inside, EVEN * min(slack, 1.0))
