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
