"""Flood illumination: its quadrature, its convergence to a closed form, its standard error, and refused settings."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from test_scans import SQUARE_ROOM

import datagen as dg
from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.records import Capture, Scene
from datagen.transport.flood import with_delays

ROOM: dict[str, Any] = {**SQUARE_ROOM, "materials": {"relay_wall": {"albedo": 0.8}}}
SIDE_M, ZONES = 1.2, 4


def flood(points: int, **capture: Any) -> DatasetConfig:
    zones = {"rows": ZONES, "columns": ZONES, "width_m": SIDE_M, "height_m": SIDE_M, "aperture_radius_mm": 2}
    settings = {
        "pairing": "exhaustive", "illumination": "flood", "scan": {"rows": points, "columns": points},
        "field_of_view": zones, "time": {"bins": 256, "bin_width_ps": 250, "origin": "source"},
    }  # fmt: skip
    return config_from_mapping({"seed": 5, "scene": ROOM, "capture": settings | capture})


@pytest.fixture(scope="module")
def scene() -> Scene:
    return dg.generate_scene(flood(4).scene, seed=5, index=0)


def captured(points: int, scene: Scene, **more: Any) -> Capture:
    return dg.capture_for(flood(points, **more), scene)


def direct_of(zone: np.ndarray, capture: Capture, cells: int = 200) -> float:
    """(1/lit area) ∫ over the zone of (ρ/π) cosθ A/R² dA by the midpoint rule: light of the first return."""
    u = (np.arange(cells) + 0.5) / cells
    across, up = np.meshgrid(u, u)
    places = zone[0] + across[..., None] * (zone[1] - zone[0]) + up[..., None] * (zone[3] - zone[0])
    toward = capture.sensor.position - places
    square = (toward**2).sum(axis=-1)
    cosine = -toward[..., 0] / np.sqrt(square)
    mean = float((0.8 / np.pi * cosine * capture.sensor.aperture_area_m2 / square).mean())
    return mean / ZONES**2


def test_first_return_converges_at_second_order_to_its_integral(scene: Scene) -> None:
    """The error of each zone falls fourfold for four times the points."""
    errors = []
    for points in (4, 8, 16):
        capture = captured(points, scene)
        found = dg.simulate(scene, capture, dg.Accuracy(samples=1, direct=True)).components["direct"]
        truth = np.array([direct_of(zone, capture) for zone in capture.sensor.pixels])
        errors.append(np.abs(found.sum(axis=-1)[0] / truth - 1).max())
    assert errors[2] < 2e-4
    for coarse, fine in pairwise(errors):
        assert 3.5 < coarse / fine < 4.5


def test_a_flood_is_the_mean_of_its_points(scene: Scene) -> None:
    capture = captured(4, scene)
    accuracy = dg.Accuracy(samples=32, max_bounces=4, direct=True)
    once = dg.simulate(scene, capture, accuracy, seed=3)
    points = dg.simulate(scene, replace(capture, illumination="scan"), accuracy, seed=3)
    assert once.total.shape == capture.shape == (1, 16, 256)
    assert points.total.shape == (16, 16, 256)
    np.testing.assert_allclose(once.total[0], points.total.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(once.overflow[0], points.overflow.mean(axis=0), rtol=1e-12)
    np.testing.assert_array_equal(once.laser_points, points.laser_points)
    assert set(once.parts) == set(points.parts)


DELAYS_BINS = np.array([0.0, 3.0, -2.0, 0.25, 4.75, -0.25, -3.6, 260.0, -300.5])


def test_a_delay_moves_the_mean_time_of_light_and_loses_none_but_at_the_ends() -> None:
    """Delays of whole bins and of parts of them, early and late: the mean time is moved by the delay, the energy
    stays, and no light goes further than into the bins on either side. Beyond the window nothing is left."""
    bins, pixels = 256, len(DELAYS_BINS)
    axis = dg.TimeAxis(bins=bins, width_s=2.5e-10)
    light = np.zeros((1, pixels, bins))
    light[:, :, 100:130] = np.random.default_rng(0).random((pixels, 30))
    corners = np.array([(1, -1, -1), (1, 1, -1), (1, 1, 1), (1, -1, 1)], float)
    sensor = dg.Sensor((0, 0, 0), np.tile(corners, (pixels, 1, 1)), delays_s=DELAYS_BINS * axis.width_s)
    late = with_delays(light, sensor, axis)
    kept = np.abs(DELAYS_BINS) < 100
    assert not late[:, ~kept].any()
    energy, mean = late.sum(axis=2)[0], late[0] @ axis.centers_s
    assert energy[kept] == pytest.approx(light.sum(axis=2)[0, kept], rel=1e-12)
    moved = (mean / light.sum(axis=2)[0] - light[0] @ axis.centers_s / light.sum(axis=2)[0]) / axis.width_s
    assert moved[kept] == pytest.approx(DELAYS_BINS[kept], abs=1e-9)
    for pixel in np.flatnonzero(kept):
        filled = np.flatnonzero(late[0, pixel])
        assert filled[0] == 100 + np.floor(DELAYS_BINS[pixel])
        assert filled[-1] == 129 + np.ceil(DELAYS_BINS[pixel])


def test_a_flood_records_the_light_of_each_pixel_late_by_its_delay(scene: Scene) -> None:
    capture = captured(4, scene)
    accuracy, delay = dg.Accuracy(samples=32, max_bounces=3, direct=True), np.linspace(-1.3, 2.9, 16)
    late = replace_sensor(capture, delays_s=delay * capture.time.width_s)
    plain, moved = (dg.simulate(scene, of, accuracy, seed=3).total[0] for of in (capture, late))
    centers = capture.time.centers_s / capture.time.width_s
    shift = moved @ centers / moved.sum(axis=1) - plain @ centers / plain.sum(axis=1)
    # A little of the light leaves the window.
    assert moved.sum(axis=1) == pytest.approx(plain.sum(axis=1), rel=1e-3)
    assert shift == pytest.approx(delay, abs=0.1)


def replace_sensor(capture: Capture, **more: Any) -> Capture:
    sensor = capture.sensor
    return replace(capture, sensor=dg.Sensor(sensor.position, sensor.pixels, sensor.aperture_radius_m, **more))


def test_a_flood_whose_first_point_has_all_light_is_that_point_alone(scene: Scene) -> None:
    """And one that fades is the sum of its points, each with its share."""
    capture = captured(4, scene)
    accuracy = dg.Accuracy(samples=32, max_bounces=4, direct=True)

    def light(laser: dg.Laser, illumination: str = "flood") -> dg.Transient:
        return dg.simulate(scene, replace(capture, laser=laser, illumination=illumination), accuracy, seed=3)

    place, targets = capture.laser.position, capture.laser.targets
    points = light(dg.Laser(place, targets), "scan")
    for shares in (np.eye(16)[0], np.exp(-0.5 * np.arange(16.0) / 3)):
        flood = light(dg.Laser(place, targets, shares))
        due = np.einsum("l,lpt->pt", shares / shares.sum(), points.total)
        np.testing.assert_allclose(flood.total[0], due, rtol=1e-12)
        np.testing.assert_allclose(flood.overflow[0], shares / shares.sum() @ points.overflow, rtol=1e-12)
    alone = light(dg.Laser(place, targets[:1]))
    np.testing.assert_allclose(light(dg.Laser(place, targets, np.eye(16)[0])).components["direct"],
                               alone.components["direct"], rtol=1e-9)  # fmt: skip


def test_standard_error_is_the_spread_of_repetitions(scene: Scene) -> None:
    """Over 24 seeds, the root mean square spread of all bins is the stated one, to a fifth."""
    capture = captured(4, scene)
    made = [dg.simulate(scene, capture, dg.Accuracy(samples=16), seed=k) for k in range(24)]
    spread = np.stack([t.total for t in made]).var(axis=0, ddof=1).sum()
    stated = np.mean([(t.stderr**2).sum() for t in made])
    assert 0.8 < np.sqrt(spread / stated) < 1.2


def test_points_are_midpoints_of_cells_that_fill_the_field_of_view(scene: Scene) -> None:
    capture = captured(8, scene)
    zones, targets = capture.sensor.pixels, capture.laser.targets
    low, high = zones.min(axis=1), zones.max(axis=1)
    inside = ((targets[:, None, 1:] > low[:, 1:]) & (targets[:, None, 1:] < high[:, 1:])).all(axis=-1)
    assert (inside.sum(axis=0) == 4).all()
    for zone, own in zip(zones, inside.T, strict=True):
        np.testing.assert_allclose(targets[own].mean(axis=0), zone.mean(axis=0), atol=1e-12)


def test_impossible_floods_are_refused(scene: Scene) -> None:
    with pytest.raises(InputError, match=r"illumination = 'flood' with pairing 'confocal'"):
        flood(4, pairing="confocal", field_of_view={})
    with pytest.raises(InputError, match=r"scan\.rows = 6 with .*field_of_view\.rows = 4.*take a multiple of 4"):
        flood(6)
    with pytest.raises(InputError, match=r"65536 points × 16 pixels × 1000 bins.*take fewer of one of them"):
        flood(256, time={"bins": 1000})
    with pytest.raises(InputError, match=r"Capture\.illumination = 'bulb'"):
        replace(captured(4, scene), illumination="bulb")
