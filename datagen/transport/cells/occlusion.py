"""What stands between two points, or between a point and all of a triangle, in double precision.

A tree of boxes over the triangles that can hide anything, built by the surface area heuristic in bins (Wald, "On
fast construction of SAH-based bounding volume hierarchies", IEEE Symposium on Interactive Ray Tracing 2007). It
answers the same on every processor, and in compiled loops, one line at a time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from datagen.records import Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import dot
from datagen.transport.cells.hierarchy import ON_PLANE, Hierarchy

TOUCHING = 1e-9
"""Share of a line at each end within which a triangle only touches it."""
FEW_VERTICES = 256
"""Vertices of a part up to which each is asked whether it lies behind a wall; of larger parts their box is."""
LEAF, BINS = 3, 12
MANY_WALLS = 1024
"""Walls that hide nothing up to which each is held against all others, whether it lies on one of them."""


class Occluders(NamedTuple):
    """F triangles that can hide anything, in N boxes; the walls round a convex room are not among them.

    Attributes
    ----------
    corners : (F, 3, 3) metres.
    number : (F,) which triangle of the `Hierarchy` each is.
    box : (N, 6) lowest and highest corner, metres; the first holds all.
    child : (N,) the first of two boxes side by side; −1 in a box that holds its triangles itself.
    span : (N, 2) its triangles, first and behind the last.
    flat : distance from a plane within which a point lies on it, metres.
    """

    corners: Floats
    number: Ints
    box: Floats
    child: Ints
    span: Ints
    flat: float

    @classmethod
    def of(cls, scene: Scene, tree: Hierarchy) -> Occluders:
        """Those of a scene, in time nearly linear in its triangles."""
        number = np.flatnonzero(_hides(scene, tree))
        corners = tree.corners[number]
        order, box, child, span = _boxes(corners.min(axis=1), corners.max(axis=1))
        corners = np.ascontiguousarray(corners[order])
        return cls(corners, number[order], box, child, span, ON_PLANE * tree.extent)


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


@njit(cache=True, error_model="numpy")
def _lie_on_each_other(corners, normal, some, near, found):  # type: ignore[no-untyped-def]
    """Mark those of some triangles that overlap another one of them in its plane."""
    for i in some:
        n = (normal[i, 0], normal[i, 1], normal[i, 2])
        for j in some:
            apart = i == j
            for v in range(3):
                apart |= abs(dot(less(corner(corners, j, v), corner(corners, i, 0)), n)) > near
            # Two triangles are apart if a side of either has the other wholly beyond it.
            for side in range(6):
                one, other = (i, j) if side < 3 else (j, i)
                a, b = corner(corners, one, side % 3), corner(corners, one, (side + 1) % 3)
                outward = _unit(cross(less(b, a), n))
                if dot(less(corner(corners, one, (side + 2) % 3), a), outward) > 0.0:
                    outward = (-outward[0], -outward[1], -outward[2])
                beyond = True
                for v in range(3):
                    beyond &= dot(less(corner(corners, other, v), a), outward) > -near
                apart |= beyond
            if not apart:
                found[i] = True
                break


@njit(cache=True, error_model="numpy")
def _boxes(low, high):  # type: ignore[no-untyped-def]
    """Order of the triangles, and the boxes: (order, box, child, span)."""
    count = len(low)
    most = max(2 * count, 1)
    order, spare = np.arange(count), np.empty(count, np.int64)
    box, child, span = np.empty((most, 6)), np.full(most, -1), np.zeros((most, 2), np.int64)
    span[0, 1], n, k = count, 1, 0
    members, bounds, cost = np.empty(BINS, np.int64), np.empty((BINS, 6)), np.empty(BINS)
    while k < n:
        first, last = span[k, 0], span[k, 1]
        axis, smallest, largest = 0, 0.0, -1.0
        for j in range(3):
            box[k, j], box[k, 3 + j], least, greatest = np.inf, -np.inf, np.inf, -np.inf
            for f in order[first:last]:
                box[k, j], box[k, 3 + j] = min(box[k, j], low[f, j]), max(box[k, 3 + j], high[f, j])
                least, greatest = min(least, low[f, j] + high[f, j]), max(greatest, low[f, j] + high[f, j])
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
            cost[:] = 0.0
            _swept(members, bounds, cost, 1)
            _swept(members, bounds, cost, -1)
            best = 1
            for m in range(2, BINS):
                if cost[m] < cost[best]:
                    best = m
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
            if middle in (first, last):
                middle = (first + last) // 2
            child[k] = n
            span[n, 0], span[n, 1], span[n + 1, 0], span[n + 1, 1] = first, middle, middle, last
            n += 2
        k += 1
    return order, box[:n], child[:n], span[:n]


@njit(cache=True, error_model="numpy")
def _bin(low, high, f, axis, smallest, largest):  # type: ignore[no-untyped-def]
    if largest <= 0.0:
        return 0
    return min(int((low[f, axis] + high[f, axis] - smallest) / largest * BINS), BINS - 1)


@njit(cache=True)
def _swept(members, bounds, cost, step):  # type: ignore[no-untyped-def]
    """Add to each cut between bins what the bins on one side of it cost: how many triangles, in how large a box."""
    total = 0
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for turn in range(BINS):
        m = turn if step > 0 else BINS - 1 - turn
        cut = m if step > 0 else m + 1
        side = high - low
        if 0 < cut < BINS and total > 0:
            cost[cut] += total * (side[0] * side[1] + side[1] * side[2] + side[2] * side[0])
        elif 0 < cut < BINS:
            cost[cut] += np.inf
        total += members[m]
        for j in range(3):
            low[j], high[j] = min(low[j], bounds[m, j]), max(high[j], bounds[m, 3 + j])


@njit(cache=True, error_model="numpy")
def less(a, b):  # type: ignore[no-untyped-def]
    """a − b, of vectors."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@njit(cache=True, error_model="numpy")
def cross(a, b):  # type: ignore[no-untyped-def]
    """The vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@njit(cache=True, error_model="numpy")
def corner(corners, f, k):  # type: ignore[no-untyped-def]
    """Corner k of triangle f."""
    return (corners[f, k, 0], corners[f, k, 1], corners[f, k, 2])


@njit(cache=True, error_model="numpy")
def _crosses(x, d, corners, f, end):  # type: ignore[no-untyped-def]
    """Whether the line x … x + d · end passes through triangle f (Möller & Trumbore, J. Graphics Tools 2 (1997))."""
    a = corner(corners, f, 0)
    along_b, along_c = less(corner(corners, f, 1), a), less(corner(corners, f, 2), a)
    p = cross(d, along_c)
    volume = dot(along_b, p)
    if volume == 0.0:
        return False
    inverse, s = 1.0 / volume, less(x, a)
    u = dot(s, p) * inverse
    if u < 0.0 or u > 1.0:
        return False
    q = cross(s, along_b)
    v = dot(d, q) * inverse
    if v < 0.0 or u + v > 1.0:
        return False
    return TOUCHING < dot(along_c, q) * inverse < end


@njit(cache=True, error_model="numpy")
def hidden(x, y, of, corners, number, box, child, span, waiting):  # type: ignore[no-untyped-def]
    """A triangle other than number `of`, on which y lies, that stands between the points x and y; −1 for none.

    The other arguments are the fields of `Occluders`, one by one: taken out of it in the loop they cost four times as
    much. waiting : (≥ 256,) int64 scratch.
    """
    d = less(y, x)
    slope = (1.0 / d[0], 1.0 / d[1], 1.0 / d[2])
    waiting[0], top = 0, 1 if len(number) > 0 else 0
    while top > 0:
        top -= 1
        k = waiting[top]
        enter, leave = 0.0, 1.0 + TOUCHING
        for j in range(3):
            if d[j] == 0.0:
                if x[j] < box[k, j] or x[j] > box[k, 3 + j]:
                    leave = -1.0
            else:
                near, far = (box[k, j] - x[j]) * slope[j], (box[k, 3 + j] - x[j]) * slope[j]
                enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
        if enter > leave * (1.0 + 1e-12):
            continue
        if child[k] >= 0:
            waiting[top], waiting[top + 1] = child[k], child[k] + 1
            top += 2
            continue
        for f in range(span[k, 0], span[k, 1]):
            # Of triangles that lie on each other the last one is seen, so that their light counts once.
            end = 1.0 + TOUCHING if number[f] > of else 1.0 - TOUCHING
            if number[f] != of and _crosses(x, d, corners, f, end):
                return f
    return -1


@njit(cache=True, error_model="numpy")
def shaded(x, a, b, c, of, corners, number, box, child, span, waiting):  # type: ignore[no-untyped-def]
    """Whether it is proven that x sees nothing of the triangle a, b, c on triangle `of`.

    A triangle that stands before all three corners stands before all between them. False is no proof of the opposite.
    """
    before = hidden(x, a, of, corners, number, box, child, span, waiting)
    if before < 0:
        return False
    end = 1.0 - TOUCHING
    return _crosses(x, less(b, x), corners, before, end) and _crosses(x, less(c, x), corners, before, end)


@njit(cache=True, error_model="numpy")
def _outside(n, x, box, k, flat):  # type: ignore[no-untyped-def]
    """Whether a box lies wholly on the outer side of the plane through x whose normal n points inwards."""
    height = 0.0
    for j in range(3):
        height += max(n[j] * (box[k, j] - x[j]), n[j] * (box[k, 3 + j] - x[j]))
    return height <= flat


@njit(cache=True, error_model="numpy")
def _unit(n):  # type: ignore[no-untyped-def]
    length = np.sqrt(dot(n, n))
    return (n[0] / length, n[1] / length, n[2] / length)


@njit(cache=True, error_model="numpy")
def clear(x, a, b, c, of, corners, number, box, child, span, flat, waiting):  # type: ignore[no-untyped-def]
    """Whether it is proven that nothing stands between x and any point of the triangle a, b, c on triangle `of`.

    The pyramid over the triangle with its tip in x is free of every triangle that lies beyond one of its sides, or
    has all of the pyramid on one side of itself. True is certain; False is no proof of the opposite.
    """
    base = _unit(cross(less(b, a), less(c, a)))
    if dot(base, less(x, a)) < 0.0:
        base = (-base[0], -base[1], -base[2])
    one, two, three = cross(less(a, x), less(b, x)), cross(less(b, x), less(c, x)), cross(less(c, x), less(a, x))
    if dot(one, less(c, x)) < 0.0:
        one, two, three = (-one[0], -one[1], -one[2]), (-two[0], -two[1], -two[2]), (-three[0], -three[1], -three[2])
    one, two, three = _unit(one), _unit(two), _unit(three)
    waiting[0], top = 0, 1 if len(number) > 0 else 0
    while top > 0:
        top -= 1
        k = waiting[top]
        if (
            _outside(one, x, box, k, flat)
            or _outside(two, x, box, k, flat)
            or _outside(three, x, box, k, flat)
            or _outside(base, a, box, k, -flat)
        ):
            continue
        if child[k] >= 0:
            waiting[top], waiting[top + 1] = child[k], child[k] + 1
            top += 2
            continue
        for f in range(span[k, 0], span[k, 1]):
            if number[f] == of:
                continue
            p, q, r = corner(corners, f, 0), corner(corners, f, 1), corner(corners, f, 2)
            if _behind(one, x, p, q, r, flat) or _behind(two, x, p, q, r, flat) or _behind(three, x, p, q, r, flat):
                continue
            if _behind(base, a, p, q, r, flat):
                upward = (-base[0], -base[1], -base[2])
                if number[f] > of and _behind(upward, a, p, q, r, flat):
                    return False  # It lies on the triangle itself, and is seen in its place.
                continue
            n = _unit(cross(less(q, p), less(r, p)))
            if _behind(n, p, a, b, c, flat) and dot(n, less(x, p)) <= flat:
                continue
            n = (-n[0], -n[1], -n[2])
            if _behind(n, p, a, b, c, flat) and dot(n, less(x, p)) <= flat:
                continue
            return False
    return True


@njit(cache=True, error_model="numpy")
def _behind(n, x, p, q, r, flat):  # type: ignore[no-untyped-def]
    """Whether three points lie on the outer side of the plane through x whose normal n points inwards, or on it."""
    return dot(n, less(p, x)) <= flat and dot(n, less(q, x)) <= flat and dot(n, less(r, x)) <= flat
