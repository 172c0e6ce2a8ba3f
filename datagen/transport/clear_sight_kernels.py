"""The compiled loops behind `clear_sight.py`: separating planes between occluders and hulls of what looks at what.

Two convex bodies do not meet where a plane separates them, whichever plane it is, so long as the extents of both
along its normal are exact: so every test here is one-sided. Gaps must exceed `gap`, or `own_gap` for the plane of a
triangle, along which ray ends are lifted off; both are many roundings of the rays they stand for.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

SHORTLIST = 8
"""Bodies left over from the whole field of view that are tried tile by tile; with more the rays are asked."""


class Tiles(NamedTuple):
    """Boxes about the FoV points, lifted off the wall: T of them, then one about all.

    corners : (T + 1, 8, 3), the first four the front face in order, the others behind them. axis : (T + 1, 3) unit
        normal of the front. low, high : (T + 1, 3) bounds along the coordinate axes.
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
    """What may occlude, as in `occluders.py`: the shell's walls (H, 4) and N bodies of 3 or 8 (`count`) corners."""

    shell: NDArray[np.float64]
    count: NDArray[np.int64]
    corners: NDArray[np.float64]
    normal: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


class Grid(NamedTuple):
    """Cubes of side `side` from `corner`, `shape` (3,) of them; a cell's number runs fastest along z."""

    corner: NDArray[np.float64]
    side: float
    shape: NDArray[np.int64]


@njit(cache=True)
def cells_of(position, grid):  # type: ignore[no-untyped-def]
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


@njit(cache=True, inline="always")
def _height(point, normal, base):  # type: ignore[no-untyped-def]
    return (
        (point[0] - base[0]) * normal[0] + (point[1] - base[1]) * normal[1] + (point[2] - base[2]) * normal[2]
    )  # fmt: skip


@njit(cache=True)
def _extent(points, count, axis):  # type: ignore[no-untyped-def]
    low, high = math.inf, -math.inf
    for i in range(count):
        s = points[i, 0] * axis[0] + points[i, 1] * axis[1] + points[i, 2] * axis[2]
        low, high = min(low, s), max(high, s)
    return low, high


@njit(cache=True)
def _axes_of_hull(hull):  # type: ignore[no-untyped-def]
    """Unit normals of planes that may bound the hull of a tile (points 0 … 7) and a cell (8 … 15): those of the
    axes, of the tile's faces, and for each edge of the tile's front the one that touches the cell."""
    axes = np.zeros((10, 3))
    axes[0, 0] = axes[1, 1] = axes[2, 2] = 1.0
    found = 3
    right, up = hull[1] - hull[0], hull[3] - hull[0]
    for candidate in (right, up, np.cross(right, up)):
        length = math.sqrt(np.dot(candidate, candidate))
        if length > 0.0:
            axes[found] = candidate / length
            found += 1
    for i in range(4):
        edge = hull[(i + 1) % 4] - hull[i]
        best = -math.inf
        for b in range(8, 16):
            normal = np.cross(edge, hull[b] - hull[i])
            length = math.sqrt(np.dot(normal, normal))
            if length == 0.0:
                continue
            normal /= length
            low, high = _extent(hull, 16, normal)
            level = np.dot(normal, hull[i])
            outside = max(low - level, level - high)
            if outside > best:
                best = outside
                axes[found] = normal
        found += best > -math.inf
    return axes[:found]


@njit(cache=True)
def bodies_in_view(cells, grid, lift, whole, bodies, gap):  # type: ignore[no-untyped-def]
    """For each of `cells` the bodies that may meet the hull of the cell and the whole field of view (8, 3).

    Returns how many for each cell, and their numbers one cell after another.
    """
    corner, side, shape = grid
    counts, members = np.zeros(len(cells), np.int64), [np.int32(0)]
    hull = np.empty((16, 3))
    hull[:8] = whole
    index = np.empty(3, np.int64)
    _, count, corners, normal, low, high = bodies
    for n in range(len(cells)):
        index[2] = cells[n] % shape[2]
        index[1] = cells[n] // shape[2] % shape[1]
        index[0] = cells[n] // (shape[2] * shape[1])
        for b in range(8):
            for k in range(3):
                bit = (b >> k) & 1
                hull[8 + b, k] = corner[k] + (index[k] + bit) * side + (2 * bit - 1) * lift
        axes = _axes_of_hull(hull)
        extents = np.empty((len(axes), 2))
        for a in range(len(axes)):
            extents[a] = _extent(hull, 16, axes[a])
        for f in range(len(corners)):
            apart = False
            for k in range(3):
                apart |= low[f, k] > extents[k, 1] + gap or high[f, k] < extents[k, 0] - gap
            for a in range(3, len(axes)):
                if apart:
                    break
                least, most = _extent(corners[f], count[f], axes[a])
                apart = least > extents[a, 1] + gap or most < extents[a, 0] - gap
            if not apart and count[f] == 3:
                least, most = _extent(hull, 16, normal[f])
                level = _height(corners[f, 0], normal[f], (0.0, 0.0, 0.0))
                apart = least > level + gap or most < level - gap
            if not apart:
                members.append(np.int32(f))
                counts[n] += 1
    return counts, np.array(members[1:], np.int32)


@njit(cache=True, inline="always")
def _apart(apex, f, t, bodies, tiles, gap, own_gap):  # type: ignore[no-untyped-def]
    """Whether a plane separates body f from the hull of an apex and tile t."""
    _, count, corners, normal, low, high = bodies
    tile_corners, tile_axis, tile_low, tile_high, heights, _ = tiles
    if count[f] == 3:
        h = _height(apex, normal[f], corners[f, 0])
        if min(h, heights[t, f, 0]) >= own_gap or max(h, heights[t, f, 1]) <= -own_gap:
            return True
    for k in range(3):
        if max(apex[k], tile_high[t, k]) < low[f, k] - gap or min(apex[k], tile_low[t, k]) > high[f, k] + gap:
            return True
    # The sides of the pyramid over the tile's front, moved out as far as its back reaches.
    for i in range(4):
        a, b, c = tile_corners[t, i], tile_corners[t, (i + 1) % 4], tile_corners[t, (i + 2) % 4]
        p = (a[0] - apex[0], a[1] - apex[1], a[2] - apex[2])
        q = (b[0] - apex[0], b[1] - apex[1], b[2] - apex[2])
        side = (p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0])
        if _height(c, side, apex) < 0.0:
            side = (-side[0], -side[1], -side[2])
        outside = -gap * math.sqrt(side[0] * side[0] + side[1] * side[1] + side[2] * side[2])
        most = -math.inf
        for k in range(count[f]):
            most = max(most, _height(corners[f, k], side, apex))
            if most >= outside:
                break
        if most >= outside:
            continue
        lowest = 0.0
        for k in range(8):
            lowest = min(lowest, _height(tile_corners[t, k], side, apex))
        if most < lowest + outside:
            return True
    # Behind the tile, or behind the apex.
    front, back = tile_corners[t, 0], tile_corners[t, 4]
    axis, depth = tile_axis[t], _height(back, tile_axis[t], front)
    h = _height(apex, axis, front)
    least, most = math.inf, -math.inf
    for k in range(count[f]):
        s = _height(corners[f, k], axis, front)
        least, most = min(least, s), max(most, s)
    return most < min(h, depth) - gap or least > max(h, 0.0) + gap


@njit(cache=True)
def prove(
    position, normal, pixel, cells, first, count, members, bodies, tiles, lift, gap, own_gap,
):  # type: ignore[no-untyped-def]  # fmt: skip
    """(n,) one bit for each tile that nothing stands in front of, as seen from each vertex.

    pixel : (n,) the one pixel a vertex is joined to, or −1 for all. cells : (n,) cell of each vertex; first, count,
    members : the bodies in view of each cell.
    """
    shell, of_pixel = bodies.shell, tiles.of_pixel
    whole = len(tiles.corners) - 1
    every = (np.uint64(1) << np.uint64(whole)) - np.uint64(1)
    out = np.zeros(len(position), np.uint64)
    left = np.empty(SHORTLIST, np.int32)
    for i in range(len(position)):
        apex = (
            position[i, 0] + lift * normal[i, 0], position[i, 1] + lift * normal[i, 1],
            position[i, 2] + lift * normal[i, 2],
        )  # fmt: skip
        inside = True
        for h in range(len(shell)):
            s = apex[0] * shell[h, 0] + apex[1] * shell[h, 1] + apex[2] * shell[h, 2] - shell[h, 3]
            inside = inside and s >= own_gap
        if not inside:
            continue
        begin, end = first[cells[i]], first[cells[i]] + count[cells[i]]
        tried = whole if pixel[i] < 0 else of_pixel[pixel[i]]
        remaining = 0
        # With one tile to see, one body in the way settles it.
        allowed = 0 if tried < whole or whole == 1 else SHORTLIST
        for m in range(begin, end):
            if not _apart(apex, members[m], tried, bodies, tiles, gap, own_gap):
                remaining += 1
                if remaining > allowed:
                    break
                left[remaining - 1] = members[m]
        if remaining == 0:
            out[i] = every if tried == whole else np.uint64(1) << np.uint64(tried)
        elif remaining <= allowed:
            for t in range(whole):
                clear = True
                for m in range(remaining):
                    clear = clear and _apart(apex, left[m], t, bodies, tiles, gap, own_gap)
                if clear:
                    out[i] |= np.uint64(1) << np.uint64(t)
    return out


@njit(cache=True)
def tiles_of_points(position, normal, weight, pixel, tiles_of_pixel, frames, shell, lift, own_gap, slack):  # type: ignore[no-untyped-def]
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
