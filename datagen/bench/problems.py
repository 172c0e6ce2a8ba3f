"""The furnished room that benches share: closed, 4 × 3 × 2.5 m, with a box and a pillar."""

from __future__ import annotations

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


def furnished_room(subdivisions: int = 0) -> Scene:
    """The room, of 36 triangles, each cut into four `subdivisions` times."""
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
    return Scene.from_parts(Part(p.name, _cut(p.mesh, subdivisions), p.material, p.role) for p in parts)


def _cut(mesh: trimesh.Trimesh, times: int) -> trimesh.Trimesh:
    for _ in range(times):
        mesh = mesh.subdivide()
    return mesh
