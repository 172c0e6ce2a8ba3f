"""Voxels that triangles enclose or touch, in double precision.

The inside is counted here and not by Open3D, whose rays take two crossings in one place for one: then nothing is
inside beyond the plane in which two boxes of a shelf or the cushions of a sofa touch.
"""

from __future__ import annotations

import numpy as np

from datagen.compiled import compiled
from datagen.labels.triangles import plane_depths
from datagen.records.arrays import Bools, Floats

_PAIRS_AT_ONCE = 1 << 20
"""Pairs of triangle and column that are tried at once, which bounds their memory to some 200 MB."""


def enclosed_voxels(triangles: Floats, shape: tuple[int, int, int]) -> Bools:
    """(depth, row, column) whether a closed surface encloses a voxel's centre, by the parity of crossings along
    depth.

    triangles : (F, 3, 3) column, row and depth in voxels (centres at +½); their winding does not matter.
    """
    layers, rows, columns = shape
    crossings = np.zeros(shape, np.uint8)
    # The columns whose centres lie in a triangle's bounding rectangle.
    first = np.clip(np.ceil(triangles[..., :2].min(axis=1) - 0.5), 0, [columns, rows]).astype(np.int64)
    end = np.clip(np.floor(triangles[..., :2].max(axis=1) + 0.5), first, [columns, rows]).astype(np.int64)
    wide, high = (end - first).T
    group = np.cumsum(wide * high) // _PAIRS_AT_ONCE
    for some in np.split(np.arange(len(triangles)), np.flatnonzero(np.diff(group)) + 1):
        pairs = (wide * high)[some]
        f = np.repeat(some, pairs)
        k = np.arange(len(f)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
        column, row = first[f, 0] + k % wide[f], first[f, 1] + k // wide[f]
        at = np.stack([column, row], axis=-1) + 0.5
        sides = [_on_left(triangles[f, a, :2], triangles[f, b, :2], at) for a, b in ((0, 1), (1, 2), (2, 0))]
        met = np.flatnonzero((sides[0] == sides[1]) & (sides[1] == sides[2]))
        # A crossing before the first centre counts for all centres, one behind the last for none.
        layer = np.ceil(np.maximum(plane_depths(triangles, f[met], at[met]) - 0.5, 0)).astype(np.int64)
        within = layer < layers
        np.add.at(crossings, (layer[within], row[met[within]], column[met[within]]), 1)
    return np.asarray(np.logical_xor.accumulate(crossings % 2 == 1, axis=0))


def _on_left(start: Floats, end: Floats, at: Floats) -> Bools:
    """(n,) whether points (n, 2) lie on the left of edges from start to end (n, 2).

    The ends are put into lexicographic order first, so that both triangles at an edge compute the same number and put
    a point on the edge on the same side: of the two it lies in one.
    """
    forward = (start[:, 0] < end[:, 0]) | ((start[:, 0] == end[:, 0]) & (start[:, 1] < end[:, 1]))
    low, high = np.where(forward[:, None], start, end), np.where(forward[:, None], end, start)
    across = (high[:, 0] - low[:, 0]) * (at[:, 1] - low[:, 1]) - (high[:, 1] - low[:, 1]) * (at[:, 0] - low[:, 0])
    return np.asarray((across >= 0) == forward)


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
