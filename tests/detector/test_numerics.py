"""Hard cases in which the obvious formula fails."""

from __future__ import annotations

from dataclasses import replace

import mpmath
import numpy as np
import pytest
from scipy.stats import binom, norm, poisson
from statistics_kit import accept

from datagen.detector import Exposure, Spad, choose_sampler, detect, expected_histogram
from datagen.detector.dead_time import PIECE_FLUX
from datagen.detector.irf import FWHM_PER_SIGMA
from datagen.errors import InputError
from datagen.records import TimeAxis

TIME = TimeAxis(100, 1e-9)


@pytest.mark.parametrize(
    ("sigma", "tail", "share"), [(0.1, 0.0, 0.0), (3.0, 0.05, 0.4), (2.0, 3.0, 0.4), (1.0, 200.0, 0.3)]
)
def test_the_response_to_a_flash_against_high_precision(sigma: float, tail: float, share: float) -> None:
    """In units of bins. exp(σ²/2τ² − t/τ) overflows float64 at σ/τ = 60, the logarithmic form does not; a tail of 200
    bins is so long that its convolution is an FFT's."""
    time, at, width_s = TimeAxis(8192, 1e-12), 50, 1e-12
    flash = np.full((1, 2, time.bins), 1e-9)
    flash[0, 0] = 0.0
    flash[0, :, at] = 1.0
    exposure = Exposure(1 / (time.bins * width_s), 1, 1.0, pulse_fwhm_s=sigma * FWHM_PER_SIGMA * width_s)
    spad = Spad(1.0, mode="ideal", jitter_tail_s=tail * width_s, jitter_tail_fraction=share)
    mean = expected_histogram(flash, time, spad, exposure)[0]
    mpmath.mp.dps = 60

    def arrived(t: float) -> mpmath.mpf:
        z = mpmath.mpf(t) / sigma
        if tail == 0:
            return mpmath.ncdf(z)
        delayed = mpmath.exp(mpmath.mpf(sigma / tail) ** 2 / 2 - mpmath.mpf(t) / tail)
        return mpmath.ncdf(z) - share * delayed * mpmath.ncdf(z - mpmath.mpf(sigma / tail))

    for k in (-8, -2, -1, 0, 1, 2, 5, 20, 700, 2000):
        truth = float(arrived(k + 0.5) - arrived(k - 0.5))
        assert mean[0, at + k] == pytest.approx(truth, rel=1e-7, abs=1e-13), k
    assert mean.min() >= 0
    assert mean.sum(axis=1) == pytest.approx(flash[0].sum(axis=1), rel=1e-12)
    # Nine orders below the flash the constant light stays what it is, to the digits that an FFT has.
    assert mean[1, 7800:] == pytest.approx(1e-9, rel=1e-6 if tail > 100 else 1e-12)


def test_a_response_of_two_and_a_half_periods_is_folded():
    """Light at the centre of bin 0, delayed exponentially: a geometric series of every later pulse."""
    tail, flash = 2.5e-7, np.zeros(100)
    flash[0] = 1e-3
    mean = expected_histogram(flash, TIME, Spad(pde=1.0, jitter_tail_s=tail), Exposure(1e7, 10**6, 1.0))
    lap = -np.expm1(-1e-7 / tail)
    left = np.exp(-np.maximum(np.arange(101) - 0.5, 0.0) * 1e-9 / tail) / lap
    share = -np.diff(left)
    # The half bin before the centre is reached only by the lap before.
    share[0] += left[-1] - (1 - lap) / lap
    np.testing.assert_allclose(mean, 1e3 * share, rtol=1e-9)


def test_response_beyond_the_window_is_lost_when_the_period_is_long():
    transient = np.zeros(100)
    transient[99] = 1e-3
    spad = Spad(pde=1.0, jitter_tail_s=5e-9)
    mean = expected_histogram(transient, TIME, spad, Exposure(1e6, 10**6, 1.0))
    # 400 ns later nothing of it is left; what the last bin keeps is the mass of its own half bin.
    assert mean.sum() == pytest.approx(1e3 * -np.expm1(-0.1), rel=1e-6)


@pytest.mark.parametrize("dead_time_s", [0.37e-9, 7.3e-9, 31.4e-9])
def test_cutting_bins_into_pieces_is_invisible_in_a_hundred_million_cycles(
    dead_time_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The only error of the return chain, and of means under a dead time."""
    shape = 0.02 + np.exp(-(((np.arange(64) - 20) / 6.0) ** 2))
    spad = Spad(pde=1.0, mode="synchronous", dead_time_s=dead_time_s)
    light = np.stack([shape * flux / shape.sum() for flux in (0.1, 4.0, 40.0)])[:, None]
    measured = light, TimeAxis(64, 1e-9), spad, Exposure(1 / 64e-9, 10**8, 1.0)
    mean = expected_histogram(*measured)
    monkeypatch.setattr("datagen.detector.dead_time.PIECE_FLUX", PIECE_FLUX / 16)
    finest = expected_histogram(*measured)
    # Of all 64 bins, whose χ² is 64 ± 11.
    increase = np.sum((mean - finest) ** 2 / finest, axis=2)
    assert (increase > 0).all() and (increase < 0.2).all()
    assert np.max(np.abs(mean / finest - 1)[:2]) < 2e-4


def test_one_detection_a_cycle_at_any_flux():
    """Where exp(−Λ) differences and 1 − e^(−λ) lose all their digits."""
    flux = np.array([1e-16, 3e-13, 1e-5, 0.3, 20.0, 1e4, 1.0])
    mpmath.mp.dps = 60
    exact = [mpmath.mpf(float(x)) for x in flux]
    truth = [float(-mpmath.expm1(-x) * mpmath.exp(-mpmath.fsum(exact[:i]))) for i, x in enumerate(exact)]
    spad = Spad(pde=1.0, dead_time_s=1e-6, mode="synchronous")
    mean = expected_histogram(flux, TimeAxis(7, 1e-9), spad, Exposure(1 / 7e-9, 1, 1.0))
    np.testing.assert_allclose(mean, truth, rtol=1e-12)


def test_flux_of_ten_thousand_per_cycle():
    """Dead for seven whole periods the shape is that of the light, λ / (1 + 7Λ)."""
    lam = np.random.default_rng(0).random(100) ** 3
    lam *= 1e4 / lam.sum()
    spad, exposure = Spad(pde=1.0, dead_time_s=7e-7), Exposure(1e7, 10**6, 1.0)
    law = 10**6 * lam / (1 + 7e4)
    np.testing.assert_allclose(expected_histogram(lam, TIME, spad, exposure), law, rtol=1e-9)
    # Counts are nearly regular.
    assert detect(lam, TIME, spad, exposure).sum() == pytest.approx(law.sum(), rel=1e-4)


def test_two_thousand_photons_in_a_paralyzable_dead_time():
    """Bin 0 counts its first photon; in bin 1 the exponent falls from a to b: b times the mean of e^−y, y = a … b."""
    a, b = 2000.0, 1e-3
    spad = Spad(pde=1.0, dead_time_s=TIME.width_s, mode="synchronous", paralyzable=True)
    lam = np.zeros(100)
    lam[:2] = a, b
    mean = expected_histogram(lam, TIME, spad, Exposure(1e6, 1000, 1.0))
    assert mean[:2] == pytest.approx([1000.0, 1000.0 * b * (np.exp(-b) - np.exp(-a)) / (a - b)], rel=1e-12)


def test_empty_bins_are_never_hit():
    lam = np.zeros(100)
    lam[[7, 8, 60]] = 0.5, 1e-9, 0.3
    for tau in (1e-9, 50e-9, 3e-7):
        counts = detect(lam, TIME, Spad(pde=1.0, dead_time_s=tau), Exposure(1e7, 200_000, 1.0), seed=4)
        assert counts[lam == 0].sum() == 0
        assert counts[7] > 0 and counts[60] > 0


@pytest.mark.parametrize(
    ("spad", "cycles", "most"),
    [
        (Spad(pde=1.0, mode="ideal", counter_max=100), 1000, 0.15),
        (Spad(pde=1.0, mode="synchronous", dead_time_s=1e-9, counter_max=3), 40, 0.2),
        (Spad(pde=1.0, mode="synchronous", dead_time_s=7.3e-9, counter_max=3), 40, 0.2),
        (Spad(pde=1.0, mode="synchronous", dead_time_s=100e-9, jitter_fwhm_s=3e-9, counter_max=3), 40, 0.2),
    ],
)
def test_saturating_counters(spad, cycles, most):
    """The mean of min(n, most) of Poisson or binomial counts n, and counts that have it."""
    exposure, transient = Exposure(1e7, cycles, 1.0), np.linspace(0.0, most, 100)
    mean = expected_histogram(transient, TIME, spad, exposure)
    unlimited = expected_histogram(transient, TIME, replace(spad, counter_max=None), exposure)
    n = np.arange(4 * cycles)
    law = (poisson(unlimited[:, None]) if spad.mode == "ideal" else binom(cycles, unlimited[:, None] / cycles)).pmf(n)
    np.testing.assert_allclose(mean, law @ np.minimum(n, spad.counter_max), rtol=1e-9, atol=1e-12)
    counts = detect(np.tile(transient, (2000, 1, 1)), TIME, spad, exposure)[:, 0]
    assert counts.max() == spad.counter_max
    deviation = np.sqrt(np.maximum(law @ np.minimum(n, spad.counter_max) ** 2 - mean**2, 0))
    # Bins in which both full and other counts are frequent enough for a normal law.
    usual = (2000 * mean >= 100) & (deviation > 0.1)
    z = (counts.mean(0) - mean)[usual] / (deviation[usual] / np.sqrt(2000))
    # Bins of one detector are not independent of one another: the largest of them, by Bonferroni.
    accept(float(min(1.0, usual.sum() * 2 * norm.sf(np.abs(z).max()))), "saturated mean")
    assert usual.sum() > 30 and (unlimited - mean).max() > 0.02


@pytest.mark.parametrize(
    "spad",
    [
        pytest.param({"afterpulse_probability": 0.5, "afterpulse_times_s": (1e-15,)}, id="afterpulses in one bin"),
        pytest.param({"dead_time_s": 0.2e-9}, id="several detections a bin"),
        pytest.param({"dead_time_s": 20e-9, "jitter_fwhm_s": 30e-9}, id="jitter brings two into one bin"),
    ],
)
def test_saturated_mean_is_given_for_counts_whose_law_is_known(spad):
    """Where the law is unknown, that of Poisson or binomial counts would be up to three times too large."""
    exposure, transient = Exposure(1e7, 1, 1.0), np.full(100, 0.3)
    unknown = Spad(**{"pde": 1.0, "mode": "synchronous", "counter_max": 1} | spad)
    with pytest.raises(InputError, match="approximate=True"):
        expected_histogram(transient, TIME, unknown, exposure)
    assert np.isfinite(expected_histogram(transient, TIME, unknown, exposure, approximate=True)).all()


def test_poisson_bias_bounds_the_true_bias():
    rng = np.random.default_rng(5)
    for _ in range(15):
        lam = rng.random(100) ** 8
        lam *= 10 ** rng.uniform(-6, -1) / lam.sum()
        tau = 10 ** rng.uniform(-9, -6)
        for mode in ("free_running", "synchronous"):
            spad = Spad(pde=1.0, dead_time_s=tau, mode=mode)
            exposure = Exposure(1e7, 10**6, 1.0)
            bound = choose_sampler(lam, TIME, spad, exposure, approximate=True).poisson_bias
            true = np.max(1 - expected_histogram(lam, TIME, spad, exposure) / (1e6 * lam))
            assert true <= bound * (1 + 1e-6) + 1e-12
            assert bound < 8 * true + 1e-9  # a useful bound
