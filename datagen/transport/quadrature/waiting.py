"""What the primary's loop has still to look at: boxes and elements, each with the candidates that may hide it.

A waiting element k is a row of 18 numbers: three vertices, at 0, 5 and 10, each with the light there and the path by
way of it; its area (15); how many times as large as itself the footprint is that it is for (16); and how much of it
may be seen though no ray found anything (17). Its tag says what it is, its number, its footprint and its candidates.
"""

from __future__ import annotations

import numpy as np

from datagen.compiled import compiled
from datagen.transport.brdf import dot
from datagen.transport.geometry import get, less, longest, put

BOX, FRESH, CELL, KEPT = map(np.int64, range(4))
"""What waits to be looked at: a box, an element, an element whose vertices' light is known, one that needs another
look. As np.int64, because numba compiles a function anew for each plain int."""


@compiled()
def push(tag, top, what, at, q, candidates):  # type: ignore[no-untyped-def]
    """A box or element to be looked at next, with the candidates that may hide it; returns how many wait."""
    tag[top, 0], tag[top, 1], tag[top, 2] = what, at, q
    tag[top, 3], tag[top, 4], tag[top, 5] = candidates
    return top + 1


@compiled()
def put_vertex(cell, k, vertex, y, w, path):  # type: ignore[no-untyped-def]
    """Vertex 0, 1 or 2 of waiting element k, and what is known there."""
    put(cell, k, 5 * vertex, y)
    cell[k, 5 * vertex + 3], cell[k, 5 * vertex + 4] = w, path


@compiled()
def vertex_of(cell, k, vertex):  # type: ignore[no-untyped-def]
    """Vertex 0, 1 or 2 of waiting element k, metres."""
    return get(cell, k, 5 * vertex)


@compiled()
def copy_cell(cell, k, to):  # type: ignore[no-untyped-def]
    """Row k once more in row `to`."""
    for j in range(18):
        cell[to, j] = cell[k, j]


@compiled()
def middle_of(cell, k):  # type: ignore[no-untyped-def]
    """The middle of waiting element k, the side that is its longest, and that side's length."""
    a, b, c = vertex_of(cell, k, 0), vertex_of(cell, k, 1), vertex_of(cell, k, 2)
    side, h = longest(a, b, c)
    return ((a[0] + b[0] + c[0]) / 3, (a[1] + b[1] + c[1]) / 3, (a[2] + b[2] + c[2]) / 3), side, h


@compiled()
def highest_above(cell, k, x, n):  # type: ignore[no-untyped-def]
    """How far the highest vertex of waiting element k lies above the plane through x with normal n."""
    a, b, c = less(vertex_of(cell, k, 0), x), less(vertex_of(cell, k, 1), x), less(vertex_of(cell, k, 2), x)
    return max(dot(a, n), dot(b, n), dot(c, n))


@compiled()
def push_halves(room, top, side, vertex, what, at, q, candidates):  # type: ignore[no-untyped-def]
    """Put the halves of the element at `top` in its place; returns how many wait.

    side : its longest side, on which it is cut. vertex : place, light and path there.
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
    """The two boxes within the one at `top`, in its place; returns how many wait."""
    cell[top + 1, 16], cell[top + 1, 17] = cell[top, 16], cell[top, 17]
    top = push(tag, top, BOX, both[1], q, candidates)
    return push(tag, top, BOX, both[0], q, candidates)
