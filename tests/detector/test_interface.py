"""Bad input, batching, the choice of samplers, classes of detectors, and detectors drawn from a configuration."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.config.detector import DetectorConfig
from datagen.detector import (
    DETECTOR_CLASSES,
    Exposure,
    Spad,
    choose_sampler,
    detect,
    detector_for,
    expected_histogram,
)
from datagen.errors import InputError
from datagen.records import TimeAxis

TIME = TimeAxis(64, 1e-9)
EXPOSURE = Exposure(repetition_rate_hz=1e7, cycles=5000, photons_per_pulse=1.0)
RNG = np.random.default_rng(0)
BLOCK = RNG.random((4, 6, 64)) * 0.02


def spike(laser: int, pixel: int, bin_: int, value: float) -> np.ndarray:
    values = np.zeros((3, 2, 64))
    values[laser, pixel, bin_] = value
    return values


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Spad(pde=1.5), ["Spad.pde", "1.5", "0 … 1"]),
        (lambda: Spad(dead_time_s=50), ["Spad.dead_time_s", "50e-9"]),
        (lambda: Spad(afterpulse_probability=0.9), ["Spad.afterpulse_probability", "0.5"]),
        (lambda: Spad(afterpulse_times_s=()), ["afterpulse_times_s"]),
        (lambda: Spad(afterpulse_times_s=(1e-8, 1e-7), afterpulse_weights=(1.0,)), ["2 weights"]),
        (lambda: Spad(mode="gated"), ["Spad.mode", "'gated'", "free_running"]),
        (lambda: Spad(gate_start_s=1e-9), ["gate_start_s", "gate_width_s", "both"]),
        (lambda: Spad(gate_start_s=0.0, gate_width_s=0.0), ["gate_width_s", "positive"]),
        (lambda: Spad(gate_start_s=0.0, gate_width_s=2e-9, gate_rise_s=2e-9), ["gate_rise_s", "half"]),
        (lambda: Spad(paralyzable=True, afterpulse_probability=0.1), ["paralyzable"]),
        (lambda: Spad(counter_max=0), ["counter_max", "1 …"]),
        (lambda: Exposure(cycles=1e6), ["Exposure.cycles", "integer"]),
        (lambda: Exposure(ambient_rate_hz=float("nan")), ["Exposure.ambient_rate_hz"]),
        (lambda: detect(spike(1, 0, 7, np.nan), TIME, Spad(), EXPOSURE), ["laser 1, pixel 0, bin 7", "nan"]),
        (lambda: detect(spike(0, 1, 3, -1e-30), TIME, Spad(), EXPOSURE), ["laser 0, pixel 1, bin 3", "≥ 0"]),
        (lambda: detect(np.zeros((2, 64)), TIME, Spad(), EXPOSURE), ["shape (2, 64)", "(laser, pixel, bin)"]),
        (lambda: detect(np.zeros((1, 1, 63)), TIME, Spad(), EXPOSURE), ["64 bins"]),
        (lambda: detect(np.zeros((0, 1, 64)), TIME, Spad(), EXPOSURE), ["empty"]),
        (lambda: detect([["a"]], TIME, Spad(), EXPOSURE), ["real numbers"]),
        (lambda: detect(BLOCK, TIME, Spad(gate_start_s=50e-9, gate_width_s=60e-9), EXPOSURE), ["gate", "period"]),
        (lambda: detect(BLOCK, TIME, Spad(), EXPOSURE, seed=-1), ["seed", "≥ 0"]),
        (lambda: detect(BLOCK, TIME, Spad(), EXPOSURE, tolerance=-1.0), ["tolerance"]),
        (lambda: detect(BLOCK, TIME, Spad(), EXPOSURE, first_pixel=-1), ["first_pixel"]),
        (lambda: detect(BLOCK, TIME, Spad(), EXPOSURE, dtype=np.float32), ["dtype", "integer"]),
        (
            lambda: detect(spike(1, 1, 5, 1.0), TIME, Spad(), Exposure(1e7, 10**6, 1.0), dtype=np.uint16),
            ["laser 1, pixel 1, bin 5", "uint16", "65535", "counter_max"],
        ),
        (
            lambda: detect(spike(0, 1, 9, 1.0), TIME, Spad(), Exposure(1e7, 10**12, 1e9)),
            ["laser 0, pixel 1", "bin 9", "1e+13"],
        ),
        (
            lambda: detect(BLOCK, TIME, Spad(dead_time_s=1e-9), Exposure(1e7, 10**9, 1.0)),
            ["laser 0, pixel 0", "2e+07", "approximate=True"],
        ),
        (
            lambda: detect(
                BLOCK, TIME, Spad(dead_time_s=1e-9, afterpulse_probability=0.1), Exposure(1e7, 10**9, 1.0)
            ),
            ["afterpulsing", "2e+07", "approximate=True"],
        ),
        (
            lambda: expected_histogram(BLOCK, TIME, Spad(dead_time_s=1e-8, afterpulse_probability=0.1), EXPOSURE),
            ["no exact mean", "approximate=True"],
        ),
        (
            lambda: detect(BLOCK, TIME, Spad(crosstalk_probability=0.1, array_columns=4), EXPOSURE),
            ["array_columns", "whole rows"],
        ),
        (lambda: Spad(tdc_dnl=2.5), ["Spad.tdc_dnl", "2.5", "0 … 2"]),
        (lambda: Spad(tdc_period_bins=7), ["Spad.tdc_period_bins", "7", "8 … 65536"]),
        (lambda: Spad(dark_count_factors=(1.0, -1.0)), ["Spad.dark_count_factors", "negative"]),
        (
            lambda: detect(BLOCK[:, :2], TIME, Spad(dark_count_factors=(1, 2, 3)), EXPOSURE, first_pixel=2),
            ["dark_count_factors", "3 numbers", "2 … 3"],
        ),
        (lambda: Spad(tdc_seed=-1), ["Spad.tdc_seed", "0 …"]),
        (lambda: Spad(tdc_edges_s=(0, 1e-9), tdc_dnl=0.1), ["tdc_dnl", "tdc_edges_s", "leave one out"]),
        (lambda: Spad(tdc_edges_s=(0.0,)), ["tdc_edges_s", "shape (1,)", "(pixel, edge)"]),
        (lambda: Spad(tdc_edges_s=((0, 1), (0,))), ["tdc_edges_s", "real numbers"]),
        (lambda: Spad(tdc_edges_s=((0, 1e-9), (0, np.nan))), ["tdc_edges_s[1]", "nan"]),
        (lambda: Spad(tdc_edges_s=((0, 2e-9, 1e-9, 3e-9),)), ["tdc_edges_s[0]", "never descend"]),
        (lambda: Spad(tdc_edges_s=(1e-9, 2e-9)), ["tdc_edges_s[0]", "start at 0"]),
        (lambda: Spad(tdc_edges_s=((0, 1e-9), (0, 2e-9))), ["tdc_edges_s[1]", "same time"]),
        (
            lambda: detect(BLOCK, TIME, Spad(tdc_edges_s=(0, 1e-9, 3e-9)), EXPOSURE),
            ["tdc_edges_s", "2 bins", "3e-09", "2e-09", "1.5e-09"],
        ),
        (
            lambda: detect(BLOCK[:, :2], TIME, Spad(tdc_edges_s=((0, 1e-9),) * 5), EXPOSURE, first_pixel=4),
            ["tdc_edges_s", "5 pixels", "4 … 5"],
        ),
    ],
)
def test_bad_input_is_one_line_that_names_it(make, words):
    with pytest.raises(InputError) as caught:
        make()
    message = str(caught.value)
    assert "\n" not in message
    for word in words:
        assert word in message, message


SPADS = {
    "ideal": Spad(pde=0.9, mode="ideal", dark_count_rate_hz=1e4, hot_pixel_fraction=0.3, jitter_fwhm_s=2e-9),
    "one_per_cycle": Spad(pde=0.9, mode="synchronous", dead_time_s=1e-6, jitter_fwhm_s=2e-9),
    "many_per_cycle": Spad(pde=0.9, mode="synchronous", dead_time_s=13e-9),
    "free_running": Spad(pde=0.9, dead_time_s=130e-9, jitter_fwhm_s=2e-9),
    "afterpulsing": Spad(pde=0.9, dead_time_s=130e-9, afterpulse_probability=0.1),
    "paralyzable": Spad(pde=0.9, dead_time_s=30e-9, paralyzable=True),
    "unequal_bins": Spad(pde=0.9, dead_time_s=130e-9, tdc_dnl=0.5, tdc_period_bins=24),
    "unequal_given": Spad(pde=0.9, mode="ideal", tdc_edges_s=[(0, k * 1e-10, 2e-9) for k in range(6)]),
}


@pytest.mark.parametrize("name", SPADS)
def test_counts_follow_from_the_seed_and_every_histogram_has_its_own(name):
    spad = SPADS[name]
    whole = detect(BLOCK, TIME, spad, EXPOSURE, seed=11)
    np.testing.assert_array_equal(whole, detect(BLOCK, TIME, spad, EXPOSURE, seed=11))
    # What the pixels of a part of an array are is that of the whole.
    means = expected_histogram(BLOCK, TIME, spad, EXPOSURE, approximate=True)
    part = expected_histogram(BLOCK[1:3, 2:5], TIME, spad, EXPOSURE, approximate=True, first_pixel=2)
    np.testing.assert_allclose(means[1:3, 2:5], part, rtol=1e-9)
    assert (whole != detect(BLOCK, TIME, spad, EXPOSURE, seed=12)).any()
    same_light = detect(np.broadcast_to(BLOCK[:1, :1], BLOCK.shape), TIME, spad, EXPOSURE, seed=11)
    assert len({same_light[i, j].tobytes() for i in range(4) for j in range(6)}) == 24


def test_float32_and_lists_are_taken_and_left_alone():
    single = BLOCK.astype(np.float32)
    kept = single.copy()
    counts = detect(single, TIME, Spad(), EXPOSURE)
    np.testing.assert_array_equal(single, kept)
    np.testing.assert_array_equal(counts, detect(single.astype(float), TIME, Spad(), EXPOSURE))
    assert detect(BLOCK[0, 0].tolist(), TIME, Spad(), EXPOSURE).shape == (64,)
    assert detect(BLOCK, TIME, Spad(), EXPOSURE, dtype=np.uint16).dtype == np.uint16


MODES = ("ideal", "synchronous", "free_running")


@pytest.mark.parametrize("mode", MODES)
def test_an_axis_longer_than_the_period_is_refused(mode):
    """In every mode, by whatever takes an exposure; what the refusal allows is taken."""
    spad, light = Spad(mode=mode), np.full(64, 1e-3)
    for take in (detect, expected_histogram, choose_sampler):
        with pytest.raises(InputError, match=r"rate_hz = 2e\+07.* at most 50 bins, 781.25 ps a bin, or 15.625 MHz"):
            take(light, TIME, spad, Exposure(20e6, 1000, 1.0))
        take(light[:50], TimeAxis(50, 1e-9), spad, Exposure(20e6, 1000, 1.0))
        take(light, TIME, spad, Exposure(15.625e6, 1000, 1.0))


def test_every_mode_measures_times_since_the_last_pulse():
    """What jitter and the laser's pulse move beyond the end of the period appears at its start."""
    transient = np.zeros(64)
    transient[[0, 63]] = 0.1
    exposure = Exposure(1 / 64e-9, 1000, 1.0, pulse_fwhm_s=2e-9)
    seen = [
        expected_histogram(transient, TIME, Spad(pde=1.0, mode=mode, jitter_fwhm_s=3e-9, dead_time_s=0.0), exposure)
        for mode in MODES
    ]
    np.testing.assert_allclose(seen[1:], [seen[0], seen[0]], atol=1e-9)
    np.testing.assert_allclose(seen[0], seen[0][::-1], atol=1e-9)
    assert seen[0].sum() == pytest.approx(200.0)


def test_background_outside_the_window_causes_dead_time():
    exposure = Exposure(1e6, 10**5, 1.0, ambient_rate_hz=1e7)
    transient = np.zeros(64)
    mean = expected_histogram(transient, TIME, Spad(pde=1.0, dead_time_s=300e-9), exposure)
    law = 1e7 / (1 + 1e7 * 300e-9) * 1e5 * 1e-9
    np.testing.assert_allclose(mean, law, rtol=1e-9)


def test_gate_with_ramps_passes_its_area():
    spad = Spad(pde=1.0, gate_start_s=10.3e-9, gate_width_s=20e-9, gate_rise_s=3e-9, dark_count_rate_hz=1e6)
    mean = expected_histogram(np.zeros(64), TIME, spad, EXPOSURE)
    assert mean.sum() == pytest.approx(5000 * 1e6 * 17e-9, rel=1e-9)
    assert mean[:10].sum() == 0 == mean[31:].sum()
    assert mean[20] == pytest.approx(5000 * 1e6 * 1e-9)


def test_hot_pixels_belong_to_the_array():
    spad = Spad(dark_count_rate_hz=100, hot_pixel_fraction=0.1, hot_pixel_factor=50, hot_pixel_seed=4)
    mean = expected_histogram(np.zeros((1, 5000, 1)), TimeAxis(1, 1e-9), spad, EXPOSURE)[0, :, 0]
    hot = mean > 2 * mean.min()
    assert 380 < hot.sum() < 620
    np.testing.assert_allclose(mean[hot], 50 * mean[~hot].mean(), rtol=1e-9)
    part = expected_histogram(np.zeros((1, 40, 1)), TimeAxis(1, 1e-9), spad, EXPOSURE, first_pixel=777)
    np.testing.assert_array_equal(part[0, :, 0], mean[777:817])


@pytest.mark.parametrize(
    ("spad", "flux", "cycles", "sampler"),
    [
        (Spad(pde=1.0, mode="ideal", dead_time_s=1e-6), 5.0, 10**6, "poisson"),
        (Spad(pde=1.0, mode="free_running"), 5.0, 10**6, "poisson"),
        (Spad(pde=1.0, dead_time_s=50e-9), 1e-3, 10**6, "poisson"),
        (Spad(pde=1.0, dead_time_s=50e-9), 1e-3, 10**9, "events"),
        (Spad(pde=1.0, dead_time_s=50e-9), 0.5, 10**6, "events"),
        (Spad(pde=1.0, mode="synchronous", dead_time_s=1e-6), 0.5, 10**6, "chain"),
        (Spad(pde=1.0, mode="synchronous", dead_time_s=20e-9), 0.5, 10**6, "chain"),
        (Spad(pde=1.0, mode="synchronous", dead_time_s=20e-9), 0.5, 50, "events"),
        (Spad(pde=1.0, dead_time_s=50e-9, afterpulse_probability=0.02), 0.01, 10**6, "events"),
        (Spad(pde=1.0, dead_time_s=50e-9, paralyzable=True), 0.5, 10**6, "events"),
    ],
)
def test_the_cheapest_sampler_within_its_bound_is_chosen(spad, flux, cycles, sampler):
    transient = np.full(64, flux / 64)
    plan = choose_sampler(transient, TIME, spad, Exposure(1e7, cycles, 1.0))
    assert plan.sampler == sampler, plan
    assert plan.histograms == {sampler: 1}
    assert plan.flux_per_cycle == pytest.approx(flux)
    assert plan.reason and not plan.approximate
    exact = choose_sampler(transient, TIME, spad, Exposure(1e7, cycles, 1.0), tolerance=0.0)
    assert exact.poisson_bias == 0 or exact.sampler != "poisson"


def test_samplers_are_chosen_for_each_histogram():
    transient = np.zeros((2, 1, 64))
    transient[0], transient[1] = 1e-9, 0.01
    plan = choose_sampler(transient, TIME, Spad(pde=1.0, dead_time_s=50e-9), Exposure(1e7, 10**6, 1.0))
    assert plan.histograms == {"events": 1, "poisson": 1}
    assert plan.sampler == "events"


@pytest.mark.parametrize("name", sorted(DETECTOR_CLASSES))
def test_classes_stay_in_their_ranges_and_are_correlated(name):
    ranges = DETECTOR_CLASSES[name]
    assert all(r.source for r in ranges.values())
    config = DetectorConfig(detector_class=name, mode="free_running")
    drawn = [detector_for(config, seed=1, index=i) for i in range(200)]
    for key, r in ranges.items():
        values = [
            e.repetition_rate_hz if key == "repetition_rate_hz"
            else s.afterpulse_times_s[0] if key == "afterpulse_times_s"
            else getattr(s, key)
            for s, e in drawn
        ]  # fmt: skip
        assert min(values) >= r.low * (1 - 1e-12) and max(values) <= r.high * (1 + 1e-12), key
        assert r.low == r.high or np.ptp(values) > 0.5 * (r.high - r.low) or r.log
    for pair, sign in ((("pde", "dark_count_rate_hz"), 1), (("dead_time_s", "afterpulse_probability"), -1)):
        ranks = [np.argsort(np.argsort([getattr(s, k) for s, _ in drawn])) for k in pair]
        assert sign * np.corrcoef(*ranks)[0, 1] > 0.3


def test_configured_numbers_replace_those_of_the_class_and_scenes_are_independent():
    config = DetectorConfig.model_validate_json(
        '{"detector_class": "any", "mode": "synchronous", "pde": {"uniform": [0.1, 0.2]}, "dead_time_ns": 33,'
        ' "cycles": {"log_uniform": [1e3, 1e5]}, "gate": {"start_ns": 5, "width_ns": 20, "rise_ps": 200}}'
    )
    drawn = [detector_for(config, 5, i) for i in range(60)]
    assert all(0.1 <= s.pde <= 0.2 and s.dead_time_s == pytest.approx(33e-9) for s, _ in drawn)
    gates = [(s.gate_start_s, s.gate_width_s, s.gate_rise_s) for s, _ in drawn]
    assert all(gate == pytest.approx((5e-9, 20e-9, 2e-10)) for gate in gates)
    assert all(1e3 <= e.cycles <= 1e5 for _, e in drawn)
    assert len({s.pde for s, _ in drawn}) == 60
    assert drawn[7] == detector_for(config, 5, 7)
    assert detector_for(config, 6, 7) != drawn[7]


def test_rates_that_are_not_given_leave_room_for_the_time_axis():
    long = TimeAxis(1000, 1e-9)
    for config in (DetectorConfig(detector_class="si_array"), DetectorConfig()):
        drawn = [detector_for(config, 0, i, long) for i in range(20)]
        assert all(exposure.period_s >= 1e-6 * (1 - 1e-12) for _, exposure in drawn)
        detect(np.zeros(1000), long, *drawn[0])
    fixed = DetectorConfig(detector_class="si_array", repetition_rate_mhz=0.5)
    assert detector_for(fixed, 0, 0, long)[1].repetition_rate_hz == pytest.approx(0.5e6)


NOT_OF_THE_DETECTOR = {"detector_class", "gate", "exposure_for", "found_for", "tolerance", "approximate"}
OTHER_VALUES = {
    "mode": "synchronous", "dark_count_factors": (2.0,), "paralyzable": True, "array_columns": 3,
    "tdc_edges_ps": ((0.0, 4.0, 8.0),), "pulse": {"samples": (1.0, 2.0), "sample_ps": 50.0}, "counter_max": 7,
    "bins_merged": 2, "hot_pixel_factor": 30.0, "tdc_period_bins": 16,
}  # fmt: skip


@pytest.mark.parametrize("key", sorted(set(DetectorConfig.model_fields) - NOT_OF_THE_DETECTOR))
def test_every_key_of_the_configuration_reaches_the_detector(key):
    """Keys are matched with the fields of `Spad` and `Exposure` by their names and units."""
    given = DetectorConfig.model_validate({key: OTHER_VALUES.get(key, 0.125 if key != "cycles" else 5.0)})
    default, changed = (detector_for(config, 3, 0) for config in (DetectorConfig(), given))
    assert default != changed
    units = {"_ps": 1e-12, "_ns": 1e-9, "_mhz": 1e6}
    unit = next((unit for ending, unit in units.items() if key.endswith(ending)), 1.0)
    numbers = {value for one in changed for value in vars(one).values() if isinstance(value, float)}
    numbers |= set(changed[0].afterpulse_times_s)
    if key not in OTHER_VALUES and key != "cycles":
        assert any(number == pytest.approx(0.125 * unit, rel=1e-12) for number in numbers)
