"""Faces of a convex body do not light each other, though they touch."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from rooms import bins_of_path, rectangle, square_pixels

from datagen import GGX, Accuracy, Capture, Lambertian, Laser, Material, Part, Scene, Sensor, simulate

DEVICE = np.array([2.5, -1.0, 2.2])


@pytest.mark.parametrize("material", [Lambertian(0.7), GGX(0.7, roughness=0.12, f0=1.0)], ids=["matt", "glossy"])
@pytest.mark.parametrize("corners", [8, 24], ids=["box", "prism"])
def test_a_wall_and_a_convex_body_have_no_light_of_four_bounces(corners: int, material: Material) -> None:
    """Triangles that hang below the plane of another, and touch it, gave a GGX box 4 % of secondary light."""
    body = (
        trimesh.creation.box((0.3, 0.4, 0.3))
        if corners == 8
        else trimesh.creation.cylinder(0.2, 0.4, sections=corners // 2)
    )
    body.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1.0, 0.4, 0.3)))
    body.apply_translation((1.1, 0.5, 1.3))
    wall = Part("wall", rectangle((0, 0, 1.2), (0, 1.2, 0), (0, 0, 1.2)), Lambertian(0.6), "relay_wall")
    spot, pixels = np.array([[0.0, -0.6, 1.4]]), np.array([[0.0, 0.1, 0.4], [0.0, 0.3, 1.8]])
    capture = Capture(Laser(DEVICE, spot), Sensor(DEVICE, square_pixels(pixels, 0.01)), bins_of_path(400, 0.02, 0.0))
    scene = Scene.from_parts([wall, Part("body", body, material)])
    found = simulate(scene, capture, Accuracy(target=0.02, max_bounces=4))
    assert found.components["primary"].sum() > 0.0
    assert found.components["secondary"].sum() < 1e-9 * found.components["primary"].sum()
