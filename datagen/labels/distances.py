"""Exact distances from the points of a grid to triangles.

The grid is halved into blocks until only few triangles can be the nearest in a block. One point q of another triangle
rules a triangle T out for a block: in

    d(x, T)² − |x − q|² = min over y in T of |y|² − |q|² − 2 x·(y − q)

each term of the minimum is linear in x, so the minimum is concave in x and takes its least value over the block at
one of the eight corners. If it is ≥ 0 at all of them, no point of the block is nearer to T than to q.
"""

from __future__ import annotations

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints

_FEW = 64
"""Most points of a block that is not halved further: its remaining triangles are tried one by one. Halved, more time
goes into halving than into these trials."""
_SLACK = 1e-12
"""Relative slack of the squared distance to q. A triangle that shares q is as near as q, and rounding may make it
seem nearer; with the slack it is ruled out. Halved, it is still far above rounding."""


def grid_distances(start: Floats, step: Floats, shape: tuple[int, int, int], corners: Floats) -> Floats:
    """(n₀, n₁, n₂) metres from each point of a grid to the nearest of the triangles `corners` (F, 3, 3), F ≥ 1.

    The points are start + step · (i, j, k), i < n₀, j < n₁, k < n₂ (`shape`); steps may be negative.
    """
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    uu, uv, vv = (np.einsum("fi,fi->f", *pair) for pair in ((u, u), (u, v), (v, v)))
    squares = (uu, vv, uu - 2 * uv + vv, uu * vv - uv * uv)
    inverse = (np.divide(1.0, square, out=np.zeros(len(u)), where=square > 0) for square in squares)
    triangles = np.concatenate([corners[:, 0], u, v, np.stack([uu, uv, vv, *inverse], axis=1)], axis=1)
    # Each halving may keep all triangles, and a side of n points is halved bit_length(n) times at most.
    stack = np.tile(np.arange(len(u)), 3 + sum(int(n).bit_length() for n in shape))
    return np.sqrt(_squares_by_blocks(start, step, np.array(shape), triangles, stack).reshape(shape))


@compiled()
def _squares_by_blocks(start: Floats, step: Floats, shape: Ints, triangles: Floats, stack: Ints) -> Floats:
    """(n₀ n₁ n₂,) squared distances.

    triangles : (F, 16) a corner, the edges u and v from it, u·u, u·v, v·v, and the inverse squares of the three edges
        and of the parallelogram's area.
    stack : numbers of all triangles, and room for as many again at every halving.
    """
    squares = np.empty(shape[0] * shape[1] * shape[2])
    # A block: its first and its last point, and the range of `stack` that holds its triangles.
    blocks = np.empty((len(stack) // len(triangles), 8), np.int64)
    block = np.empty(8, np.int64)
    points = np.empty((3, _FEW))
    nearest = np.empty(_FEW)
    table = np.empty((len(triangles), 9))
    for k in range(3):
        blocks[0, k], blocks[0, 3 + k] = 0, shape[k] - 1
    blocks[0, 6], blocks[0, 7] = 0, len(triangles)
    waiting = 1
    while waiting > 0:
        # Blocks are taken depth first, so entries of `stack` beyond this block's triangles belong to finished blocks.
        waiting -= 1
        for k in range(8):
            block[k] = blocks[waiting, k]
        for p in range(9):
            for k in range(3):
                # The eight corners, and last the centre.
                place = 0.5 * (block[k] + block[3 + k]) if p == 8 else float(block[k + 3 * ((p >> k) & 1)])
                points[k, p] = start[k] + step[k] * place
        last = _keep_nearest(triangles, stack, block[6], block[7], points, table)
        longest, size = 0, 1
        for k in range(3):
            size *= block[3 + k] - block[k] + 1
            longest = k if block[3 + k] - block[k] > block[3 + longest] - block[longest] else longest
        # A large block is halved across its longest side, and both halves inherit the triangles that were kept.
        if size > _FEW:
            middle = (block[longest] + block[3 + longest]) // 2
            for upper in range(2):
                for k in range(6):
                    blocks[waiting, k] = block[k]
                blocks[waiting, longest if upper else longest + 3] = middle + upper
                blocks[waiting, 6], blocks[waiting, 7] = block[7], last
                waiting += 1
            continue
        rows, columns = block[4] - block[1] + 1, block[5] - block[2] + 1
        for p in range(size):
            points[0, p] = start[0] + step[0] * (block[0] + p // (rows * columns))
            points[1, p] = start[1] + step[1] * (block[1] + p // columns % rows)
            points[2, p] = start[2] + step[2] * (block[2] + p % columns)
            nearest[p] = np.inf
        # Few points and few triangles are left, so every triangle is tried for every point.
        for k in range(block[7], last):
            _lower(triangles, stack[k], points, size, nearest)
        for p in range(size):
            layer, row = block[0] + p // (rows * columns), block[1] + p // columns % rows
            squares[(layer * shape[1] + row) * shape[2] + block[2] + p % columns] = nearest[p]
    return squares


@compiled()
def _keep_nearest(triangles: Floats, stack: Ints, first: int, last: int, points: Floats, table: Floats) -> int:
    """The end of the triangles kept: those of stack[first:last] that may be nearest in a block are copied to
    stack[last:].

    points : (3, ≥ 9) the corners of the block and its centre.
    table : (≥ last - first, 9) work space.
    """
    nearest = 0
    for k in range(last - first):
        for p in range(9):
            table[k, p] = np.inf
        _lower(triangles, stack[first + k], points, table.shape[1], table[k])
        if table[k, 8] < table[nearest, 8]:
            nearest = k
    # The point q of the module's inequality: the surface point nearest to the block's centre rules out most
    # triangles.
    u, v = _closest_point(triangles, stack[first + nearest], points)
    limit = np.zeros(8)
    for k in range(3):
        f = stack[first + nearest]
        q = triangles[f, k] + u * triangles[f, 3 + k] + v * triangles[f, 6 + k]
        for p in range(8):
            limit[p] += (points[k, p] - q) ** 2 * (1.0 - _SLACK)
    kept = last
    for k in range(last - first):
        near = k == nearest
        for p in range(8):
            near = near or table[k, p] < limit[p]
        if near:
            stack[kept] = stack[first + k]
            kept += 1
    return kept


@compiled()
def _lower(triangles: Floats, f: int, points: Floats, count: int, squares: Floats) -> None:
    """Lower `squares` of the first `count` of `points` (3, n) to the squared distance to triangle f, if that is
    smaller.

    The nearest point of a triangle lies on an edge, or is the foot of the perpendicular if that lies inside.
    """
    ax, ay, az = triangles[f, 0], triangles[f, 1], triangles[f, 2]
    ux, uy, uz = triangles[f, 3], triangles[f, 4], triangles[f, 5]
    vx, vy, vz = triangles[f, 6], triangles[f, 7], triangles[f, 8]
    uu, uv, vv = triangles[f, 9], triangles[f, 10], triangles[f, 11]
    per_uu, per_vv, per_ww, per_area = triangles[f, 12], triangles[f, 13], triangles[f, 14], triangles[f, 15]
    for p in range(count):
        x, y, z = points[0, p] - ax, points[1, p] - ay, points[2, p] - az
        along_u, along_v = x * ux + y * uy + z * uz, x * vx + y * vy + z * vz
        a = min(max(along_u * per_uu, 0.0), 1.0)
        on_u = (x - a * ux) ** 2 + (y - a * uy) ** 2 + (z - a * uz) ** 2
        b = min(max(along_v * per_vv, 0.0), 1.0)
        on_v = (x - b * vx) ** 2 + (y - b * vy) ** 2 + (z - b * vz) ** 2
        c = min(max((along_v - along_u - uv + uu) * per_ww, 0.0), 1.0)
        d = 1.0 - c
        on_w = (x - d * ux - c * vx) ** 2 + (y - d * uy - c * vy) ** 2 + (z - d * uz - c * vz) ** 2
        # The foot of the perpendicular counts only where it lies inside the triangle.
        r, s = (vv * along_u - uv * along_v) * per_area, (uu * along_v - uv * along_u) * per_area
        inside = (x - r * ux - s * vx) ** 2 + (y - r * uy - s * vy) ** 2 + (z - r * uz - s * vz) ** 2
        inside = inside if min(r, s, 1.0 - r - s) > 0.0 else on_u
        squares[p] = min(squares[p], on_u, on_v, on_w, inside)


@compiled()
def _closest_point(triangles: Floats, f: int, points: Floats) -> tuple[float, float]:
    """The point of triangle f that is nearest to points[:, 8], in units of the edges u and v."""
    along_u, along_v, along = 0.0, 0.0, 0.0
    for k in range(3):
        offset = points[k, 8] - triangles[f, k]
        along_u += offset * triangles[f, 3 + k]
        along_v += offset * triangles[f, 6 + k]
        along += offset * offset
    uu, uv, vv = triangles[f, 9], triangles[f, 10], triangles[f, 11]
    r, s = (vv * along_u - uv * along_v) * triangles[f, 15], (uu * along_v - uv * along_u) * triangles[f, 15]
    if min(r, s, 1.0 - r - s) > 0.0:
        return r, s
    a = min(max(along_u * triangles[f, 12], 0.0), 1.0)
    b = min(max(along_v * triangles[f, 13], 0.0), 1.0)
    c = min(max((along_v - along_u - uv + uu) * triangles[f, 14], 0.0), 1.0)
    best_r, best_s, least = 0.0, 0.0, along
    for r, s in ((a, 0.0), (0.0, b), (1.0 - c, c)):
        square = along - 2 * (r * along_u + s * along_v) + r * r * uu + 2 * r * s * uv + s * s * vv
        if square < least:
            best_r, best_s, least = r, s, square
    return best_r, best_s
