"""How many triangles a segment passes through, in double precision: the oracle of the laws of rooms."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def crossing_counts(triangles: np.ndarray, start: np.ndarray, end: np.ndarray) -> NDArray[np.int64]:
    """(n,): how many triangles (F, 3, 3) each segment start → end (n, 3) passes through (Möller & Trumbore 1997)."""
    start, end = np.broadcast_arrays(start, end)
    return _counts(
        np.ascontiguousarray(triangles, np.float64), np.ascontiguousarray(start), np.ascontiguousarray(end)
    )


@njit(cache=True)
def _counts(triangles: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    counts = np.zeros(len(start), np.int64)
    for f in range(len(triangles)):
        ax, ay, az = triangles[f, 0]
        bx, by, bz = triangles[f, 1, 0] - ax, triangles[f, 1, 1] - ay, triangles[f, 1, 2] - az
        cx, cy, cz = triangles[f, 2, 0] - ax, triangles[f, 2, 1] - ay, triangles[f, 2, 2] - az
        for i in range(len(start)):
            sx, sy, sz = start[i]
            dx, dy, dz = end[i, 0] - sx, end[i, 1] - sy, end[i, 2] - sz
            px, py, pz = dy * cz - dz * cy, dz * cx - dx * cz, dx * cy - dy * cx
            det = bx * px + by * py + bz * pz
            if abs(det) < 1e-14:
                continue
            sx, sy, sz = sx - ax, sy - ay, sz - az
            u = (sx * px + sy * py + sz * pz) / det
            if u < 0 or u > 1:
                continue
            qx, qy, qz = sy * bz - sz * by, sz * bx - sx * bz, sx * by - sy * bx
            v = (dx * qx + dy * qy + dz * qz) / det
            if v < 0 or u + v > 1:
                continue
            t = (cx * qx + cy * qy + cz * qz) / det
            if 1e-9 < t < 1 - 1e-9:
                counts[i] += 1
    return counts
