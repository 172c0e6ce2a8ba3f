"""Rooms built by hand, for the tests of labels and pictures."""

from __future__ import annotations

import numpy as np
import trimesh

from datagen.records import Lambertian, Part, Rectangle, Scene

DISTANCE_M = 6.0
HEIGHT_M = 2.5


def rectangle_mesh(rectangle: Rectangle) -> trimesh.Trimesh:
    return trimesh.Trimesh(rectangle.corners, [[0, 1, 2], [0, 2, 3]], process=False)


def box_mesh(size: tuple[float, float, float], center: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(center))


def wall_view(side: int = 1, width_m: float = 3.0) -> Rectangle:
    """The hidden view of an L corridor whose room opens towards `side` · y; right as seen from the room is −y."""
    return Rectangle.of((DISTANCE_M, side * 2.5, HEIGHT_M / 2), (0, -width_m / 2, 0), (0, 0, HEIGHT_M / 2))


def l_corridor(side: int = 1, objects: list[Part] | None = None, shell: bool = True) -> Scene:
    """Corridor −1 ≤ y ≤ 1 from x = 0 to the relay wall at x = 6; room 1 ≤ side·y ≤ 4 behind x = 3."""
    relay = Rectangle.of((DISTANCE_M, 0, HEIGHT_M / 2), (0, -1, 0), (0, 0, HEIGHT_M / 2))
    parts = [Part("relay_wall", rectangle_mesh(relay), Lambertian(0.8), "relay_wall")]
    if shell:
        outline = np.array([[6, 1], [6, 4], [3, 4], [3, 1], [0, 1], [0, -1], [6, -1]], float) * [1, side]
        for k in range(len(outline) - 1):
            parts.append(Part(f"wall_{k}", _upright(outline[k], outline[k + 1]), Lambertian(0.7), "structure"))
        for name, z in (("floor", 0.0), ("ceiling", HEIGHT_M)):
            parts.append(Part(name, _slab(side, z), Lambertian(0.5), "structure"))
    if objects is None:
        pillar = box_mesh((0.4, 0.4, HEIGHT_M), (0, 0, HEIGHT_M / 2))
        pillar.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 4, (0, 0, 1)))
        pillar.apply_translation((3.6, side * 2.2, 0))
        objects = [
            Part("pillar", pillar, Lambertian(0.6)),
            Part("box", box_mesh((0.6, 0.5, 0.8), (4.6, side * 3.2, 0.4)), Lambertian(0.4)),
        ]
    low, high = sorted((side * 1.0, side * 4.0))
    return Scene.from_parts(
        [*parts, *objects],
        relay_wall=relay,
        hidden_view=wall_view(side),
        hidden_bounds=[[3, low, 0], [6, high, HEIGHT_M]],
        device_position=(0, 0, 1),
    )


def _upright(a: np.ndarray, b: np.ndarray) -> trimesh.Trimesh:
    base = np.array([[*a, 0], [*b, 0], [*b, HEIGHT_M], [*a, HEIGHT_M]])
    return trimesh.Trimesh(base, [[0, 1, 2], [0, 2, 3]], process=False)


def _slab(side: int, z: float) -> trimesh.Trimesh:
    corridor = np.array([[0, -1, z], [6, -1, z], [6, 1, z], [0, 1, z]], float)
    room = np.array([[3, side, z], [6, side, z], [6, 4 * side, z], [3, 4 * side, z]], float)
    return trimesh.Trimesh(
        np.concatenate([corridor, room]), [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], process=False
    )
