"""The hard cases of light without noise: what equal cells make of each, what ours make of it, and the truth."""

from __future__ import annotations

import numpy as np
import trimesh
from hard_case_light import moved
from measured import HardCase
from numpy.typing import ArrayLike
from rooms import bins_of_path, furnished_box, rectangle, square_pixels

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, Transient, simulate
from datagen.transport.quadrature.clusters import COARSEST

TARGET = 0.02
DEVICE = (1.5, 0.1, 1.3)
POINTS = [[0.0, y, z] for y in (-0.8, 0.7) for z in (0.5, 2.0)]


def scan(points: ArrayLike) -> Capture:
    """A confocal scan by pixels as small as points."""
    at = np.asarray(points, float)
    time = bins_of_path(512, 0.03, 0.0)
    return Capture(Laser(DEVICE, at), Sensor(DEVICE, square_pixels(at, 1e-4)), time, "confocal")


def by_cells(scene: Scene, capture: Capture, target: float = TARGET) -> Transient:
    """The primary to the target, which cells must have met."""
    found = simulate(scene, capture, Accuracy(target=target), seed=1)
    assert found.met_target
    assert found.spend is not None
    assert found.spend.way["primary"] == "cells"
    return found


def apart(found: np.ndarray, truth: np.ndarray) -> float:
    """Relative L2 difference."""
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


def cells_at_an_edge() -> HardCase:
    """A laser point half a millimetre from the next wall, whose light there changes within that."""
    distance, scene = 5e-4, furnished_box()

    def cells(from_wall: float) -> float:
        found = by_cells(scene, scan([[0.0, -1.5 + from_wall, 1.4]]))
        assert found.spend is not None
        return found.spend.lookins["primary"]

    inside, area = cells(0.75), 2 * (4 * 3 + 4 * 2.5 + 3 * 2.5)
    return HardCase(
        "Laser point 0.5 mm from an edge, by cells",
        "all surfaces in cells as small as the smallest: times as many as 0.75 m from it",
        area / (COARSEST * distance) ** 2 / inside,
        "cells as small as their distance asks: times as many",
        cells(distance) / inside,
        "light to 2 % either way",
        allowed=10.0,
    )


def cells_far_away() -> HardCase:
    """A room 10 km from the origin, and rooms of 0.1 m and 1 km."""
    scene, capture = furnished_box(), scan(POINTS)
    truth = by_cells(scene, capture).total
    places = ((1.0, (6e3, -8e3, 3.0)), (0.025, (0.0, 0.0, 0.0)), (250.0, (0.0, 0.0, 0.0)))
    found = [by_cells(*moved(scene, capture, scale, shift)).total * scale**2 for scale, shift in places]
    far = moved(scene, capture, *places[0])[0].vertices
    rounded = np.abs(far.astype(np.float32) - far).max()
    return HardCase(
        "A room 10 km from the origin, of 0.1 m, of 1 km, by cells to 2 %",
        "vertices kept in float32: furthest off, in pixels of 0.2 mm",
        float(rounded) / 2e-4,
        "float64: largest relative L2 difference",
        max(apart(one, truth) for one in found),
        "the same room at the origin",
        allowed=TARGET / 4,
    )


def cells_of_needles() -> HardCase:
    """A screen of 2 000 needles, each 800 times as long as it is wide."""
    room, capture, corner = _parts(), scan(POINTS), np.array([1.9, -0.2, 0.9])
    needles, along, across = 1000, np.array([0.0, 0.8, 0.0]), np.array([0.2, 0.0, 0.7])
    edge = corner + across * (np.arange(needles + 1) / needles)[:, None]
    k = np.arange(needles)
    faces = np.concatenate(
        [np.stack([k, k + needles + 1, k + needles + 2], 1), np.stack([k, k + needles + 2, k + 1], 1)]
    )

    def light(mesh: trimesh.Trimesh) -> np.ndarray:
        return by_cells(Scene.from_parts([*room, Part("screen", mesh, Lambertian(0.7))]), capture).parts["screen"]

    middle = corner + (along + across) / 2
    truth = light(rectangle(middle, along / 2, across / 2))
    cut = light(trimesh.Trimesh(np.concatenate([edge, edge + along]), faces, process=False))
    # In the middle of a needle all its light arrives at once; truly it takes as long as its length is off square.
    return HardCase(
        "A screen of 2 000 needles of 0.8 m, by cells",
        "each a cell whose light arrives at once: bins of 3 cm that it misses",
        float(np.linalg.norm(along)) / 0.03,
        "needles cut along, arrival times spread: relative L2 error of the screen's own light",
        apart(cut, truth),
        "the same screen of two triangles",
        allowed=2.5 * TARGET,
    )


def cells_in_one_plane() -> HardCase:
    """A poster in the very plane of the wall behind it: both must not be counted."""
    capture, room = scan(POINTS), _parts()
    poster = Part("poster", rectangle((4, 0.2, 1.2), (0, 0.5, 0), (0, 0, 0.4)), Lambertian(0.7))
    truth = by_cells(Scene.from_parts(room), capture, TARGET / 4).total.sum()
    found = by_cells(Scene.from_parts([*room, poster]), capture, TARGET / 4)
    own = Scene.from_parts([room[0], poster])
    return HardCase(
        "A poster in the plane of the wall that it hangs on, by cells",
        "both counted: energy too much",
        float(by_cells(own, capture).total.sum() / truth),
        "whichever is met first: the same",
        abs(float(found.total.sum() / truth) - 1),
        "the wall without it",
        allowed=2e-3,
    )


def _parts() -> list[Part]:
    room = furnished_box()
    meshes = [
        trimesh.Trimesh(room.vertices, room.triangles[room.faces_of(n)], process=False) for n in room.part_names
    ]
    return [Part(*one) for one in zip(room.part_names, meshes, room.materials, room.roles, strict=True)]


CELLS = (cells_at_an_edge, cells_far_away, cells_of_needles, cells_in_one_plane)
