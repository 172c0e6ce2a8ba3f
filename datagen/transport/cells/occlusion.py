"""Whether anything stands between two points, asked of the hierarchy in double precision."""

from __future__ import annotations

from numba import njit

from datagen.transport.brdf import dot

TOUCHING = 1e-9
"""Share of a line at each end within which a triangle only touches it."""


@njit(cache=True, inline="always")
def less(a, b):  # type: ignore[no-untyped-def]
    """a − b, of vectors."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


@njit(cache=True, inline="always")
def cross(a, b):  # type: ignore[no-untyped-def]
    """The vector product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@njit(cache=True, inline="always")
def _crosses(x, d, triangle, end):  # type: ignore[no-untyped-def]
    """Whether the line x … x + d · end passes through a triangle (Möller & Trumbore, J. Graphics Tools 2 (1997))."""
    a = (triangle[0, 0], triangle[0, 1], triangle[0, 2])
    along_b = less((triangle[1, 0], triangle[1, 1], triangle[1, 2]), a)
    along_c = less((triangle[2, 0], triangle[2, 1], triangle[2, 2]), a)
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
def hidden(x, y, of, top_box, box, children, span, blocks, hides, corners, waiting):  # type: ignore[no-untyped-def]
    """Whether a triangle other than number `of`, on which y lies, stands between the points x and y.

    The other arguments are the fields of a `Hierarchy`, one by one: taken out of it in the loop they cost four times
    as much. waiting : (≥ 256,) int64 scratch.
    """
    d = less(y, x)
    slope = (1.0 / d[0], 1.0 / d[1], 1.0 / d[2])
    waiting[0], top = top_box, 1
    while top > 0:
        top -= 1
        k = waiting[top]
        if not blocks[k]:
            continue
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
        if children[k, 0] >= 0:
            waiting[top], waiting[top + 1] = children[k, 0], children[k, 1]
            top += 2
            continue
        for f in range(span[k, 0], span[k, 1]):
            # Of triangles that lie on each other the last one is seen, so that their light counts once.
            end = 1.0 + TOUCHING if f > of else 1.0 - TOUCHING
            if f != of and hides[f] and _crosses(x, d, corners[f], end):
                return True
    return False
