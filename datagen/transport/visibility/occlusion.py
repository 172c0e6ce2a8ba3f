"""What stands between two points, or between a point and all of a triangle, in double precision.

It is asked of a BVH over the triangles that can hide anything (`occluder_rows.py`), answers the same on
every processor, and in compiled loops, one line at a time.
"""

from __future__ import annotations

import numpy as np

from datagen.compiled import compiled
from datagen.transport.brdf import dot
from datagen.transport.geometry import above, cross, get, subtract
from datagen.transport.visibility.occluder_rows import (
    FIRST,
    FLAT,
    HEAD,
    LINK,
    NORMAL,
    NUMBER,
    C,
)

TINY = 1e-300
TOUCHING = 1e-9
"""Share of a line at each end within which a triangle only touches it."""
MOST, RING = 16, 63
"""Candidates up to which boxes are opened, and the mask of a ring that holds those still to be looked at."""
SUSPECT, LISTED = 255, 256
"""In the lists that are handed down: what is to be looked at, which is scratch, comes first; then the triangle that
hid something the last time, or 0; and from `LISTED` on candidates: rows, of triangles less than 0, their −k."""


@compiled()
def lists(room):  # type: ignore[no-untyped-def]
    """The lists, with room for so many candidates, of which the first two are boxes that hold all."""
    found = np.empty(LISTED + max(room, 2), np.int64)
    found[SUSPECT] = found[LISTED] = found[LISTED + 1] = 0
    return found


@compiled(forceinline=True)
def _crosses(x, d, row, f, end):  # type: ignore[no-untyped-def]
    """Whether the line x … x + d · end passes through triangle f (Möller & Trumbore, J. Graphics Tools 2 (1997))."""
    a = get(row, f, 0)
    along_b, along_c = subtract(get(row, f, 3), a), subtract(get(row, f + 1, C), a)
    p = cross(d, along_c)
    volume = dot(along_b, p)
    if volume == 0.0:
        return False
    inverse, s = 1.0 / volume, subtract(x, a)
    u = dot(s, p) * inverse
    if u < 0.0 or u > 1.0:
        return False
    q = cross(s, along_b)
    v = dot(d, q) * inverse
    if v < 0.0 or u + v > 1.0:
        return False
    return TOUCHING < dot(along_c, q) * inverse < end


@compiled()
def hidden(x, y, of, first, last, row, listed):  # type: ignore[no-untyped-def]
    """The row of a triangle other than number `of`, on which y lies, that stands between the points x and y; 0 for
    none.

    row : that of `Occluders`. listed : `lists`, of whose candidates first … last are asked.
    """
    if first >= last:
        return 0
    d, suspect = subtract(y, x), listed[SUSPECT]
    if suspect > 0 and _stands_between(x, d, of, suspect, row):
        return suspect
    per = (1.0 / (d[0] or TINY), 1.0 / (d[1] or TINY), 1.0 / (d[2] or TINY))
    for i in range(first, last):
        listed[0], top = listed[i], 1
        while top > 0:
            top -= 1
            k = listed[top]
            if k < 0:
                if _stands_between(x, d, of, -k, row):
                    # What hides one point often hides the next: it is looked at first then.
                    listed[SUSPECT] = -k
                    return -k
            elif _meets(x, per, k, row):
                top = _opened(listed, top, row, k)
    return 0


@compiled(forceinline=True)
def _meets(x, per, k, row):  # type: ignore[no-untyped-def]
    """Whether a line from x meets box k; per : 1 over each component of the line."""
    a, b = (row[k, 0] - x[0]) * per[0], (row[k, 3] - x[0]) * per[0]
    enter, leave = min(a, b), max(a, b)
    a, b = (row[k, 1] - x[1]) * per[1], (row[k, 4] - x[1]) * per[1]
    enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    a, b = (row[k, 2] - x[2]) * per[2], (row[k, 5] - x[2]) * per[2]
    enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    # A box is taken as a little larger than it is, for a triangle in its plane must not be lost to rounding.
    return max(enter, 0.0) <= min(leave, 1.0 + TOUCHING) * (1.0 + 1e-12)


@compiled(forceinline=True)
def _stands_between(x, d, of, f, row):  # type: ignore[no-untyped-def]
    """Whether occluder f hides x + d on triangle `of` from x."""
    number = row[f, NUMBER]
    if number == of:
        return False
    # Of triangles that lie on each other the last one is seen, so that their light counts once.
    return _crosses(x, d, row, f, 1.0 + TOUCHING if number > of else 1.0 - TOUCHING)


@compiled()
def _opened(listed, top, row, k):  # type: ignore[no-untyped-def]
    """Put what box k holds behind the first `top` entries; returns how many there are then."""
    one = int(row[k, LINK])
    if one > 0:
        listed[top], listed[top + 1] = one, int(row[k, FIRST])
        return top + 2
    first = int(row[k, FIRST])
    for j in range(-one):
        listed[top + j] = -(first + 2 * j)
    return top - one


@compiled()
def shaded(x, a, b, c, of, first, last, row, listed):  # type: ignore[no-untyped-def]
    """Whether it is proven that x sees nothing of the triangle a, b, c on triangle `of`: one of the candidates
    first … last stands before all three corners, and so before all between them. False proves nothing."""
    before = hidden(x, a, of, first, last, row, listed)
    if before == 0:
        return False
    return _stands_between(x, subtract(b, x), of, before, row) and _stands_between(x, subtract(c, x), of, before, row)


@compiled()
def _waiting(listed, first, last):  # type: ignore[no-untyped-def]
    """Put candidates first … last into the ring of what is to be looked at; returns how many."""
    for i in range(last - first):
        listed[i] = listed[first + i]
    return last - first


@compiled()
def narrowed(x, a, b, c, of, first, last, free, row, listed):  # type: ignore[no-untyped-def]
    """Write from `free` on those of the candidates first … last that may stand between x and some point of the
    triangle a, b, c on triangle `of`, with boxes opened while they are few; returns the end of what is written. Where
    none is left, it is proven that x sees all of the triangle.

    The pyramid over the triangle with its tip in x is free of every triangle that lies beyond one of its sides, or
    has all of the pyramid on one side of itself.
    """
    if first >= last:
        return free
    flat = row[HEAD, FLAT]
    base = cross(subtract(b, a), subtract(c, a))
    if dot(base, subtract(x, a)) < 0.0:
        base = (-base[0], -base[1], -base[2])
    one, two, three = (
        cross(subtract(a, x), subtract(b, x)),
        cross(subtract(b, x), subtract(c, x)),
        cross(subtract(c, x), subtract(a, x)),
    )
    if dot(one, subtract(c, x)) < 0.0:
        one, two, three = (-one[0], -one[1], -one[2]), (-two[0], -two[1], -two[2]), (-three[0], -three[1], -three[2])
    near1, near2, near3, near0 = _margin(one, flat), _margin(two, flat), _margin(three, flat), _margin(base, flat)
    head, tail, end = 0, _waiting(listed, first, last), free
    while head < tail:
        k = listed[head & RING]
        head += 1
        if k < 0:
            f = -k
            number = row[f, NUMBER]
            if number == of:
                continue
            p, q, r = get(row, f, 0), get(row, f, 3), get(row, f + 1, C)
            if (
                _beyond(one, x, p, q, r, near1)
                or _beyond(two, x, p, q, r, near2)
                or _beyond(three, x, p, q, r, near3)
            ):
                continue
            if _beyond(base, a, p, q, r, near0):
                # One that lies on the triangle itself, and is seen in its place, hides it.
                upward = (-base[0], -base[1], -base[2])
                if not (number > of and _beyond(upward, a, p, q, r, near0)):
                    continue
            else:
                low, high = _heights(get(row, f + 1, NORMAL), p, x, a, b, c)
                if high <= flat or low >= -flat:
                    continue
        elif (
            above(row, k, x, one) <= near1
            or above(row, k, x, two) <= near2
            or above(row, k, x, three) <= near3
            or above(row, k, a, base) <= -near0
        ):
            continue
        elif end - free + tail - head < MOST:
            one_of, inside = int(row[k, LINK]), int(row[k, FIRST])
            if one_of > 0:
                listed[tail & RING], listed[(tail + 1) & RING] = one_of, inside
                tail += 2
            else:
                for j in range(-one_of):
                    listed[(tail + j) & RING] = -(inside + 2 * j)
                tail -= one_of
            continue
        listed[end] = k
        end += 1
    return end


@compiled()
def _beyond(n, x, p, q, r, near):  # type: ignore[no-untyped-def]
    """Whether three points lie on the outer side of the plane through x whose normal n points inwards, or on it."""
    return dot(n, subtract(p, x)) <= near and dot(n, subtract(q, x)) <= near and dot(n, subtract(r, x)) <= near


@compiled()
def _heights(n, p, x, a, b, c):  # type: ignore[no-untyped-def]
    """Least and greatest height of four points above the plane through p."""
    at_x, at_a, at_b, at_c = (
        dot(n, subtract(x, p)),
        dot(n, subtract(a, p)),
        dot(n, subtract(b, p)),
        dot(n, subtract(c, p)),
    )
    return min(at_x, at_a, at_b, at_c), max(at_x, at_a, at_b, at_c)


@compiled()
def _margin(n, flat):  # type: ignore[no-untyped-def]
    """What a height of `flat` is along n, no unit vector; no number, so that nothing is proven, if that is zero."""
    length = np.sqrt(dot(n, n))
    return flat * length if length > 0.0 else np.nan
