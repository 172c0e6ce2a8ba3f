"""Hard cases in which the obvious formula fails."""

from __future__ import annotations

from dataclasses import replace

import mpmath
import numba
import numpy as np
import pytest
from scipy.stats import binom, chi2, norm, poisson
from statistics_kit import accept

from datagen.detector import Exposure, Spad, choose_sampler, detect, expected_histogram
from datagen.detector.irf import response_cdf, response_kernel, spread
from datagen.detector.random_numbers import binomial, generator_of
from datagen.errors import InputError
from datagen.records import TimeAxis

TIME = TimeAxis(100, 1e-9)


@pytest.mark.parametrize(
    ("n", "p"),
    [
        (2**40, 1e-12),
        (10**12, 1e-11),
        (40, 0.3),
        (10**6, 0.99999),
        (10**9, 0.2),
        (5, 1 - 1e-12),
        (10**6, 5e-5),
        (10**6, 1.02e-5),
        (100, 0.5),
        (20, 0.5),
        (25, 0.45),
        (10**5, 0.3),
        (3 * 10**9, 1e-8),
        (10**12, 0.4),
    ],
)
def test_binomial_at_its_extremes(n, p):
    sample = _many_binomials(n, p, 100_000, generator_of(3))
    exact = binom(n, p)
    cuts = np.unique(exact.ppf(np.linspace(0.02, 0.98, 25)))
    edges = np.concatenate([[-np.inf], cuts, [np.inf]])
    observed = np.histogram(sample, np.nextafter(edges, np.inf))[0]
    wanted = len(sample) * np.diff(np.concatenate([[0.0], exact.cdf(cuts), [1.0]]))
    use = wanted > 5
    statistic = np.sum((observed[use] - wanted[use]) ** 2 / wanted[use]) if use.sum() > 1 else 0.0
    accept(float(chi2(max(use.sum() - 1, 1)).sf(statistic)), f"binomial({n}, {p})")
    assert np.all(observed[wanted < 1e-9] == 0)


@numba.njit
def _many_binomials(n, p, count, stream):
    return np.array([binomial(n, p, stream) for _ in range(count)])


def test_long_kernels_go_through_the_fft_without_negatives_or_loss():
    kernel = response_kernel(1e-12, 0.0, 2e-10)
    assert len(kernel.weights) > 4096
    signal = np.full((2, 3000), 1e-6)
    signal[:, 50] = 1.0
    out = spread(signal, kernel)
    assert out.min() >= 0
    np.testing.assert_allclose(out.sum(-1), signal.sum(-1), rtol=1e-12)
    np.testing.assert_allclose(out[0], np.convolve(signal[0], kernel.weights), rtol=1e-6, atol=1e-14)


@pytest.mark.parametrize("ratio", [1e-3, 0.3, 3.0, 60.0])
def test_exponential_tail_against_high_precision(ratio):
    """exp(σ²/2τ² − t/τ) overflows float64 at σ/τ = 60; the logarithmic form does not."""
    sigma, tail, share = 1.0, 1.0 / ratio, 0.4
    mpmath.mp.dps = 60
    for t in (-5.0, -1.0, 0.0, 0.7, 4.0, 20.0):
        z = mpmath.mpf(t) / sigma
        delayed = mpmath.exp(mpmath.mpf(ratio) ** 2 / 2 - mpmath.mpf(t) / tail) * mpmath.ncdf(z - ratio)
        truth = float(mpmath.ncdf(z) - share * delayed)
        got = float(response_cdf(np.array([t]), sigma, tail, share)[0])
        assert got == pytest.approx(truth, rel=1e-7, abs=1e-13)


def test_mean_delay_of_the_response_is_that_of_the_tail():
    kernel = response_kernel(1e-11, 8e-11, 2e-10, 0.3)
    delay = 1e-11 * (kernel.weights @ (np.arange(len(kernel.weights)) - kernel.before))
    assert delay == pytest.approx(0.3 * 2e-10, rel=1e-4)


def test_response_beyond_the_window_is_lost_when_the_period_is_long():
    transient = np.zeros(100)
    transient[99] = 1e-3
    spad = Spad(pde=1.0, jitter_tail_s=5e-9)
    mean = expected_histogram(transient, TIME, spad, Exposure(1e6, 10**6, 1.0))
    # 400 ns later nothing of it is left; what the last bin keeps is the mass of its own half bin.
    assert mean.sum() == pytest.approx(1e3 * -np.expm1(-0.1), rel=1e-6)


@pytest.mark.parametrize("mode", ["ideal", "synchronous", "free_running"])
def test_without_light_there_are_no_counts_and_no_warnings(mode):
    spad = Spad(mode=mode, dead_time_s=2e-7, afterpulse_probability=0.02 if mode == "free_running" else 0.0)
    with np.errstate(all="raise"):
        counts = detect(np.zeros((2, 2, 100)), TIME, spad, Exposure())
        mean = expected_histogram(np.zeros((2, 2, 100)), TIME, spad, Exposure(), approximate=True)
    assert counts.sum() == 0 == mean.sum()


def test_flux_of_ten_thousand_per_cycle():
    """Free running at λ τ ≫ 1: counts are nearly regular, and the mean of a long run agrees with the solver."""
    lam = np.random.default_rng(0).random(100) ** 3
    lam *= 1e4 / lam.sum()
    for tau in (33.337e-9, 250e-9):
        spad, exposure = Spad(pde=1.0, dead_time_s=tau), Exposure(1e7, 10**4, 1.0)
        total = 1e8 / (1 + 1e4 * tau / 1e-7)
        assert expected_histogram(lam, TIME, spad, exposure).sum() == pytest.approx(total, rel=2e-3)
        assert detect(lam, TIME, spad, exposure).sum() == pytest.approx(total, rel=2e-3)


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


def test_saturating_counters():
    spad = Spad(pde=1.0, mode="ideal", counter_max=100)
    exposure = Exposure(1e7, 1000, 1.0)
    transient = np.linspace(0.05, 0.15, 100)
    counts = detect(np.tile(transient, (400, 1, 1)), TIME, spad, exposure)[:, 0]
    mean = expected_histogram(transient, TIME, spad, exposure)
    assert counts.max() == 100
    # Their spread by the law: that of the sample is nothing where none of few unsaturated counts came.
    n = np.arange(400)
    law = poisson.pmf(n, 1000 * transient[:, None])
    deviation = np.sqrt(law @ np.minimum(n, 100) ** 2 - (law @ np.minimum(n, 100)) ** 2)
    usual = 400 * poisson.cdf(99, 1000 * transient) >= 10
    z = (counts.mean(0) - mean)[usual] / (deviation[usual] / 20)
    accept(float(chi2(usual.sum()).sf(np.sum(z**2))), "saturated mean")
    assert usual.sum() > 60 and np.abs(counts.mean(0) - mean)[~usual].max() < 0.2
    assert mean[50] < 1000 * transient[50] - 2


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
    known = Spad(pde=1.0, mode="synchronous", counter_max=1, dead_time_s=1e-9)
    expected_histogram(transient, TIME, known, exposure)
    unknown = Spad(**{"pde": 1.0, "mode": "synchronous", "counter_max": 1} | spad)
    with pytest.raises(InputError, match=r"neither Poisson nor binomial.*approximate=True"):
        expected_histogram(transient, TIME, unknown, exposure)
    assert np.isfinite(expected_histogram(transient, TIME, unknown, exposure, approximate=True)).all()


@pytest.mark.parametrize("jitter, dead_time", [(0.0, 1e-9), (0.0, 7.3e-9), (3e-9, 100e-9)])
def test_saturated_mean_of_binomial_counts(jitter, dead_time):
    spad = Spad(pde=1.0, mode="synchronous", dead_time_s=dead_time, jitter_fwhm_s=jitter, counter_max=3)
    exposure, transient = Exposure(1e7, 40, 1.0), np.linspace(0.0, 0.2, 100)
    mean = expected_histogram(transient, TIME, spad, exposure)
    unlimited = expected_histogram(transient, TIME, replace(spad, counter_max=None), exposure)
    n = np.arange(41)
    law = binom.pmf(n, 40, unlimited[:, None] / 40)
    np.testing.assert_allclose(mean, law @ np.minimum(n, 3), rtol=1e-9, atol=1e-12)
    counts = detect(np.tile(transient, (4000, 1, 1)), TIME, spad, exposure)[:, 0]
    deviation = np.sqrt(law @ np.minimum(n, 3) ** 2 - mean**2)
    usual = 4000 * mean >= 100
    z = (counts.mean(0) - mean)[usual] / (deviation[usual] / np.sqrt(4000))
    # Bins of one detector are not independent of one another: the largest of them, by Bonferroni.
    accept(float(min(1.0, usual.sum() * 2 * norm.sf(np.abs(z).max()))), "saturated mean")
    assert usual.sum() > 30 and (unlimited - mean).max() > 0.02


def test_poisson_bias_bounds_the_true_bias():
    rng = np.random.default_rng(5)
    for _ in range(30):
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
