"""What zones see: depth by zone against closed forms, and the direct light of each part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from rooms import ONE_BOUNCE

import datagen as dg
from datagen.devices import share_of_late_zones

at = trimesh.transformations.translation_matrix


def room(*, tilt: float = 0.0, box_m: float | None = None) -> dg.Scene:
    """A wall 0.8 m ahead along x, tilted about the vertical, and a box before its left half."""
    wall = trimesh.creation.box((0.1, 20, 20), at((0.85, 0, 0)))
    wall.apply_transform(trimesh.transformations.rotation_matrix(tilt, (0, 0, 1), (0.8, 0, 0)))
    parts = [dg.Part("wall", wall, dg.Lambertian(0.8), role="relay_wall")]
    if box_m is not None:
        box = trimesh.creation.box(bounds=[(box_m, 0, -5), (0.75, 5, 5)])
        parts.append(dg.Part("box", box, dg.Lambertian(0.4)))
    return dg.Scene.from_parts(parts)


def capture_of(name: str) -> dg.Capture:
    return dg.device(name).at((0, 0, 0), (1, 0, 0))[0]


@pytest.mark.parametrize(("name", "tilt"), [("vl53l8ch", 0.3), ("tmf8820", 0.0), ("uneven", 0.3)])
def test_depth_before_a_plane_has_its_closed_form(name: str, tilt: float) -> None:
    """A plane n·x = d is met along w at t w with t = d / n·w: the mean over the footprint of t w·a, a the axis."""
    capture = capture_of("vl53l8ch_4x4" if name == "uneven" else name)
    if name == "uneven":
        seen, weights = capture.sensor, np.random.default_rng(1).random((16, 2, 4)) ** 3
        capture = replace(capture, sensor=dg.Sensor(seen.position, seen.pixels, footprints=weights))
    normal = np.array([np.cos(tilt), np.sin(tilt), 0.0])
    distance = 0.8 * normal[0]
    u, v = np.meshgrid((np.arange(200) + 0.5) / 200, (np.arange(200) + 0.5) / 200)
    due = []
    for p, corners in enumerate(capture.sensor.pixels):
        a, b, _, d = corners
        w = a + u[..., None] * (b - a) + v[..., None] * (d - a)
        axis = corners.mean(axis=0) / np.linalg.norm(corners.mean(axis=0))
        weights = np.ones_like(u)
        if (sensitivity := capture.sensor.footprints) is not None:
            rows, columns = sensitivity.shape[1:]
            weights = sensitivity[p][(v * rows).astype(int), (u * columns).astype(int)]
        due.append(np.average(distance / (w @ normal) * (w @ axis), weights=weights))
    np.testing.assert_allclose(dg.zone_depth(room(tilt=tilt), capture), due, rtol=2e-3)


def test_a_zone_that_sees_nothing_has_no_depth() -> None:
    capture = capture_of("vl53l8ch_4x4")
    half = dg.Scene.from_parts([dg.Part("box", trimesh.creation.box(bounds=[(0.5, 0, -5), (0.6, 5, 5)]),
                                        dg.Lambertian(0.5))])  # fmt: skip
    depth = dg.zone_depth(half, capture).reshape(4, 4)
    assert np.isfinite(depth[:, :2]).all() and np.isnan(depth[:, 3]).all()
    assert share_of_late_zones(half, capture) == 0.0


def test_zones_of_light_beyond_the_time_axis_are_counted() -> None:
    """A time axis that ends between box and wall misses what the zones on the right see."""
    capture = capture_of("vl53l8ch_4x4")
    short = dg.TimeAxis(20, 0.2e-9)
    early = dg.Capture(capture.laser, capture.sensor, short, "exhaustive", "flood")
    assert share_of_late_zones(room(box_m=0.3), early) == 0.5
    assert share_of_late_zones(room(box_m=0.3), capture) == 0.0


@pytest.mark.parametrize("bounces", [1, 3])
def test_parts_share_the_direct_light(bounces: int) -> None:
    """The direct light of all parts is all direct light but that of the cover glass, and each part's is where it is:
    what is left when all others are black."""
    capture, _, _ = dg.device("tmf8820").at((0, 0, 0), (1, 0, 0))
    bare = dg.Sensor(capture.sensor.position, capture.sensor.pixels, capture.sensor.aperture_radius_m, False,
                     capture.sensor.footprints, capture.sensor.crosstalk, None, capture.sensor.delays_s)  # fmt: skip
    capture = dg.Capture(capture.laser, bare, capture.time, "exhaustive", "flood")
    accuracy = dg.Accuracy(samples=16, max_bounces=bounces, direct=True)
    scene = room(box_m=0.3)
    light = dg.simulate(scene, capture, accuracy, seed=1)
    if bounces == 1:
        np.testing.assert_allclose(sum(light.parts.values()), light.total, rtol=1e-12, atol=1e-25)
    dark = dg.simulate(scene, capture, dg.Accuracy(samples=16, max_bounces=3), seed=1)
    for k, name in enumerate(scene.part_names):
        black = [m if j == k else dg.Lambertian(0.0) for j, m in enumerate(scene.materials)]
        alone = dg.Scene(**{**vars(scene), "materials": tuple(black)})
        direct = dg.simulate(alone, capture, ONE_BOUNCE)
        primary = dark.parts[name] if bounces == 3 else 0.0
        # Three bounces are sampled, and their noise is another with direct light.
        found, wanted = light.parts[name], direct.total + primary
        if bounces == 1:
            np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-25)
        assert found.sum() == pytest.approx(wanted.sum(), rel=0.01)
