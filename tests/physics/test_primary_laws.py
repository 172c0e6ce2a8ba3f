"""Laws of the primary: linearity, scaling, shifts, conservation of energy between bins, contact, and scenes without
light."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numba import njit
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, TimeAxis, simulate

ACCURACY = Accuracy(8192, 8, 3, 8)
DEVICE = np.array([1.5, 0.1, 1.3])


def test_the_primary_is_linear_in_each_albedo() -> None:
    """The light is proportional to the albedo at the laser point, the hidden vertex and the FoV point, exactly,
    because the paths are the same."""
    scene, capture = furnished_box(0.5), one_point_capture()
    base = simulate(scene, capture, ACCURACY, seed=4)
    for name, power in (("relay_wall", 2), ("box", 1)):
        k = scene.part_names.index(name)
        materials = tuple(Lambertian(0.25) if i == k else m for i, m in enumerate(scene.materials))
        dimmed = simulate(replace(scene, materials=materials), capture, ACCURACY, seed=4)
        np.testing.assert_allclose(dimmed.parts["box"], base.parts["box"] * 0.5**power, rtol=1e-9, atol=0)
        if name == "box":
            np.testing.assert_allclose(dimmed.parts["floor"], base.parts["floor"], rtol=1e-9, atol=0)
    assert not simulate(furnished_box(0.0), capture, ACCURACY, seed=4).total.any()


@pytest.mark.filterwarnings("ignore:simulate. all light arrives outside:datagen.InputWarning")
@pytest.mark.parametrize(("bins", "start"), [(1, 0.0), (7, 2.2), (40, 2.0), (200, 30.0), (100_000, 0.0)])
def test_energy_is_in_a_bin_or_in_the_overflow(bins: int, start: float) -> None:
    """Whatever the window, light outside it is tallied as overflow: it never wraps and never piles up in an end
    bin."""
    scene, width = furnished_box(), 0.05 if bins < 1000 else 1e-4
    whole = simulate(scene, one_point_capture(time=bins_of_path(400, 0.05, 0.0)), ACCURACY, seed=6)
    part = simulate(scene, one_point_capture(time=bins_of_path(bins, width, start)), ACCURACY, seed=6)
    assert whole.overflow.sum() == 0
    assert part.total.sum() + part.overflow.sum() == pytest.approx(whole.total.sum(), rel=1e-2)
    if bins == 200:
        assert not part.total.any()


def test_energy_within_the_window_is_the_same_in_any_window() -> None:
    scene = furnished_box()
    whole = simulate(scene, one_point_capture(time=bins_of_path(400, 0.05, 0.0)), ACCURACY, seed=6)
    part = simulate(scene, one_point_capture(time=bins_of_path(40, 0.05, 2.0)), ACCURACY, seed=6)
    np.testing.assert_allclose(part.total[..., 1:-1], whole.total[..., 41:79], rtol=1e-9)


def test_an_occluder_casts_an_exact_shadow() -> None:
    """A screen halfway hides part of a plate from the laser point and part from the field of view: compared with a
    brute-force integral."""
    wall = rectangle((0, 0, 0), (0, 3, 0), (0, 0, 3))
    plate = rectangle((2, 0, 0), (0, 0.5, 0), (0, 0, 0.5))
    screen = rectangle((1, 0.1, 0.0), (0, 0.2, 0), (0, 0, 0.35))
    scene = Scene.from_parts(
        [
            Part("wall", wall, Lambertian(0.9), "relay_wall"),
            Part("plate", plate, Lambertian(0.7)),
            Part("screen", screen, Lambertian(0.0)),
        ]
    )
    x1, x3, device, h = np.array([0, -0.6, 0.1]), np.array([0, 0.7, -0.1]), np.array([0.6, -1.5, 0]), 1e-4
    capture = Capture(Laser(device, [x1]), Sensor(device, square_pixels([x3], h)), bins_of_path(1, 20, 0))
    result = simulate(scene, capture, Accuracy(1 << 17, 1, 3, 8), seed=3)

    n = 2000
    knots = ((np.arange(n) + 0.5) / n * 2 - 1) * 0.5
    y, z = (k.ravel() for k in np.meshgrid(knots, knots))
    x2 = np.stack([np.full_like(y, 2.0), y, z], axis=1)

    def clear(p: np.ndarray) -> np.ndarray:
        crossing = p + (x2 - p) * 0.5
        return ~((np.abs(crossing[:, 1] - 0.1) < 0.2) & (np.abs(crossing[:, 2]) < 0.35))

    r1, r3 = np.linalg.norm(x2 - x1, axis=1), np.linalg.norm(x2 - x3, axis=1)
    kernel = (2 / r1) ** 2 / r1**2 * (2 / r3) ** 2 / r3**2 * clear(x1) * clear(x3) / n**2
    omega = (2 * h) ** 2 * device[0] / np.linalg.norm(device - x3) ** 3
    truth = 0.9 * 0.7 * 0.9 / np.pi**3 * kernel.sum() * np.pi * 0.02**2 * omega
    assert 0.3 < (clear(x1) & clear(x3)).mean() < 0.9
    assert result.total.sum() + result.overflow.sum() == pytest.approx(truth, rel=2e-3)


def corner_capture(gap: float, half: float = 0.05, time: TimeAxis | None = None) -> Capture:
    """Laser point and pixel `gap` above the floor z = 0, at the foot of the wall x = 0."""
    return one_point_capture((0, -0.02, gap), (0, 0.02, gap + half), half, time or bins_of_path(64, 0.02, 0.0))


def corner_scene() -> Scene:
    wall = rectangle((0, 0, 1), (0, 1, 0), (0, 0, 1))
    floor = rectangle((1, 0, 0), (1, 0, 0), (0, 1, 0))
    return Scene.from_parts(
        [Part("wall", wall, Lambertian(0.8), "relay_wall"), Part("floor", floor, Lambertian(0.6), "structure")]
    )


@njit(cache=True)
def corner_quadrature(gap: float, half: float, radii: int, angles: int, ys: int, zs: int) -> float:
    """∫∫ cosθ₁cosθ₂/R₁₂² · cosθ₂′cosθ₃/R₂₃² · cosθ₃′/R₃ₛ² dA₂ dA₃ over the floor (2 × 2 m) and the pixel.

    Floor points in polar coordinates about the foot of the laser point, logarithmic in radius; pixel points dense
    near that foot too (sinh in y, logarithmic in z).
    """
    total = 0.0
    r_low, r_high = math.log(1e-6), math.log(2.5)
    z_low, z_high = math.log(1e-6), math.log(2 * half + 1e-6)
    t_low, t_high = math.asinh((0.04 - half) / 1e-3), math.asinh((0.04 + half) / 1e-3)
    for iz in range(zs):
        step = math.exp(z_low + (iz + 0.5) / zs * (z_high - z_low))
        z, dz = gap + step - 1e-6, step * (z_high - z_low) / zs
        for iy in range(ys):
            t = t_low + (iy + 0.5) / ys * (t_high - t_low)
            y, dy = -0.02 + 1e-3 * math.sinh(t), 1e-3 * math.cosh(t) * (t_high - t_low) / ys
            inner = 0.0
            for ir in range(radii):
                r = math.exp(r_low + (ir + 0.5) / radii * (r_high - r_low))
                for ia in range(angles):
                    a = (ia + 0.5) / angles * math.pi - math.pi / 2
                    x2, y2 = r * math.cos(a), -0.02 + r * math.sin(a)
                    if x2 < 2 and abs(y2) < 1:
                        first = r * r + gap * gap
                        second = x2 * x2 + (y - y2) ** 2 + z * z
                        inner += (x2 * gap / first**2) * (z * x2 / second**2) * r * r
            inner *= (r_high - r_low) / radii * math.pi / angles
            reach = 1.5**2 + (0.1 - y) ** 2 + (1.3 - z) ** 2
            total += inner * 1.5 / reach**1.5 * dy * dz
    return total


CORNER_GAP, CORNER_HALF = 1e-3, 0.05
CORNER_QUADRATURE = 0.3089204724
"""Values of `corner_quadrature` for these gaps with 240 × 160 × 96 × 64 points."""


@pytest.mark.parametrize("points", [(120, 80, 48, 32), pytest.param((240, 160, 96, 64), marks=pytest.mark.nightly)])
def test_the_quadrature_of_the_corner_has_converged(points: tuple[int, ...]) -> None:
    assert corner_quadrature(CORNER_GAP, CORNER_HALF, *points) == pytest.approx(CORNER_QUADRATURE, rel=5e-4)


def test_surfaces_that_touch_converge_and_stay_bounded() -> None:
    """Field of view and laser point are a millimetre above the floor: 1/R² is unbounded there, the estimate is
    bounded."""
    scene, gap, half = corner_scene(), CORNER_GAP, CORNER_HALF
    truth = 0.8 * 0.6 * 0.8 / np.pi**3 * np.pi * 0.02**2 * CORNER_QUADRATURE

    def energy(lookins: int, points: int, seed: int) -> float:
        result = simulate(scene, corner_capture(gap, half), Accuracy(lookins, points, 3, 1), seed=seed)
        return float(result.total.sum() + result.overflow.sum())

    assert energy(1 << 16, 16, 1) == pytest.approx(truth, rel=2e-3)
    single = np.array([energy(1, 1, seed) for seed in range(300)])
    # One lookin carries at most ρ₁, and at most a share 1 of it lands in the pixel: L ≤ 2 ρ₁ρ₂ρ₃/π A/R²ₛ (both ways).
    bound = 2 * 0.8 * 0.6 * 0.8 / np.pi * np.pi * 0.02**2 / (DEVICE[0] ** 2)
    assert single.max() < bound
    error = stats.sem(single)
    assert abs(single.mean() - truth) < stats.norm.ppf(1 - 0.5e-3) * error * 1.5


def test_nothing_visible_is_a_zero_transient() -> None:
    scene = Scene.from_parts(
        [Part("wall", rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1)), Lambertian(0.8), "relay_wall")]
    )
    away = Capture(
        Laser((1, 0, 0), [[2, 0, 0], [0, 0, 0]]),
        Sensor((1, 0, 0), np.concatenate([square_pixels([[0, 0.2, 0]], 0.1), square_pixels([[2, 0, 0]], 0.1)])),
        bins_of_path(50, 0.1, 0.0),
    )
    for result in (simulate(scene, away, ACCURACY), simulate(scene, replace(away, pairing="confocal"), ACCURACY)):
        assert not result.total.any()
        assert not result.overflow.any()
        assert result.relative_error == 0.0
        assert np.isnan(result.laser_points[0]).all()
        np.testing.assert_allclose(result.laser_points[1], 0.0, atol=1e-12)


def test_degenerate_duplicate_and_inverted_triangles_change_nothing() -> None:
    scene, capture = furnished_box(), one_point_capture()
    plain = simulate(scene, capture, ACCURACY, seed=9)
    box = trimesh.Trimesh(scene.vertices, scene.triangles[scene.faces_of("box")], process=False)
    messy = trimesh.Trimesh(
        box.vertices, np.concatenate([box.faces[:, ::-1], box.faces[:4], np.repeat(box.faces[:3, :1], 3, axis=1)]),
        process=False,
    )  # fmt: skip
    parts = [
        Part(name, messy if name == "box" else trimesh.Trimesh(scene.vertices, scene.triangles[scene.faces_of(name)],
             process=False), material, role)
        for name, material, role in zip(scene.part_names, scene.materials, scene.roles, strict=True)
    ]  # fmt: skip
    result = simulate(Scene.from_parts(parts), capture, ACCURACY, seed=9)
    for name in scene.part_names:
        sigma = 3 * (plain.stderr.sum() + 1e-30)
        assert abs(result.parts[name].sum() - plain.parts[name].sum()) < sigma
    assert result.total.sum() == pytest.approx(plain.total.sum(), rel=5e-3)


def test_same_seed_same_bytes_another_seed_others() -> None:
    scene, capture = furnished_box(), one_point_capture()
    a, b, c = (simulate(scene, capture, Accuracy(512, 2, 3, 2), seed=s) for s in (5, 5, 6))
    assert a.total.tobytes() == b.total.tobytes()
    assert a.total.tobytes() != c.total.tobytes()
