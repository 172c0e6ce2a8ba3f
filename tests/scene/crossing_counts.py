"""How many triangles a segment passes through, in double precision: the oracle of the laws, plain and compiled."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def crossings(triangles: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]) -> np.ndarray:
    """(n, F): whether segment start → end (n, 3) passes through triangle (F, 3, 3) (Möller & Trumbore 1997)."""
    a, e1, e2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    d = (end - start)[:, None]
    p = np.cross(d, e2[None])
    det = (e1[None] * p).sum(-1)
    safe = np.where(np.abs(det) < 1e-14, 1.0, det)
    s = start[:, None] - a[None]
    u = (s * p).sum(-1) / safe
    q = np.cross(s, e1[None])
    v = (d * q).sum(-1) / safe
    t = (e2[None] * q).sum(-1) / safe
    return (np.abs(det) >= 1e-14) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9) & (t < 1 - 1e-9)


def crossing_counts(triangles: np.ndarray, start: np.ndarray, end: np.ndarray) -> NDArray[np.int64]:
    """(n,): the row sums of `crossings`, many times as fast."""
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
