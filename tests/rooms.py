"""Small scenes with known answers, shared by the tests."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from datagen.records import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, TimeAxis
from datagen.units import SPEED_OF_LIGHT_M_PER_S as C

ONE_BOUNCE = Accuracy(samples=1, max_bounces=1, direct=True)
"""Light of the first return alone, which has no noise."""


def rectangle(center: ArrayLike, right: ArrayLike, up: ArrayLike) -> trimesh.Trimesh:
    """Two triangles spanning center ± right ± up."""
    c, r, u = (np.asarray(v, float) for v in (center, right, up))
    return trimesh.Trimesh([c - r - u, c + r - u, c + r + u, c - r + u], [[0, 1, 2], [0, 2, 3]], process=False)


def plane_ahead(metres: float, albedo: float = 0.8) -> Scene:
    """A wide plane so far ahead along x, which faces the origin."""
    at = trimesh.transformations.translation_matrix((metres + 0.01, 0, 0))
    plane = trimesh.creation.box((0.02, 20, 20), at)
    return Scene.from_parts([Part("plane", plane, Lambertian(albedo), "relay_wall")])


def square_pixels(centers: ArrayLike, half_side_m: float) -> NDArray[np.float64]:
    """(P, 4, 3) square pixels in planes of constant x."""
    h = half_side_m
    corners = np.array([[0, -h, -h], [0, h, -h], [0, h, h], [0, -h, h]])
    return np.asarray(centers, float)[:, None] + corners


def bins_of_path(bins: int, width_m: float, start_m: float, origin: str = "wall") -> TimeAxis:
    """A time axis given as path lengths."""
    return TimeAxis(bins, width_m / C, start_m / C, origin)  # type: ignore[arg-type]


def furnished_box(albedo: float = 0.7) -> Scene:
    """A closed 4 × 3 × 2.5 m room (x from 0) with a box and a pillar; the wall x = 0 is the relay wall."""
    low, high = np.array([0, -1.5, 0.0]), np.array([4, 1.5, 2.5])
    c, h = (low + high) / 2, (high - low) / 2
    ex, ey, ez = np.eye(3)
    box = trimesh.creation.box((0.6, 0.5, 0.8))
    box.apply_translation((2.2, -0.7, 0.4))
    pillar = trimesh.creation.box((0.4, 0.4, 2.5))
    pillar.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 4, (0, 0, 1)))
    pillar.apply_translation((2.6, 0.7, 1.25))
    walls = trimesh.util.concatenate(
        [
            rectangle(c + ex * h[0], ey * h[1], ez * h[2]),
            rectangle(c - ey * h[1], ex * h[0], ez * h[2]),
            rectangle(c + ey * h[1], ex * h[0], ez * h[2]),
        ]
    )
    return Scene.from_parts(
        [
            Part("relay_wall", rectangle(c - ex * h[0], ey * h[1], ez * h[2]), Lambertian(albedo), "relay_wall"),
            Part("walls", walls, Lambertian(albedo), "structure"),
            Part("floor", rectangle(c - ez * h[2], ex * h[0], ey * h[1]), Lambertian(albedo), "structure"),
            Part("ceiling", rectangle(c + ez * h[2], ex * h[0], ey * h[1]), Lambertian(albedo), "structure"),
            Part("box", box, Lambertian(albedo)),
            Part("pillar", pillar, Lambertian(albedo)),
        ]
    )


def one_point_capture(
    laser_point: ArrayLike = (0, -0.8, 1.4),
    fov_center: ArrayLike = (0, 0.4, 1.2),
    half_side_m: float = 0.2,
    time: TimeAxis | None = None,
    device: ArrayLike = (1.5, 0.1, 1.3),
) -> Capture:
    """One laser point and one square pixel on the wall x = 0."""
    return Capture(
        Laser(device, [laser_point]),
        Sensor(device, square_pixels([fov_center], half_side_m)),
        time or bins_of_path(200, 0.1, 0.0),
    )
