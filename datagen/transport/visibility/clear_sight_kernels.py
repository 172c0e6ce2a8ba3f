"""The compiled loops behind `clear_sight.py`: separating planes between occluders and hulls of what looks at what.

Two convex bodies do not meet where a plane separates them, whichever plane it is, so long as the extents of both
along its normal are exact: so every test here is one-sided. Gaps must exceed `gap`, or `own_gap` for the plane of a
triangle, along which ray ends are lifted off; both are many roundings of the rays they stand for.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import Vector

FEW = 16
"""Bodies in view of a cell with which it is still worth while to ask for each tile alone."""
SHORTLIST = 8
"""Bodies left over from the whole field of view that are tried tile by tile; with more the rays are asked."""


class Tiles(NamedTuple):
    """Boxes about the FoV points, lifted off the wall: T of them, then one about all.

    Attributes
    ----------
    corners : (T + 1, 8, 3), the first four the front face in order, the others behind them.
    axis : (T + 1, 3) unit normal of the front.
    low, high : (T + 1, 3) bounds along the coordinate axes.
    heights : (T + 1, N, 2) lowest and highest corner above the plane of each body that is a triangle.
    of_pixel : (P,) the tile of each pixel.
    """

    corners: NDArray[np.float64]
    axis: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    heights: NDArray[np.float64]
    of_pixel: NDArray[np.int64]


class Bodies(NamedTuple):
    """What may occlude, as in `occluders.py`: the shell's walls and N convex bodies.

    Attributes
    ----------
    shell : (H, 4) unit normal towards the scene and level of each wall: normal · x − level is a point's height.
    size : (N,) corners a body has: 3, a triangle, or 8, a box.
    corners : (N, 8, 3) metres.
    normal, level : (N, 3), (N,) a triangle's plane; 0 for a box.
    low, high : (N, 3) bounds along the axes.
    """

    shell: NDArray[np.float64]
    size: NDArray[np.int64]
    corners: NDArray[np.float64]
    normal: NDArray[np.float64]
    level: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


class Grid(NamedTuple):
    """Cubes of side `side` from `corner`, `shape` (3,) of them; a cell's number runs fastest along z."""

    corner: NDArray[np.float64]
    side: float
    shape: NDArray[np.int64]


@compiled()
def cells_of(position: Floats, grid: Grid) -> Ints:
    """(n,) the cell each point lies in; one outside counts to the nearest."""
    corner, side, shape = grid
    out = np.empty(len(position), np.int64)
    for i in range(len(position)):
        number = 0
        for k in range(3):
            along = int((position[i, k] - corner[k]) / side)
            number = number * shape[k] + min(max(along, 0), shape[k] - 1)
        out[i] = number
    return out


@compiled(inline="always")
def _height(point: Vector, normal: Floats, base: Floats) -> float:
    return float(
        (point[0] - base[0]) * normal[0] + (point[1] - base[1]) * normal[1] + (point[2] - base[2]) * normal[2]
    )


@compiled()
def _extent(points: Floats, count: int, axis: Vector) -> tuple[float, float]:
    low, high = math.inf, -math.inf
    for i in range(count):
        s = points[i, 0] * axis[0] + points[i, 1] * axis[1] + points[i, 2] * axis[2]
        low, high = min(low, s), max(high, s)
    return low, high


@compiled(inline="always")
def _dot(p: Vector, q: Vector) -> float:
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@compiled(inline="always")
def _cross(p: Vector, q: Vector) -> Vector:
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


@compiled()
def _row(array: Floats, i: int) -> Vector:
    return (array[i, 0], array[i, 1], array[i, 2])


@compiled()
def _from_to(points: Floats, i: int, j: int) -> Vector:
    return (points[j, 0] - points[i, 0], points[j, 1] - points[i, 1], points[j, 2] - points[i, 2])


# One number at a time: numpy's cross product, and rows written at once, take the compiler four times as long.
@compiled()
def _axes_of_hull(hull: Floats) -> Floats:
    """Unit normals of planes that may bound the hull of a tile (points 0 … 7) and a cell (8 … 15): those of the
    axes, of the tile's faces, and for each edge of the tile's front the one that touches the cell."""
    axes = np.zeros((10, 3))
    axes[0, 0] = axes[1, 1] = axes[2, 2] = 1.0
    found, first = 3, int(np.int64(0))
    right, up = _from_to(hull, first, first + 1), _from_to(hull, first, first + 3)
    for candidate in (right, up, _cross(right, up)):
        length = math.sqrt(_dot(candidate, candidate))
        if length > 0.0:
            for k in range(3):
                axes[found, k] = candidate[k] / length
            found += 1
    for i in range(4):
        edge = _from_to(hull, i, (i + 1) % 4)
        best = -math.inf
        for b in range(8, 16):
            x, y, z = _cross(edge, _from_to(hull, i, b))
            length = math.sqrt(x * x + y * y + z * z)
            if length == 0.0:
                continue
            normal = (x / length, y / length, z / length)
            low, high = _extent(hull, len(hull), normal)
            level = _dot(normal, _row(hull, i))
            outside = max(low - level, level - high)
            if outside > best:
                best = outside
                axes[found, 0], axes[found, 1], axes[found, 2] = normal
        found += best > -math.inf
    return axes[:found]


@compiled()
def _in_view(hull: Floats, numbers: NDArray[np.int32], bodies: Bodies, gap: float) -> NDArray[np.int32]:
    """Which of the bodies `numbers` may meet a hull of a tile and a cell (16, 3)."""
    _, count, corners, normal, level, low, high = bodies
    axes = _axes_of_hull(hull)
    extents = np.empty((len(axes), 2))
    for a in range(len(axes)):
        extents[a, 0], extents[a, 1] = _extent(hull, len(hull), _row(axes, a))
    kept, n = np.empty(len(numbers), np.int32), 0
    for f in numbers:
        apart = False
        for k in range(3):
            apart |= low[f, k] > extents[k, 1] + gap or high[f, k] < extents[k, 0] - gap
        for a in range(3, len(axes)):
            if apart:
                break
            least, most = _extent(corners[f], count[f], _row(axes, a))
            apart = least > extents[a, 1] + gap or most < extents[a, 0] - gap
        if not apart and count[f] == 3:
            least, most = _extent(hull, len(hull), _row(normal, f))
            apart = least > level[f] + gap or most < level[f] - gap
        if not apart:
            kept[n] = f
            n += 1
    return kept[:n]


@compiled()
def _put_tile(hull: Floats, tile_corners: Floats, t: int) -> None:
    """Take tile t's corners for the hull's first eight points."""
    for b in range(8):
        for k in range(3):
            hull[b, k] = tile_corners[t, b, k]


@compiled()
def bodies_in_view(
    cells: Ints, grid: Grid, lift: float, tile_corners: Floats, bodies: Bodies, gap: float,
) -> tuple[Ints, NDArray[np.int32], NDArray[np.uint64]]:  # fmt: skip
    """For each of `cells` the bodies that may meet the hull of the cell and the whole field of view, and the tiles
    that none of them stands in front of, whatever the place in the cell.

    Returns how many bodies for each cell, their numbers one cell after another, and one bit for each tile (n,).
    """
    corner, side, shape = grid
    whole = len(tile_corners) - 1
    counts, clear, members = np.zeros(len(cells), np.int64), np.zeros(len(cells), np.uint64), [np.int32(0)]
    hull = np.empty((16, 3))
    index = np.empty(3, np.int64)
    every = np.arange(len(bodies.corners)).astype(np.int32)
    for n in range(len(cells)):
        index[2] = cells[n] % shape[2]
        index[1] = cells[n] // shape[2] % shape[1]
        index[0] = cells[n] // (shape[2] * shape[1])
        for b in range(8):
            for k in range(3):
                bit = (b >> k) & 1
                hull[8 + b, k] = corner[k] + (index[k] + bit) * side + (2 * bit - 1) * lift
        _put_tile(hull, tile_corners, whole)
        seen = _in_view(hull, every, bodies, gap)
        counts[n] = len(seen)
        for f in seen:
            members.append(f)
        for t in range(whole):
            _put_tile(hull, tile_corners, t)
            if len(seen) == 0 or (len(seen) <= FEW and len(_in_view(hull, seen, bodies, gap)) == 0):
                clear[n] |= np.uint64(1) << np.uint64(t)
    return counts, np.array(members[1:], np.int32), clear


@compiled(inline="always")
def _to_corner(apex: Vector, tile_corners: Floats, t: int, i: int) -> Vector:
    return tile_corners[t, i, 0] - apex[0], tile_corners[t, i, 1] - apex[1], tile_corners[t, i, 2] - apex[2]


@compiled()
def _face_pyramid(apex: Vector, t: int, tile_corners: Floats, tile_axis: Floats, gap: float, planes: Floats) -> None:
    """The planes (6, 4) that bound the hull of an apex and tile t: a body is apart where normal · x < limit for all
    of its corners. Four sides over the tile's front, moved out as far as its back reaches; both ends."""
    least, most = math.inf, -math.inf
    for k in range(3):
        planes[4, k], planes[5, k] = tile_axis[t, k], -tile_axis[t, k]
    for i in range(4):
        j, opposite = (i + 1) % 4, (i + 2) % 4
        x, y, z = _cross(_to_corner(apex, tile_corners, t, i), _to_corner(apex, tile_corners, t, j))
        level = x * apex[0] + y * apex[1] + z * apex[2]
        inner = (
            x * tile_corners[t, opposite, 0] + y * tile_corners[t, opposite, 1] + z * tile_corners[t, opposite, 2]
        )  # fmt: skip
        if inner < level:
            x, y, z, level = -x, -y, -z, -level
        lowest = level
        for k in range(8):
            lowest = min(
                lowest, x * tile_corners[t, k, 0] + y * tile_corners[t, k, 1] + z * tile_corners[t, k, 2]
            )  # fmt: skip
        planes[i, 0], planes[i, 1], planes[i, 2] = x, y, z
        planes[i, 3] = lowest - gap * math.sqrt(x * x + y * y + z * z)
    for k in range(9):
        x, y, z = apex if k == 8 else (tile_corners[t, k, 0], tile_corners[t, k, 1], tile_corners[t, k, 2])
        s = x * planes[4, 0] + y * planes[4, 1] + z * planes[4, 2]
        least, most = min(least, s), max(most, s)
    planes[4, 3], planes[5, 3] = least - gap, -most - gap


@compiled()
def _prove_one(
    apex: Vector, t: int, numbers: NDArray[np.int32], begin: int, end: int, allowed: int, left: NDArray[np.int32],
    count: Ints, corners: Floats, normal: Floats, level: Floats, low: Floats, high: Floats, tile_corners: Floats,
    tile_axis: Floats, tile_low: Floats, tile_high: Floats, heights: Floats, gap: float, own_gap: float,
    planes: Floats, thorough: bool,
) -> int:  # fmt: skip
    """Which of the bodies numbers[begin … end] no plane separates from the hull of an apex and tile t.

    They go to `left`; returns how many, or allowed + 1 as soon as there are more.
    """
    remaining, made = 0, False
    for m in range(begin, end):
        f = numbers[m]
        if count[f] == 3:
            h = apex[0] * normal[f, 0] + apex[1] * normal[f, 1] + apex[2] * normal[f, 2] - level[f]
            if min(h, heights[t, f, 0]) >= own_gap or max(h, heights[t, f, 1]) <= -own_gap:
                continue
        apart = False
        for k in range(3):
            apart |= max(apex[k], tile_high[t, k]) < low[f, k] - gap
            apart |= min(apex[k], tile_low[t, k]) > high[f, k] + gap
        if not apart and thorough:
            if not made:
                _face_pyramid(apex, t, tile_corners, tile_axis, gap, planes)
                made = True
            for i in range(6):
                apart = True
                for k in range(count[f]):
                    s = (
                        planes[i, 0] * corners[f, k, 0] + planes[i, 1] * corners[f, k, 1]
                        + planes[i, 2] * corners[f, k, 2]
                    )  # fmt: skip
                    if s >= planes[i, 3]:
                        apart = False
                        break
                if apart:
                    break
        if not apart:
            remaining += 1
            if remaining > allowed:
                break
            left[remaining - 1] = f
    return remaining


@compiled()
def prove(
    position: Floats, normal2: Floats, pixel: Ints, cells: Ints, first: Ints, listed: Ints,
    members: NDArray[np.int32], known: NDArray[np.uint64], bodies: Bodies, tiles: Tiles, lift: float, gap: float,
    own_gap: float, tests: int, thorough: bool,
) -> NDArray[np.uint64]:  # fmt: skip
    """(n,) one bit for each tile that nothing stands in front of, as seen from each vertex.

    pixel : (n,) the one pixel a vertex is joined to, or −1 for all. cells : (n,) cell of each vertex; first, listed,
    members : the bodies in view of each cell; known : the tiles that are clear from all of it. tests : with more
    bodies in view than that a vertex is not tried; thorough : whether the pyramid's sides are tried too, which costs
    as much as some rays.
    """
    # Numba counts references whenever a record of arrays is handed on: what the loops need is taken out here.
    shell, count, corners, normal, level, low, high = bodies
    tile_corners, tile_axis, tile_low, tile_high, heights, of_pixel = tiles
    whole = len(tile_corners) - 1
    every = (np.uint64(1) << np.uint64(whole)) - np.uint64(1)
    out = np.zeros(len(position), np.uint64)
    # As plain zeros these two would have `_prove_one` compiled once more for them.
    start = no_more = int(np.int64(0))
    left, none, planes = np.empty(SHORTLIST, np.int32), np.empty(0, np.int32), np.empty((6, 4))
    for i in range(len(position)):
        apex = (
            position[i, 0] + lift * normal2[i, 0], position[i, 1] + lift * normal2[i, 1],
            position[i, 2] + lift * normal2[i, 2],
        )  # fmt: skip
        inside = True
        for h in range(len(shell)):
            s = apex[0] * shell[h, 0] + apex[1] * shell[h, 1] + apex[2] * shell[h, 2] - shell[h, 3]
            inside = inside and s >= own_gap
        tried = whole if pixel[i] < 0 else of_pixel[pixel[i]]
        if not inside or tried < 0:
            continue
        out[i] = known[cells[i]]
        asked = every if tried == whole else np.uint64(1) << np.uint64(tried)
        if out[i] & asked == asked or listed[cells[i]] > tests:
            continue
        begin, end = first[cells[i]], first[cells[i]] + listed[cells[i]]
        # With one tile to see, one body in the way settles it.
        allowed = 0 if tried < whole or whole == 1 else SHORTLIST
        remaining = _prove_one(
            apex, tried, members, begin, end, allowed, left, count, corners, normal, level, low, high, tile_corners,
            tile_axis, tile_low, tile_high, heights, gap, own_gap, planes, thorough,
        )  # fmt: skip
        if remaining == 0:
            out[i] |= asked
        elif remaining <= allowed:
            for t in range(whole):
                if out[i] >> np.uint64(t) & np.uint64(1):
                    continue
                behind = _prove_one(
                    apex, t, left, start, remaining, no_more, none, count, corners, normal, level, low, high,
                    tile_corners, tile_axis, tile_low, tile_high, heights, gap, own_gap, planes, thorough,
                )  # fmt: skip
                if behind == 0:
                    out[i] |= np.uint64(1) << np.uint64(t)
    return out


@compiled()
def tiles_of_points(
    position: Floats, normal: Floats, weight: Floats, pixel: Ints, tiles_of_pixel: Ints, frames: Floats,
    shell: Floats, lift: float, own_gap: float, slack: float,
) -> NDArray[np.int8]:  # fmt: skip
    """(P, Q) the tile whose box holds each FoV point, lifted, above every wall of the shell; −1 for none.

    frames : (T, 5, 3) of each tile: a corner of its box, three unit axes, its extents along them.
    """
    out = np.full(weight.shape, -1, np.int8)
    for p in range(len(weight)):
        t = tiles_of_pixel[pixel[p]]
        if t < 0:
            continue
        frame = frames[t]
        for q in range(weight.shape[1]):
            if weight[p, q] == 0.0:
                continue
            x = position[p, q, 0] + lift * normal[p, q, 0]
            y = position[p, q, 1] + lift * normal[p, q, 1]
            z = position[p, q, 2] + lift * normal[p, q, 2]
            held = True
            for k in range(3):
                s = _height((x, y, z), frame[1 + k], frame[0])
                held = held and -slack <= s <= frame[4, k] + slack
            for h in range(len(shell)):
                held = held and x * shell[h, 0] + y * shell[h, 1] + z * shell[h, 2] - shell[h, 3] >= own_gap
            if held:
                out[p, q] = t
    return out
