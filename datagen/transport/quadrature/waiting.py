"""The stack of boxes and elements that the three-bounce kernel has still to look at.

Entry k is a row `tag[k]` of six integers (kind, number of box or triangle, footprint, and three numbers that say
where the list of its possible occluders is) and a row `cell[k]` of 18 numbers: three vertices, at 0, 5 and 10,
metres, each with the weight and the path by way of it, metres; the area, m² (15); the number of footprints alike that
its footprint stands for (16); and the error, relative to its light, that is feared where no ray found any of it (17).
"""

from __future__ import annotations

import numpy as np

from datagen.compiled import compiled
from datagen.transport.brdf import dot
from datagen.transport.geometry import get, longest, put, subtract

BOX, FRESH, CELL, KEPT = map(np.int64, range(4))
"""Kinds of entries: a box of the BVH; a triangle whose vertices have no weights yet; an element whose vertices have;
and one that has been judged clear and comes back to be seen from quarters of its footprint. They are np.int64,
because numba compiles a function anew for each plain int."""


@compiled()
def push(tag, top, what, at, q, candidates):  # type: ignore[no-untyped-def]
    """Put a box or element on the stack, with the list of its possible occluders; returns the new height."""
    tag[top, 0], tag[top, 1], tag[top, 2] = what, at, q
    tag[top, 3], tag[top, 4], tag[top, 5] = candidates
    return top + 1


@compiled()
def put_vertex(cell, k, vertex, y, w, path):  # type: ignore[no-untyped-def]
    """Set vertex 0, 1 or 2 of entry k, with the weight and path there."""
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
    """The middle of entry k, which of its sides is longest, and that side's length, metres."""
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
    """Put the two halves of the element at `top` in its place; returns the new height of the stack.

    side : number of its longest side, which is cut. vertex : the middle of that side, with weight and path there.
    """
    tag, cell, (y, w, path) = room.tag, room.cell, vertex
    cell[top, 15] *= 0.5
    copy_cell(cell, top, top + 1)
    put_vertex(cell, top, side, y, w, path)
    put_vertex(cell, top + 1, (side + 1) % 3, y, w, path)
    top = push(tag, top, what, at, q, candidates)
    return push(tag, top, what, at, q, candidates)


@compiled()
def push_boxes(tag, cell, top, both, q, candidates):  # type: ignore[no-untyped-def]
    """Put the two boxes within the box at `top` in its place; returns the new height of the stack."""
    cell[top + 1, 16], cell[top + 1, 17] = cell[top, 16], cell[top, 17]
    top = push(tag, top, BOX, both[1], q, candidates)
    return push(tag, top, BOX, both[0], q, candidates)
