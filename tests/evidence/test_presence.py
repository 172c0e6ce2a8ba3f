"""The presence of objects, against laws that it obeys and against a matched filter on drawn histograms."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from datasets import write_dataset
from rooms import rectangle

import datagen as dg
from datagen.config import config_from_mapping
from datagen.evidence.presence import presence_against
from datagen.pipeline import simulate_sample

IDEAL = dg.Spad(pde=0.3, mode="ideal", dark_count_rate_hz=1e4)
EXPOSURE = dg.Exposure(repetition_rate_hz=2e7, cycles=10_000, photons_per_pulse=3e8)
COARSE = dg.Accuracy(target=0.05)


def plate(x: float, y: float, half: float) -> trimesh.Trimesh:
    """A square that faces the wall x = 0 at the distance x."""
    return rectangle((x, y, 0), (0, half, 0), (0, 0, half))


def room(albedo: float = 0.6, back: bool = True) -> dg.Scene:
    """A wall, another behind it that a plate shadows, and a second plate behind that wall."""
    parts = [
        dg.Part("relay_wall", plate(0, 0, 2), dg.Lambertian(0.8), "relay_wall"),
        dg.Part("plate", plate(1, 0, 0.3), dg.Lambertian(albedo)),
    ]
    if back:
        parts += [
            dg.Part("back", plate(1.6, 0, 2), dg.Lambertian(0.8), "structure"),
            dg.Part("hidden", plate(2.2, 0, 0.3), dg.Lambertian(0.8)),
        ]
    return dg.Scene.from_parts(parts)


def capture() -> dg.Capture:
    place, points = (1.2, -1.5, 0.0), [(0, 0.3, 0.2), (0, -0.3, 0.3), (0, 0.1, -0.4)]
    sensor = dg.Sensor.grid(place, (0, 0.1, 0), (0, 0.2, 0), (0, 0, 0.2), rows=1, columns=2)
    return dg.Capture(dg.Laser(place, points), sensor, dg.TimeAxis(bins=100, width_s=2.5e-10, origin="wall"))


def presence(scene: dg.Scene, accuracy: dg.Accuracy = COARSE, exposure: dg.Exposure = EXPOSURE) -> dg.Presence:
    return dg.presence_evidence(scene, capture(), accuracy, IDEAL, exposure, ["plate"], seed=3)["plate"]


def test_the_floor_is_made_of_the_errors_of_both_simulations() -> None:
    """Squares of errors add up: that of the scene with the object, and that of the scene without it."""
    light, rng = np.full((2, 3, 5), 1e-9), np.random.default_rng(0)
    errors = rng.random((2, *light.shape)) * 1e-10 * np.array([1.0, 3.0])[:, None, None, None]
    time = dg.TimeAxis(bins=5, width_s=1e-9)

    def floor(with_it: np.ndarray, without: np.ndarray) -> float:
        whole, rest = (
            dg.Transient(time, {"primary": of}, {}, error, 0 * of[..., 0], np.zeros((2, 3)))
            for of, error in ((light, with_it), (0.9 * light, without))
        )
        return presence_against(whole, [("plate", rest)], IDEAL, EXPOSURE)["plate"].floor

    both, first, second = floor(*errors), floor(errors[0], 0 * light), floor(0 * light, errors[1])
    assert 0 < 2 * first < second
    assert both == pytest.approx(np.hypot(first, second), rel=1e-9)
    assert floor(errors[0], errors[0]) == pytest.approx(np.sqrt(2) * first, rel=1e-9)


@cache
def fine(albedo: float) -> tuple[dg.Transient, dg.Transient]:
    """Transients with the plate and without it, whose errors are far below their difference."""
    return dg.simulate(room(albedo), capture(), dg.Accuracy(target=0.01), seed=7), fine_without()


@cache
def fine_without() -> dg.Transient:
    """The transient without the plate, which is the same for any albedo of it."""
    return dg.simulate(room().without("plate"), capture(), dg.Accuracy(target=0.01), seed=7)


def expected(albedo: float, exposure: dg.Exposure = EXPOSURE) -> list[np.ndarray]:
    """Expected detections with the plate and without it."""
    return [dg.expected_histogram(of.total, of.time, IDEAL, exposure) for of in fine(albedo)]


def truth(albedo: float, exposure: dg.Exposure = EXPOSURE) -> float:
    full, empty = expected(albedo, exposure)
    return float(np.sqrt(((full - empty) ** 2 / np.maximum(full, empty)).sum()))


@pytest.mark.parametrize(
    ("albedo", "faint"),
    [pytest.param(0.0, True, marks=pytest.mark.nightly), (0.3, False)],
)
def test_a_matched_filter_on_draws_finds_the_stated_separation(albedo: float, faint: bool) -> None:
    """Histograms are drawn with and without the plate, for an exposure that makes σ 6. A faint plate is seen under
    daylight of many times its change in every bin, so that both spreads are equal."""
    draws, wanted = 1000 if faint else 400, 6.0
    day = replace(EXPOSURE, ambient_rate_hz=6e11 if faint else 1e4)
    exposure = replace(day, cycles=int(day.cycles * (wanted / truth(albedo, day)) ** 2) + 1)
    stated = presence(room(albedo), dg.Accuracy(target=0.01), exposure)
    full, empty = expected(albedo, exposure)
    weight = (full - empty) / np.maximum(full, empty)
    answers = []
    for seed, of in enumerate(fine(albedo)):
        many = np.tile(of.total, (draws, 1, 1))
        counts = dg.detect(many, of.time, IDEAL, exposure, seed=seed).reshape(draws, *weight.shape)
        answers.append((weight * counts).sum(axis=(1, 2, 3)))
    spreads = [of.std(ddof=1) for of in answers]
    measured = (answers[0].mean() - answers[1].mean()) / max(spreads)
    unsure = 4 * np.hypot(np.hypot(np.sqrt(2 / draws), measured / np.sqrt(2 * draws)), stated.floor)
    assert measured > stated.significance - unsure
    if faint:
        assert np.abs(full - empty).max() < 0.1 * full.min()
        assert measured == pytest.approx(stated.significance, abs=unsure)
    assert stated.floor < 0.1 * stated.significance


@pytest.mark.parametrize(
    ("albedo", "target"), [(0.0, 0.04), (0.3, 0.02), pytest.param(0.8, 0.1, marks=pytest.mark.nightly)]
)
def test_significance_is_within_its_floor_of_the_truth(albedo: float, target: float) -> None:
    found = presence(room(albedo), dg.Accuracy(target=target))
    assert abs(found.significance - truth(albedo)) < found.floor < 0.25 * found.significance


def test_errors_are_no_evidence() -> None:
    """A plate that no light reaches has no significance above its floor, even with so few samples that two
    simulations differ by many σ, and with other random numbers for each scene, which is the worst case."""
    scene, accuracy = room(), dg.Accuracy(samples=256)
    exposure = replace(EXPOSURE, cycles=10**7)
    pair = [dg.simulate(scene, capture(), accuracy, seed=seed) for seed in (1, 2)]
    a, b = (dg.expected_histogram(of.total, of.time, IDEAL, exposure) for of in pair)
    assert float(np.sqrt(((a - b) ** 2 / np.maximum(a, b)).sum())) > 100
    for given in (None, pair[1]):
        found = dg.presence_evidence(
            scene, capture(), accuracy, IDEAL, exposure, ["hidden", "plate"], seed=1, transient=given
        )
        assert found["hidden"].significance < 1.2 * found["hidden"].floor
        assert found["plate"].significance > found["plate"].floor


def test_with_one_sample_the_floor_is_unknown() -> None:
    found = presence(room(), dg.Accuracy(samples=1))
    assert np.isnan(found.floor)


def test_a_black_plate_is_detected_by_its_shadow() -> None:
    black = presence(room(0.0))
    own = dg.own_evidence(fine(0.0)[0], IDEAL, EXPOSURE, ["plate"])["plate"]
    assert own.significance == 0 and black.detections < 0 and black.significance > 3 * black.floor


@pytest.mark.parametrize(
    "spad",
    [
        IDEAL,
        replace(IDEAL, gate_start_s=7e-9, gate_width_s=4e-9),
        replace(IDEAL, mode="synchronous", dead_time_s=4e-8),
        replace(IDEAL, mode="free_running", dead_time_s=5e-9, jitter_fwhm_s=3e-10),
    ],
    ids=["ideal", "gated", "synchronous", "free running"],
)
def test_presence_without_shadows_is_the_evidence_of_own_light(spad: dg.Spad) -> None:
    lone = room(0.6, back=False)
    t = dg.simulate(lone, capture(), dg.Accuracy(target=0.005), seed=1)
    own = dg.own_evidence(t, spad, EXPOSURE, ["plate"])["plate"]
    found = dg.presence_evidence(lone, capture(), COARSE, spad, EXPOSURE, ["plate"], seed=3)["plate"]
    assert abs(found.significance - own.significance) < 0.02 * own.significance + found.floor
    assert found.detections == pytest.approx(own.detections, rel=0.05) and own.significance > 10


def test_presence_grows_with_the_root_of_the_exposure() -> None:
    once, four = (presence(room(), exposure=replace(EXPOSURE, cycles=n * EXPOSURE.cycles)) for n in (1, 4))
    for name, times in (("significance", 2), ("floor", 2), ("detections", 4)):
        assert getattr(four, name) == pytest.approx(times * getattr(once, name), rel=1e-9)


def test_unknown_parts_are_refused() -> None:
    with pytest.raises(dg.InputError, match="presence_evidence: part 'door': this scene has relay_wall, plate"):
        dg.presence_evidence(room(), capture(), COARSE, IDEAL, EXPOSURE, ["door"])
    assert dg.presence_evidence(room(), capture(), COARSE, IDEAL, EXPOSURE, []) == {}


def test_a_dataset_has_presence_on_request(tmp_path: Path) -> None:
    values = {
        "seed": 6,
        "scenes": 2,
        "scene": {"layout": {"kind": "l_corridor"}, "contents": [{"kind": "box", "count": {"choice": [1, 2]}}]},
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 96, "bin_width_ps": 600}},
        "transport": {"target": 0.2},
        "detector": {"cycles": 100_000},
    }
    plain = config_from_mapping(values | {"store": {"fields": ["histogram"]}})
    with_presence = config_from_mapping(values | {"store": {"fields": ["histogram", "objects", "presence"]}})
    data = dg.TransientDataset(write_dataset(with_presence, tmp_path / "set"), ("objects", "histogram"))
    for index in range(2):
        without, item = simulate_sample(plain, index), data[index]
        assert np.array_equal(without.arrays["histogram"], item["histogram"].numpy())
        assert not any("presence" in name for name in without.parameters)
        count = int(item["object_count"])
        table = item["object_presence"].numpy()
        names = ("box", "box_2")[:count]
        assert np.allclose(table[:count], [data.parameters(f"evidence.{name}.presence")[index] for name in names])
        assert not table[count:].any()
        for name in names:
            assert data.parameters(f"evidence.{name}.presence_floor")[index] > 0
    assert "evidence.box.presence_detections" in simulate_sample(with_presence, 0).parameters
