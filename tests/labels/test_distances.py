"""Distances against another formula, evaluated for every triangle at every point."""

from __future__ import annotations

import numpy as np
import trimesh

from datagen.labels.triangles import Triangles

START, STEP, SHAPE = np.array([-1.3, 1.1, -0.9]), np.array([0.21, -0.17, 0.13]), (13, 14, 15)
PLACES = START + STEP * np.stack(np.meshgrid(*map(np.arange, SHAPE), indexing="ij"), axis=-1)
SINGLE = {"rtol": 1e-6, "atol": 2e-6}


def by_every_triangle(corners: np.ndarray) -> np.ndarray:
    """The plane's distance where the foot is on the inner side of all edges, else that of the nearest edge."""
    least = np.full(SHAPE, np.inf)
    for triangle in corners:
        normal = np.cross(triangle[1] - triangle[0], triangle[2] - triangle[0])
        inside = np.full(SHAPE, bool(normal.any()))
        for a, b in zip(triangle, np.roll(triangle, -1, axis=0), strict=True):
            edge, offset = b - a, PLACES - a
            share = np.clip(offset @ edge / max(edge @ edge, 1e-300), 0, 1)
            least = np.minimum(least, np.linalg.norm(offset - share[..., None] * edge, axis=-1))
            inside &= offset @ np.cross(normal, edge) > 0
        height = abs((PLACES - triangle[0]) @ normal) / max(np.linalg.norm(normal), 1e-300)
        least = np.where(inside, np.minimum(least, height), least)
    return least


def test_any_triangles() -> None:
    """Alone and many, small and large; and meshes, where many triangles are equally near to an edge or a corner."""
    rng = np.random.default_rng(3)
    soups = [
        rng.uniform(-1, 1, (count, 1, 3)) + rng.uniform(-size, size, (count, 3, 3))
        for count, size in ((1, 2.0), (2, 0.3), (3, 0.02), (300, 0.02), (300, 2.0))
    ]
    turn = trimesh.transformations.rotation_matrix(0.4, (1, 2, 3))[:3, :3]
    for mesh in (trimesh.creation.box((0.9, 0.6, 0.7)), trimesh.creation.torus(0.7, 0.2, 24, 12)):
        soups += [np.asarray(mesh.triangles) @ turn + place for place in ((0.1, -0.2, 0.05), (4.0, -3.0, 2.0))]
    # A triangle through points of the grid, on its corners, on an edge and inside.
    soups.append((START + STEP * np.array([[2, 3, 4], [2, 7, 4], [2, 3, 10]]))[None])
    for corners in soups:
        np.testing.assert_allclose(Triangles(corners).distances(PLACES), by_every_triangle(corners), **SINGLE)


def test_no_needle_is_nearer_than_it_is() -> None:
    """A needle alone may seem farther away; in a mesh its neighbours, which share its edges, are as near."""
    rng = np.random.default_rng(8)
    ends = rng.uniform(-1, 1, (60, 2, 3))
    beside = np.concatenate([ends, rng.uniform(-1, 1, (60, 1, 3))], axis=1)
    for width in (0.0, 1e-9, 1e-3):
        tips = ends.mean(axis=1) + width * rng.uniform(-1, 1, (60, 3))
        needles = np.concatenate([ends, tips[:, None]], axis=1)
        assert (Triangles(needles).distances(PLACES) >= by_every_triangle(needles) - 2e-6).all()
        mesh = np.concatenate([needles, beside])
        np.testing.assert_allclose(Triangles(mesh).distances(PLACES), by_every_triangle(mesh), **SINGLE)
