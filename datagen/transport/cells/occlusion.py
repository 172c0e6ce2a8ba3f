"""What stands between two points, or between a point and all of a triangle, in double precision.

It is asked of a tree of boxes over the triangles that can hide anything, answers the same on every processor, and in
compiled loops, one line at a time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records import Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import dot
from datagen.transport.cells.geometry import above, ball, corner, cross, distance, less, unit
from datagen.transport.cells.hierarchy import ON_PLANE, Hierarchy
from datagen.transport.cells.surface_area import boxes_over

TINY = 1e-300
TOUCHING = 1e-9
"""Share of a line at each end within which a triangle only touches it."""
FEW_VERTICES = 256
"""Vertices of a part up to which each is asked whether it lies behind a wall; of larger parts their box is."""
MOST, RING = 16, 63
"""Candidates up to which boxes are opened, and the mask of a ring that holds those still to be looked at."""
MANY_WALLS = 1024
"""Walls that hide nothing up to which each is held against all others, whether it lies on one of them."""


class Occluders(NamedTuple):
    """F triangles that can hide anything, in N boxes; the walls round a convex room are not among them.

    Attributes
    ----------
    facet : (F, 4, 3) three corners, metres, and the unit normal.
    number : (F,) which triangle of the `Hierarchy` each is.
    box : (N, 6) lowest and highest corner, metres; the first holds all.
    link : (N, 3) the first of two boxes side by side, −1 in a box that holds its triangles itself; these, first and
        behind the last.
    flat : distance from a plane within which a point lies on it, metres.
    """

    facet: Floats
    number: Ints
    box: Floats
    link: Ints
    flat: float

    @classmethod
    def of(cls, scene: Scene, tree: Hierarchy) -> Occluders:
        """Those of a scene, in time nearly linear in its triangles."""
        number = np.flatnonzero(_hides(scene, tree))
        corners = tree.corners[number]
        order, box, link = boxes_over(corners.min(axis=1), corners.max(axis=1))
        number = number[order]
        facet = np.concatenate([tree.corners[number], tree.normal[number, None]], axis=1)
        return cls(facet, number, box, link, ON_PLANE * tree.extent)


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
                outward = unit(cross(less(b, a), n))
                if dot(less(corner(corners, one, (side + 2) % 3), a), outward) > 0.0:
                    outward = (-outward[0], -outward[1], -outward[2])
                beyond = True
                for v in range(3):
                    beyond &= dot(less(corner(corners, other, v), a), outward) > -near
                apart |= beyond
            if not apart:
                found[i] = True
                break


@compiled()
def _crosses(x, d, facet, f, end):  # type: ignore[no-untyped-def]
    """Whether the line x … x + d · end passes through triangle f (Möller & Trumbore, J. Graphics Tools 2 (1997))."""
    a = corner(facet, f, 0)
    along_b, along_c = less(corner(facet, f, 1), a), less(corner(facet, f, 2), a)
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


@compiled()
def hidden(x, y, of, candidates, first, last, facet, number, box, link, waiting):  # type: ignore[no-untyped-def]
    """A triangle other than number `of`, on which y lies, that stands between the points x and y; −1 for none.

    candidates : boxes k and triangles −1 − f, of which first … last are asked.
    waiting : (≥ 256,) int64 scratch; the last of it is the triangle that hid something the last time, asked first,
        or −1.

    The other arguments are the fields of `Occluders`, one by one: taken out of it in the loop they cost four times as
    much.
    """
    d = less(y, x)
    suspect = waiting[-1]
    if first < last and suspect >= 0 and _stands_between(x, d, of, suspect, facet, number):
        return suspect
    slope = (1.0 / (d[0] or TINY), 1.0 / (d[1] or TINY), 1.0 / (d[2] or TINY))
    for i in range(first, last):
        waiting[0], top = candidates[i], 1
        while top > 0:
            top -= 1
            k = waiting[top]
            if k < 0:
                f = -1 - k
                if _stands_between(x, d, of, f, facet, number):
                    waiting[-1] = f
                    return f
                continue
            enter, leave = 0.0, 1.0 + TOUCHING
            for j in range(3):
                one, other = (box[k, j] - x[j]) * slope[j], (box[k, 3 + j] - x[j]) * slope[j]
                enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
            if enter <= leave * (1.0 + 1e-12):
                top = _opened(waiting, top, link, k)
    return -1


@compiled()
def _stands_between(x, d, of, f, facet, number):  # type: ignore[no-untyped-def]
    """Whether occluder f hides x + d on triangle `of` from x."""
    if number[f] == of:
        return False
    # Of triangles that lie on each other the last one is seen, so that their light counts once.
    return _crosses(x, d, facet, f, 1.0 + TOUCHING if number[f] > of else 1.0 - TOUCHING)


@compiled()
def _opened(entries, top, link, k):  # type: ignore[no-untyped-def]
    """Put what box k holds behind the first `top` entries; returns how many there are then."""
    if link[k, 0] >= 0:
        entries[top], entries[top + 1] = link[k, 0], link[k, 0] + 1
        return top + 2
    for f in range(link[k, 1], link[k, 2]):
        entries[top] = -1 - f
        top += 1
    return top


@compiled()
def shaded(x, a, b, c, of, candidates, first, last, facet, number, box, link, waiting):  # type: ignore[no-untyped-def]
    """Whether it is proven that x sees nothing of the triangle a, b, c on triangle `of`.

    A triangle that stands before all three corners stands before all between them. False is no proof of the opposite.
    """
    before = hidden(x, a, of, candidates, first, last, facet, number, box, link, waiting)
    if before < 0:
        return False
    end = 1.0 - TOUCHING
    return _crosses(x, less(b, x), facet, before, end) and _crosses(x, less(c, x), facet, before, end)


@compiled()
def narrowed_to_box(x, around, at, candidates, first, last, free, box, link, waiting):  # type: ignore[no-untyped-def]
    """Those of the candidates first … last that may stand between x and some point of the box `around[at]`; as
    `narrowed`, but only boxes are asked: by their shadows on the axes and by the cone over the ball round the box."""
    middle, radius = ball(around, at)
    axis, far = less(middle, x), distance(middle, x)
    sine = min(radius / far, 1.0)
    cosine = np.sqrt(1.0 - sine * sine)
    head, tail, end = 0, _listed(waiting, candidates, first, last), free
    while head < tail:
        k = waiting[head & RING]
        head += 1
        if k >= 0:
            apart = False
            for j in range(3):
                apart |= box[k, j] > max(x[j], around[at, 3 + j]) or box[k, 3 + j] < min(x[j], around[at, j])
            centre, size = ball(box, k)
            d = less(centre, x)
            along = dot(d, axis) / far
            across = np.sqrt(max(dot(d, d) - along * along, 0.0))
            if apart or (sine < 1.0 and across * cosine - along * sine > size * (1.0 + 1e-6)):
                continue
            if link[k, 0] >= 0 and end - free + tail - head < MOST:
                tail = _pair_listed(waiting, tail, link[k, 0])
                continue
        candidates[end] = k
        end += 1
    return end


@compiled()
def _listed(waiting, candidates, first, last):  # type: ignore[no-untyped-def]
    """Put candidates first … last into the ring of what is to be looked at; returns how many."""
    for i in range(last - first):
        waiting[i] = candidates[first + i]
    return last - first


@compiled()
def _pair_listed(waiting, tail, one):  # type: ignore[no-untyped-def]
    """Put two boxes side by side at the end of the ring; returns its new end."""
    waiting[tail & RING], waiting[(tail + 1) & RING] = one, one + 1
    return tail + 2


@compiled()
def narrowed(x, a, b, c, of, candidates, first, last, free, facet, number, box, link, flat, waiting):  # type: ignore[no-untyped-def]
    """Those of the candidates first … last that may stand between x and some point of the triangle a, b, c on
    triangle `of`, boxes opened while they are few: written from `free` on; returns the end. None left is a proof.

    The pyramid over the triangle with its tip in x is free of every triangle that lies beyond one of its sides, or
    has all of the pyramid on one side of itself.
    """
    base = cross(less(b, a), less(c, a))
    if dot(base, less(x, a)) < 0.0:
        base = (-base[0], -base[1], -base[2])
    one, two, three = cross(less(a, x), less(b, x)), cross(less(b, x), less(c, x)), cross(less(c, x), less(a, x))
    if dot(one, less(c, x)) < 0.0:
        one, two, three = (-one[0], -one[1], -one[2]), (-two[0], -two[1], -two[2]), (-three[0], -three[1], -three[2])
    near1, near2, near3, near0 = _margin(one, flat), _margin(two, flat), _margin(three, flat), _margin(base, flat)
    head, tail, end = 0, _listed(waiting, candidates, first, last), free
    while head < tail:
        k = waiting[head & RING]
        head += 1
        if k < 0:
            f = -1 - k
            if number[f] == of:
                continue
            p, q, r = corner(facet, f, 0), corner(facet, f, 1), corner(facet, f, 2)
            if (
                _beyond(one, x, p, q, r, near1)
                or _beyond(two, x, p, q, r, near2)
                or _beyond(three, x, p, q, r, near3)
            ):
                continue
            if _beyond(base, a, p, q, r, near0):
                # One that lies on the triangle itself, and is seen in its place, hides it.
                upward = (-base[0], -base[1], -base[2])
                if not (number[f] > of and _beyond(upward, a, p, q, r, near0)):
                    continue
            else:
                n = corner(facet, f, 3)
                low, high = _heights(n, p, x, a, b, c)
                if high <= flat or low >= -flat:
                    continue
        elif (
            _outside(one, x, box, k, near1)
            or _outside(two, x, box, k, near2)
            or _outside(three, x, box, k, near3)
            or _outside(base, a, box, k, -near0)
        ):
            continue
        elif end - free + tail - head < MOST:
            if link[k, 0] >= 0:
                tail = _pair_listed(waiting, tail, link[k, 0])
            else:
                for f in range(link[k, 1], link[k, 2]):
                    waiting[tail & RING] = -1 - f
                    tail += 1
            continue
        candidates[end] = k
        end += 1
    return end


@compiled()
def _outside(n, x, box, k, near):  # type: ignore[no-untyped-def]
    """Whether a box lies wholly on the outer side of the plane through x whose normal n points inwards."""
    return above(box, k, x, n) <= near


@compiled()
def _beyond(n, x, p, q, r, near):  # type: ignore[no-untyped-def]
    """Whether three points lie on the outer side of the plane through x whose normal n points inwards, or on it."""
    return dot(n, less(p, x)) <= near and dot(n, less(q, x)) <= near and dot(n, less(r, x)) <= near


@compiled()
def _heights(n, p, x, a, b, c):  # type: ignore[no-untyped-def]
    """Least and greatest height of four points above the plane through p."""
    at_x, at_a, at_b, at_c = dot(n, less(x, p)), dot(n, less(a, p)), dot(n, less(b, p)), dot(n, less(c, p))
    return min(at_x, at_a, at_b, at_c), max(at_x, at_a, at_b, at_c)


@compiled()
def _margin(n, flat):  # type: ignore[no-untyped-def]
    """What a height of `flat` is along n, no unit vector; no number, so that nothing is proven, if that is zero."""
    length = np.sqrt(dot(n, n))
    return flat * length if length > 0.0 else np.nan
