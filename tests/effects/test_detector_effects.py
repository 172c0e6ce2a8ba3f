"""Each bound of the detector's table bounds what leaving the effect out changes in the expected histogram."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from datagen.detector import Exposure, Spad, detect, expected_histogram
from datagen.detector.expected import has_exact_mean
from datagen.effects import plan_detector_effects
from datagen.effects.detector_effects import DETECTOR_EFFECTS
from datagen.effects.detector_world import DetectorWorld
from datagen.records import TimeAxis

ROWS = {row.name: row for row in DETECTOR_EFFECTS}
AXIS = TimeAxis(100, 0.2e-9, 0.0, "wall")
ALL_GONE = frozenset(ROWS)


def signal(rng: np.random.Generator, axis: TimeAxis = AXIS) -> np.ndarray:
    """(2, 4, bin) transients with an early peak, a hump, and empty bins."""
    t = np.arange(axis.bins)
    rows = [
        np.exp(-0.5 * ((t - rng.uniform(0.2, 0.8) * axis.bins) / rng.uniform(1, 10)) ** 2)
        + rng.uniform(0, 3) * (t == int(rng.integers(axis.bins // 2)))
        for _ in range(8)
    ]
    values = np.array(rows) * rng.uniform(0.2, 1.0, (8, 1))
    values[values < 1e-4] = 0.0
    return (values / values.sum(axis=1).max()).reshape(2, 4, axis.bins) * 1e-9


def random_world(rng: np.random.Generator) -> DetectorWorld:
    """A detector with everything, from dim to bright; effects strong and weak."""

    def chance(low: float, high: float) -> float:
        return float(low * (high / low) ** rng.random())

    open_long = rng.random() < 0.5
    mode = ("ideal", "synchronous", "free_running")[int(rng.integers(3))]
    spad = Spad(
        pde=0.3,
        dark_count_rate_hz=chance(1e-1, 1e6),
        dead_time_s=chance(1e-10, 1e-6),
        jitter_fwhm_s=chance(1e-11, 3e-10),
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
        pulse_fwhm_s=chance(1e-11, 3e-10),
    )
    return DetectorWorld(signal(rng), AXIS, spad, exposure, 1e-3)


def change(world: DetectorWorld, without: DetectorWorld) -> float:
    """Relative L2 change of the expected histograms."""
    mean, reference = (
        expected_histogram(w.transient, w.time, w.spad, w.exposure, approximate=True) for w in (without, world)
    )
    return float(np.linalg.norm(mean - reference) / np.linalg.norm(reference))


@pytest.mark.parametrize("effect", ROWS)
def test_bound_holds_in_random_detectors(effect: str) -> None:
    """60 random detectors; in some the effect must be strong, in some nearly nothing, or nothing is tested."""
    row, rng = ROWS[effect], np.random.default_rng(11)
    strong = weak = 0
    while strong < 3 or weak < 3 or strong + weak < 25:
        world = random_world(rng)
        if not row.present(world) or world.figures.kept_norm == 0:
            continue
        found = row.estimate(world, frozenset())
        if found.value is None:
            continue
        actual = change(world, row.without(world))
        # Where the mean itself is approximate, it is known to some 1e-6 only.
        rounding = 1e-8 if has_exact_mean(world.spad, world.transient.shape[1]) else 2e-5
        assert actual <= found.value * (1 + 1e-6) + rounding, (found, world.spad, world.exposure)
        strong, weak = strong + (actual > 0.01), weak + (found.value <= 0.01)


def test_what_is_known_for_nothing_bounds_the_figures() -> None:
    """200 random detectors; each bound must be close to what it bounds in some of them."""
    rng, close = np.random.default_rng(12), np.zeros(3)
    for _ in range(200):
        world = random_world(rng)
        if rng.random() < 0.3:
            world = world.with_spad(gate_start_s=None, gate_width_s=None)
        figures, slack = world.figures, 1 + 1e-9
        assert world.least_total <= figures.total * slack
        assert world.least_within <= figures.within * slack
        assert world.most_in_bin * slack >= figures.brightest_bin
        assert world.most_events * slack >= figures.total * world.exposure.cycles
        bounds = (world.least_total, figures.total), (world.least_within, figures.within)
        close += [a > 0.7 * b for a, b in (*bounds, (figures.brightest_bin, world.most_in_bin))]
    assert (close > 10).all(), close


def test_what_is_not_worked_out_is_simulated() -> None:
    """Without the figures of the flux nothing is left out that would not be left out with them, by the same estimate
    or a larger one, and what is refused for nothing is refused with them too."""
    rng, left, without, refused = np.random.default_rng(13), 0, 0, 0
    for _ in range(150):
        world = random_world(rng)
        for row in DETECTOR_EFFECTS:
            quick = replace(world, leave=0.01)
            if not row.present(world):
                continue
            soon, full = row.estimate(quick, frozenset()), row.estimate(world, frozenset())
            without += not quick.looked
            if soon.allowed and soon.value is not None and soon.value <= 0.01:
                left += 1
                assert full.allowed and full.value is not None and full.value <= soon.value
            elif not quick.looked and soon.value is not None:
                # Refused by a lower bound on the estimate.
                refused += 1
                assert full.value is None or full.value >= soon.value * (1 - 1e-9)
    assert left > 50 and without > 200 and refused > 100, (left, without, refused)


def test_plainly_bright_detections_are_not_looked_into(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*arguments: object) -> None:
        raise AssertionError("worked out although plain")

    spad = Spad(pde=0.3, jitter_fwhm_s=3e-10, afterpulse_probability=0.05, dead_time_s=50e-9, mode="free_running")
    exposure = Exposure(repetition_rate_hz=20e6, cycles=10000, photons_per_pulse=1e10, ambient_rate_hz=1e5)
    values = signal(np.random.default_rng(1))
    monkeypatch.setattr(DetectorWorld, "_blocks", never)
    plan = plan_detector_effects(values, AXIS, spad, exposure)
    assert all(decision.simulated or decision.kind == "absent" for decision in plan.decisions)
    with pytest.raises(AssertionError, match="worked out"):
        plan_detector_effects(values, AXIS, replace(spad, afterpulse_probability=1e-6), exposure)


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
    counts = detect(dark, axis, jittery, exposure, seed=3)
    spread = (counts - moved) / np.sqrt(moved)
    # 29 bins at a family-wise level of 10⁻⁴: 4.7 standard deviations each.
    assert np.abs(spread).max() < 4.7
