"""Evidence against laws that it obeys exactly, and against a matched filter on drawn histograms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.matched_filter import MODES, farthest_of, ready, separation

import datagen as dg
from datagen.detector.expected import one_per_cycle_mean
from datagen.records import Transient
from datagen.store.columns import Columns
from datagen.store.summaries import evidence_by_kind, evidence_lines

TIME = dg.TimeAxis(bins=60, width_s=2e-10)
PARTS = ("wall", "box", "pillar")


def transient(seed: int = 0, pixels: int = 2) -> Transient:
    """Light of three parts, and some that belongs to none (bounces beyond the third)."""
    rng = np.random.default_rng(seed)
    parts = {name: rng.random((3, pixels, TIME.bins)) * (rng.random(TIME.bins) < 0.4) * 1e-12 for name in PARTS}
    primary = sum(parts.values(), start=np.zeros((3, pixels, TIME.bins)))
    more = rng.random(primary.shape) * 1e-13
    zeros = np.zeros_like(primary)
    return Transient(TIME, {"primary": primary, "secondary": more}, parts, zeros, zeros[..., 0], np.zeros((3, 3)))


DETECTORS = {
    "ideal": dg.Spad(pde=0.4, dark_count_rate_hz=1e5),
    "jitter": dg.Spad(pde=0.4, jitter_fwhm_s=5e-10, jitter_tail_s=3e-10),
    "gated": dg.Spad(pde=0.4, dark_count_rate_hz=1e5, gate_start_s=2e-9, gate_width_s=6e-9, gate_rise_s=1e-9),
    "synchronous": dg.Spad(pde=0.4, mode="synchronous", dead_time_s=5e-8, jitter_fwhm_s=3e-10),
    "free running": dg.Spad(pde=0.4, dead_time_s=1.3e-9, dark_count_rate_hz=1e6),
    "paralyzable": dg.Spad(pde=0.4, dead_time_s=1.3e-9, paralyzable=True),
    "afterpulses": dg.Spad(pde=0.4, mode="synchronous", dead_time_s=2e-9, afterpulse_probability=0.05),
    "crosstalk": dg.Spad(pde=0.4, dead_time_s=2e-9, crosstalk_probability=0.02),
}
BRIGHT = dg.Exposure(repetition_rate_hz=2e7, cycles=10_000, photons_per_pulse=3e10, pulse_fwhm_s=3e-10)


@pytest.mark.parametrize("name", DETECTORS)
def test_detections_of_parts_add_up_to_the_expected_histogram(name: str) -> None:
    """Without background and caused avalanches, every detection is due to a photon of one of the lights."""
    quiet = {"dark_count_rate_hz": 0.0, "afterpulse_probability": 0.0, "crosstalk_probability": 0.0}
    t, spad = transient(), replace(DETECTORS[name], **quiet)
    parts = t.parts | {"rest": t.components["secondary"]}
    found = dg.own_evidence(replace(t, parts=parts | {"two": parts["box"] + parts["pillar"]}), spad, BRIGHT)
    expected = dg.expected_histogram(t.total, TIME, spad, BRIGHT, approximate=True)
    assert np.isclose(sum(found[part].detections for part in parts), expected.sum(), rtol=2e-3)
    assert np.isclose(found["box"].detections + found["pillar"].detections, found["two"].detections, rtol=1e-9)
    # Two lights together stand out more than either, and by no more than if they shared no bin.
    alone = (found["box"].significance, found["pillar"].significance)
    assert max(alone) <= found["two"].significance <= sum(alone)


def test_caused_avalanches_belong_to_no_part() -> None:
    t = transient()
    clean = dg.own_evidence(t, replace(DETECTORS["afterpulses"], afterpulse_probability=0.0), BRIGHT)
    noisy = dg.own_evidence(t, DETECTORS["afterpulses"], BRIGHT)
    for part in PARTS:
        # Their dead time removes detections of the part, and their counts hide it.
        assert 0.9 * clean[part].detections < noisy[part].detections < clean[part].detections
        assert noisy[part].significance < clean[part].significance


@pytest.mark.parametrize("name", DETECTORS)
def test_evidence_grows_with_the_root_of_the_exposure(name: str) -> None:
    t, spad = transient(), DETECTORS[name]
    short, long = (dg.own_evidence(t, spad, replace(BRIGHT, cycles=n)) for n in (10_000, 90_000))
    for part in PARTS:
        for quantity, times in (("detections", 9), ("brightest_bin", 9), ("significance", 3)):
            assert np.isclose(getattr(long[part], quantity), times * getattr(short[part], quantity), rtol=1e-9)


def test_significance_of_a_lone_light_is_the_root_of_its_detections() -> None:
    light = transient().parts["box"]
    alone = Transient(TIME, {"primary": light}, {"box": light}, 0 * light, light[..., 0], np.zeros((3, 3)))
    found = dg.own_evidence(alone, dg.Spad(pde=0.4, mode="ideal"), replace(BRIGHT, pulse_fwhm_s=0.0))["box"]
    assert np.isclose(found.detections, 0.4 * 3e10 * 10_000 * light.sum(), rtol=1e-9)
    assert np.isclose(found.significance, np.sqrt(found.detections), rtol=1e-9)


def test_one_detection_a_cycle_gives_the_information_of_its_multinomial() -> None:
    """N cycles, of which p_i end in bin i: the information on a light is N [Σ p'²/p + (Σ p')²/(1 − Σ p)]."""
    rng = np.random.default_rng(3)
    own = rng.random(400) * 2e-5
    flux = own + rng.random(400) * 3e-3
    time, cycles = dg.TimeAxis(bins=400, width_s=1e-10), 1000
    before = np.cumsum(flux) - flux
    p = one_per_cycle_mean(flux)
    change = np.exp(-before - flux) * own - p * (np.cumsum(own) - own)
    information = cycles * (np.sum(change**2 / p) + change.sum() ** 2 / (1 - p.sum()))
    spad = dg.Spad(pde=1.0, mode="synchronous", dead_time_s=1e-6)
    exposure = dg.Exposure(repetition_rate_hz=2.5e7, cycles=cycles, photons_per_pulse=1e9)
    light, part = flux.reshape(1, 1, -1) * 1e-9, own.reshape(1, 1, -1) * 1e-9
    t = Transient(time, {"primary": light}, {"box": part}, 0 * light, light[..., 0], np.zeros((1, 3)))
    # To second order in the flux of a bin.
    assert np.isclose(dg.own_evidence(t, spad, exposure)["box"].significance, np.sqrt(information), rtol=1e-5)


def test_nothing_is_seen_through_a_shut_gate_or_in_a_full_counter() -> None:
    t = transient()
    shut = dg.Spad(pde=0.4, mode="ideal", gate_start_s=2e-8, gate_width_s=1e-8)
    assert dg.own_evidence(t, shut, BRIGHT)["box"] == dg.Evidence(0.0, 0.0, 0.0)
    free = dg.own_evidence(t, dg.Spad(pde=0.4, mode="ideal"), BRIGHT)["box"]
    for counter, kept in ((10**9, 1.0), (1, 0.0)):
        found = dg.own_evidence(t, dg.Spad(pde=0.4, mode="ideal", counter_max=counter), BRIGHT)["box"]
        assert np.isclose(found.detections, kept * free.detections)


def test_an_unknown_part_is_refused() -> None:
    with pytest.raises(dg.InputError, match="part 'sofa': this transient is split by wall, box, pillar"):
        dg.own_evidence(transient(), dg.Spad(), BRIGHT, ["sofa"])


@pytest.mark.parametrize("scenes", [len(MODES), pytest.param(200, marks=pytest.mark.nightly)])
def test_matched_filters_have_the_stated_significance(scenes: int) -> None:
    """On drawn histograms of each scene, at a level of 1e-3 for all scenes together."""
    draws = 400 if scenes == len(MODES) else 1000
    found = [separation(number, MODES[number % len(MODES)], draws) for number in range(scenes)]
    assert all(of.stated > 0.5 for of in found[: len(MODES)])
    assert max(of.beyond for of in found) < farthest_of(scenes)
    if scenes == 200:
        # For σ under 1 the ratio is mostly noise. The error of the median is far below 3 %.
        assert abs(np.median([of.measured / of.stated for of in found if of.stated > 1]) - 1) < 0.03


def test_the_dead_time_that_an_object_causes_separates_further() -> None:
    """A letter brings nearly all the light: the separation is above σ, and as the law of the detector predicts."""
    letter = next(number for number, of in enumerate(ready()) if of.name == "letters_on_a_bench")
    found = separation(letter, "free running", 3000)
    assert found.follows > 1.05 * found.stated
    assert found.beyond < 4.0 < (found.measured - found.stated) / found.error


def test_the_summary_of_kinds() -> None:
    sigma = {"box": [1.5, 30.0], "box_2": [6.0], "cone": [0.5], "ghost": [0.0]}
    scenes = [
        {f"evidence.{name}.significance": values[k] for name, values in sigma.items() if k < len(values)}
        | {"evidence.weakest": 0.0, "evidence.box.detections": 5.0}
        for k in range(2)
    ]
    box, cone, ghost = evidence_by_kind(Columns(scenes))
    assert (box.objects, box.median, box.exposure_factor) == (3, 6.0, 4.0)
    assert np.isclose(box.under_3, 1 / 3) and box.under_1 == 0.0 and cone.under_1 == 1.0
    assert all(f"{of.kind}: " in line for of, line in zip((box, ghost), evidence_lines([box, ghost]), strict=True))
    # With the exposure that the summary states, the object is over 3 σ.
    more = {"evidence.box.significance": 1.5 * np.sqrt(box.exposure_factor)}
    assert evidence_by_kind(Columns([more]))[0].under_3 == 0.0
