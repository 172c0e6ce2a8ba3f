"""Closed surfaces: what they keep from being seen, and what of them need not be asked.

From a point outside a closed surface whose triangles do not pass through each other nothing is seen of their inner
sides. A line from there that meets the surface enters it first, through a triangle that turns its outer side to the
point; and to be outside again, where it ends on an outer side of the surface itself, it has left it, through one that
turns its inner side. So of a surface's triangles those with one side towards the point suffice to tell what it hides:
the outer for all else, the inner for its own outer side, near which there is hardly any of them.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import dot
from datagen.transport.geometry import corner, cross, get, less

NONE, SEVERAL = -1, -2
"""In place of a solid's number: none, and not one alone."""
THIN = 1e-12
"""Volume, relative to the cube of the scene's size, up to which a surface bounds nothing."""
MOST_OPEN, MOST_CONVEX = 1024, 1024
"""Open sides up to which it is asked what others they meet on their way; triangles of a solid up to which it is asked
whether it is convex."""


def closed(triangles: Ints, vertices: Floats, part: Ints, near: float) -> tuple[Ints, Bools]:
    """(F,) which closed surface of one part (F,) triangles (F, 3) belong to, or `NONE`; and (S,) whether each is
    inside out.

    Where they are not closed as they are, vertices (V, 3) within `near` of each other, metres, are taken as one, and
    sides may meet several others on their way.
    """
    face = np.repeat(np.arange(len(triangles)), 3)
    solid = _closed(face, *_sides(triangles), part)
    rest = np.flatnonzero(solid < 0)
    if len(rest):
        merged, place = _merged(triangles[rest], vertices, part[rest], near)
        more = _closed(
            *_divided(np.repeat(np.arange(len(rest)), 3), *_sides(merged), part[rest], place, near), part[rest]
        )
        solid[rest] = np.where(more >= 0, more + solid.max() + 1, NONE)
    on, count = solid >= 0, int(solid.max(initial=NONE)) + 1
    a, b, c = (vertices[triangles[on, j]] - vertices[0] for j in range(3))
    volume = np.bincount(solid[on], np.einsum("fi,fi->f", a, np.cross(b, c)), count) / 6
    thin = np.abs(volume) <= THIN * float(np.ptp(vertices, axis=0).max()) ** 3
    number = np.append(np.where(thin, NONE, np.cumsum(~thin) - 1), NONE)
    return number[solid], volume[~thin] < 0.0


def _sides(triangles: Ints) -> tuple[Ints, Ints]:
    """Where the sides of triangles start and end."""
    return triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()


def _met(start: Ints, end: Ints) -> tuple[Ints, Bools]:
    """(n, 2) the sides that are passed once in either direction, by whom; and which sides are not."""
    side = np.minimum(start, end) * (int(max(start.max(), end.max())) + 1) + np.maximum(start, end)
    order = np.argsort(side, kind="stable")
    first = np.flatnonzero(np.diff(side[order], prepend=-1))
    first = first[np.diff(first, append=len(order)) == 2]
    pairs = np.column_stack([order[first], order[first + 1]])
    pairs = pairs[start[pairs[:, 0]] == end[pairs[:, 1]]]
    open_ = np.ones(len(side), np.bool_)
    open_[pairs] = False
    return pairs, open_


def _closed(face: Ints, start: Ints, end: Ints, part: Ints) -> Ints:
    """(F,) which surface of one part, that has no open side, or `NONE`. face, start, end : of all sides."""
    count, (pairs, open_) = len(part), _met(start, end)
    one, other = face[pairs].T
    links = coo_array((np.ones(len(pairs), np.int8), (one, other)), (count, count))
    groups, group = connected_components(links, directed=False)
    broken = np.zeros(groups, np.bool_)
    broken[group[face[open_]]] = True
    broken[group[one[part[one] != part[other]]]] = True
    return np.asarray(np.where(broken, NONE, np.cumsum(~broken) - 1)[group])


def _divided(face: Ints, start: Ints, end: Ints, part: Ints, place: Floats, near: float) -> tuple[Ints, Ints, Ints]:
    """Sides, with the open ones cut at all ends of open ones of their part that lie on them; as they are if these are
    too many. place : (V, 3) metres."""
    found = np.flatnonzero(_met(start, end)[1])
    if not 0 < len(found) <= MOST_OPEN:
        return face, start, end
    ends, first = np.unique(np.concatenate([start[found], end[found]]), return_index=True)
    owner = part[np.tile(face[found], 2)][first]
    a, d = place[start[found]], place[end[found]] - place[start[found]]
    length = np.maximum(np.linalg.norm(d, axis=1), near)
    apart = place[ends] - a[:, None]
    along = np.einsum("svi,si->sv", apart, d / length[:, None])
    off = np.linalg.norm(apart - (along / length[:, None])[..., None] * d[:, None], axis=2)
    on = (off <= near) & (along > near) & (along < length[:, None] - near) & (part[face[found], None] == owner)
    side, vertex = np.nonzero(on)
    order = np.lexsort((along[side, vertex], side))
    side, vertex = side[order], ends[vertex[order]]
    # From its start to the first of them, from each to the next, from the last to its end.
    times = 1 + np.bincount(side, minlength=len(found))
    starts, stops = np.repeat(start[found], times), np.repeat(end[found], times)
    at = np.arange(len(side)) + side
    starts[at + 1], stops[at] = vertex, vertex
    kept = np.delete(np.arange(len(face)), found)
    return (
        np.concatenate([face[kept], np.repeat(face[found], times)]), np.concatenate([start[kept], starts]),
        np.concatenate([end[kept], stops]),
    )  # fmt: skip


def _merged(triangles: Ints, vertices: Floats, part: Ints, near: float) -> tuple[Ints, Floats]:
    """Triangles with one number for all vertices of a part that are in one place, and where (V, 3)."""
    used, local = np.unique(triangles, return_inverse=True)
    owner = np.zeros(len(used), np.int64)
    owner[local.reshape(-1)] = np.repeat(part, 3)
    places = np.column_stack([np.rint(vertices[used] / near).astype(np.int64), owner])
    _, one, number = np.unique(places, axis=0, return_index=True, return_inverse=True)
    return np.asarray(number.reshape(-1)[local].reshape(triangles.shape)), vertices[used[one]]


def bounds(solid: Ints, corners: Floats, near: float) -> Floats:
    """(S, 6) lowest and highest corner of each solid, `near` beyond it."""
    on = np.flatnonzero(solid >= 0)
    count = int(solid.max(initial=NONE)) + 1
    box = np.repeat([[np.inf, -np.inf]], count, axis=0).repeat(3, axis=1)
    np.minimum.at(box[:, :3], solid[on], corners[on].min(axis=1) - near)
    np.maximum.at(box[:, 3:], solid[on], corners[on].max(axis=1) + near)
    return box


def convex(solid: Ints, corners: Floats, normal: Floats, near: float) -> Bools:
    """(S,) which solids have nothing of their surface beyond the plane of any of their triangles. Of those of many
    triangles it is not asked."""
    found = np.zeros(int(solid.max(initial=NONE)) + 1, np.bool_)
    order = np.argsort(solid, kind="stable")
    for faces in np.split(order, np.flatnonzero(np.diff(solid[order])) + 1):
        if solid[faces[0]] >= 0 and len(faces) <= MOST_CONVEX:
            places = np.einsum("fi,pi->fp", normal[faces], corners[faces].reshape(-1, 3))
            own = np.einsum("fi,fi->f", normal[faces], corners[faces, 0])
            found[solid[faces[0]]] = (places.max(axis=1) - own).max() <= near
    return found


@compiled()
def pierced(corners, normal, box, children, span, roots, solid, near, found):  # type: ignore[no-untyped-def]
    """Mark in found (S,) the solids of which two triangles pass through each other, or lie on each other."""
    waiting, low, high = np.empty(256, np.int64), np.empty(3), np.empty(3)
    for root in roots:
        for f in range(span[root, 0], span[root, 1]):
            s = solid[f]
            if s < 0 or found[s]:
                continue
            for j in range(3):
                low[j] = min(corners[f, 0, j], corners[f, 1, j], corners[f, 2, j])
                high[j] = max(corners[f, 0, j], corners[f, 1, j], corners[f, 2, j])
            waiting[0], top = root, 1
            while top > 0 and not found[s]:
                top -= 1
                k = waiting[top]
                apart = span[k, 1] <= f + 1
                for j in range(3):
                    apart |= box[k, j] > high[j] or box[k, 3 + j] < low[j]
                if apart:
                    continue
                if children[k, 0] >= 0:
                    waiting[top], waiting[top + 1] = children[k, 0], children[k, 1]
                    top += 2
                    continue
                for g in range(max(span[k, 0], f + 1), span[k, 1]):
                    if solid[g] == s and _meet(corners, normal, f, g, near):
                        found[s] = True


@compiled()
def _meet(corners, normal, f, g, near):  # type: ignore[no-untyped-def]
    """Whether triangles f and g have more in common than they touch: no plane by a side of theirs parts them."""
    least_f, most_f = _along(corners, f, g, get(normal, g, 0))
    least_g, most_g = _along(corners, g, f, get(normal, f, 0))
    in_plane = max(-least_f, most_f, -least_g, most_g) <= near
    if not in_plane and (least_f >= -near or most_f <= near or least_g >= -near or most_g <= near):
        return False
    if apart_in_plane(corners, normal, f, g, near):
        return False
    if in_plane:
        return True
    for i in range(3):
        for j in range(3):
            if _apart(corners, f, g, cross(_side(corners, f, i), _side(corners, g, j)), near):
                return False
    return True


@compiled()
def apart_in_plane(corners, normal, f, g, near):  # type: ignore[no-untyped-def]
    """Whether a side of triangle f or g has the other wholly beyond it, but for touching."""
    for i in range(3):
        out_f, out_g = cross(_side(corners, f, i), get(normal, f, 0)), cross(_side(corners, g, i), get(normal, g, 0))
        if _apart(corners, f, g, out_f, near) or _apart(corners, f, g, out_g, near):
            return True
    return False


@compiled()
def _side(corners, f, i):  # type: ignore[no-untyped-def]
    return less(corner(corners, f, (i + 1) % 3), corner(corners, f, i))


@compiled()
def _along(corners, f, g, axis):  # type: ignore[no-untyped-def]
    """Least and greatest place of triangle f along an axis, from the first corner of g."""
    a = corner(corners, g, 0)
    one, two, three = (
        dot(less(corner(corners, f, 0), a), axis), dot(less(corner(corners, f, 1), a), axis),
        dot(less(corner(corners, f, 2), a), axis),
    )  # fmt: skip
    return min(one, two, three), max(one, two, three)


@compiled()
def _apart(corners, f, g, axis, near):  # type: ignore[no-untyped-def]
    """Whether two triangles are beyond each other along an axis, but for touching."""
    length = math.sqrt(dot(axis, axis))
    least_f, most_f = _along(corners, f, g, axis)
    least_g, most_g = _along(corners, g, g, axis)
    return length > 0.0 and (most_f <= least_g + near * length or most_g <= least_f + near * length)


@compiled()
def of_boxes(solid, children, span):  # type: ignore[no-untyped-def]
    """(N,) the solid that all triangles of a box belong to; `NONE` if none does to any, else `SEVERAL`."""
    found = np.full(len(children), NONE)
    for k in range(len(children) - 1, -1, -1):
        if children[k, 0] >= 0:
            one, other = found[children[k, 0]], found[children[k, 1]]
            found[k] = one if one == other else SEVERAL
        elif span[k, 1] > span[k, 0]:
            found[k] = solid[span[k, 0]]
            for f in range(span[k, 0], span[k, 1]):
                found[k] = found[k] if solid[f] == found[k] else SEVERAL
    return found


@compiled()
def encloses(solid_box, s, x):  # type: ignore[no-untyped-def]
    """Whether solid s may enclose x: its box does."""
    inside = True
    for j in range(3):
        inside &= solid_box[s, j] <= x[j] and x[j] <= solid_box[s, 3 + j]
    return inside


@compiled()
def seen_from_outside(solid_box, s, x):  # type: ignore[no-untyped-def]
    """Number s of a solid, or what stands in its place; `SEVERAL` where x may be within it."""
    return SEVERAL if s >= 0 and encloses(solid_box, s, x) else s


@compiled()
def inner_side(x, n, corners, f, solid, solid_box):  # type: ignore[no-untyped-def]
    """Whether triangle f turns the inner side of a solid to x, which lies outside it and so cannot see it."""
    s = solid[f]
    return s >= 0 and dot(less(x, corner(corners, f, 0)), n) < 0.0 and not encloses(solid_box, s, x)


@compiled()
def side_turned(d, radius, axis, cosine, sine):  # type: ignore[no-untyped-def]
    """Whether all surface within a ball turns its outer side to a point (1), or its inner one (−1); 0 if it may not.

    d : from the ball's middle to the point. cosine, sine : of the largest angle of a normal with the axis.
    """
    free = dot(d, d) - radius * radius
    if not (free > 0.0 and cosine > 0.0):
        return 0
    tangent, across = math.sqrt(free), dot(d, axis)
    # The cone of the normals, widened by that of the lines to the ball, on one side of a right angle.
    if cosine * tangent <= sine * radius or abs(across) <= radius * cosine + tangent * sine:
        return 0
    return 1 if across > 0.0 else -1
