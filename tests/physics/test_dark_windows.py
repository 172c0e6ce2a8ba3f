"""Windows that little light falls into, or none: they cost what a look costs, and what is not known is not claimed.

And floods, whose light is that of all laser points together, as right and as far off as claimed.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels
from scipy import stats

import datagen as dg
from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, TimeAxis, Transient, simulate
from datagen.bench.plain_check import PlainPaths
from datagen.config import config_from_mapping
from datagen.transport.simulate import transient_of

LOOK = 2e7
"""Rays that a look may take; 1.0.0 took a hundred times as many, or did not end."""
SEEDS, LEVEL = 16, 1e-4


def in_a_window(start_m: float, length_m: float, bins: int = 64, **capture: Any) -> Capture:
    """One laser point and pixel in the furnished box."""
    return one_point_capture(time=bins_of_path(bins, length_m / bins, start_m, "source"), **capture)


@pytest.mark.parametrize(("start_m", "length_m"), [(0.0, 2.0), (60.0, 4.0)])
@pytest.mark.parametrize("bounces", [3, 4, None])
def test_a_window_without_light_ends_after_a_look(start_m: float, length_m: float, bounces: int | None) -> None:
    """Before the first light and after the last one: of three bounces that is proven, as no element may arrive; that
    more bounces bring none is proven only before the first."""
    accuracy = Accuracy(target=0.02, max_bounces=bounces)
    if start_m and bounces is None:
        pytest.skip("light of all orders never ends")
    found = transient_of(furnished_box(), in_a_window(start_m, length_m), accuracy, 0)
    assert not found.total.any() and found.overflow.sum() > 0
    assert sum(found.rays.values()) < LOOK
    is_proven = start_m == 0.0 or bounces == 3
    assert found.relative_error == 0.0 if is_proven else np.isnan(found.relative_error)
    assert found.met_target == is_proven


def test_light_that_something_hides_is_not_claimed_to_be_none() -> None:
    """Between wall and object stands a screen: light might fall into the window, and a look meets none."""
    wall, screen = (rectangle((x, 0, 1.25), (0, 1, 0), (0, 0, 1)) for x in (0, 0.6))
    far = rectangle((6.0, 0, 1.25), (0, 0.8, 0), (0, 0, 0.8))
    parts = [
        Part("wall", wall, Lambertian(0.8), "relay_wall"), Part("screen", screen, Lambertian(0.5), "structure"),
        Part("far", far, Lambertian(0.5)),
    ]  # fmt: skip
    capture = one_point_capture(device=(0.3, 0.1, 1.3), time=bins_of_path(32, 0.1, 11.5))
    found = transient_of(Scene.from_parts(parts), capture, Accuracy(target=0.05), 0)
    assert not found.total.any() and found.overflow.sum() > 0
    assert np.isnan(found.relative_error) and not found.met_target and sum(found.rays.values()) < LOOK


@pytest.mark.parametrize("end_m", [5.7, 5.78])
def test_little_light_is_found_where_it_is(end_m: float) -> None:
    """A window that ends soon after the first light has a small share of it; what it has is that of paths."""
    scene, axis = furnished_box(), bins_of_path(32, end_m / 32, 0.0, "source")
    capture = one_point_capture(time=axis)
    runs = [simulate(scene, capture, Accuracy(target=0.05, max_bounces=3), seed=seed) for seed in range(SEEDS)]
    truth = PlainPaths.of(scene, capture, Accuracy(max_bounces=3), 1 << 16, 7).runs["primary"].sum(axis=(1, 2))
    energy = np.array([run.total.sum() for run in runs])
    share = energy.mean() / np.mean([run.total.sum() + run.overflow.sum() for run in runs])
    assert 0 < share < 0.05, share
    assert all(sum(run.rays.values()) < LOOK for run in runs)
    noise = np.hypot(stats.sem(energy), stats.sem(truth))
    assert abs(energy.mean() - truth.mean()) < stats.t.isf(LEVEL, len(truth) - 1) * noise + 0.01 * truth.mean()


@pytest.mark.parametrize("name", ["tmf8820", "vl53l8ch", "vl53l1x", "phone_dots"])
def test_a_device_in_a_default_room_is_done(name: str) -> None:
    """Rays of a scene at the default target; 1.0.0 had followed more than 10⁸ when it was stopped."""
    config = config_from_mapping({"seed": 4, "capture": {"device": name}})
    scene = dg.scene_for(config, 0)
    found = transient_of(scene, dg.capture_for(config, scene), config.transport.accuracy(), 0)
    assert sum(found.rays.values()) < LOOK


def flood(points: int, weights: np.ndarray | None = None) -> tuple[Scene, Capture]:
    """The furnished box, with points × points and 2 × 2 pixels on its wall."""
    device = np.array([1.5, 0.1, 1.3])
    y, z = np.meshgrid(np.linspace(-1.2, 0.2, points), np.linspace(0.3, 2.2, points))
    targets = np.column_stack([np.zeros(points**2), y.ravel(), z.ravel()])
    pixels = square_pixels([(0, a, b) for a in (0.3, 0.9) for b in (0.8, 1.6)], 0.2)
    axis = bins_of_path(64, 0.2, 2.0)
    return furnished_box(), Capture(
        Laser(device, targets, weights), Sensor(device, pixels), axis, "exhaustive", "flood"
    )


def energies(run: Transient) -> list[float]:
    """Of each pixel, of each part, and of what is outside the window."""
    return [*run.total.sum(axis=(0, 2)), *(light.sum() for light in run.parts.values()), run.overflow.sum()]


@pytest.mark.parametrize("weights", [None, "uneven"])
def test_a_flood_has_the_light_of_its_paths(weights: str | None) -> None:
    """Means over seeds, by Student's t at a family-wise level of `LEVEL`: elements that bring little get a sample by
    chance, which changes the noise and no mean."""
    shares = None if weights is None else np.random.default_rng(0).uniform(0, 1, 36) ** 4
    scene, capture = flood(6, shares)
    capture = replace(capture, time=replace(capture.time, bins=40))
    runs = [simulate(scene, capture, Accuracy(target=0.1, max_bounces=3), seed=seed) for seed in range(SEEDS)]
    assert {run.samplers["primary"] for run in runs} == {"cuts"}
    paths = [simulate(scene, capture, Accuracy(samples=1024, max_bounces=3), seed=seed) for seed in range(SEEDS)]
    ours, theirs = (np.array([energies(run) for run in of]) for of in (runs, paths))
    apart, noise = ours.mean(axis=0) - theirs.mean(axis=0), np.hypot(stats.sem(ours), stats.sem(theirs))
    assert (np.abs(apart) <= stats.t.isf(LEVEL / 2 / len(noise), SEEDS - 1) * noise + 1e-12 * ours.max()).all()
    assert (noise < 0.05 * ours.mean(axis=0) + 1e-3 * ours.mean(axis=0).max()).all()


def test_a_flood_is_as_far_off_as_it_claims() -> None:
    """The target is that of the sum over all laser points, which is met with the rays of few of them."""
    scene, capture = flood(6)
    truth = PlainPaths.of(scene, capture, Accuracy(max_bounces=3), 1 << 11, 99)
    runs = [simulate(scene, capture, Accuracy(target=0.05, max_bounces=3), seed=seed) for seed in range(SEEDS)]
    true = np.mean([truth.check(run.total, "primary").square for run in runs])
    claimed = np.mean([run.relative_error**2 for run in runs])
    assert 0.5 < np.sqrt(true / claimed) < 1.6
    assert all(run.met_target for run in runs)
    scan = simulate(scene, replace(capture, illumination="scan"), Accuracy(target=0.05, max_bounces=3), seed=0)
    assert np.median([run.rays["primary"] for run in runs]) < 0.7 * scan.rays["primary"]


def test_more_bounces_of_a_flood_are_those_of_its_points() -> None:
    """Blocks of a flood, whose laser points share the histograms, bring the mean light of the scan."""
    scene, capture = flood(4, np.random.default_rng(1).uniform(0, 1, 16))
    accuracy = Accuracy(target=0.02, max_bounces=5)
    found = simulate(scene, capture, accuracy, seed=0)
    scan = simulate(scene, replace(capture, illumination="scan"), accuracy, seed=1)
    for name in ("primary", "secondary", "higher"):
        mean = np.einsum("l,lpt->pt", capture.laser.shares, scan.components[name])
        assert found.components[name][0].sum(axis=1) == pytest.approx(mean.sum(axis=1), rel=0.05)


def test_direct_light_counts_in_what_is_asked() -> None:
    """A pixel that sees the laser point gets far more light of one bounce than of three, which may err by as much
    more; and what is claimed is an error of all light."""
    scene, capture = flood(4)
    seen = replace(capture, sensor=Sensor(capture.sensor.position, square_pixels([(0, -0.5, 1.25)], 0.8)))
    seen = replace(seen, time=TimeAxis(64, seen.time.width_s, 0.0, "wall"))
    alone = simulate(scene, seen, Accuracy(target=0.02, max_bounces=3, part_target=1.0), seed=0)
    beside = simulate(scene, seen, Accuracy(target=0.02, max_bounces=3, part_target=1.0, direct=True), seed=0)
    assert beside.components["direct"].sum() > 5 * beside.components["primary"].sum()
    assert beside.rays["primary"] < 0.5 * alone.rays["primary"]
    assert beside.relative_error <= 0.025 and beside.met_target
