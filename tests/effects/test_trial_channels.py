"""No effect is left out because the trial run chose channels without it: on floods, arrays, single pixels and sparse
scans, whatever pairs of laser points and pixels have the effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from rooms import furnished_box, rectangle, square_pixels

from datagen.capture import capture_for
from datagen.config import load_config
from datagen.design.light import transport_effects
from datagen.design.scene_for import scene_for
from datagen.effects import EffectDecisions, decide_transport_effects
from datagen.effects.trial import run_trial, trial_channels
from datagen.records import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, TimeAxis
from datagen.transport import simulate
from datagen.transport.laser_points import LaserPoints
from datagen.transport.rays import Raycaster

DEVICE = (2.5, 0.05, 1.25)
AXIS = TimeAxis(96, 0.4e-9, 0.0, "source")


def grid(
    rows: int, columns: int, half_m: float = 0.7, center: tuple[float, float] = (0.0, 1.25)
) -> list[list[float]]:
    """Midpoints of rows × columns cells on the relay wall x = 0."""
    across = (np.arange(columns) + 0.5) / columns * 2 - 1
    upward = 1 - (np.arange(rows) + 0.5) / rows * 2
    return [[0.0, center[0] + half_m * y, center[1] + half_m * z] for z in upward for y in across]


def zones(rows: int, columns: int, half_m: float = 0.7) -> Sensor:
    return Sensor.grid(DEVICE, (0, 0, 1.25), (0, half_m, 0), (0, 0, half_m), rows, columns)


def exhaustive(targets: list[list[float]], sensor: Sensor, **changes: str) -> Capture:
    return Capture(Laser(DEVICE, targets), sensor, AXIS, "exhaustive", **changes)  # type: ignore[arg-type]


CAPTURES: dict[str, tuple[Capture, bool]] = {
    "flood of zones, as sensors have": (exhaustive(grid(16, 16), zones(8, 8), illumination="flood"), True),
    "array in whose view the scan lies": (exhaustive(grid(3, 3, 0.1), zones(16, 16)), True),
    "array beside the scan": (exhaustive(grid(3, 3, 0.1, (-1.0, 1.25)), zones(16, 16)), False),
    "one small pixel, one of 1024 laser points in it": (
        exhaustive(grid(32, 32), Sensor(DEVICE, square_pixels([grid(32, 32)[777]], 0.01))), True,
    ),
    "sparse: 5 laser points, 6 pixels, one pair": (
        exhaustive(
            [[0, y, 1.0] for y in (-0.9, -0.5, -0.1, 0.3, 0.7)],
            Sensor(DEVICE, square_pixels([(0, y, 1.0) for y in (-0.7, -0.3, 0.1, 0.5, 0.701, 0.9)], 0.03)),
        ), True,
    ),
    "sparse: none of 5 in any of 6": (
        exhaustive(
            [[0, y, 1.0] for y in (-0.9, -0.5, -0.1, 0.3, 0.7)],
            Sensor(DEVICE, square_pixels([(0, y, 1.5) for y in (-0.7, -0.3, 0.1, 0.5, 0.7, 0.9)], 0.03)),
        ), False,
    ),
}  # fmt: skip


def direct_decided(scene: Scene, capture: Capture) -> tuple[EffectDecisions, float]:
    """Decisions about a transport large enough for a trial run, and how much direct light there is."""
    large = Accuracy(samples=8192, max_bounces=4, direct=True)
    few = Accuracy(samples=64, max_bounces=3, direct=True)
    direct = simulate(scene, capture, few, seed=1, split_parts=False).components["direct"]
    return decide_transport_effects(scene, capture, large, seed=5), float(direct.sum())


@pytest.mark.parametrize("how", CAPTURES)
def test_direct_return_is_simulated_wherever_there_is_some(how: str) -> None:
    capture, there = CAPTURES[how]
    decided, light = direct_decided(furnished_box(0.5), capture)
    assert (light > 0) is there
    assert decided["direct_return"].simulated is there
    assert decided["direct_return"].kind == "bound"


@pytest.mark.parametrize("width_m", [0.4, 0.004])
def test_direct_return_by_two_bounces_is_seen_however_small_what_returns_it(width_m: float) -> None:
    """A block on the wall, between the lines of sight of a pixel, is lit from the side and seen by the sensor."""
    wall = rectangle((0, 0, 1.25), (0, 2, 0), (0, 0, 1.25))
    at = np.array([0.02, 0.233, 1.117])
    block = trimesh.creation.box(bounds=[at - [0.0199, width_m / 2, width_m / 2], at + width_m / 2])
    flat = Scene.from_parts([Part("relay_wall", wall, Lambertian(0.8))])
    scene = Scene.from_parts([Part("relay_wall", wall, Lambertian(0.8)), Part("block", block, Lambertian(0.5))])
    capture = exhaustive(grid(3, 3, 0.1, (-1.0, 1.25)), zones(4, 4))
    assert direct_decided(scene, capture)[0]["direct_return"].simulated
    decided, light = direct_decided(flat, capture)
    assert light == 0 and not decided["direct_return"].simulated


def test_zone_sensor_has_its_first_return_in_every_scene() -> None:
    config = load_config("configs/zone_sensor.yaml")
    for index in range(6):
        scene = scene_for(config, index)
        decided = transport_effects(config, scene, capture_for(config, scene, config.seed, index), index)
        assert decided["direct_return"].simulated


def beside_a_wall(capture_of: str) -> tuple[Scene, Capture]:
    """A relay wall whose last column of pixels, or laser points, lies at the foot of a bright wall; elsewhere there
    is only a small box far away. Light of four bounces comes by that column."""
    wall = trimesh.Trimesh([(0, -2, 0), (0, 0.71, 0), (0, 0.71, 2.5), (0, -2, 2.5)], [(0, 1, 2), (0, 2, 3)])
    side = trimesh.creation.box(bounds=[(0.0, 0.71, 0.5), (0.5, 0.75, 2.0)])
    roof = trimesh.creation.box(bounds=[(0.0, 0.2, 2.0), (0.5, 0.75, 2.05)])
    box = trimesh.creation.box(bounds=[(0.8, -1.9, 1.0), (1.1, -1.6, 1.4)])
    parts = [("relay_wall", wall, 0.8), ("side", side, 0.95), ("roof", roof, 0.95), ("box", box, 0.6)]
    scene = Scene.from_parts([Part(name, mesh, Lambertian(albedo)) for name, mesh, albedo in parts])
    sensor = Sensor.grid(DEVICE, (0, 0, 1.25), (0, 0.69, 0), (0, 0, 0.69), 8, 8)
    how = "flood" if capture_of == "flood" else "scan"
    return scene, exhaustive(grid(16, 16, 0.69), sensor, illumination=how)


@pytest.mark.parametrize("how", ["flood", "array"])
def test_four_bounces_at_one_edge_of_the_scan_are_seen(how: str) -> None:
    scene, capture = beside_a_wall(how)
    plan = decide_transport_effects(scene, capture, Accuracy(samples=8192, max_bounces=4), seed=3)
    light = simulate(scene, capture, Accuracy(samples=256, max_bounces=4), seed=2, split_parts=False)
    share = np.linalg.norm(light.components["secondary"]) / np.linalg.norm(light.total)
    assert share > 0.05
    decision = plan["secondary_bounce"]
    assert decision.kind == "trial" and decision.simulated
    assert decision.estimate is not None and decision.estimate > share / 2


def test_a_trial_run_of_a_flood_looks_at_the_points_that_have_its_light() -> None:
    """One of 256 has all of it. Of a scan weights say nothing."""
    flood, scene = CAPTURES["flood of zones, as sensors have"][0], furnished_box()
    caster = Raycaster(scene)
    for lit in (0, 200):
        laser = Laser(DEVICE, flood.laser.targets, np.eye(256)[lit])
        capture, points = replace(flood, laser=laser), LaserPoints.of(caster, scene, laser)
        assert trial_channels(capture, points)[0].tolist() == [lit]
        assert len(trial_channels(replace(capture, illumination="scan"), points)[0]) > 1
        for illumination in ("flood", "scan"):
            given = replace(capture, illumination=illumination)
            trial = run_trial(scene, given, Accuracy(samples=64, max_bounces=4), 0, caster, points)
            assert trial.share("secondary") is not None
