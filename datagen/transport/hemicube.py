"""Pictures of moving parts on a hemicube: which of its cells they cover as seen from a point of a surface.

The half space above a point is divided into the cells of five faces of a cube about it (Cohen & Greenberg, "The
hemi-cube", SIGGRAPH 1985), whose straight lines are straight lines of space. Each cell has 4 × 4 places, and a
picture is a list of the cells that are covered, with a bit for each place and the depth of what is nearest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import dot
from datagen.transport.geometry import cross, get, put, subtract
from datagen.transport.movers import place_after
from datagen.transport.sampling import mix

PLACES = 4
"""Places of a cell along each of its sides; a picture's 16 bits have room for no more."""
FULL = (1 << PLACES * PLACES) - 1
"""The bits of a cell that is covered all over."""
NEAREST = 1e-4
"""Depth, relative to the farthest corner, from which on parts are drawn: what is nearer lies beside the point."""
MOST_CELLS = 1024
"""Most cells that a picture is expected to have; a call with more is repeated with more room."""


class Pictures(NamedTuple):
    """M pictures, of which picture m has the entries first[m] … first[m + 1] − 1.

    cell : number of the cell. bits : its covered places. near : depth of the nearest covered place, along the axis of
    the cell's face, metres.
    """

    first: Ints
    cell: Ints
    bits: Ints
    near: Floats


class Views(NamedTuple):
    """Where pictures are drawn from: origin (n, 3), metres, and axes (n, 3, 3), whose rows are two tangents and the
    normal of the surface."""

    origin: Floats
    axes: Floats

    @classmethod
    def of(cls, origin: Floats, normal: Floats, seed: int) -> Views:
        """Views from points with normals (n, 3), turned about these at random, by the point's number alone."""
        axes = np.empty((len(origin), 3, 3))
        _set_axes(normal, np.uint64(seed), axes)
        return cls(np.ascontiguousarray(origin), axes)


class Drawn(NamedTuple):
    """What is drawn: vertices (V, 3), metres, and the number of the mover of each (V,); triangles (T, 3), and whether
    each is one of a closed mesh with its normals outward (1) or inward (−1), or of another (0)."""

    vertices: Floats
    mover: Ints
    triangles: Ints
    outer: Floats


@compiled(forceinline=True, allocates=False)
def uniform(seed, a, b, c):  # type: ignore[no-untyped-def]
    """A random number in 0 … 1, a hash of a seed and three whole numbers."""
    word = mix(mix(np.uint64(seed), np.uint64(a)), mix(np.uint64(b), np.uint64(c)))
    return (np.float64(word) + 0.5) * 2.0**-32


@compiled(allocates=False)
def _set_axes(normal, seed, axes):  # type: ignore[no-untyped-def]
    """Sets the `axes` of views."""
    for k in range(len(normal)):
        n = get(normal, k, 0)
        one = (0.0, 0.0, 1.0) if abs(n[2]) < 0.9 else (1.0, 0.0, 0.0)
        u = cross(one, n)
        length = math.sqrt(max(dot(u, u), 1e-300))
        u = (u[0] / length, u[1] / length, u[2] / length)
        v = cross(n, u)
        angle = 2.0 * math.pi * uniform(seed, k, 0, 0)
        c, s = math.cos(angle), math.sin(angle)
        put(axes[k], 0, 0, (c * u[0] + s * v[0], c * u[1] + s * v[1], c * u[2] + s * v[2]))
        put(axes[k], 1, 0, (c * v[0] - s * u[0], c * v[1] - s * u[1], c * v[2] - s * u[2]))
        put(axes[k], 2, 0, n)


@compiled(forceinline=True, allocates=False)
def on_face(face, p):  # type: ignore[no-untyped-def]
    """Coordinates of a place on a face: across, up and depth, for p along tangents and normal."""
    if face == 0:
        return p[0], p[1], p[2]
    if face == 1:
        return p[1], p[2], p[0]
    if face == 2:
        return p[1], p[2], -p[0]
    if face == 3:
        return p[0], p[2], p[1]
    return p[0], p[2], -p[1]


@compiled(forceinline=True, allocates=False)
def off_face(face, q):  # type: ignore[no-untyped-def]
    """The vector, along tangents and normal, whose coordinates on a face are `q`: the inverse of `on_face`."""
    if face == 0:
        return q
    if face == 1:
        return q[2], q[0], q[1]
    if face == 2:
        return -q[2], q[0], q[1]
    if face == 3:
        return q[0], q[2], q[1]
    return q[0], -q[2], q[1]


@compiled(forceinline=True, allocates=False)
def along(axes, p):  # type: ignore[no-untyped-def]
    """The vector p along the axes (3, 3)."""
    return dot(get(axes, 0, 0), p), dot(get(axes, 1, 0), p), dot(get(axes, 2, 0), p)


@compiled(forceinline=True, allocates=False)
def in_space(axes, q):  # type: ignore[no-untyped-def]
    """The vector in space whose coordinates along the axes (3, 3) are `q`."""
    u, v, n = get(axes, 0, 0), get(axes, 1, 0), get(axes, 2, 0)
    return (
        q[0] * u[0] + q[1] * v[0] + q[2] * n[0], q[0] * u[1] + q[1] * v[1] + q[2] * n[1],
        q[0] * u[2] + q[1] * v[2] + q[2] * n[2],
    )  # fmt: skip


@compiled(forceinline=True, allocates=False)
def cells_of(side):  # type: ignore[no-untyped-def]
    """Number of cells of a hemicube whose front face has side × side of them, an even number."""
    return 3 * side * side


@compiled(forceinline=True, allocates=False)
def number_of(side, face, i, j):  # type: ignore[no-untyped-def]
    """The number of cell (i, j) of a face."""
    return i * side + j if face == 0 else side * side + (face - 1) * side * (side // 2) + i * (side // 2) + j


@compiled(forceinline=True, allocates=False)
def place_of(side, cell):  # type: ignore[no-untyped-def]
    """Face of a cell, and its place (i, j) there."""
    if cell < side * side:
        return 0, cell // side, cell % side
    rest, half = cell - side * side, side * (side // 2)
    face, rest = 1 + rest // half, rest % half
    return face, rest // (side // 2), rest % (side // 2)


@compiled(forceinline=True, allocates=False)
def toward(side, face, i, j):  # type: ignore[no-untyped-def]
    """Across and up, on a face at depth 1, of the place i, j cells from its lowest corner."""
    return 2.0 * i / side - 1.0, 2.0 * j / side - (1.0 if face == 0 else 0.0)


@compiled(forceinline=True, allocates=False)
def is_covered(side, face, a, b, bits):  # type: ignore[no-untyped-def]
    """Whether a picture covers the place across a and up b of a face at depth 1. bits : (cells,) of all cells."""
    x, y = 0.5 * (a + 1.0) * side, 0.5 * (b + (1.0 if face == 0 else 0.0)) * side
    high = side if face == 0 else side // 2
    if not (0.0 <= x < side and 0.0 <= y < high):
        return False
    i, j = int(x), int(y)
    bit = int((x - i) * PLACES) * PLACES + int((y - j) * PLACES)
    return (bits[number_of(side, face, i, j)] >> bit) & 1 == 1


@compiled(forceinline=True, allocates=False)
def face_toward(d):  # type: ignore[no-untyped-def]
    """The face that direction d, along tangents and normal, goes through; −1 below the surface."""
    if d[2] <= 0.0:
        return -1
    u, v = abs(d[0]), abs(d[1])
    if u <= d[2] and v <= d[2]:
        return 0
    return (1 if d[0] > 0.0 else 2) if u >= v else (3 if d[1] > 0.0 else 4)


@compiled(allocates=False)
def _cover(p0, p1, p2, face, side, bits, near, touched, count):  # type: ignore[no-untyped-def]
    """Draws a triangle whose corners are across, up (places) and one over depth on a face; returns the new `count`
    of `touched` cells."""
    wide, high = side * PLACES, (side if face == 0 else side // 2) * PLACES
    area = (p1[0] - p0[0]) * (p2[1] - p0[1]) - (p1[1] - p0[1]) * (p2[0] - p0[0])
    i0, i1 = max(math.ceil(min(p0[0], p1[0], p2[0])), 0), min(math.floor(max(p0[0], p1[0], p2[0])), wide - 1)
    j0, j1 = max(math.ceil(min(p0[1], p1[1], p2[1])), 0), min(math.floor(max(p0[1], p1[1], p2[1])), high - 1)
    if area == 0.0 or i1 < i0 or j1 < j0:
        return count
    per = 1.0 / area
    g0, g1 = (p2[0] - p1[0]) * per, (p0[0] - p2[0]) * per
    for i in range(int(i0), int(i1) + 1):
        w0 = ((p1[0] - i) * (p2[1] - j0) - (p1[1] - j0) * (p2[0] - i)) * per
        w1 = ((p2[0] - i) * (p0[1] - j0) - (p2[1] - j0) * (p0[0] - i)) * per
        for j in range(int(j0), int(j1) + 1):
            if w0 >= 0.0 and w1 >= 0.0 and w0 + w1 <= 1.0:
                depth = 1.0 / (p2[2] + w0 * (p0[2] - p2[2]) + w1 * (p1[2] - p2[2]))
                cell = number_of(side, face, i // PLACES, j // PLACES)
                if bits[cell] == 0:
                    touched[count], near[cell] = cell, depth
                    count += 1
                bits[cell] |= 1 << ((i % PLACES) * PLACES + j % PLACES)
                near[cell] = min(near[cell], depth)
            w0 += g0
            w1 += g1
    return count


@compiled(forceinline=True, allocates=False)
def _place_on(q, face, side):  # type: ignore[no-untyped-def]
    """Across and up, in places from the middle of the lowest one, and one over depth, of q on a face."""
    per, half = 1.0 / q[2], 0.5 * side * PLACES
    return q[0] * per * half + half - 0.5, q[1] * per * half + (half if face == 0 else 0.0) - 0.5, per


@compiled(forceinline=True, allocates=False)
def _cut_at(a, b, depth):  # type: ignore[no-untyped-def]
    """The place between a and b on a face that has some depth."""
    t = (depth - a[2]) / (b[2] - a[2])
    return a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), depth


@compiled(allocates=False)
def _draw_triangle(a, b, c, face, side, nearest, bits, near, touched, count):  # type: ignore[no-untyped-def]
    """Draws a triangle with corners on a face, cut off at the depth `nearest`; returns the new `count`."""
    # Most triangles that are not on a face are beside it.
    if max(a[0] + a[2], b[0] + b[2], c[0] + c[2]) <= 0.0 or min(a[0] - a[2], b[0] - b[2], c[0] - c[2]) >= 0.0:
        return count
    if min(a[1] - a[2], b[1] - b[2], c[1] - c[2]) >= 0.0:
        return count
    inside = int(a[2] > nearest) + int(b[2] > nearest) + int(c[2] > nearest)
    if inside == 0:
        return count
    # The corner that is alone on its side of the cut comes first.
    if inside in (1, 2):
        is_one = inside == 1
        for _ in range(2):
            if (a[2] > nearest) != is_one:
                a, b, c = b, c, a
    if inside == 3 or inside == 1:
        if inside == 1:
            b, c = _cut_at(a, b, nearest), _cut_at(a, c, nearest)
        p0, p1, p2 = _place_on(a, face, side), _place_on(b, face, side), _place_on(c, face, side)
        return _cover(p0, p1, p2, face, side, bits, near, touched, count)
    d, e = _place_on(_cut_at(a, b, nearest), face, side), _place_on(_cut_at(a, c, nearest), face, side)
    p1, p2 = _place_on(b, face, side), _place_on(c, face, side)
    count = _cover(d, p1, p2, face, side, bits, near, touched, count)
    return _cover(d, p2, e, face, side, bits, near, touched, count)


@compiled(forceinline=True, allocates=False)
def _may_meet(face, local, count, nearest):  # type: ignore[no-untyped-def]
    """Whether a part with `count` vertices, along tangents and normal, may be seen through a face."""
    deep = left = right = low = high = False
    for k in range(count):
        q = on_face(face, get(local, k, 0))
        deep |= q[2] > nearest
        left |= q[0] > -q[2]
        right |= q[0] < q[2]
        low |= q[1] > (-q[2] if face == 0 else 0.0)
        high |= q[1] < q[2]
    return deep and left and right and low and high


@compiled(allocates=False)
def _draw_all(view, of_view, pose, drawn, side, local, shown, bits, near, touched, first, cell, of_bits, of_near):  # type: ignore[no-untyped-def]
    """Sets `first` (M + 1,) and the entries `cell`, `of_bits`, `of_near` of `Pictures`, as many as have room; returns
    their number. of_view : (M,) view of each picture. pose : (M, movers, 5).

    local (V, 3), shown (T,), bits, near, touched (cells,) : arrays to work in; bits are 0 before and after.
    """
    used = 0
    for m in range(len(of_view)):
        origin, axes, farthest = get(view.origin, of_view[m], 0), view.axes[of_view[m]], 0.0
        for k in range(len(local)):
            q = along(axes, subtract(place_after(pose[m, drawn.mover[k]], get(drawn.vertices, k, 0)), origin))
            put(local, k, 0, q)
            farthest = max(farthest, dot(q, q))
        for t in range(len(shown)):
            a, b, c = (
                get(local, drawn.triangles[t, 0], 0), get(local, drawn.triangles[t, 1], 0),
                get(local, drawn.triangles[t, 2], 0),
            )  # fmt: skip
            # Of a closed mesh the triangles that turn to the view cover what the others do.
            shown[t] = drawn.outer[t] * dot(a, cross(subtract(b, a), subtract(c, a))) <= 0.0
        count, nearest = 0, NEAREST * math.sqrt(farthest)
        for face in range(5):
            if not _may_meet(face, local, len(local), nearest):
                continue
            for t in range(len(shown)):
                if shown[t]:
                    a, b, c = (
                        on_face(face, get(local, drawn.triangles[t, 0], 0)),
                        on_face(face, get(local, drawn.triangles[t, 1], 0)),
                        on_face(face, get(local, drawn.triangles[t, 2], 0)),
                    )  # fmt: skip
                    count = _draw_triangle(a, b, c, face, side, nearest, bits, near, touched, count)
        first[m] = used
        for k in range(count):
            if used < len(cell):
                cell[used], of_bits[used], of_near[used] = touched[k], bits[touched[k]], near[touched[k]]
            used += 1
            bits[touched[k]] = 0
    first[len(of_view)] = used
    return used


def pictures(views: Views, of_view: Ints, pose: Floats, drawn: Drawn, side: int) -> Pictures:
    """Pictures of all movers together, from views `of_view` (M,), with the movers at poses (M, movers, 5); the front
    face of the hemicube has side × side cells."""
    cells, count, most = 3 * side * side, len(of_view), 64 * len(of_view) + MOST_CELLS
    bits, near, touched = np.zeros(cells, np.int64), np.empty(cells), np.empty(cells, np.int64)
    local, shown = np.empty((len(drawn.vertices), 3)), np.empty(len(drawn.triangles), np.bool_)
    first: NDArray[np.int64] = np.empty(count + 1, np.int64)
    while True:
        cell, of_bits, of_near = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
        used = _draw_all(
            views, of_view, pose, drawn, side, local, shown, bits, near, touched, first, cell, of_bits, of_near
        )  # fmt: skip
        if used <= most:
            return Pictures(first, cell[:used], of_bits[:used], of_near[:used])
        most = int(used)
