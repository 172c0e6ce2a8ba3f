"""Cuts and sampled paths, two ways that share only the BRDFs and the rays, bring the same primary for pixels, walls,
windows and apertures that `test_all_ways.py`, which has all BRDFs, shapes and scans, has not.

Means over `RUNS` seeds of both are compared by Student's t at `LEVEL` over all numbers: energy of every part, of
every laser point and pixel, and by coarse bins of time.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Retroreflector, Scene, Sensor, simulate
from datagen.records import Transient

RUNS, LEVEL = 8, 1e-3
DEVICE = (1.5, 0.1, 1.3)
TIME = bins_of_path(160, 0.1, 0.0)
COARSE = 8
"""Number of bins added up into one."""
SPREAD = 0.01
"""Share of the light that may arrive in a neighbouring window, half of the error that is asked."""
FAINT = 0.01
"""Numbers below this fraction of the largest of their kind are not compared: few paths find them."""


def numbers(found: Transient) -> list[NDArray[np.float64]]:
    """Energies by part, by laser point and pixel, and by coarse bins of time followed by the overflow."""
    kept = len(found.time.centers_s) // COARSE * COARSE
    by_time = found.total[..., :kept].sum(axis=(0, 1)).reshape(-1, COARSE).sum(axis=1)
    parts = np.array([values.sum() for values in found.parts.values()])
    return [parts, (found.total.sum(axis=2) + found.overflow).ravel(), np.append(by_time, found.overflow.sum())]


def same_light(scene: Scene, capture: Capture, target: float = 0.02) -> None:
    asked = Accuracy(target=target, part_target=2.5 * target)
    cuts = [simulate(scene, capture, asked, seed=s) for s in range(1, 1 + RUNS)]
    assert {run.samplers["primary"] for run in cuts} <= {"cuts", "paths"}
    paths = [simulate(scene, capture, Accuracy(samples=4096), seed=s) for s in range(RUNS)]
    ours, theirs = (
        [np.array(kind) for kind in zip(*(numbers(run) for run in runs), strict=True)] for runs in (cuts, paths)
    )
    many = sum(of.shape[1] for of in ours)
    for one, other in zip(ours, theirs, strict=True):
        a, b = one.mean(axis=0), other.mean(axis=0)
        noise, bright = np.hypot(stats.sem(one), stats.sem(other)), np.maximum(a, b) > FAINT * b.max()
        allowed = stats.t.isf(LEVEL / 2 / many, RUNS - 1) * noise + SPREAD * b.max()
        assert (np.abs(a - b) <= allowed)[bright].all(), np.column_stack([a, b, noise])[bright]
    # The comparison means something only where the light of paths is known well.
    whole = theirs[0].sum(axis=1)
    assert stats.sem(whole) < 0.02 * whole.mean()


def several(pairing: str, half_side_m: float = 0.05, origin: str = "wall") -> Capture:
    lasers = np.array([[0, y, z] for y in (-0.9, 0.3) for z in (0.6, 1.7)])
    pixels = square_pixels(lasers if pairing == "confocal" else [[0, 0.5, 1.2], [0, -0.4, 0.7]], half_side_m)
    return Capture(Laser(DEVICE, lasers), Sensor(DEVICE, pixels), replace(TIME, origin=origin), pairing)  # type: ignore[arg-type]


@pytest.mark.parametrize(("pairing", "origin"), [("confocal", "source"), ("exhaustive", "wall")])
def test_scans(pairing: str, origin: str) -> None:
    same_light(furnished_box(), several(pairing, origin=origin))


@pytest.mark.parametrize(
    ("y", "half_side_m"),
    [(0.2, 5e-4), (0.2, 0.2), (0.2, 1.0), (1.43, 0.2), (1.475, 0.025)],
    ids=["1 mm", "0.4 m", "2 m", "on two walls", "at a wall's foot"],
)
def test_pixels_of_every_size_and_place(y: float, half_side_m: float) -> None:
    same_light(furnished_box(), one_point_capture((0, -0.3, 1.1), (0, y, 1.2), half_side_m, TIME))


def test_a_beam_that_reaches_over_the_edge_of_the_wall() -> None:
    """Light comes from what each cell has of the wall, whether or not its middle has it."""
    wall = Part("wall", rectangle((0, 0, 1), (0, 0.8, 0), (0, 0, 0.7)), Lambertian(0.8), "relay_wall")
    plate = Part(
        "plate", rectangle((0.7, 0.9, 1.1), (0, 0, 0.2), (0.1, 0.2, 0)), Retroreflector(0.9, 0.2, 0.6), "object"
    )
    laser = Laser.flood(DEVICE, (0, 0.2, 1.0), (0, 0.9, 0), (0, 0, 0.8), 2, 2, [1, 2, 3, 4])
    seen = Sensor(DEVICE, square_pixels([[0, 0.3, 1.2], [0, -0.4, 0.7]], 0.15))
    same_light(Scene.from_parts([wall, plate]), Capture(laser, seen, TIME, "exhaustive", "flood"))


def test_a_pixel_that_reaches_over_the_edge_of_the_wall() -> None:
    wall = Part("wall", rectangle((0, 0, 1), (0, 1, 0), (0, 0, 1)), Lambertian(0.8), "relay_wall")
    box = trimesh.creation.box(bounds=[(1.2, -0.3, 0.7), (1.8, 0.3, 1.3)])
    scene = Scene.from_parts([wall, Part("box", box, Lambertian(0.6))])
    # To 2 % cuts take ten times as long as to 5 %, or leave the light to paths.
    same_light(scene, one_point_capture((0, -0.3, 1.1), (0, 1.06, 1.1), 0.2, TIME, (0.4, 0.1, 1.9)), 0.05)


def bumpy(seed: int = 3) -> trimesh.Trimesh:
    """A relay wall of 2 × 2 m in 12 × 12 squares whose corners stand out by up to 3 cm."""
    knots = np.linspace(-1, 1, 13)
    y, z = (k.ravel() for k in np.meshgrid(knots, knots))
    out = np.random.default_rng(seed).uniform(0, 0.03, len(y))
    corner = (np.arange(12)[:, None] * 13 + np.arange(12)).ravel()
    faces = [[corner, corner + 1, corner + 14], [corner, corner + 14, corner + 13]]
    return trimesh.Trimesh(np.stack([out, y, z + 1], axis=1), np.concatenate([np.stack(f, axis=1) for f in faces]))


@pytest.mark.parametrize("half_side_m", [0.02, 0.2])
def test_an_uneven_relay_wall(half_side_m: float) -> None:
    box = trimesh.creation.box(bounds=[(1.2, -0.3, 0.7), (1.8, 0.3, 1.3)])
    scene = Scene.from_parts(
        [Part("wall", bumpy(), Lambertian(0.8), "relay_wall"), Part("box", box, Lambertian(0.6))]
    )
    same_light(scene, one_point_capture((0, -0.3, 1.1), (0, 0.4, 1.0), half_side_m, TIME, (0.4, 0.1, 1.9)))


def test_attenuation_and_windows() -> None:
    foggy = replace(furnished_box(), attenuation_per_m=0.4)
    capture = several("exhaustive")
    for start, bins in ((0.0, 160), (3.03, 64), (0.0, 40), (5.5, 8)):
        same_light(foggy, replace(capture, time=bins_of_path(bins, 0.1, start)))


def test_a_finite_aperture() -> None:
    capture = several("exhaustive")
    sensor = replace(capture.sensor, aperture_radius_m=0.3, finite_aperture=True)
    same_light(furnished_box(), replace(capture, sensor=sensor))
