"""The furnished room of several benches, closed, 4 × 3 × 2.5 m, with a box and a pillar; and lumps for it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh

from datagen.records import Lambertian, Part, Rectangle, Scene
from datagen.records.scene import Role

WALL = Rectangle.of((0, 0, 1.25), (0, 1.5, 0), (0, 0, 1.25))
"""The relay wall."""
DEVICE = np.array([1.5, 0.1, 1.3])


def rectangle(name: str, surface: Rectangle, albedo: float, role: Role = "structure") -> Part:
    """A rectangle as a part of two triangles."""
    mesh = trimesh.Trimesh(surface.corners, [[0, 1, 2], [0, 2, 3]], process=False)
    return Part(name, mesh, Lambertian(albedo), role)


def furnished_room(subdivisions: int = 0, more: Sequence[Part] = ()) -> Scene:
    """The room, of 36 triangles, each cut into four `subdivisions` times, with `more` parts in it."""
    shell = trimesh.creation.box((4, 3, 2.5))
    shell.apply_translation((2, 0, 1.25))
    others = shell.submesh([np.flatnonzero(shell.triangles_center[:, 0] > 1e-6)], append=True)
    box = trimesh.creation.box((0.6, 0.5, 0.8))
    box.apply_translation((2.2, -0.7, 0.4))
    pillar = trimesh.creation.box((0.4, 0.4, 2.5))
    pillar.vertices = pillar.vertices @ np.array([[1, 1, 0], [-1, 1, 0], [0, 0, 2**0.5]]) / 2**0.5
    pillar.apply_translation((2.6, 0.7, 1.25))
    parts = [
        rectangle("relay_wall", WALL, 0.8, "relay_wall"),
        Part("shell", others, Lambertian(0.65), "structure"),
        Part("box", box, Lambertian(0.5)),
        Part("pillar", pillar, Lambertian(0.7)),
    ]
    cut = [Part(p.name, _cut(p.mesh, subdivisions), p.material, p.role) for p in parts]
    return Scene.from_parts([*cut, *more])


def lump(name: str, center: tuple[float, float, float], radius_m: float, quads: int) -> Part:
    """A sphere with bumps of a tenth of its radius, of 12 quads² triangles: a cube's faces, projected outwards."""
    side = np.linspace(-1, 1, quads + 1)
    u, v = (x.ravel() for x in np.meshgrid(side, side, indexing="ij"))
    low = (np.arange(quads)[:, None] * (quads + 1) + np.arange(quads)).ravel()
    right, up = low + quads + 1, low + 1
    face = np.concatenate([np.stack([low, right, right + 1], 1), np.stack([low, right + 1, up], 1)])
    points, faces = [], []
    for k in range(6):
        axis, sign = k // 2, 1.0 - 2.0 * (k % 2)
        cube = np.empty((len(u), 3))
        cube[:, axis], cube[:, (axis + 1) % 3], cube[:, (axis + 2) % 3] = sign, u, v
        points.append(cube / np.linalg.norm(cube, axis=1, keepdims=True))
        faces.append((face if sign > 0 else face[:, ::-1]) + k * len(u))
    ball = np.concatenate(points)
    bumps = 1 + 0.1 * np.prod(np.sin(5 * ball + (0.3, 1.1, 2.0)), axis=1)
    vertices = radius_m * bumps[:, None] * ball + center
    return Part(name, trimesh.Trimesh(vertices, np.concatenate(faces), process=False), Lambertian(0.6))


def _cut(mesh: trimesh.Trimesh, times: int) -> trimesh.Trimesh:
    for _ in range(times):
        mesh = mesh.subdivide()
    return mesh
