"""The stack of boxes and elements that the three-bounce kernel has not yet dealt with.

Entry k of the stack is a row of two arrays. `tag[k]` has six integers: kind of the entry, index of its box or
triangle, index of the footprint that it is seen from, and three indices that bound the lists of its possible
occluders. `cell[k]` has 18 numbers: three vertices (from columns 0, 5 and 10), metres, each with its weight and the
length of the path by way of it, metres; the area, m² (15); the number of footprints for which the footprint stands
(16); and the error, relative to the element's light, that is expected where no ray finds any of it (17).
"""

from __future__ import annotations

import numpy as np

from datagen.compiled import compiled
from datagen.transport.brdf import dot
from datagen.transport.geometry import get, longest, put, subtract

BOX, FRESH, CELL, KEPT = map(np.int64, range(4))
"""Kinds of entries: a box of the BVH; an element whose vertices have no weights yet; an element whose vertices have
weights; and an element from the stack of clear elements (`clear_elements.py`) that has to be seen from quarters of
its footprint. They are np.int64, because numba compiles a function anew for each plain int."""


@compiled()
def push(tag, top, what, at, q, candidates):  # type: ignore[no-untyped-def]
    """New height of the stack, after the tag of a box or element was put on it; its `cell` is already in place.

    what, at, q : kind, index of box or triangle, and index of the footprint. candidates : bounds of the lists of its
    possible occluders.
    """
    tag[top, 0], tag[top, 1], tag[top, 2] = what, at, q
    tag[top, 3], tag[top, 4], tag[top, 5] = candidates
    return top + 1


@compiled()
def put_vertex(cell, k, vertex, y, w, path):  # type: ignore[no-untyped-def]
    """Set vertex 0, 1 or 2 of entry k to the point y, metres, with its weight w and the path by way of it, metres."""
    put(cell, k, 5 * vertex, y)
    cell[k, 5 * vertex + 3], cell[k, 5 * vertex + 4] = w, path


@compiled()
def vertex_of(cell, k, vertex):  # type: ignore[no-untyped-def]
    """Vertex 0, 1 or 2 of entry k, metres."""
    return get(cell, k, 5 * vertex)


@compiled()
def copy_cell(cell, k, to):  # type: ignore[no-untyped-def]
    """Copy the numbers of entry k to entry `to`."""
    for j in range(18):
        cell[to, j] = cell[k, j]


@compiled()
def middle_of(cell, k):  # type: ignore[no-untyped-def]
    """The middle of entry k, metres; the number of its longest side (0 for ab, 1 for bc, 2 for ca); and that side's
    length, metres."""
    a, b, c = vertex_of(cell, k, 0), vertex_of(cell, k, 1), vertex_of(cell, k, 2)
    side, h = longest(a, b, c)
    return ((a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3), side, h


@compiled()
def highest_above(cell, k, x, n):  # type: ignore[no-untyped-def]
    """Height of the highest vertex of entry k above the plane through x with normal n, metres."""
    a, b, c = (
        subtract(vertex_of(cell, k, 0), x),
        subtract(vertex_of(cell, k, 1), x),
        subtract(vertex_of(cell, k, 2), x),
    )
    return max(dot(a, n), dot(b, n), dot(c, n))


@compiled()
def push_halves(room, top, side, vertex, what, at, q, candidates):  # type: ignore[no-untyped-def]
    """New height of the stack, after the element at `top` was replaced by its two halves.

    side : number of the element's longest side, which is cut. vertex : middle of that side, with its weight and path.
    """
    tag, cell, (y, w, path) = room.tag, room.cell, vertex
    # Each half has the middle of the cut side in place of one of that side's ends.
    cell[top, 15] *= 0.5
    copy_cell(cell, top, top + 1)
    put_vertex(cell, top, side, y, w, path)
    put_vertex(cell, top + 1, (side + 1) % 3, y, w, path)
    top = push(tag, top, what, at, q, candidates)
    return push(tag, top, what, at, q, candidates)


@compiled()
def push_boxes(tag, cell, top, both, q, candidates):  # type: ignore[no-untyped-def]
    """New height of the stack, after the box at `top` was replaced by the two boxes within it, `both`."""
    # Of a box, `cell` has no vertices: only the last two numbers are handed on.
    cell[top + 1, 16], cell[top + 1, 17] = cell[top, 16], cell[top, 17]
    top = push(tag, top, BOX, both[1], q, candidates)
    return push(tag, top, BOX, both[0], q, candidates)
