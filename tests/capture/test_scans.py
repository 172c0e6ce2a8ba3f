"""Scan patterns: positions of laser points, patterns drawn for every scene, and refused settings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

import datagen as dg
from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.records import Rectangle, Scene

SQUARE_ROOM = {
    "layout": {
        "kind": "l_corridor", "turn": "left", "relay_distance_m": 6, "height_m": 3, "device_height_m": 1,
        "device_offset": 0.5, "corridor_width_m": 2, "corridor_behind_m": 1, "room_length_m": 3, "room_width_m": 3,
    },
}  # fmt: skip
EVERY_KIND: dict[str, dict[str, Any]] = {
    "default": {},
    "grid without kind": {"rows": 3, "columns": 5},
    "points": {"kind": "points", "points_m": [[0, 0], [0.5, -0.25], [6.0, 0.5, 2.0]]},
    "circle": {"kind": "circle", "count": 7},
    "random": {"kind": "random", "count": 11},
    "subset": {"kind": "subset", "count": 6, "rows": 8, "columns": 8},
}


def configured(scan: dict[str, Any], **capture: Any) -> DatasetConfig:
    return config_from_mapping({"seed": 5, "scene": SQUARE_ROOM, "capture": {"scan": scan, **capture}})


@pytest.fixture(scope="module")
def scene() -> Scene:
    return dg.generate_scene(configured({}).scene, seed=5, index=0)


def targets(scan: dict[str, Any], scene: Scene, index: int = 0) -> np.ndarray:
    return dg.capture_for(configured(scan), scene, index=index).laser.targets


def wall_of(scene: Scene) -> Rectangle:
    assert scene.relay_wall is not None
    return scene.relay_wall


def on_wall(points: np.ndarray, scene: Scene) -> np.ndarray:
    """(n, 2) metres right and up of the middle of the visible wall; the points must lie in its plane."""
    wall = wall_of(scene)
    right, up = (axis / np.linalg.norm(axis) for axis in (wall.right, wall.up))
    offset = points - wall.center
    assert np.abs(offset @ np.cross(right, up)).max() < 1e-12
    return np.stack([offset @ right, offset @ up], axis=1)


@pytest.mark.parametrize("kind", EVERY_KIND)
def test_points_lie_on_the_visible_wall_and_their_number_is_known_without_a_scene(kind: str, scene: Scene) -> None:
    for pairing in ("confocal", "exhaustive"):
        config = configured(EVERY_KIND[kind], pairing=pairing)
        capture = dg.capture_for(config, scene)
        assert capture.shape == config.capture.shape
    wall = wall_of(scene)
    place = np.abs(on_wall(capture.laser.targets, scene))
    assert (place <= np.linalg.norm([wall.right, wall.up], axis=1) * (1 + 1e-12)).all()


def test_a_grid_goes_row_by_row_from_the_top_left(scene: Scene) -> None:
    scan = {"kind": "grid", "rows": 3, "columns": 2, "width_m": 1.0, "height_m": 0.5, "center_m": [0.2, -0.1]}
    expected = [[-0.3, 0.15], [0.7, 0.15], [-0.3, -0.1], [0.7, -0.1], [-0.3, -0.35], [0.7, -0.35]]
    np.testing.assert_allclose(on_wall(targets(scan, scene), scene), expected, atol=1e-12)


def test_a_place_on_the_wall_has_two_notations(scene: Scene) -> None:
    wall = wall_of(scene)
    point = wall.center + 0.3 * wall.right / np.linalg.norm(wall.right) - [0, 0, 0.2]
    for kind in ({"rows": 2, "columns": 2}, {"kind": "circle", "count": 4}):
        relative, absolute = ({**kind, "center_m": place} for place in ([0.3, -0.2], point.tolist()))
        np.testing.assert_allclose(targets(relative, scene), targets(absolute, scene), atol=1e-12)
    listed = targets({"kind": "points", "points_m": [[0.3, -0.2], point.tolist()]}, scene)
    np.testing.assert_allclose(listed[0], listed[1], atol=1e-12)


def test_without_sizes_a_scan_fills_the_same_share_of_what_is_left(scene: Scene) -> None:
    wall = wall_of(scene)
    half = np.linalg.norm([wall.right, wall.up], axis=1)
    corners = {"rows": 2, "columns": 2}
    np.testing.assert_allclose(on_wall(targets(corners, scene), scene)[1], 0.8 * half)
    moved = on_wall(targets({**corners, "center_m": [0.5, 0]}, scene), scene)
    np.testing.assert_allclose(moved[1], [0.5 + 0.8 * (half[0] - 0.5), 0.8 * half[1]])


def test_a_circle_is_round_even_and_counter_clockwise(scene: Scene) -> None:
    scan = {"kind": "circle", "count": 12, "radius_m": 0.7, "center_m": [0.1, 0.2], "start_deg": 90}
    place = (on_wall(targets(scan, scene), scene) - [0.1, 0.2]) @ [1, 1j]
    np.testing.assert_allclose(place, 0.7j * np.exp(2j * np.pi * np.arange(12) / 12), atol=1e-12)


def test_drawn_patterns_depend_on_scene_and_seed_alone(scene: Scene) -> None:
    for kind in ("random", "subset"):
        config = configured(EVERY_KIND[kind])
        first = dg.capture_for(config, scene, seed=5, index=3).laser.targets
        np.testing.assert_array_equal(first, dg.capture_for(config, scene, index=3).laser.targets)
        assert not np.array_equal(first, dg.capture_for(config, scene, index=4).laser.targets)
        assert not np.array_equal(first, dg.capture_for(config, scene, seed=6, index=3).laser.targets)
    for kind in ("default", "points", "circle"):
        np.testing.assert_array_equal(targets(EVERY_KIND[kind], scene, 0), targets(EVERY_KIND[kind], scene, 1))


def test_random_points_are_uniform_and_independent(scene: Scene) -> None:
    """Family-wise level 0.1 % over three tests (Bonferroni); the seed is fixed."""
    scan = {"kind": "random", "count": 4000, "width_m": 1.2, "height_m": 0.8, "center_m": [0.1, 0.3]}
    place = (on_wall(targets(scan, scene), scene) - [0.1, 0.3]) / [1.2, 0.8] + 0.5
    p = [stats.kstest(place[:, 0], "uniform").pvalue, stats.kstest(place[:, 1], "uniform").pvalue]
    p.append(stats.spearmanr(place[:, 0], place[:, 1]).pvalue)
    assert min(p) > 0.001 / len(p)


def test_a_subset_is_part_of_its_grid_and_every_point_is_as_likely(scene: Scene) -> None:
    """χ² of how often each of 16 grid points is among 5 drawn, at 0.1 %. Draws without replacement vary less than
    independent ones: their covariance gives (grid − 1) / (grid − 5) times the usual sum, which is χ² of 15.
    """
    grid = targets({"rows": 4, "columns": 4}, scene)
    times, draws = np.zeros(16), 400
    for index in range(draws):
        chosen = targets({"kind": "subset", "count": 5, "rows": 4, "columns": 4}, scene, index)
        number = [int(np.flatnonzero((grid == point).all(axis=1))[0]) for point in chosen]
        assert number == sorted(set(number)) and len(number) == 5
        times[number] += 1
    expected = draws * 5 / 16
    statistic = ((times - expected) ** 2).sum() / expected * 15 / 11
    assert stats.chi2.sf(statistic, 15) > 0.001


@pytest.mark.parametrize(
    ("scan", "words"),
    [
        ({"kind": "circel", "count": 3}, ["capture.scan", "'circel'", "did you mean 'circle'", "subset"]),
        ({"kind": "circle"}, ["capture.scan.count", "missing"]),
        ({"kind": "points", "points_m": []}, ["capture.scan.points_m"]),
        ({"kind": "points", "points_m": [[1]]}, ["capture.scan.points_m[0]"]),
        ({"kind": "points", "points_m": [[1, 2, 3, 4]]}, ["capture.scan.points_m[0]"]),
        ({"kind": "random", "count": 0}, ["capture.scan.count", "0"]),
        ({"kind": "subset", "count": 17, "rows": 4, "columns": 4}, ["17", "4 × 4 = 16", "lower count"]),
        ({"rows": 65536, "columns": 2}, ["131072", "65536", "lower one"]),
        ({"rows": 2, "radius_m": 2}, ["capture.scan.radius_m", "unknown key"]),
        ([], ["capture.scan", "mapping"]),
    ],
)
def test_bad_scans_are_refused_with_their_key(scan: Any, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        configured(scan)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    ("scan", "key"),
    [
        ({"rows": 2, "height_m": 3.5}, "capture.scan.height_m = 3.5"),
        ({"kind": "random", "count": 2, "width_m": 40}, "capture.scan.width_m = 40"),
        ({"kind": "subset", "count": 2, "height_m": 2.9, "center_m": [0, 0.2]}, "capture.scan.height_m = 2.9"),
        ({"kind": "circle", "count": 2, "radius_m": 1.6}, "capture.scan.radius_m = 1.6"),
        ({"kind": "circle", "count": 2, "center_m": [0, 2]}, "capture.scan.center_m = [0.0, 2.0]"),
        ({"rows": 2, "center_m": [9, 0]}, "capture.scan.center_m = [9.0, 0.0]"),
        ({"rows": 2, "center_m": [5.5, 0, 1.5]}, "capture.scan.center_m = [5.5, 0.0, 1.5]"),
        ({"kind": "points", "points_m": [[0, 0], [0, 1.6]]}, "capture.scan.points_m[1] = [0.0, 1.6]"),
    ],
)
def test_scans_larger_than_the_visible_wall_are_refused(scan: dict[str, Any], key: str, scene: Scene) -> None:
    with pytest.raises(InputError) as caught:
        targets(scan, scene)
    assert str(caught.value).startswith(key)
    assert "\n" not in str(caught.value)


def test_a_laser_that_meets_nothing_is_refused() -> None:
    """Of a list of places in the room; what lies on the relay wall is met."""
    open_air = {"layout": {"kind": "isolated_wall"}}
    capture = {"pairing": "exhaustive", "scan": {"kind": "points", "points_m": [[0, 0], [0.0, 0.0, 100.0]]}}
    config = config_from_mapping({"scene": open_air, "capture": capture})
    with pytest.raises(InputError, match=r"^capture\.scan\.points_m: .* meets nothing towards 1 of 2 "):
        dg.capture_for(config, dg.generate_scene(config.scene, 0, 0))
