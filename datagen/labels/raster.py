"""Orthographic rasters of triangles: the first triangle behind each pixel, and the voxels that triangles enclose.

All rays of a label image are parallel, so triangles can be projected onto the pixels: this needs no BVH, and has
float64 precision and no seams. A pixel centre on the edge of two triangles belongs to exactly one of them.
"""

from __future__ import annotations

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats, Ints


@compiled()
def _side(x0: float, y0: float, x1: float, y1: float, px: float, py: float) -> bool:
    """Whether the point lies on the left of the edge (0 → 1).

    The end points are put into lexicographic order first, so that both triangles at an edge compute the same number
    and put a point on the edge on the same side.
    """
    if x0 < x1 or (x0 == x1 and y0 < y1):
        return (x1 - x0) * (py - y0) - (y1 - y0) * (px - x0) >= 0.0
    return (x0 - x1) * (py - y1) - (y0 - y1) * (px - x1) < 0.0


@compiled()
def _contains(t: Floats, px: float, py: float) -> bool:
    """Whether the point lies in the projected triangle: on the same side of all edges, whatever its winding."""
    first = _side(t[0, 0], t[0, 1], t[1, 0], t[1, 1], px, py)
    return (
        _side(t[1, 0], t[1, 1], t[2, 0], t[2, 1], px, py) == first
        and _side(t[2, 0], t[2, 1], t[0, 0], t[0, 1], px, py) == first
    )


@compiled()
def _covered(low: float, high: float, count: int) -> tuple[int, int]:
    """Number of the first pixel whose centre lies in low … high, and of the first one beyond."""
    return max(0, int(np.ceil(max(low, 0.0) - 0.5))), min(count, int(np.floor(min(high, count + 1.0) - 0.5)) + 1)


@compiled()
def _rows_and_columns(t: Floats, rows: int, columns: int) -> tuple[int, int, int, int]:
    """First row, end of the rows, first column and end of the columns in the triangle's bounding rectangle."""
    top, bottom = _covered(min(t[0, 1], t[1, 1], t[2, 1]), max(t[0, 1], t[1, 1], t[2, 1]), rows)
    left, right = _covered(min(t[0, 0], t[1, 0], t[2, 0]), max(t[0, 0], t[1, 0], t[2, 0]), columns)
    return top, bottom, left, right


@compiled()
def _depth(triangle: Floats, px: float, py: float) -> float:
    """Depth of the triangle's plane at (px, py), clipped to the depths of its corners."""
    ux, uy, uz = triangle[1, 0] - triangle[0, 0], triangle[1, 1] - triangle[0, 1], triangle[1, 2] - triangle[0, 2]
    vx, vy, vz = triangle[2, 0] - triangle[0, 0], triangle[2, 1] - triangle[0, 1], triangle[2, 2] - triangle[0, 2]
    nz = ux * vy - uy * vx
    nearest: float = min(triangle[0, 2], triangle[1, 2], triangle[2, 2])
    farthest: float = max(triangle[0, 2], triangle[1, 2], triangle[2, 2])
    # A triangle seen edge on contains a pixel centre only by rounding, and any of its depths will do.
    if nz == 0.0:
        return nearest
    nx, ny = uy * vz - uz * vy, uz * vx - ux * vz
    # By rounding, the plane of a steep triangle may leave the depths of its corners.
    depth: float = triangle[0, 2] - (nx * (px - triangle[0, 0]) + ny * (py - triangle[0, 1])) / nz
    return min(max(depth, nearest), farthest)


@compiled()
def first_hits(triangles: Floats, rows: int, columns: int, near: float) -> tuple[Ints, Floats]:
    """The nearest triangle at or beyond depth `near` for every pixel centre.

    triangles : (F, 3, 3) corners as column, row (pixels) and depth.

    Returns
    -------
    face : (rows, columns) index of the triangle, −1 where there is none; of equally near ones the first.
    depth : (rows, columns) its depth, infinity where there is none.
    """
    face = np.full((rows, columns), -1, np.int64)
    depth = np.full((rows, columns), np.inf)
    for f in range(len(triangles)):
        t = triangles[f]
        top, bottom, left, right = _rows_and_columns(t, rows, columns)
        for row in range(top, bottom):
            py = row + 0.5
            for column in range(left, right):
                px = column + 0.5
                if not _contains(t, px, py):
                    continue
                z = _depth(t, px, py)
                # The test is strict, so that the first of coinciding triangles is kept at all pixels.
                if near <= z < depth[row, column]:
                    depth[row, column] = z
                    face[row, column] = f
    return face, depth


@compiled()
def hidden_pixels(triangles: Floats, depth: Floats) -> Ints:
    """(F,) number of pixels at which each triangle (F, 3, 3) lies in front of a finite `depth` (rows, columns)."""
    rows, columns = depth.shape
    counts = np.zeros(len(triangles), np.int64)
    for f in range(len(triangles)):
        t = triangles[f]
        top, bottom, left, right = _rows_and_columns(t, rows, columns)
        for row in range(top, bottom):
            for column in range(left, right):
                if not np.isfinite(depth[row, column]):
                    continue
                px, py = column + 0.5, row + 0.5
                if not _contains(t, px, py):
                    continue
                if _depth(t, px, py) < depth[row, column]:
                    counts[f] += 1
    return counts


def inside_columns(triangles: Floats, shape: tuple[int, int, int]) -> Bools:
    """(depth, row, column) whether a closed surface encloses a voxel's centre, by the parity of crossings along
    depth.

    triangles : (F, 3, 3) column, row and depth in voxels (centres at +½); their winding does not matter.
    """
    return np.logical_xor.accumulate(_odd_crossings(triangles, shape), axis=0)


@compiled()
def _odd_crossings(triangles: Floats, shape: tuple[int, int, int]) -> Bools:
    """(depth, row, column) whether the number of crossings between a voxel's centre and the one before is odd."""
    layers, rows, columns = shape
    crossed = np.zeros((layers, rows, columns), np.bool_)
    for f in range(len(triangles)):
        t = triangles[f]
        top, bottom, left, right = _rows_and_columns(t, rows, columns)
        for row in range(top, bottom):
            for column in range(left, right):
                px, py = column + 0.5, row + 0.5
                if not _contains(t, px, py):
                    continue
                # A crossing before the first centre counts for all centres, one behind the last for none.
                z = max(_depth(t, px, py) - 0.5, -0.5)
                if z <= layers - 1:
                    layer = int(np.ceil(z))
                    crossed[layer, row, column] = not crossed[layer, row, column]
    return crossed


@compiled()
def cut_voxels(triangles: Floats, shape: tuple[int, int, int]) -> Bools:
    """(depth, row, column) whether a triangle touches a voxel, by the separating-axis test for a box and a triangle
    (Akenine-Möller, "Fast 3D triangle-box overlap testing", Journal of Graphics Tools 6 (2001), 29–33)."""
    layers, rows, columns = shape
    counts = (columns, rows, layers)
    cut = np.zeros((layers, rows, columns), np.bool_)
    first = np.zeros(3, np.int64)
    last = np.zeros(3, np.int64)
    for f in range(len(triangles)):
        t = triangles[f]
        # Only voxels that the triangle's bounding box meets are worth a test.
        for k in range(3):
            first[k] = int(min(max(np.floor(min(t[0, k], t[1, k], t[2, k])), 0.0), counts[k]))
            last[k] = int(min(max(np.floor(max(t[0, k], t[1, k], t[2, k])) + 1.0, 0.0), counts[k]))
        for layer in range(first[2], last[2]):
            for row in range(first[1], last[1]):
                for column in range(first[0], last[0]):
                    if not cut[layer, row, column]:
                        cut[layer, row, column] = _touches(t, column + 0.5, row + 0.5, layer + 0.5)
    return cut


@compiled()
def _touches(t: Floats, cx: float, cy: float, cz: float) -> bool:
    """Whether the triangle meets the unit cube around (cx, cy, cz), given that its bounding box does."""
    v = np.empty((3, 3))
    for k in range(3):
        v[k, 0], v[k, 1], v[k, 2] = t[k, 0] - cx, t[k, 1] - cy, t[k, 2] - cz
    # Separation along the triangle's normal: the cube's farthest corner does not reach the plane.
    distance, reach = 0.0, 0.0
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        n = (v[1, i] - v[0, i]) * (v[2, j] - v[0, j]) - (v[1, j] - v[0, j]) * (v[2, i] - v[0, i])
        distance += n * v[0, k]
        reach += 0.5 * abs(n)
    if abs(distance) > reach:
        return False
    # Separation along the cross products of the triangle's edges and the cube's.
    for e in range(3):
        a, b = v[e], v[(e + 1) % 3]
        c = v[(e + 2) % 3]
        for k in range(3):
            i, j = (k + 1) % 3, (k + 2) % 3
            along_i, along_j = b[i] - a[i], b[j] - a[j]
            edge, opposite = a[i] * along_j - a[j] * along_i, c[i] * along_j - c[j] * along_i
            reach = 0.5 * (abs(along_i) + abs(along_j))
            if min(edge, opposite) > reach or max(edge, opposite) < -reach:
                return False
    return True
