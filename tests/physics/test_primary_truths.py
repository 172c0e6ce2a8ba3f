"""The primary against three truths: a small patch (closed form), a rectangle (numerical integral), the inside of a
sphere."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from lit_plate import plate_by_quadrature
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats
from sphere_chords import BINS, QUAD, SPOT, WIDTH_M, stored

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, simulate
from datagen.transport.fields_of_view import PixelCones
from datagen.units import SPEED_OF_LIGHT_M_PER_S as C

APERTURE_M2 = np.pi * 0.02**2
BY_ELEMENTS = Accuracy(target=0.005, max_bounces=3)


def wall_and(plate: trimesh.Trimesh, albedo: float = 0.6) -> Scene:
    wall = rectangle((0, 0, 0), (0, 3, 0), (0, 0, 3))
    return Scene.from_parts(
        [Part("wall", wall, Lambertian(0.8), "relay_wall"), Part("plate", plate, Lambertian(albedo))]
    )


@pytest.mark.parametrize("origin", ["wall", "source"])
def test_small_patch_amplitude_and_arrival_time(origin: str) -> None:
    """L = (ρ₁/π) cosθ₁cosθ₂ a/R₁₂² · (ρ₂/π) cosθ₂′cosθ₃/R₂₃² · (ρ₃/π) A Ω, at one time."""
    side, h = 1e-3, 5e-4
    x2, n2 = np.array([1.2, 0.5, -0.3]), np.array([-1.0, 0, 0])
    x1, x3, device = np.array([0, -0.4, 0.2]), np.array([0, 0.9, 0.1]), np.array([2.0, -1.0, 0.4])
    scene = wall_and(rectangle(x2, (0, side / 2, 0), (0, 0, side / 2)))
    r12, r23, r3s = np.linalg.norm(x2 - x1), np.linalg.norm(x3 - x2), np.linalg.norm(device - x3)
    path = r12 + r23 + (r3s + np.linalg.norm(device - x1) if origin == "source" else 0.0)
    capture = Capture(
        Laser(device, [x1]), Sensor(device, square_pixels([x3], h)), bins_of_path(400, 1e-5, path - 2e-3, origin)
    )
    result = simulate(scene, capture, Accuracy(256, 4, 3, 2), seed=3)

    cos1, cos2 = (x2 - x1)[0] / r12, n2 @ (x1 - x2) / r12
    cos2_out, cos3 = n2 @ (x3 - x2) / r23, -(x3 - x2)[0] / r23
    omega = (2 * h) ** 2 * (device - x3)[0] / r3s**3
    patch = 0.8 / np.pi * cos1 * cos2 / r12**2 * side**2
    expected = patch * 0.6 / np.pi * cos2_out * cos3 / r23**2 * 0.8 / np.pi * APERTURE_M2 * omega
    assert result.total.sum() == pytest.approx(expected, rel=1e-5)
    mean_time = (result.total[0, 0] * capture.time.centers_s).sum() / result.total.sum()
    assert mean_time == pytest.approx(path / C, abs=1e-5 / C)


@pytest.mark.parametrize("accuracy", [Accuracy(1 << 17, 1, 3, 1), BY_ELEMENTS], ids=["paths", "elements"])
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
    assert np.abs(result.total[:, 0] - truth).sum() / truth.sum() < 0.01
    if accuracy is BY_ELEMENTS:
        assert np.linalg.norm(result.total[:, 0] - truth) < 0.008 * np.linalg.norm(truth)
    assert result.total.sum() == pytest.approx(truth.sum(), rel=1e-4)


def sphere_capture() -> Capture:
    return Capture(Laser((0, 0, 0.0), [SPOT]), Sensor((0, 0, 0.0), QUAD), bins_of_path(BINS, WIDTH_M, 0.0))


@pytest.fixture(scope="module")
def ball() -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=6)
    # Scaled so that the polyhedron has the unit sphere's area: its energy is then right to second order.
    mesh.apply_scale(np.sqrt(4 * np.pi / mesh.area))
    return mesh


@pytest.mark.parametrize("albedo", [0.3, 1.0])
def test_inside_of_a_sphere_energy(ball: trimesh.Trimesh, albedo: float) -> None:
    """Every vertex after a bounce is uniform on the sphere, so L = ρ³/π · A Ω / (4π r²) whatever the geometry."""
    scene = Scene.from_parts([Part("sphere", ball, Lambertian(albedo), "structure")])
    capture = sphere_capture()
    result = simulate(scene, capture, Accuracy(1 << 16, 16, 3, 4), seed=2)
    omega = PixelCones.of(capture.sensor).solid_angle[0]
    expected = albedo**3 / np.pi / (4 * np.pi) * APERTURE_M2 * omega
    assert (result.total.sum() + result.overflow.sum()) == pytest.approx(expected, rel=5e-4)


def test_inside_of_a_sphere_shape(ball: trimesh.Trimesh) -> None:
    """Arrival times are distributed as the length of two chords that meet in a uniform point: 16 runs, level 10⁻³
    over the bins."""
    scene = Scene.from_parts([Part("sphere", ball, Lambertian(0.8), "structure")])
    capture = sphere_capture()
    runs = np.array([simulate(scene, capture, Accuracy(4096, 8, 3, 1), seed=s).total[0, 0] for s in range(16)])
    measured, stderr = runs.mean(axis=0), runs.std(axis=0, ddof=1) / np.sqrt(len(runs))

    share, error = stored().of(3)
    omega = PixelCones.of(capture.sensor).solid_angle[0]
    primary = 0.8**3 / np.pi / (4 * np.pi) * APERTURE_M2 * omega
    expected = primary * share
    filled = measured > 1e-3 * measured.max()
    noise = stderr[filled] ** 2 + (primary * error[filled]) ** 2
    t2 = (measured[filled] - expected[filled]) ** 2 / noise
    # With 16 runs each term is about F(1, 15): mean 15/13, variance 2·15²·14 / (13²·11). Level 10⁻³, one-sided.
    mean, variance = 15 / 13, 2 * 15**2 * 14 / (13**2 * 11)
    z = (t2.sum() - filled.sum() * mean) / np.sqrt(filled.sum() * variance)
    assert z < stats.norm.ppf(1 - 1e-3)
    assert np.abs(measured - expected).sum() / expected.sum() < 0.01


def test_reciprocity() -> None:
    """Swapping laser point and FoV point leaves the transient between them as it was."""
    scene = furnished_box()
    a, b, device, h = np.array([0, -0.8, 1.4]), np.array([0, 0.5, 0.9]), np.array([1.5, 0.1, 1.3]), 1e-3
    there, back = (
        simulate(scene, one_point_capture(p, q, h, device=device), Accuracy(1 << 16, 1, 3, 8), seed=s)
        for p, q, s in ((a, b, 1), (b, a, 2))
    )
    # The solid angle of the pixel differs with the place of the FoV point; E₃ per photon does not.
    solid = [h**2 * 4 * device[0] / np.linalg.norm(device - p) ** 3 for p in (b, a)]
    e_there, e_back = there.total / solid[0], back.total / solid[1]
    assert e_there.sum() == pytest.approx(e_back.sum(), rel=2e-3)
    sigma = np.hypot(there.stderr / solid[0], back.stderr / solid[1])
    filled = sigma > 0
    z = np.abs(e_there - e_back)[filled] / sigma[filled]
    # Two estimates of 8 replicates each: Student's t with about 14 degrees, Bonferroni over the bins at 10⁻³.
    assert z.max() < stats.t.ppf(1 - 0.5e-3 / filled.sum(), 14)
