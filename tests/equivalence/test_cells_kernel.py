"""The short cuts of the quadrature kernel give the light of the plain way: every shadow ray cast, every element taken
by itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from rooms import bins_of_path, one_point_capture, rectangle

from datagen import Accuracy, Capture, Lambertian, OrenNayar, Part, Scene
from datagen.records import Material
from datagen.transport.problem import Problem
from datagen.transport.quadrature.gathering import Gathering
from datagen.transport.reference import pairs_of


def cluttered() -> Scene:
    """A wall, a ball, two boxes that intersect, a ring turned inside out, a ring whose triangles share no vertices, a
    ball with a dent through its other side, and a box without a lid."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    ball.apply_translation((1.2, 0.3, 0.4))
    box = trimesh.creation.box(bounds=[(0.9, -0.5, -0.3), (1.3, -0.1, 0.3)])
    inside = trimesh.creation.box(bounds=[(1.1, -0.3, 0.0), (1.6, 0.4, 0.2)])
    opened = trimesh.creation.box(bounds=[(0.6, 0.4, -0.6), (0.9, 0.8, -0.3)])
    opened.update_faces(opened.triangles_center[:, 0] > 0.61)
    ring = trimesh.creation.torus(0.25, 0.1, 12, 8)
    ring.apply_transform(trimesh.transformations.euler_matrix(0.4, 1.2, 0.3))
    ring.apply_translation((0.8, 0.0, 0.6))
    apart = np.asarray(ring.triangles).reshape(-1, 3) + np.array((0.5, -0.6, -0.2))
    loose = trimesh.Trimesh(apart, np.arange(len(apart)).reshape(-1, 3), process=False)
    inverted = trimesh.Trimesh(ring.vertices, ring.faces[:, ::-1], process=False)
    dented = trimesh.creation.icosphere(subdivisions=2, radius=0.25)
    dented.vertices[np.argmax(dented.vertices[:, 2])] -= (0, 0, 0.6)
    dented.apply_translation((1.1, 0.6, -0.3))
    wall = Part("wall", rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1)), Lambertian(0.8), "relay_wall")
    behind = Part("behind", rectangle((2, 0, 0), (0, -1, 0), (0, 0, 1)), Lambertian(0.7), "structure")
    meshes = {"ball": ball, "box": box, "inside": inside, "ring": inverted, "loose": loose, "dented": dented,
              "opened": opened}  # fmt: skip
    return Scene.from_parts([wall, behind, *(Part(name, mesh, Lambertian(0.6)) for name, mesh in meshes.items())])


def within_a_ring() -> Scene:
    """A ring whose bounding box contains the laser point but not the pixel."""
    ring = trimesh.creation.torus(0.3, 0.08, 24, 12)
    ring.apply_transform(trimesh.transformations.euler_matrix(0.2, 1.4, 0.1))
    ring.apply_translation((0.05, -0.3, 0.5))
    return Scene.from_parts(
        [Part("wall", rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1)), Lambertian(0.8), "relay_wall"),
         Part("behind", rectangle((1, 0, 0), (0, -1, 0), (0, 0, 1)), Lambertian(0.7), "structure"),
         Part("ring", ring, Lambertian(0.6))]
    )  # fmt: skip


def touching() -> Scene:
    """Boxes that stand on each other, with edges where points of elements lie."""
    wall = Part("wall", rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1)), Lambertian(0.8), "relay_wall")
    third = 0.4 / 3
    bounds = [[(1.0, -0.4, -0.4), (1.4, 0.4, 0.4)], [(0.8, -third, 0.0), (1.0, third, third)],
              [(0.8, -0.4, -0.4), (1.0, 0.4, -2 * third)], [(0.9, 0.0, -third), (1.0, third, 0.0)],
              [(0.8, third, 0.0), (1.0, 2 * third, 2 * third)]]  # fmt: skip
    shelf = trimesh.util.concatenate([trimesh.creation.box(bounds=ends) for ends in bounds])
    shelf.apply_transform(trimesh.transformations.euler_matrix(0.0, 0.0, 0.37))
    shelf.apply_translation((0.0123, 0.0345, 0.0567))
    return Scene.from_parts([wall, Part("shelf", shelf, Lambertian(0.6))])


def histograms(scene: Scene, capture: Capture, error: float) -> tuple[np.ndarray, int, int]:
    gathering = Gathering.of(Problem.of(scene, capture, Accuracy(target=0.02), 0, split_parts=True))
    pairs, parts = pairs_of(gathering.task.capture), len(scene.part_names)
    seen = list(gathering.seen(pairs, 1))
    coarse = gathering.gathered(pairs, seen, np.full(parts, 1e300), np.arange(parts)).histogram
    allowed = error * np.maximum(np.linalg.norm(coarse, axis=(0, 2)), 1e-3 * np.linalg.norm(coarse))
    found = gathering.gathered(pairs, seen, allowed, np.arange(parts))
    return found.histogram, int(found.cells.sum()), int(found.rays.sum())


@pytest.mark.parametrize(("half_side_m", "origin"), [(1e-3, "wall"), (0.05, "source"), (0.4, "wall")])
def test_cells_taken_together_are_those_taken_one_by_one(half_side_m: float, origin: str) -> None:
    """Lambertian surfaces against surfaces of another model at its Lambertian limit, whose elements are never
    processed in batches: as many elements and rays, and the same light in each bin but for rounding; from a point to
    a wide pixel, in haze, beside a corner, behind a screen and across the ends of the window."""
    places = {
        "wall": ((0, 0, 0), (0, 1, 0), (0, 0, 1)), "behind": ((2, 0, 0), (0, -1, 0), (0, 0, 1)),
        "beside": ((1, -1, 0), (1, 0, 0), (0, 0, 1)), "screen": ((1.2, 0.3, 0.1), (0, -0.3, 0.1), (0, 0, 0.4)),
    }  # fmt: skip
    capture = one_point_capture(
        (0, -0.3, 0.5), (0, 0.4, 0.6), half_side_m, bins_of_path(170, 0.03, 0.9, origin), (0.4, 0.1, 0.9)
    )

    def room(diffuse: Callable[[float], Material]) -> Scene:
        parts = [
            Part(name, rectangle(*place), diffuse(0.6), "relay_wall" if name == "wall" else "structure")
            for name, place in places.items()
        ]
        return Scene.from_parts(parts, attenuation_per_m=0.1)

    together, cells, rays = histograms(room(Lambertian), capture, 1e-4)
    alone, same_cells, same_rays = histograms(room(lambda albedo: OrenNayar(albedo, 0.0)), capture, 1e-4)
    assert (cells, rays) == (same_cells, same_rays)
    assert (together.sum(axis=(0, 2))[1:] > 0).all()
    np.testing.assert_allclose(together, alone, rtol=1e-9, atol=1e-12 * alone.max())
