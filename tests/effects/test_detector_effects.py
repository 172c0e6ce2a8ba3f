"""The bounds on the timing response and on unequal bins of the TDC bound the change of the expected histogram without
them; the detector's other effects are always simulated, because leaving them out saves nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from datagen.detector import Exposure, Spad, expected_histogram
from datagen.effects import decide_detector_effects
from datagen.effects.detector_effects import DETECTOR_EFFECTS, Detection
from datagen.records import TimeAxis

ROWS = {row.name: row for row in DETECTOR_EFFECTS}
AXIS = TimeAxis(100, 0.2e-9, 0.0, "wall")


def signal(rng: np.random.Generator, axis: TimeAxis = AXIS) -> np.ndarray:
    """(2, 2, bin) transients with an early peak, a hump, and empty bins."""
    t = np.arange(axis.bins)
    rows = [
        np.exp(-0.5 * ((t - rng.uniform(0.2, 0.8) * axis.bins) / rng.uniform(1, 10)) ** 2)
        + rng.uniform(0, 3) * (t == int(rng.integers(axis.bins // 2)))
        for _ in range(4)
    ]
    values = np.array(rows) * rng.uniform(0.2, 1.0, (4, 1))
    values[values < 1e-4] = 0.0
    return (values / values.sum(axis=1).max()).reshape(2, 2, axis.bins) * 1e-9


def random_detection(rng: np.random.Generator) -> Detection:
    """A detector with everything, from dim to bright; effects strong and weak."""

    def chance(low: float, high: float) -> float:
        return float(low * (high / low) ** rng.random())

    open_long = rng.random() < 0.5
    mode = ("ideal", "synchronous", "free_running")[int(rng.integers(3))]
    spad = Spad(
        pde=0.3,
        dark_count_rate_hz=chance(1e-1, 1e6),
        dead_time_s=chance(1e-10, 1e-6),
        jitter_fwhm_s=chance(1e-11, 1e-10),
        jitter_tail_s=chance(1e-12, 2e-11),
        afterpulse_probability=chance(1e-6, 0.05),
        afterpulse_times_s=(chance(5e-9, 3e-7),),
        crosstalk_probability=chance(1e-6, 0.02),
        array_columns=2,
        mode=mode,  # type: ignore[arg-type]
        gate_start_s=chance(1e-12, 1e-11) if open_long else chance(1e-10, 8e-9),
        gate_width_s=chance(1.9e-8, 1.999e-8) if open_long else chance(1e-9, 12e-9),
        counter_max=int(chance(3, 3000)),
    )
    exposure = Exposure(
        repetition_rate_hz=float(rng.choice([5e6, 20e6, 50e6])),
        cycles=int(rng.choice([100, 1000, 10000])),
        photons_per_pulse=chance(1e5, 1e10),
        ambient_rate_hz=chance(1e-1, 1e7),
        pulse_fwhm_s=chance(1e-11, 1e-10),
    )
    if rng.random() < 0.4:
        spad = replace(spad, gate_start_s=None, gate_width_s=None)
    if rng.random() < 0.4:
        spad = replace(spad, counter_max=None)
    if rng.random() < 0.6:
        spad = replace(spad, afterpulse_probability=0.0, crosstalk_probability=0.0)
    if rng.random() < 0.5:
        spad = replace(spad, tdc_dnl=chance(1e-6, 1.0), tdc_period_bins=int(chance(8, 200)))
    return Detection(spad, exposure, 1e-3, signal(rng), AXIS)


def change(given: Detection, without: Detection) -> float:
    """Relative L2 change of the expected histograms, recorded over the whole period so that both have the same bins:
    otherwise the dark rest of the period is cut up, and rounded, according to the response's length."""
    time, recorded = given.time, given.time.bins
    whole = replace(time, bins=round(given.exposure.period_s / time.width_s))
    transient = np.pad(given.transient, ((0, 0), (0, 0), (0, whole.bins - recorded)))
    mean, reference = (
        expected_histogram(transient, whole, d.spad, d.exposure, approximate=True)[..., :recorded]
        for d in (without, given)
    )
    return float(np.linalg.norm(mean - reference) / np.linalg.norm(reference))


@pytest.mark.parametrize("detectors", [50, pytest.param(4000, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("effect", ["timing_response", "tdc_nonlinearity"])
def test_bound_holds_in_random_detectors(effect: str, detectors: int) -> None:
    """The test needs detectors in which the effect matters, and others in which it does not."""
    row, rng = ROWS[effect], np.random.default_rng(11)
    assert row.change is not None
    strong = weak = tried = 0
    while strong < 3 or weak < 20 or tried < detectors:
        given = random_detection(rng)
        if not row.present(given):
            continue
        found = row.change(given)
        if found.value is None:
            continue
        actual = change(given, row.without(given))
        assert actual <= found.value * (1 + 1e-6) + 1e-13, (found, given.spad, given.exposure)
        strong, weak, tried = strong + (actual > 0.01), weak + (found.value <= 0.01), tried + 1


def test_bright_light_outside_the_gate_counts() -> None:
    """The gate shuts out a flash a thousand times as bright as the rest, of which the response moves some into it."""
    values = np.full((1, 1, AXIS.bins), 1e-12)
    values[..., 20] = 1e-8
    spad = Spad(pde=0.3, mode="ideal", jitter_tail_s=2e-11, gate_start_s=4.2e-9, gate_width_s=1e-8)
    given = Detection(spad, Exposure(cycles=1000, photons_per_pulse=1e10), 1e-3, values, AXIS)
    row = ROWS["timing_response"]
    assert row.change is not None
    found, actual = row.change(given), change(given, row.without(given))
    assert actual > 0.9 and (found.value is None or found.value >= actual)
    no_gate = given.with_spad(gate_start_s=None, gate_width_s=None)
    assert change(no_gate, row.without(no_gate)) < 0.1


def test_effects_that_save_nothing_are_simulated() -> None:
    """Under `auto` the sampler's bias is at most `detector.tolerance`; under `on` the sampler is exact."""
    given = random_detection(np.random.default_rng(3))
    decided = decide_detector_effects(given.transient, given.time, given.spad, given.exposure)
    for decision in decided.decisions:
        if ROWS[decision.effect].change is None and decision.kind != "absent":
            assert decision.simulated and decision.kind == "always" and "saves nothing" in decision.reason
    assert decided.apply_detector(given.spad, given.exposure, 1e-3)[2] == 1e-3


@pytest.mark.parametrize("jitter_fwhm_s", [2e-10, 3e-9])
def test_a_short_last_bin_keeps_its_records(jitter_fwhm_s: float) -> None:
    """A period of 29.64 bins: jitter far narrower than a bin moves nothing, a wide one loses and adds nothing."""
    axis = TimeAxis(29, 4e-9, 0.0, "wall")
    exposure = Exposure(repetition_rate_hz=1 / (29.64 * 4e-9), cycles=10**6, photons_per_pulse=0.0)
    sharp = Spad(dark_count_rate_hz=1e6, mode="ideal")
    dark = np.zeros((1, 1, 29))
    mean = expected_histogram(dark, axis, sharp, exposure)
    jittery = replace(sharp, jitter_fwhm_s=jitter_fwhm_s)
    moved = expected_histogram(dark, axis, jittery, exposure)
    even = 1e6 * 4e-9 * 1e6
    assert mean == pytest.approx(even)
    # Seen from bin 0 and bin 28, the short bin stands for a whole one: some of the wide jitter's records lack there.
    inner = slice(3, 26)
    assert moved[..., inner] == pytest.approx(even, rel=1e-9)
    if jitter_fwhm_s < 1e-9:
        assert moved == pytest.approx(mean, rel=1e-9)
