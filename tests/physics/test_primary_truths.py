"""The primary against three truths: a small patch (closed form), a rectangle, and one behind a screen (integrals)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from lit_plate import plate_by_quadrature
from rooms import bins_of_path, rectangle, square_pixels

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, simulate
from datagen.units import SPEED_OF_LIGHT_M_PER_S as C

APERTURE_M2 = np.pi * 0.02**2
BY_CUTS = Accuracy(target=0.005, max_bounces=3)


def wall_and(plate: trimesh.Trimesh, albedo: float = 0.6) -> Scene:
    wall = rectangle((0, 0, 0), (0, 3, 0), (0, 0, 3))
    return Scene.from_parts(
        [Part("wall", wall, Lambertian(0.8), "relay_wall"), Part("plate", plate, Lambertian(albedo))]
    )


@pytest.mark.parametrize("accuracy", [Accuracy(samples=256, max_bounces=3), BY_CUTS], ids=["paths", "cuts"])
@pytest.mark.parametrize("origin", ["wall", "source"])
def test_small_patch_amplitude_and_arrival_time(origin: str, accuracy: Accuracy) -> None:
    """L = (ρ₁/π) cosθ₁cosθ₂ a/R₁₂² · (ρ₂/π) cosθ₂′cosθ₃/R₂₃² · (ρ₃/π) A Ω, at one time, in fog on all
    four legs."""
    side, h = 1e-3, 5e-4
    x2, n2 = np.array([1.2, 0.5, -0.3]), np.array([-1.0, 0, 0])
    x1, x3, device = np.array([0, -0.4, 0.2]), np.array([0, 0.9, 0.1]), np.array([2.0, -1.0, 0.4])
    scene = replace(wall_and(rectangle(x2, (0, side / 2, 0), (0, 0, side / 2))), attenuation_per_m=0.4)
    r12, r23, r3s = np.linalg.norm(x2 - x1), np.linalg.norm(x3 - x2), np.linalg.norm(device - x3)
    of_device = r3s + np.linalg.norm(device - x1)
    path = r12 + r23 + (of_device if origin == "source" else 0.0)
    capture = Capture(
        Laser(device, [x1]), Sensor(device, square_pixels([x3], h)), bins_of_path(400, 1e-5, path - 2e-3, origin)
    )
    result = simulate(scene, capture, accuracy, seed=3)

    cos1, cos2 = (x2 - x1)[0] / r12, n2 @ (x1 - x2) / r12
    cos2_out, cos3 = n2 @ (x3 - x2) / r23, -(x3 - x2)[0] / r23
    omega = (2 * h) ** 2 * (device - x3)[0] / r3s**3
    patch = 0.8 / np.pi * cos1 * cos2 / r12**2 * side**2
    expected = patch * 0.6 / np.pi * cos2_out * cos3 / r23**2 * 0.8 / np.pi * APERTURE_M2 * omega
    expected *= np.exp(-0.4 * (r12 + r23 + of_device))
    assert result.total.sum() == pytest.approx(expected, rel=1e-4, abs=0)
    mean_time = (result.total[0, 0] * capture.time.centers_s).sum() / result.total.sum()
    assert mean_time == pytest.approx(path / C, abs=1e-5 / C)


@pytest.mark.parametrize("accuracy", [Accuracy(samples=1 << 17), BY_CUTS], ids=["paths", "cuts"])
@pytest.mark.parametrize("side", [5, pytest.param(16, marks=pytest.mark.nightly)])
def test_rectangle_against_quadrature_per_3_mm_bin(side: int, accuracy: Accuracy) -> None:
    """An unoccluded plate, confocal points, 300 bins of 3 mm: relative L1 under 1 % (docs/physics.md)."""
    center, right, up = np.array([1, 0.1, 0.05]), np.array([0.05, 0.13, 0]), np.array([0, 0, 0.13])
    scene = wall_and(rectangle(center, right, up))
    knots = np.linspace(-0.35, 0.35, side)
    points = np.array([[0, y, z] for z in knots for y in knots])
    h, device = 1e-4, np.array([0.5, 0, 0])
    capture = Capture(
        Laser(device, points), Sensor(device, square_pixels(points, h)), bins_of_path(300, 0.003, 1.75), "confocal"
    )
    truth = plate_by_quadrature(points, center, right, up, 600, 300, 1.75, 0.003)
    omega = (2 * h) ** 2 * device[0] / np.linalg.norm(device - points, axis=1) ** 3
    truth *= 0.8**2 * 0.6 / np.pi**3 * APERTURE_M2 * omega[:, None]
    result = simulate(scene, capture, accuracy, seed=5, split_parts=False)
    assert np.abs(result.total[:, 0] - truth).sum() / truth.sum() < (0.01 if accuracy is BY_CUTS else 0.025)
    if accuracy is BY_CUTS:
        assert np.linalg.norm(result.total[:, 0] - truth) < 0.008 * np.linalg.norm(truth)
    assert result.total.sum() == pytest.approx(truth.sum(), rel=5e-4 if accuracy is BY_CUTS else 1e-3, abs=0)


@pytest.mark.parametrize("accuracy", [Accuracy(samples=1 << 17), BY_CUTS], ids=["paths", "cuts"])
@pytest.mark.parametrize("ahead", [0.1, 1.0, 1.9])
def test_an_occluder_casts_an_exact_shadow(ahead: float, accuracy: Accuracy) -> None:
    """A screen hides part of a plate from the laser point, another part of it from the field of view; close to the
    wall, halfway, or close to the plate: compared with a brute-force integral."""
    wall = rectangle((0, 0, 0), (0, 3, 0), (0, 0, 3))
    plate = rectangle((2, 0, 0), (0, 0.5, 0), (0, 0, 0.5))
    x1, x3, device, h = np.array([0, -0.6, 0.1]), np.array([0, 0.7, -0.1]), np.array([0.6, -1.5, 0]), 1e-4
    parts = [Part("wall", wall, Lambertian(0.9), "relay_wall"), Part("plate", plate, Lambertian(0.7))]
    # Middle, half sides, and share of the way from an end to the plate, by the shadow there. They must not touch.
    screens = [
        (np.array([2, *middle]) * on_the_way + end * (1 - on_the_way), half * on_the_way, on_the_way)
        for end, middle, half, on_the_way in (
            (x1, (0.3, 0.1), np.array([0.25, 0.35]), ahead / 2),
            (x3, (-0.2, -0.25), np.array([0.2, 0.3]), ahead / 2 + 0.01),
        )
    ]
    for k, (middle, (right, up), _) in enumerate(screens):
        parts.append(Part(f"screen {k}", rectangle(middle, (0, right, 0), (0, 0, up)), Lambertian(0.0)))
    scene = Scene.from_parts(parts)
    capture = Capture(Laser(device, [x1]), Sensor(device, square_pixels([x3], h)), bins_of_path(1, 20, 0))
    result = simulate(scene, capture, accuracy, seed=3)

    n = 600
    knots = ((np.arange(n) + 0.5) / n * 2 - 1) * 0.5
    y, z = (k.ravel() for k in np.meshgrid(knots, knots))
    x2 = np.stack([np.full_like(y, 2.0), y, z], axis=1)

    def clear(p: np.ndarray) -> np.ndarray:
        off = [
            (np.abs((p + (x2 - p) * on_the_way - middle)[:, 1:]) / half).max(axis=1)
            for middle, half, on_the_way in screens
        ]
        return np.min(off, axis=0) > 1

    r1, r3, is_lit = np.linalg.norm(x2 - x1, axis=1), np.linalg.norm(x2 - x3, axis=1), clear(x1) & clear(x3)
    kernel = (2 / r1) ** 2 / r1**2 * (2 / r3) ** 2 / r3**2 * is_lit / n**2
    omega = (2 * h) ** 2 * device[0] / np.linalg.norm(device - x3) ** 3
    truth = 0.9 * 0.7 * 0.9 / np.pi**3 * kernel.sum() * APERTURE_M2 * omega
    assert 0.3 < is_lit.mean() < 0.9
    assert result.total.sum() + result.overflow.sum() == pytest.approx(truth, rel=0.01, abs=0)
