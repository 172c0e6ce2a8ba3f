"""All orders of bounces: the inside of a sphere, the direct return, attenuation, the aperture, components."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats
from sphere_chords import BINS, ORDERS, QUAD, SPOT, WIDTH_M, chords, stored, unit_ball

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, simulate
from datagen.transport.fields_of_view import PixelCones

APERTURE_M2 = np.pi * 0.02**2


def in_the_ball(albedo: float, subdivisions: int = 5) -> tuple[Scene, Capture, float]:
    """Scene, capture, and the energy of the primary, L = ρ³/π · A Ω / (4π r²)."""
    scene = Scene.from_parts([Part("sphere", unit_ball(subdivisions), Lambertian(albedo), "structure")])
    capture = Capture(Laser((0, 0, 0.0), [SPOT]), Sensor((0, 0, 0.0), QUAD), bins_of_path(BINS, WIDTH_M, 0.0))
    omega = PixelCones.of(capture.sensor).solid_angle[0]
    return scene, capture, albedo**3 / np.pi / (4 * np.pi) * APERTURE_M2 * omega


def test_sphere_energy_for_three_to_six_bounces() -> None:
    """Each extra bounce multiplies the energy by ρ."""
    albedo = 0.3
    scene, capture, primary = in_the_ball(albedo)
    energy = {}
    for last in (3, 4, 5, 6):
        result = simulate(scene, capture, Accuracy(samples=1 << 15, max_bounces=last), seed=last)
        energy[last] = result.total.sum() + result.overflow.sum()
        assert energy[last] == pytest.approx(primary * sum(albedo**k for k in range(last - 2)), rel=1e-3, abs=0)
    assert energy[6] - energy[5] == pytest.approx(primary * albedo**3, rel=1e-2, abs=0)


def test_sphere_shape_for_three_to_six_bounces() -> None:
    """The arrival times of b bounces are distributed as the length of b − 1 chords between uniform points: compared
    by t² of each bin and order.

    The mean and the error of each bin come from 16 independent runs with several laser points at one place; the truth
    from 16 million chains of uniform points. The level is 10⁻³ over 4 orders.
    """
    scene, capture, primary = in_the_ball(0.8, subdivisions=6)
    laser, sensor = Laser((0, 0, 0.0), [SPOT] * 16), Sensor((0, 0, 0.0), np.repeat(QUAD, 16, axis=0))
    sixteen = Capture(laser, sensor, capture.time, "confocal")
    fifth, both = (simulate(scene, sixteen, Accuracy(samples=4096, max_bounces=last), seed=600) for last in (5, 6))
    runs: dict[int, NDArray[np.float64]] = {
        3: both.components["primary"][:, 0],
        4: both.components["secondary"][:, 0],
        5: fifth.components["higher"][:, 0],
        # The same seed walks the same paths, so the difference is the sixth bounce alone.
        6: (both.components["higher"] - fifth.components["higher"])[:, 0],
    }
    for order in ORDERS:
        energy = primary * 0.8 ** (order - 3)
        truth, truth_error = (energy * values for values in stored().of(order))
        mean, error = runs[order].mean(axis=0), runs[order].std(axis=0, ddof=1) / 4
        filled = mean > 1e-3 * mean.max()
        t2 = (mean[filled] - truth[filled]) ** 2 / (error[filled] ** 2 + truth_error[filled] ** 2)
        # Each term is about F(1, 15): mean 15/13, variance 2·15²·14 / (13²·11).
        z = (t2.sum() - filled.sum() * 15 / 13) / np.sqrt(filled.sum() * 2 * 15**2 * 14 / (13**2 * 11))
        assert z < stats.norm.ppf(1 - 1e-3 / 4), order


@pytest.mark.nightly
def test_the_stored_chords_are_those_of_other_chains() -> None:
    """16 sets of other chains agree with the 32 stored sets by Welch's t for each bin, at 10⁻³ over all orders and
    bins."""
    kept, anew = stored(), chords(16, 250_000, 2)
    filled = kept.share > 1e-3 * kept.share.max(axis=1, keepdims=True)
    t = np.abs(anew.share - kept.share)[filled] / np.hypot(anew.error, kept.error)[filled]
    assert t.max() < stats.t.isf(0.5e-3 / filled.sum(), 15)


def test_russian_roulette_follows_all_orders_without_bias() -> None:
    """All orders in the sphere sum to 1/(1 − ρ) times the primary."""
    scene, capture, primary = in_the_ball(0.6)
    result = simulate(scene, capture, Accuracy(samples=1 << 17, max_bounces=None), seed=2)
    total = result.total.sum() + result.overflow.sum()
    assert total == pytest.approx(primary / (1 - 0.6), rel=4e-3, abs=0)


def test_components_add_up_and_orders_do_not_disturb_each_other() -> None:
    scene, capture = furnished_box(), one_point_capture(time=bins_of_path(60, 0.3, 0.0))
    few = simulate(scene, capture, Accuracy(samples=2048, max_bounces=3), seed=3)
    many = simulate(scene, capture, Accuracy(samples=2048, max_bounces=6, direct=True), seed=3)
    assert list(many.components) == ["direct", "primary", "secondary", "higher"]
    np.testing.assert_allclose(sum(many.components.values()), many.total, rtol=1e-12)
    np.testing.assert_allclose(sum(many.parts.values()), many.components["primary"], rtol=1e-12)
    assert many.components["primary"].sum() == pytest.approx(few.components["primary"].sum(), rel=0.02, abs=0)


def test_light_is_linear_in_each_albedo_order_by_order() -> None:
    """Exactly, because the paths are the same: halving every albedo divides the primary by 2³ and the secondary by
    2⁴; halving one part's, the light of a path by 2 for each bounce on that part."""
    capture, accuracy = one_point_capture(time=bins_of_path(60, 0.3, 0.0)), Accuracy(samples=2048, max_bounces=4)
    scene = furnished_box(0.8)
    bright, dark = (simulate(of, capture, accuracy, seed=3) for of in (scene, furnished_box(0.4)))
    np.testing.assert_allclose(dark.components["primary"] * 8, bright.components["primary"], rtol=1e-9)
    np.testing.assert_allclose(dark.components["secondary"] * 16, bright.components["secondary"], rtol=1e-9)
    for name, bounces in (("relay_wall", 2), ("box", 1)):
        materials = tuple(
            Lambertian(0.4) if n == name else m for n, m in zip(scene.part_names, scene.materials, strict=True)
        )
        dimmed = simulate(replace(scene, materials=materials), capture, accuracy, seed=3).parts
        np.testing.assert_allclose(dimmed["box"], bright.parts["box"] * 0.5**bounces, rtol=1e-9)
        if name == "box":
            np.testing.assert_allclose(dimmed["floor"], bright.parts["floor"], rtol=1e-9)


def test_attenuation_is_exp_of_the_whole_path() -> None:
    """With the time origin at the source each bin is one path length, so its light is dimmed by exp(−a path),
    whatever the leg."""
    capture = one_point_capture(time=bins_of_path(4000, 0.005, 0.0, "source"))
    clear = simulate(furnished_box(), capture, Accuracy(samples=2048, max_bounces=5, direct=True), seed=1)
    foggy = simulate(
        replace(furnished_box(), attenuation_per_m=0.7),
        capture,
        Accuracy(samples=2048, max_bounces=5, direct=True),
        seed=1,
    )
    path = 0.005 * (np.arange(4000) + 0.5)
    filled = clear.total[0, 0] > 0
    ratio = foggy.total[0, 0][filled] / clear.total[0, 0][filled]
    np.testing.assert_allclose(ratio, np.exp(-0.7 * path[filled]), rtol=0.7 * 0.006)


def test_direct_return_of_the_laser_point_in_closed_form() -> None:
    """One bounce brings ρ/π cosθ A/R², at the path of both device legs (0 with the origin at the wall), in the pixel
    that sees the laser point."""
    wall = Scene.from_parts([Part("wall", rectangle((0, 0, 0), (0, 2, 0), (0, 0, 2)), Lambertian(0.8), "relay_wall")])
    laser, sensor, spot = np.array([2.0, 0.5, 0]), np.array([1.5, -0.2, 0.3]), np.array([0, 0.1, 0.2])
    pixels = square_pixels([spot, [0, 0.6, 0.2]], 0.1)
    out = sensor - spot
    reach = np.linalg.norm(out)
    expected = 0.8 / np.pi * out[0] / reach * APERTURE_M2 / reach**2
    for origin, path in (("source", np.linalg.norm(laser - spot) + reach), ("wall", 0.0)):
        capture = Capture(Laser(laser, [spot]), Sensor(sensor, pixels), bins_of_path(1000, 0.01, -0.02, origin))
        result = simulate(wall, capture, Accuracy(samples=64, max_bounces=3, direct=True), seed=1)
        direct = result.components["direct"][0]
        assert direct[0].sum() == pytest.approx(expected, rel=1e-9, abs=0)
        assert np.flatnonzero(direct[0]) == int((path + 0.02) / 0.01)
        assert not direct[1].any()
        assert not result.components["primary"].any()
        assert not result.stderr.any()


def test_direct_return_of_two_bounces_by_quadrature() -> None:
    """A side wall in the field of view is lit by the laser point on the wall beside it, down to the corner that both
    share."""
    wall = rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1))
    side = rectangle((1, 1, 0), (1, 0, 0), (0, 0, 1))
    scene = Scene.from_parts([Part("wall", wall, Lambertian(0.8), "relay_wall"), Part("side", side, Lambertian(0.5))])
    spot, device = np.array([0, 0.9, 0.1]), np.array([1.0, -1.0, 0.0])
    low, high = np.array([1e-9, -0.3]), np.array([0.6, 0.4])
    corners = np.array([[low[0], 1, low[1]], [high[0], 1, low[1]], [high[0], 1, high[1]], [low[0], 1, high[1]]])
    capture = Capture(Laser(device, [spot]), Sensor(device, [corners]), bins_of_path(1, 20.0, 0.0))
    result = simulate(scene, capture, Accuracy(samples=1 << 15, max_bounces=3, direct=True), seed=2)
    n = 1500
    x, z = (
        low[k] + (high[k] - low[k]) * (np.arange(n) + 0.5) / n for k in (0, 1)
    )  # fmt: skip
    x, z = (g.ravel() for g in np.meshgrid(x, z))
    d = np.stack([x, np.full_like(x, 0.1), z - 0.1], axis=1)
    r2 = (d**2).sum(axis=1)
    e3 = 0.8 / np.pi * d[:, 0] * d[:, 1] / r2**2
    to_sensor = device - np.stack([x, np.ones_like(x), z], axis=1)
    reach = np.linalg.norm(to_sensor, axis=1)
    truth = (e3 * 0.5 / np.pi * -to_sensor[:, 1] / reach**3).sum() * np.prod(high - low) / n**2 * APERTURE_M2
    measured = result.components["direct"].sum() + result.overflow.sum()
    assert measured == pytest.approx(truth, rel=2e-3, abs=0)


def test_a_near_disc_aperture_receives_its_exact_share() -> None:
    """From an on-axis point a facing disc receives a²/(R² + a²) of what a Lambertian point scatters."""
    scene = Scene.from_parts(
        [Part("wall", rectangle((0, 0, 0), (0, 2, 0), (0, 0, 2)), Lambertian(0.8), "relay_wall")]
    )
    for distance in (0.02, 0.2, 2.0):
        sensor = Sensor((distance, 0, 0), square_pixels([[0, 0, 0]], 1e-3), 0.02, finite_aperture=True)
        capture = Capture(Laser((1.0, 0.5, 0), [[0, 0, 0]]), sensor, bins_of_path(10, 1.0, 0.0))
        result = simulate(scene, capture, Accuracy(samples=16, max_bounces=3, direct=True), seed=1)
        received = result.components["direct"].sum() + result.overflow.sum()
        assert received == pytest.approx(0.8 * 0.02**2 / (distance**2 + 0.02**2), rel=1e-6, abs=0)


@pytest.mark.parametrize("pairing", ["exhaustive", "confocal"])
def test_many_pixels_give_what_each_gives_alone(pairing: str) -> None:
    """Array sensors, single pixels, confocal and exhaustive scans run the same code and give each pixel the same
    light."""
    scene, device, axis = furnished_box(), np.array([1.5, 0.1, 1.3]), bins_of_path(20, 0.8, 0.0)
    points = np.array([[0, y, 1.3] for y in (-0.8, 0.0, 0.8)])
    pixels = square_pixels(points, 0.1)
    accuracy = Accuracy(samples=1 << 13, max_bounces=4)
    capture = Capture(Laser(device, points), Sensor(device, pixels), axis, pairing)  # type: ignore[arg-type]
    together = simulate(scene, capture, accuracy, seed=1)
    worst = []
    for i in range(3):
        for k, p in enumerate([i] if pairing == "confocal" else range(3)):
            alone = simulate(
                scene, Capture(Laser(device, points[[i]]), Sensor(device, pixels[[p]]), axis), accuracy, seed=2
            )
            sigma = np.hypot(alone.stderr[0, 0], together.stderr[i, k])
            filled = sigma > 0
            worst.append((np.abs(alone.total[0, 0] - together.total[i, k])[filled] / sigma[filled]).max())
            assert alone.total.sum() == pytest.approx(together.total[i, k].sum(), rel=0.02, abs=0)
    # Bonferroni over at most 9 × 20 bins at 10⁻³, Student's t with about 14 degrees.
    assert max(worst) < stats.t.ppf(1 - 0.5e-3 / 180, 14)
