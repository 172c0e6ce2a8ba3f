"""Closed forms and conservation laws that counts and their expected values obey."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm, poisson
from statistics_kit import accept, mean_is, poisson_like_chi2

from datagen.detector import Exposure, Spad, choose_sampler, detect, expected_histogram
from datagen.records import TimeAxis

TIME = TimeAxis(200, 0.5e-9)
PERIOD = 100e-9
EXPOSURE = Exposure(repetition_rate_hz=1 / PERIOD, cycles=20_000, photons_per_pulse=1.0)


def signal(flux: float) -> np.ndarray:
    """(200,) expected events per cycle: a direct return, a bump, a floor."""
    i = np.arange(200)
    lam = 0.1 + 3 * np.exp(-(((i - 90) / 9.0) ** 2)) + 40 * (i == 30)
    return lam * flux / lam.sum()


@pytest.mark.parametrize("rate", [1e5, 1e7, 3e8])
@pytest.mark.parametrize("dead_time", [13.3e-9, 100e-9, 433.3e-9])
def test_constant_rate_saturates_as_renewal_theory_says(rate, dead_time):
    spad = Spad(pde=1.0, dark_count_rate_hz=rate, dead_time_s=dead_time)
    mean = expected_histogram(np.zeros(200), TIME, spad, EXPOSURE)
    law = rate / (1 + rate * dead_time) * EXPOSURE.cycles * PERIOD / 200
    np.testing.assert_allclose(mean, law, rtol=1e-10)


@pytest.mark.parametrize("dead_time", [40e-9, 250e-9])
def test_constant_rate_has_the_fano_factor_of_renewal_theory(dead_time):
    rate, repeats = 1e7, 400
    spad = Spad(pde=1.0, dark_count_rate_hz=rate, dead_time_s=dead_time)
    exposure = replace(EXPOSURE, cycles=5000)
    totals = detect(np.zeros((repeats, 1, 200)), TIME, spad, exposure, seed=1, tolerance=0.0).sum(axis=(1, 2))
    law = 1 / (1 + rate * dead_time) ** 2
    fano = totals.var(ddof=1) / totals.mean()
    z = np.log(fano / law) / np.sqrt(2 / repeats)
    accept(float(2 * norm.sf(abs(z))), f"Fano {fano:.4f} against {law:.4f}")


def coates_correction(counts: np.ndarray, cycles: int) -> np.ndarray:
    """Flux per cycle and bin from counts with one detection a cycle: −log(1 − n_i / (N − Σ_{k<i} n_k)), exact on the
    mean and the maximum-likelihood estimate on counts (P. B. Coates, J. Phys. E 1, 878, 1968)."""
    return -np.log1p(-counts / (cycles - np.cumsum(counts) + counts))


@pytest.mark.parametrize("flux", [1e-12, 0.1, 4.0])
def test_coates_inverts_the_expected_histogram(flux):
    lam = signal(flux)
    spad = Spad(pde=1.0, dead_time_s=1e-6, mode="synchronous")
    mean = expected_histogram(lam, TIME, spad, EXPOSURE)
    # Beyond 20 events into the cycle nothing is left to invert: e^-20 of the cycles against 1 is rounding.
    reached = np.cumsum(lam) < 12
    np.testing.assert_allclose(coates_correction(mean, EXPOSURE.cycles)[reached], lam[reached], rtol=1e-9)


def test_afterpulse_gain_at_low_flux():
    """Without dead time every avalanche of flux λ ends up as 1/(1 − μ) counts, μ = −ln(1 − p)."""
    probability = 0.2
    spad = Spad(pde=1.0, afterpulse_probability=probability, afterpulse_times_s=(30e-9,))
    exposure = replace(EXPOSURE, cycles=1000)
    lam = signal(0.2)
    gain = 1 / (1 + np.log1p(-probability))
    mean = expected_histogram(lam, TIME, spad, exposure)
    assert mean.sum() == pytest.approx(1000 * 0.2 * gain, rel=1e-6)
    counts = detect(np.tile(lam, (800, 1, 1)), TIME, spad, exposure, seed=5, tolerance=0.0)[:, 0]
    mean_is(counts.reshape(800, 20, 10).sum(2), mean.reshape(20, 10).sum(1), "afterpulse gain")


def test_afterpulse_probability_is_what_it_says():
    """Rare triggers in long cycles: a share p of avalanches is followed by another, after the dead time and the first
    of n releases, n Poisson with a mean of μ = −ln(1 − p)."""
    probability = 0.15
    exposure = Exposure(repetition_rate_hz=1e4, cycles=4_000_000, photons_per_pulse=1.0)
    lam = np.zeros(200)
    lam[0] = 0.01
    spad = Spad(pde=1.0, dead_time_s=200e-9, afterpulse_probability=probability, afterpulse_times_s=(5e-9,))
    triggers = 4_000_000 * -np.expm1(-0.01)
    wide = TimeAxis(2000, 0.5e-9)
    counts = detect(np.append(lam, np.zeros(1800)), wide, spad, exposure, seed=2)
    assert abs(counts[0] - triggers) < 6 * np.sqrt(triggers)
    assert counts[1:400].sum() == 0
    followers = counts[400:].sum()
    law = triggers * probability / (1 - probability)  # traps are empty after a dead time of forty release times
    assert abs(followers - law) < 6 * np.sqrt(law)
    first, n = counts[400:800], np.arange(1, 20)
    delay_s = first @ (wide.centers_s[:400] - 0.25e-9) / first.sum()
    mean_s = 5e-9 * (poisson(-np.log1p(-probability)).pmf(n) / n).sum() / probability
    assert delay_s == pytest.approx(mean_s, rel=5 / np.sqrt(first.sum()))


def test_no_dead_time_is_poisson():
    lam = signal(3.0)
    for mode in ("ideal", "synchronous", "free_running"):
        spad = Spad(pde=1.0, mode=mode)
        assert choose_sampler(lam, TIME, spad, EXPOSURE, tolerance=0.0).sampler == "poisson"
        np.testing.assert_allclose(expected_histogram(lam, TIME, spad, EXPOSURE), EXPOSURE.cycles * lam, rtol=1e-12)


@pytest.mark.parametrize("mode", ["synchronous", "free_running"])
def test_counts_are_conserved(mode):
    """Jitter moves records but neither makes nor loses any (the window is the whole period), and one detection a
    cycle means no more counts than cycles."""
    lam = signal(50.0)
    plain = Spad(pde=1.0, mode=mode, dead_time_s=100e-9)
    blurred = replace(plain, jitter_fwhm_s=1.7e-9)
    a, b = (detect(lam, TIME, s, EXPOSURE, seed=9) for s in (plain, blurred))
    assert a.sum() == b.sum() <= EXPOSURE.cycles
    means = [expected_histogram(lam, TIME, s, EXPOSURE).sum() for s in (plain, blurred)]
    assert means[0] == pytest.approx(means[1], rel=1e-12)


@pytest.mark.parametrize("gated", [False, True])
def test_the_direct_return_shadows_what_follows(gated):
    """One direct photon per cycle scales all after it by exp(−1), and not at all behind a gate."""
    lam = np.zeros(200)
    lam[20], lam[120] = 1.0, 1e-6
    gate = {"gate_start_s": 30e-9, "gate_width_s": 60e-9} if gated else {}
    spad = Spad(pde=1.0, dead_time_s=1e-6, mode="synchronous", **gate)
    mean = expected_histogram(lam, TIME, spad, EXPOSURE)
    assert mean[120] == pytest.approx(EXPOSURE.cycles * 1e-6 * (1.0 if gated else np.exp(-1)), rel=1e-5)


def test_expected_is_the_mean_of_detect_with_everything_on():
    """Gate with ramps, pulse, tail, jitter, ambient, dark counts, a period that is no multiple of the bin."""
    time = TimeAxis(64, 1e-9, start_s=5e-9)
    exposure = Exposure(9.7e6, 3000, 1.0, ambient_rate_hz=3e6, pulse_fwhm_s=2e-9)
    transient = np.zeros((600, 1, 64))
    transient[:, 0, 12], transient[:, 0, 40:50] = 1.5, 0.1
    for mode, dead_time in (("ideal", 0.0), ("synchronous", 33e-9), ("synchronous", 2e-7), ("free_running", 33e-9),
                            ("free_running", 290e-9)):  # fmt: skip
        spad = Spad(0.5, 1e5, dead_time, 3e-9, 4e-9, 0.3, mode=mode, gate_start_s=8e-9, gate_width_s=57.3e-9,
                    gate_rise_s=3e-9)  # fmt: skip
        mean = expected_histogram(transient[0, 0], time, spad, exposure)
        counts = detect(transient, time, spad, exposure, seed=4, tolerance=0.0)[:, 0]
        mean_is(counts[:, 4:].reshape(600, 20, 3).sum(2), mean[4:].reshape(20, 3).sum(1), f"everything, {mode}")


def test_self_consistent_mean_with_afterpulses_and_crosstalk_is_close():
    lam = np.tile(signal(0.3), (1, 2, 1))
    exposure = Exposure(1 / PERIOD, 60_000, 1.0)
    for spad, error in (
        (Spad(1.0, dead_time_s=60e-9, afterpulse_probability=0.05, afterpulse_times_s=(40e-9,)), 0.004),
        (Spad(1.0, dead_time_s=60e-9, crosstalk_probability=0.05), 0.004),
        (Spad(1.0, dead_time_s=60e-9, afterpulse_probability=0.05, mode="synchronous"), 0.004),
    ):
        mean = expected_histogram(lam, TIME, spad, exposure, approximate=True).sum()
        counts = detect(np.repeat(lam, 60, axis=0), TIME, spad, exposure, seed=8, tolerance=0.0).sum() / 60
        plain = expected_histogram(lam, TIME, Spad(1.0, dead_time_s=60e-9, mode=spad.mode), exposure).sum()
        assert abs(mean - counts) < error * counts < 0.2 * (counts - plain)


@pytest.mark.parametrize("mode", ["synchronous", "free_running"])
@pytest.mark.parametrize("caused", [{"afterpulse_probability": 0.05, "afterpulse_times_s": (5e-9,)},
                                    {"crosstalk_probability": 0.05}], ids=["traps", "neighbours"])  # fmt: skip
def test_self_consistent_mean_is_the_same_however_much_darkness_is_recorded(mode, caused):
    """The time between the record and the next pulse is cut into bins much longer than those of the record."""
    lam = np.tile(signal(0.3), (1, 2, 1))
    exposure = Exposure(1 / (8 * PERIOD), 10**6, 1.0, ambient_rate_hz=2e6)
    spad = Spad(1.0, dead_time_s=450e-9, mode=mode, **caused)
    longer = np.concatenate([lam, np.zeros((1, 2, 7 * lam.shape[2]))], axis=2)
    short = expected_histogram(lam, TIME, spad, exposure, approximate=True)
    whole = expected_histogram(longer, replace(TIME, bins=8 * TIME.bins), spad, exposure, approximate=True)
    assert np.linalg.norm(short - whole[..., : TIME.bins]) < 2e-5 * np.linalg.norm(short)


def test_large_exposure_fits_its_mean_bin_by_bin():
    lam, cycles = signal(1.0), 2**40
    exposure = Exposure(1 / PERIOD, cycles, 1.0)
    for dead_time in (17.3e-9, 1e-6):
        spad = Spad(pde=1.0, dead_time_s=dead_time, mode="synchronous")
        counts = detect(lam, TIME, spad, exposure, seed=1)
        accept(poisson_like_chi2(counts, expected_histogram(lam, TIME, spad, exposure), cycles), f"τ = {dead_time}")
