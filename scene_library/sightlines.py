"""Whether the visible part of the relay wall sees an object, by rays through the finished room."""

from __future__ import annotations

from typing import Any

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from scene_library.arrays import Floats

_POINTS = 64
_GOLDEN = (0.754877666246693, 0.569840290998053)
"""Steps of the R2 sequence (powers of 1/plastic number): even cover of a square by any number of points."""


def _ray_scene(triangles: Floats) -> tuple[Any, Floats]:
    """Embree's scene of triangles (F, 3, 3) about their middle (3,), which keeps single precision fine, and that."""
    middle = triangles.reshape(-1, 3).mean(axis=0)
    scene = EmbreeScene()
    TriangleMesh(scene, (triangles - middle).astype(np.float32))
    return scene, middle


def seen_fractions(
    triangles: Floats,
    face_part: NDArray[np.int32],
    parts: NDArray[np.int64],
    wall_points: Floats,
) -> Floats:
    """Share of (wall point, surface point) pairs whose segment nothing blocks, for each of `parts`.

    A surface point that faces away counts as blocked, so 0.5 is much for a closed object. The points are fixed.

    triangles : (F, 3, 3) corners of the whole room, metres.
    face_part : (F,) the part that each belongs to.
    wall_points : (n, 3) on the relay wall, n ≤ 64.
    """
    scene, middle = _ray_scene(triangles)
    points = np.concatenate([_surface_points(triangles[face_part == part]) for part in parts])
    # Each object point meets each wall point of its rank and a shifted one: pairs spread over both surfaces.
    n = len(wall_points)
    order = np.arange(len(points))
    fractions = np.zeros(len(parts))
    for shift in (0, n // 3, (2 * n) // 3):
        start = wall_points[(order + shift) % n]
        toward = points - start
        distance = np.linalg.norm(toward, axis=1)
        direction = toward / distance[:, None]
        # The wall itself is behind the start; a small step keeps float32 from finding it again.
        step = 1e-4 * distance
        origin = (start - middle + direction * step[:, None]).astype(np.float32)
        hit = scene.run(origin, direction.astype(np.float32), query="DISTANCE")
        free = hit >= (distance - step) * (1 - 1e-3)
        fractions += free.reshape(len(parts), _POINTS).mean(axis=1) / 3
    return fractions


def first_faces(triangles: Floats, eye: Floats, points: Floats, slack: float = 1e-3) -> NDArray[np.int64]:
    """(n,) index of the triangle that blocks the way from `eye` (3,) to each of `points` (n, 3); −1: the way is free.

    triangles : (F, 3, 3) corners, metres.
    slack : a surface on the last part of the way, of this share, does not block: it is what the point lies on.
    """
    scene, middle = _ray_scene(triangles)
    toward = points - eye
    distance = np.linalg.norm(toward, axis=1)
    direction = (toward / distance[:, None]).astype(np.float32)
    origin = np.broadcast_to((eye - middle).astype(np.float32), direction.shape)
    hit = scene.run(origin, direction, query="DISTANCE")
    face = np.asarray(scene.run(origin, direction, query="INTERSECT"), np.int64)
    return np.where(hit < distance * (1 - slack), face, -1)


def lattice_points(triangles: Floats) -> Floats:
    """(n, 3) points on (F, 3, 3) triangles: all corners, where these are few a lattice of about 4096."""
    steps = max(1, int(np.sqrt(2 * 4096 / len(triangles))) - 1)
    i, j = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1), indexing="ij")
    inside = i + j <= steps
    weights = np.stack([i[inside], j[inside], steps - i[inside] - j[inside]], axis=1) / steps
    return np.asarray(np.einsum("wk,fkx->fwx", weights, triangles).reshape(-1, 3))


def _surface_points(triangles: Floats) -> Floats:
    """(64, 3) points spread evenly over the area of (F, 3, 3) triangles."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    edges = np.cumsum(area)
    k = np.arange(_POINTS)
    # A random-looking order of faces, so that neighbours in rank do not share a face and a wall point.
    face = np.searchsorted(edges, ((k * 0.6180339887498949) % 1.0) * edges[-1], side="right").clip(0, len(area) - 1)
    u, v = (0.5 + k * _GOLDEN[0]) % 1.0, (0.5 + k * _GOLDEN[1]) % 1.0
    over = u + v > 1
    u, v = np.where(over, 1 - u, u)[:, None], np.where(over, 1 - v, v)[:, None]
    return np.asarray(a[face] + u * (b - a)[face] + v * (c - a)[face])


def even_points(center: Floats, right: Floats, up: Floats) -> Floats:
    """(64, 3) points spread evenly over the rectangle `center ± right ± up`."""
    k = np.arange(_POINTS)
    u, v = (0.5 + k * _GOLDEN[0]) % 1.0, (0.5 + k * _GOLDEN[1]) % 1.0
    return np.asarray(center + (2 * u - 1)[:, None] * right + (2 * v - 1)[:, None] * up)
