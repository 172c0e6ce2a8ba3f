"""Occlusion between two points, or between a point and all of a triangle, in double precision.

Compiled loops call these functions for one line at a time; they search a BVH over the triangles that can hide
anything (`occluder_rows.py`).
"""

from __future__ import annotations

import numpy as np

from datagen.compiled import compiled
from datagen.transport.brdf import dot
from datagen.transport.geometry import above, cross, get, subtract
from datagen.transport.visibility.occluder_rows import FIRST, FLAT, HEAD, LINK, NORMAL, NUMBER, C

TINY = 1e-300
"""A number to divide by in place of zero."""
TOUCHING = 1e-9
"""Fraction of a line, at each end, in which a triangle only touches the line and hides nothing. Half of it is nearer
to the rounding error of coordinates."""
MOST, RING = 16, 63
"""Number of candidates up to which boxes among them are opened (half of it gives shorter lists of larger boxes, which
prove less); and the mask of indices into the ring of candidates not yet tested, whose 64 entries hold more than
`MOST` candidates and what an opened box adds."""
SUSPECT, LISTED = 255, 256
"""Places in the array that `lists` returns: entries 0 … 254 are scratch for candidates not yet tested; `SUSPECT` is
the triangle that hid something the last time, or 0; lists of candidates begin at `LISTED`. A candidate is a row of
`Occluders.row`: k for a box, −k for a triangle."""


@compiled()
def lists(room):  # type: ignore[no-untyped-def]
    """An array for lists of possible occluders, with space for `room` candidates after `LISTED`.

    The first two candidates are the box that holds all occluders: one for each leg of a path.
    """
    listed = np.empty(LISTED + max(room, 2), np.int64)
    listed[SUSPECT] = listed[LISTED] = listed[LISTED + 1] = 0
    return listed


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
    """Row of a triangle that hides y from x, 0 if none does.

    x, y : points, metres. of : index of the triangle on which y lies, which does not hide it. row : `Occluders.row`.
    listed : array of `lists`, of which the candidates first … last − 1 are tested.
    """
    if first >= last:
        return 0
    # What hid the last point often hides this one, which saves the search.
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
                    listed[SUSPECT] = -k
                    return -k
            elif _meets(x, per, k, row):
                top = _opened(listed, top, row, k)
    return 0


@compiled(forceinline=True)
def _meets(x, per, k, row):  # type: ignore[no-untyped-def]
    """Whether a line from x meets box k. per : the inverse of each component of the vector along the line."""
    a, b = (row[k, 0] - x[0]) * per[0], (row[k, 3] - x[0]) * per[0]
    enter, leave = min(a, b), max(a, b)
    a, b = (row[k, 1] - x[1]) * per[1], (row[k, 4] - x[1]) * per[1]
    enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    a, b = (row[k, 2] - x[2]) * per[2], (row[k, 5] - x[2]) * per[2]
    enter, leave = max(enter, min(a, b)), min(leave, max(a, b))
    # The box counts as slightly larger than it is: rounding must not lose a triangle that lies in a face of the box.
    return max(enter, 0.0) <= min(leave, 1.0 + TOUCHING) * (1.0 + 1e-12)


@compiled(forceinline=True)
def _stands_between(x, d, of, f, row):  # type: ignore[no-untyped-def]
    """Whether occluder f hides x + d on triangle `of` from x."""
    number = row[f, NUMBER]
    if number == of:
        return False
    # Of triangles that lie in the same place the last one is seen, so that their light counts once.
    return _crosses(x, d, row, f, 1.0 + TOUCHING if number > of else 1.0 - TOUCHING)


@compiled()
def _opened(listed, top, row, k):  # type: ignore[no-untyped-def]
    """Append the two boxes or the triangles within box k to the first `top` entries of `listed`; returns the new
    number of entries."""
    link = int(row[k, LINK])
    if link > 0:
        listed[top], listed[top + 1] = link, int(row[k, FIRST])
        return top + 2
    first = int(row[k, FIRST])
    for j in range(-link):
        listed[top + j] = -(first + 2 * j)
    return top - link


@compiled()
def shaded(x, a, b, c, of, first, last, row, listed):  # type: ignore[no-untyped-def]
    """Whether it is proven that x sees nothing of the triangle a, b, c, a part of triangle `of`: one of the
    candidates first … last − 1 hides all three corners. False proves nothing."""
    f = hidden(x, a, of, first, last, row, listed)
    if f == 0:
        return False
    # A triangle is convex: if it hides the corners, it hides all points between them.
    return _stands_between(x, subtract(b, x), of, f, row) and _stands_between(x, subtract(c, x), of, f, row)


@compiled()
def narrowed(x, a, b, c, of, first, last, free, row, listed):  # type: ignore[no-untyped-def]
    """End of the list, written into `listed` from index `free` on, of those candidates first … last − 1 that may hide
    some point of the triangle a, b, c from x. If that list is empty, it is proven that x sees all of the triangle.

    The triangle a, b, c is a part of triangle `of`. Boxes are replaced by what they hold while candidates are few.

    A candidate cannot meet the pyramid over a, b, c with its tip in x if it lies beyond one side of the pyramid, or
    if all of the pyramid lies on one side of the candidate's plane.
    """
    if first >= last:
        return free
    flat = row[HEAD, FLAT]
    # Normals of the pyramid's base and of its three sides, all turned to the inside.
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
    # Entries head … tail − 1 of a ring at the beginning of `listed` are the candidates not yet tested.
    for i in range(last - first):
        listed[i] = listed[first + i]
    head, tail, end = 0, last - first, free
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
                # It lies behind the triangle or in its plane; in the plane it hides the triangle if its index is
                # higher, as in `_stands_between`.
                upward = (-base[0], -base[1], -base[2])
                if not (number > of and _beyond(upward, a, p, q, r, near0)):
                    continue
            else:
                # All of the pyramid lies on one side of the candidate's plane.
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
            # While candidates are few, a box is replaced by what it holds: more of that can be left out.
            link, inside = int(row[k, LINK]), int(row[k, FIRST])
            if link > 0:
                listed[tail & RING], listed[(tail + 1) & RING] = link, inside
                tail += 2
            else:
                for j in range(-link):
                    listed[(tail + j) & RING] = -(inside + 2 * j)
                tail -= link
            continue
        listed[end] = k
        end += 1
    return end


@compiled()
def _beyond(n, x, p, q, r, near):  # type: ignore[no-untyped-def]
    """Whether the points p, q and r lie outside the plane through x whose normal n points inwards, or in the plane.

    near : height, in units of n, up to which a point lies in the plane.
    """
    return dot(n, subtract(p, x)) <= near and dot(n, subtract(q, x)) <= near and dot(n, subtract(r, x)) <= near


@compiled()
def _heights(n, p, x, a, b, c):  # type: ignore[no-untyped-def]
    """Least and greatest height of the points x, a, b and c above the plane through p with unit normal n, metres."""
    at_x, at_a, at_b, at_c = (
        dot(n, subtract(x, p)),
        dot(n, subtract(a, p)),
        dot(n, subtract(b, p)),
        dot(n, subtract(c, p)),
    )
    return min(at_x, at_a, at_b, at_c), max(at_x, at_a, at_b, at_c)


@compiled()
def _margin(n, flat):  # type: ignore[no-untyped-def]
    """The height `flat`, metres, in units of the vector n, which is not of unit length."""
    length = np.sqrt(dot(n, n))
    # Needles have sides without a direction: comparisons with NaN are False, so that such a side proves nothing.
    return flat * length if length > 0.0 else np.nan
