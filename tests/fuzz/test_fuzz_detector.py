"""The detector against its laws on random detectors, exposures and transients."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fuzz_profile import NIGHTLY, assume, fuzzed
from random_detectors import Measurement, measurements
from scipy import stats

from datagen import detect, expected_histogram
from datagen.detector import SamplerChoice, choose_sampler
from datagen.errors import InputError

FAMILY_LEVEL = 1e-3
"""Probability that `test_counts_have_the_expected_mean` fails by chance in one run, nightly or not."""
MEAN_CASES = 200 if NIGHTLY else 12
REPEATS = 30


def planned(m: Measurement) -> SamplerChoice:
    """The plan; a measurement that no exact sampler can draw, or no counter hold, is refused in one line."""
    try:
        return choose_sampler(m.transient, m.time, m.spad, m.exposure)
    except InputError as error:
        assert "\n" not in str(error)
        assume(False)
        raise


def drawn(m: Measurement, seed: int = 0, **kwargs: float) -> np.ndarray:
    return detect(m.transient, m.time, m.spad, m.exposure, seed=m.seed + seed, **kwargs)  # type: ignore[arg-type]


@fuzzed(30, 700, measurements())
def test_every_histogram_obeys_the_laws(m: Measurement) -> None:
    plan = planned(m)
    counts = drawn(m)
    assert counts.shape == m.transient.shape and counts.dtype == np.int64
    assert (counts >= 0).all(), "negative counts"
    assert counts.tobytes() == drawn(m).tobytes(), "same seed, other counts"
    most = most_detections(m)
    assert (counts.sum(axis=2) <= most).all(), f"more than the dead time leaves room for, {most}"
    if m.spad.counter_max is not None:
        assert counts.max() <= m.spad.counter_max
    mean = expected_histogram(m.transient, m.time, m.spad, m.exposure, approximate=True)
    assert np.isfinite(mean).all() and (mean >= 0).all()
    assert (mean.sum(axis=2) <= most * (1 + 1e-9)).all()
    assert np.isfinite([plan.flux_per_cycle, plan.poisson_bias, plan.detections]).all()
    dark = m.spad.dark_count_rate_hz == 0 and m.exposure.ambient_rate_hz == 0
    if dark and (m.spad.pde == 0 or not m.transient.any()):
        assert not counts.any() and not mean.any(), "counts without light"


def most_detections(m: Measurement) -> float:
    """How often the detector can fire while it is dead for τ after each time; +inf without a dead time.

    Free running: once in every τ of the exposure, and once more. Synchronous: ⌈T/τ⌉ times in each cycle.
    """
    dead_time, period, cycles = m.spad.dead_time_s, m.exposure.period_s, m.exposure.cycles
    if dead_time == 0 or m.spad.mode == "ideal" or plan_is_poisson(m):
        return np.inf
    if m.spad.mode == "synchronous":
        return float(cycles * np.ceil(period / dead_time * (1 + 1e-9)))
    return float(np.floor(cycles * period / dead_time * (1 + 1e-9)) + 1)


def plan_is_poisson(m: Measurement) -> bool:
    """Whether counts are drawn as Poisson, within tolerance, in any histogram: such counts know no most."""
    return "poisson" in choose_sampler(m.transient, m.time, m.spad, m.exposure).histograms


@fuzzed(MEAN_CASES, MEAN_CASES, measurements())
def test_counts_have_the_expected_mean(m: Measurement) -> None:
    """Repeated draws against the exact mean: the total, and four groups of bins; Student's t at FAMILY_LEVEL.

    The t law holds only nearly for counts: few and rare ones are left out, and a case beyond the limit is decided by
    new draws, twenty times as many.
    """
    planned(m)
    one = replace(m, transient=m.transient[:1], exposure=replace(m.exposure, cycles=min(m.exposure.cycles, 2_000)))
    try:
        mean = expected_histogram(one.transient, one.time, one.spad, one.exposure)[0]
    except InputError:
        assume(False)
        raise
    groups = np.array_split(np.arange(m.time.bins), min(4, m.time.bins))
    wanted = np.stack([mean.sum(axis=1), *(mean[:, g].sum(axis=1) for g in groups)])
    level = FAMILY_LEVEL / (MEAN_CASES * 15)
    for repeats in (REPEATS, 20 * REPEATS):
        tiled = np.repeat(one.transient, repeats, axis=0)
        counts = detect(tiled, one.time, one.spad, one.exposure, seed=m.seed + repeats, tolerance=0.0)
        found = np.stack([counts.sum(axis=2), *(counts[:, :, g].sum(axis=2) for g in groups)])
        error = found.std(axis=1, ddof=1) / np.sqrt(repeats)
        usable = wanted * repeats >= 200
        gap = np.abs(found.mean(axis=1) - wanted)
        allowed = error * stats.t.isf(level / 2, repeats - 1) + 1e-9 * wanted + 2.0 / repeats
        if (gap <= allowed)[usable].all():
            return
    pytest.fail(f"means {found.mean(axis=1)} of counts, {wanted} expected, ± {error}")
