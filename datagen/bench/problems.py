"""The problems whose cost `scaling.py` measures: a furnished room, cut into as many triangles as asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from datagen.records import Accuracy, Capture, Lambertian, Laser, Part, Rectangle, Scene, Sensor, TimeAxis
from datagen.transport import simulate
from datagen.units import time_from_path

WALL = Rectangle.of((0, 0, 1.25), (0, 1.2, 0), (0, 0, 1.0))
DEVICE = np.array([1.5, 0.1, 1.3])


@dataclass(frozen=True)
class Problem:
    """The sizes that are varied, at the values they have while another is.

    observed : points each lookin sees, for the factorised sum of all secondary paths; None for the walk.
    """

    lookins: int = 2048
    fov_samples: int = 4
    bounces: int = 4
    observed: int | None = None
    lasers_a_side: int = 2
    pixels_a_side: int = 4
    bins: int = 512
    triangles: int = 100
    scene: str = "room"
    confocal: bool = False

    def prepared(self) -> Callable[[], object]:
        """The call that is timed; the scene and the capture are made beforehand."""
        scene = SCENES[self.scene](self.triangles)
        points = _grid(self.lasers_a_side)
        axis = TimeAxis(self.bins, time_from_path(20.0 / self.bins), 0.0, "wall")
        if self.confocal:
            half = np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]]) * 0.02
            sensor = Sensor(DEVICE, points[:, None] + half)
        else:
            sensor = Sensor.grid(DEVICE, WALL.center, WALL.right, WALL.up, self.pixels_a_side, self.pixels_a_side)
        capture = Capture(Laser(DEVICE, points), sensor, axis, "confocal" if self.confocal else "exhaustive")
        accuracy = Accuracy(
            lookins=self.lookins, fov_samples=self.fov_samples, max_bounces=self.bounces, replicates=2,
            observed=self.observed,
        )  # fmt: skip
        return lambda: simulate(scene, capture, accuracy, seed=1, split_parts=False)


def _grid(side: int) -> NDArray[np.float64]:
    knots = (np.arange(side) + 0.5) / side * 2 - 1
    grid = WALL.center + knots[None, :, None] * WALL.right - knots[:, None, None] * WALL.up
    return grid.reshape(-1, 3)


def tessellated_room(triangles: int) -> Scene:
    """A furnished room whose every surface is cut into equal triangles, about `triangles` in all."""
    shell = trimesh.creation.box((4, 3, 2.5))
    shell.apply_translation((2, 0, 1.25))
    box = trimesh.creation.box((0.6, 0.5, 0.8))
    box.apply_translation((2.2, -0.7, 0.401))
    return _cut_to(
        triangles,
        ("shell", shell, Lambertian(0.65), "structure"),
        ("box", box, Lambertian(0.5), "object"),
    )


def room_with_sphere(triangles: int) -> Scene:
    """A plain room with a sphere of about `triangles` triangles, a curved object as scanned ones are."""
    shell = trimesh.creation.box((4, 3, 2.5))
    shell.apply_translation((2, 0, 1.25))
    rings = max(4, round((triangles / 4) ** 0.5))
    sphere = trimesh.creation.uv_sphere(radius=0.5, count=(rings, 2 * rings))
    sphere.apply_translation((2.4, 0.4, 1.1))
    return Scene.from_parts(
        [Part("shell", shell, Lambertian(0.65), "structure"), Part("sphere", sphere, Lambertian(0.5), "object")]
    )


SCENES: dict[str, Callable[[int], Scene]] = {"room": tessellated_room, "sphere": room_with_sphere}


def _cut_to(triangles: int, *surfaces: tuple[str, trimesh.Trimesh, Lambertian, str]) -> Scene:
    """Cut each triangle into n² similar ones; n is such that all together come nearest to `triangles`."""
    present = sum(len(mesh.faces) for _, mesh, _, _ in surfaces)
    n = max(1, round((triangles / present) ** 0.5))
    return Scene.from_parts(
        Part(name, _cut(mesh, n), material, role)  # type: ignore[arg-type]
        for name, mesh, material, role in surfaces
    )


def _cut(mesh: trimesh.Trimesh, n: int) -> trimesh.Trimesh:
    """Each triangle cut into n² similar ones; vertices along shared edges are not joined."""
    i, j = (k.ravel() for k in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
    inside = i + j <= n
    i, j = i[inside], j[inside]
    number = np.full((n + 2, n + 2), -1)
    number[i, j] = np.arange(len(i))
    upright = [number[i, j], number[i + 1, j], number[i, j + 1]]
    turned = [number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]]
    cells = np.concatenate([np.stack(upright, axis=1)[i + j < n], np.stack(turned, axis=1)[i + j < n - 1]])
    a, b, c = (mesh.triangles[:, k, None] for k in range(3))
    vertices = a + (b - a) * (i / n)[:, None] + (c - a) * (j / n)[:, None]
    faces = cells[None] + (np.arange(len(vertices)) * len(i))[:, None, None]
    return trimesh.Trimesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), process=False)
