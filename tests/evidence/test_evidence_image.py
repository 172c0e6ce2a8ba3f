"""The image of evidence against each object's own light, and against laws that it obeys."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
import trimesh
from rooms import rectangle

import datagen as dg
from datagen.config import LabelsConfig
from datagen.evidence import evidence_image
from datagen.evidence.image import SCAN_PAIRS, representative_pairs
from datagen.evidence.own import evidence_and_gain
from datagen.labels import make_labels
from datagen.labels.images import hidden_surface
from datagen.records import Rectangle
from datagen.transport.rays import Raycaster

LABELS = LabelsConfig(rows=64, columns=64)
TIME = dg.TimeAxis(bins=300, width_s=1e-10, origin="wall")
EXPOSURE = dg.Exposure(repetition_rate_hz=2e7, cycles=10_000, photons_per_pulse=1e8)
WALL = Rectangle.of((0, 0, 0), (0, 1, 0), (0, 0, 1))


def plate(x: float, y: float, z: float, half: float) -> trimesh.Trimesh:
    """A square that faces the wall at the distance x."""
    return rectangle((x, y, z), (0, half, 0), (0, 0, half))


def room(*more: dg.Part) -> dg.Scene:
    wall = dg.Part("relay_wall", plate(0, 0, 0, 3), dg.Lambertian(0.8), "relay_wall")
    plates = [
        dg.Part("low", plate(1.2, -0.5, -0.5, 0.25), dg.Lambertian(0.6)),
        dg.Part("high", plate(0.8, 0.5, 0.5, 0.25), dg.Lambertian(0.4)),
    ]
    return dg.Scene.from_parts([wall, *plates, *more], relay_wall=WALL, hidden_view=WALL)


def grid(n: int) -> list[tuple[float, float, float]]:
    at = (np.arange(n) + 0.5) / n - 0.5
    return [(0.0, y, z) for z in at for y in at]


def confocal(n: int) -> dg.Capture:
    place = (3.0, 2.9, -1.5)
    points = np.array(grid(n))
    corners = np.array([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)]) * 0.02
    return dg.Capture(dg.Laser(place, points), dg.Sensor(place, points[:, None] + corners), TIME, pairing="confocal")


def exhaustive() -> dg.Capture:
    place = (3.0, 2.9, -1.5)
    sensor = dg.Sensor.grid(place, (0, 0.1, 0), (0, 0.1, 0), (0, 0, 0.1), rows=2, columns=2)
    return dg.Capture(dg.Laser(place, grid(2)), sensor, TIME)


def flood(weights: tuple[float, ...] | None = None, points: int = 2, **sensor: Any) -> dg.Capture:
    """A flood of 2 × 2 laser points, or of the first of these alone, and a sensor of 2 × 2 pixels."""
    scan = exhaustive()
    laser = dg.Laser(scan.laser.position, grid(2)[: points**2], weights)
    pixels = scan.sensor.position, scan.sensor.pixels
    return dg.Capture(laser, dg.Sensor(*pixels, **sensor), TIME, illumination="flood")


PARTLY = np.zeros((4, 2, 2))
PARTLY[3, 0, 1], PARTLY[0, :, 0], PARTLY[1] = 1.0, 0.5, 0.3
"""Sensitivities of pixels of which one is sensitive in a quarter, one in a half, one everywhere, and one nowhere."""
LIT_UNEVENLY = {
    "an even flood": flood(),
    "one of four lit": flood((1, 0, 0, 0)),
    "two of four lit": flood((1, 0, 0, 5)),
    "fading": flood((0.6, 0.2, 0.15, 0.05)),
    "sensitive in places": flood((0.6, 0.2, 0.15, 0.05), footprints=PARTLY),
    "crosstalk": flood((0.6, 0.2, 0.15, 0.05), crosstalk=0.1),
    "early and late": flood(delays_s=np.array([-2e-9, 0, 0.35e-9, 3e-9])),
}
CAPTURES = {"confocal": confocal(3), "exhaustive": exhaustive(), "many points": confocal(9), **LIT_UNEVENLY}


def curtain() -> dg.Part:
    """An occluder between the wall's lit middle and one of the plates, edge on to the label pixels."""
    half = [(0.05, -0.3, -3), (1.19, -0.3, -3), (1.19, -0.3, 3), (0.05, -0.3, 3)]
    return dg.Part("curtain", trimesh.Trimesh(half, [(0, 1, 2), (0, 2, 3)]), dg.Lambertian(0.0), "structure")


@cache
def lit(scan: str, hung: bool) -> tuple[dg.Scene, dg.Transient]:
    """The room, with the curtain or without, and its transient."""
    scene = room(curtain()) if hung else room()
    target = 0.01 if scan in LIT_UNEVENLY else 0.002
    return scene, dg.simulate(scene, CAPTURES[scan], dg.Accuracy(target=target, max_bounces=3), seed=0)


def image_and_truth(scan: str, spad: dg.Spad, hung: bool = False) -> dict[str, tuple[float, float]]:
    """Object → sum of the image over its pixels, and its own detections."""
    capture = CAPTURES[scan]
    scene, t = lit(scan, hung)
    caster, surface = Raycaster(scene), hidden_surface(scene, LABELS.rows, LABELS.columns)
    scan_pairs = representative_pairs(caster, scene, capture)
    own, gain = evidence_and_gain(t, spad, EXPOSURE, scan_pairs=scan_pairs)
    image = evidence_image(caster, surface, capture, scan_pairs, gain)
    part = make_labels(LABELS, scene, ["part_id"])["part_id"]
    assert image.dtype == np.float32 and np.array_equal(image > 0, (part >= 0) & (image > 0))
    return {
        name: (float(image[part == k].sum()), own[name].detections)
        for k, name in enumerate(scene.part_names)
        if scene.roles[k] == "object"
    }


SPADS = {
    "ideal": dg.Spad(pde=0.3, mode="ideal"),
    "gated": dg.Spad(pde=0.3, mode="ideal", gate_start_s=6e-9, gate_width_s=8e-9),
    "dead time": dg.Spad(pde=0.3, mode="synchronous", dead_time_s=4e-8),
}


def test_a_curtain_takes_the_evidence_of_what_stands_behind_it() -> None:
    for spad in SPADS.values():
        open_, hung = (image_and_truth("confocal", spad, hung) for hung in (False, True))
        assert hung["low"][0] < 0.7 * open_["low"][0]
        assert hung["low"][0] == pytest.approx(hung["low"][1], rel=0.1, abs=0.02 * open_["low"][1])


@pytest.mark.parametrize(
    ("scan", "name", "share"),
    [
        ("many points", "ideal", 0.05),
        *((scan, name, 0.02) for scan in ("confocal", "exhaustive") for name in SPADS),
        *((scan, "gated", 0.03) for scan in LIT_UNEVENLY),
    ],
)
def test_pixels_of_an_object_in_view_add_up_to_its_own_detections(scan: str, name: str, share: float) -> None:
    """Plates of 16 × 16 pixels whose edges are those of pixels: the midpoint rule. A few pairs stand for a large
    scan."""
    assert len(CAPTURES["many points"].laser.targets) > 4 * SCAN_PAIRS
    for found, truth in image_and_truth(scan, SPADS[name]).values():
        assert found == pytest.approx(truth, rel=share)


def test_laser_points_without_light_do_not_count() -> None:
    """A flood that gives all of its light to its first laser point has the image of one that has only this point, and
    pixels that sense nothing have no part in it."""
    image = {}
    blind = np.ones((4, 1, 1))
    blind[1:] = 0.0
    captures = {
        "one of four": flood((1, 0, 0, 0), footprints=blind),
        "alone": flood(points=1, footprints=blind),
        "first pixel": flood(points=1),
    }
    captures["first pixel"] = captures["first pixel"].excerpt(np.array([0]), np.array([0]))
    scene = room()
    caster, surface = Raycaster(scene), hidden_surface(scene, LABELS.rows, LABELS.columns)
    for name, capture in captures.items():
        pairs = representative_pairs(caster, scene, capture)
        assert pairs is not None
        image[name] = evidence_image(caster, surface, capture, pairs, np.ones((len(pairs.times), TIME.bins)))
    assert image["alone"].any()
    for name in captures:
        np.testing.assert_allclose(image[name], image["alone"], rtol=1e-6)


@pytest.mark.parametrize("even", [False, True])
def test_the_heavier_side_of_a_spread_beam_has_the_representatives(even: bool) -> None:
    """Of the light of a beam that fades to one side a representative stands for equal shares; of an even beam for
    equally many points."""
    capture = flood()
    targets = np.column_stack([np.zeros(64), np.linspace(-1, 1, 64), np.zeros(64)])
    weights = None if even else np.exp(-2.0 * np.arange(64) / 16)
    wide = replace(capture, laser=dg.Laser(capture.laser.position, targets, weights))
    scene = room()
    pairs = representative_pairs(Raycaster(scene), scene, wide)
    assert pairs is not None
    of_light = pairs.times.reshape(-1, 4)
    assert of_light.sum() == pytest.approx(4.0)
    assert of_light.max() <= (1.0 if even else 1.7) * of_light.min()


def test_without_a_laser_point_there_is_no_evidence() -> None:
    sensor = dg.Sensor.grid((3, 2.9, -1.5), (0, 0, 0), (0, 1, 0), (0, 0, 1), 1, 1)
    away, scene = dg.Capture(dg.Laser((3.0, 2.9, -1.5), [(9.0, 9.0, 0.0)]), sensor, TIME), room()
    caster = Raycaster(scene)
    pairs = representative_pairs(caster, scene, away)
    per_photon = np.ones((0 if pairs is None else len(pairs.times), TIME.bins))
    assert not evidence_image(caster, hidden_surface(scene, 8, 8), away, pairs, per_photon).any()
