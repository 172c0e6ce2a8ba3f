"""Samplers against whole laws: every outcome of small cases is counted, and extreme cases have known outcomes."""

from __future__ import annotations

from collections import Counter
from itertools import product

import numpy as np
import pytest
from photon_by_photon import Rule, simulate
from scipy.stats import binom, chi2, chi2_contingency, chisquare, multinomial, poisson
from statistics_kit import accept

from datagen.detector import Exposure, Spad, detect
from datagen.detector.irf import response_kernel
from datagen.records import TimeAxis

REPLICATES = 8_000
WIDTH_S = 1e-9
TIME = TimeAxis(4, WIDTH_S)
FLUX = np.array([0.9, 0.0, 0.4, 0.7])


def counted(flux, dead_time_s: float, cycles: int, count: int = REPLICATES) -> np.ndarray:
    """(count, 4) counts of a synchronous detector, whose last bin is not the end of the period."""
    spad = Spad(pde=1.0, mode="synchronous", dead_time_s=dead_time_s)
    light = np.tile(flux, (count, 1, 1))
    return detect(light, TIME, spad, Exposure(1 / 4.4e-9, cycles, 1.0), tolerance=0.0)[:, 0]


def outcomes_are_alike(a, b, what: str) -> None:
    """χ² over whole rows of counts, rare ones together."""
    found = [Counter(map(tuple, x.tolist())) for x in (a, b)]
    table = np.array([[f[outcome] for outcome in found[0] | found[1]] for f in found])
    rare = table.sum(0) < 20
    table = np.column_stack([table[:, ~rare], table[:, rare].sum(1)])
    accept(float(chi2_contingency(table[:, table.sum(0) > 0]).pvalue), what)


@pytest.mark.parametrize("cycles", [1, 3])
def test_one_detection_a_cycle_is_multinomial_outcome_by_outcome(cycles):
    p = -np.expm1(-FLUX) * np.exp(-(np.cumsum(FLUX) - FLUX))
    p = np.append(p, 1.0 - p.sum())
    outcomes = [o for o in product(range(cycles + 1), repeat=5) if sum(o) == cycles and o[1] == 0]
    law = multinomial(cycles, p).pmf(np.array(outcomes))
    drawn = Counter(map(tuple, counted(FLUX, 1e-6, cycles).tolist()))
    observed = np.array([drawn.pop(o[:4], 0) for o in outcomes])
    assert not drawn, "an outcome that cannot be"
    accept(float(chisquare(observed, REPLICATES * law).pvalue), f"outcomes of {cycles} cycles")


@pytest.mark.parametrize(("dead_time_s", "cycles"), [(0.3e-9, 3), (1e-9, 1), (1.7e-9, 3)])
def test_returns_within_the_cycle_are_those_of_single_photons(dead_time_s, cycles):
    rule = Rule(dead_time_s, synchronous=True)
    edges = np.append(WIDTH_S * np.arange(5), 4.4e-9)
    flux = np.append(FLUX, 0.0)
    want = simulate(flux, edges, cycles, rule, np.random.default_rng(1), REPLICATES)[:, 0, :4]
    outcomes_are_alike(counted(FLUX, dead_time_s, cycles), want, f"dead time {dead_time_s}, {cycles} cycles")


def test_from_nothing_to_certainty():
    assert not counted(np.zeros(4), 1e-9, 2**40, 10).any()
    for dead_time_s in (1e-9, 1e-6):
        # 1e12 cycles of 1e-12 events each: a Poisson number, for which no cycle is ever missed.
        rare = counted(np.full(4, 2.5e-12), dead_time_s, 10**12)
        follows(rare.sum(1), poisson(10.0), "1e12 cycles")
        assert counted([0.0, 1e-290, 0.0, 0.0], dead_time_s, 10**9, 10).sum() == 0
    # A bin in which every cycle fires leaves none for those after it, until the dead time is over.
    for certain in (50.0, 1e190):
        assert counted([0.0, certain, 5.0, 0.0], 1e-6, 1000, 3).tolist() == [[0, 1000, 0, 0]] * 3
    assert counted([50.0, 0.0, 0.0, 50.0], 1.5e-9, 1000, 3).tolist() == [[1000, 0, 0, 1000]] * 3


@pytest.mark.parametrize(
    ("cycles", "p"), [(2**40, 1e-12), (40, 0.3), (10**6, 0.99999), (10**6, 5e-5), (3 * 10**9, 1e-8), (10**12, 0.4)]
)
def test_the_first_bin_is_binomial_at_its_extremes(cycles, p):
    drawn = counted([-np.log1p(-p), 0.0, 0.0, 0.0], 1e-6, cycles)[:, 0]
    follows(drawn, binom(cycles, p), f"binomial({cycles}, {p})")


def test_counts_without_dead_time_are_poisson_of_any_size():
    means = np.array([0.0, 1e-3, 0.5, 9.9, 10.0, 30.0, 3e4, 1e9, 1e11, 9e12])
    time = TimeAxis(len(means), WIDTH_S)
    light = np.tile(means, (REPLICATES, 1, 1))
    drawn = detect(light, time, Spad(1.0, mode="ideal"), Exposure(1 / (time.bins * WIDTH_S), 1, 1.0))[:, 0]
    assert not drawn[:, 0].any()
    for column in range(1, 7):
        follows(drawn[:, column], poisson(means[column]), f"Poisson({means[column]})")
    # Bins are independent of one another: their sum has the law of its mean, too.
    follows(drawn[:, 1:6].sum(1), poisson(means[1:6].sum()), "sum of Poisson counts")
    for column in range(7, 10):
        z = (drawn[:, column] - np.int64(means[column])) / np.sqrt(means[column])
        for moment, value, variance in ((z, 0.0, 1.0), (z**2, 1.0, 2.0), (z**3, 0.0, 15.0), (z**4, 3.0, 96.0)):
            deviation = (moment.mean() - value) / np.sqrt(variance / len(z))
            accept(float(chi2(1).sf(deviation**2)), f"moments of Poisson({means[column]})")


def test_jitter_is_multinomial_outcome_by_outcome():
    """A few records are displaced one by one, many by binomials: both follow the same law."""
    fwhm_s = 0.4e-9
    light = np.zeros(8)
    light[4] = 1e3  # every cycle fires there
    kernel = response_kernel(1e-9, fwhm_s)
    for cycles in (3, 2 * len(kernel.weights) + 1):
        spad = Spad(pde=1.0, mode="synchronous", dead_time_s=1e-6, jitter_fwhm_s=fwhm_s)
        drawn = detect(np.tile(light, (REPLICATES, 1, 1)), TimeAxis(8, 1e-9), spad, Exposure(1e8, cycles, 1.0))[:, 0]
        assert (drawn.sum(1) == cycles).all()
        near = drawn[:, 4 - kernel.before : 5 + kernel.after]
        plain = np.random.default_rng(2).multinomial(cycles, kernel.weights, REPLICATES)
        outcomes_are_alike(near, plain, f"jitter of {cycles} records")


def follows(drawn, law, what: str) -> None:
    """χ² of counts against a law of scipy's, values pooled into classes of at least twenty."""
    cuts = np.unique(law.ppf(np.linspace(0.01, 0.99, 25)))
    share = np.diff(np.concatenate([[0.0], law.cdf(cuts), [1.0]]))
    observed = np.bincount(np.searchsorted(cuts, drawn, side="left"), minlength=len(share))
    expected = len(drawn) * share
    assert not observed[expected < 1e-9].any(), f"{what}: counts that cannot be"
    use = expected >= 20
    if use.sum() < 2:
        accept(float(poisson.sf(drawn.sum() - 1, len(drawn) * law.mean())) if drawn.sum() else 1.0, what)
        return
    statistic = np.sum((observed[use] - expected[use]) ** 2 / expected[use])
    accept(float(chi2(use.sum() - 1).sf(statistic)), what)
