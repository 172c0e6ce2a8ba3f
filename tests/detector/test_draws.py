"""Samplers against whole laws: every outcome of small cases is counted, and extreme cases have known outcomes."""

from __future__ import annotations

from collections import Counter
from itertools import product

import numpy as np
import pytest
from photon_by_photon import Rule, simulate
from scipy.stats import chi2, chi2_contingency, chisquare, multinomial, poisson
from statistics_kit import accept, mean_is, same_law

from datagen.detector import Exposure, Spad, detect
from datagen.detector.chain import draw_hazard_chain, draw_in_order, draw_return_chain
from datagen.detector.dead_time import pieces_of
from datagen.detector.expected import one_per_cycle_mean
from datagen.detector.flux import cycle_of
from datagen.detector.random_numbers import draw_poisson, generator_of
from datagen.detector.tdc import Tdc
from datagen.records import TimeAxis

REPLICATES = 20_000
EDGES = np.array([0.0, 1.0, 2.0, 3.0, 3.4])
FLUX = np.array([0.9, 0.0, 0.4, 0.7])


def in_order(flux, edges, dead_time, cycles, seed=0, count=REPLICATES):
    edges.flags.writeable = False  # as those of a `Cycle` are, for which the kernels are compiled then
    return draw_in_order(np.tile(flux, (count, 1)), edges, dead_time, cycles, generator_of(seed))


def outcomes_are_alike(a, b, what: str) -> None:
    """χ² over whole rows of counts, rare ones together."""
    found = [Counter(map(tuple, x.tolist())) for x in (a, b)]
    table = np.array([[f[outcome] for outcome in found[0] | found[1]] for f in found])
    rare = table.sum(0) < 20
    table = np.column_stack([table[:, ~rare], table[:, rare].sum(1)])
    accept(float(chi2_contingency(table[:, table.sum(0) > 0]).pvalue), what)


@pytest.mark.parametrize("cycles", [1, 3])
def test_one_detection_a_cycle_is_multinomial_outcome_by_outcome(cycles):
    p = one_per_cycle_mean(FLUX)
    p = np.append(p, 1.0 - p.sum())
    outcomes = [o for o in product(range(cycles + 1), repeat=5) if sum(o) == cycles and o[1] == 0]
    law = multinomial(cycles, p).pmf(np.array(outcomes))
    drawn = Counter(map(tuple, in_order(FLUX, EDGES, 9.0, cycles).tolist()))
    observed = np.array([drawn.pop(o[:4], 0) for o in outcomes])
    assert not drawn, "an outcome that cannot be"
    accept(float(chisquare(observed, REPLICATES * law).pvalue), f"outcomes of {cycles} cycles")


@pytest.mark.parametrize("cycles", [1, 3])
@pytest.mark.parametrize("dead_time", [0.3, 1.0, 1.7])
def test_returns_within_the_cycle_are_those_of_single_photons(dead_time, cycles):
    rule = Rule(dead_time, synchronous=True)
    want = simulate(FLUX, EDGES, cycles, rule, np.random.default_rng(1), REPLICATES)[:, 0]
    outcomes_are_alike(in_order(FLUX, EDGES, dead_time, cycles), want, f"dead time {dead_time}, {cycles} cycles")


@pytest.mark.parametrize("dead_time", [0.37, 7.3, 99.0])
@pytest.mark.parametrize("flux", [0.1, 4.0])
def test_in_order_and_bin_by_bin_are_one_law(flux, dead_time):
    edges = np.append(np.arange(20.0), 19.4)
    lam = 0.02 + np.exp(-np.arange(20) / 6.0)
    lam[[4, 11]] = 6.0, 0.0
    lam *= flux / lam.sum()
    got = in_order(lam, edges, dead_time, 500, count=400)
    if dead_time > edges[-1]:
        rng = generator_of(1)
        want = np.stack([draw_hazard_chain(lam, 500, rng) for _ in range(400)])
        mean_is(got, 500 * one_per_cycle_mean(lam), f"one a cycle, flux {flux}")
    else:
        pieces = pieces_of(lam, edges, 1.0, dead_time, shorter_than_dead_time=True)
        rng = generator_of(1)
        want = np.stack([draw_return_chain(pieces, 20, 500, rng) for _ in range(400)])
    same_law(got, want, f"in order, flux {flux}, dead time {dead_time}")


def test_in_order_from_nothing_to_certainty():
    nothing = in_order(np.zeros(4), EDGES, 1.0, 2**40, count=10)
    assert not nothing.any()
    # 1e12 cycles of 1e-12 events each: a Poisson number, for which no cycle is ever missed.
    rare = in_order(np.full(4, 2.5e-12), EDGES, 1.0, 10**12)
    accept(_poisson_law(rare.sum(1), 10.0), "1e12 cycles")
    # A bin in which every cycle fires leaves none for those after it, until the dead time is over.
    for certain in (50.0, 1e300):
        flux = np.array([0.0, certain, 5.0, 0.0])
        assert in_order(flux, EDGES, 9.0, 1000, count=3).tolist() == [[0, 1000, 0, 0]] * 3
        twice = in_order(np.array([certain, 0.0, 0.0, certain]), EDGES, 1.5, 1000, count=3)
        assert twice.tolist() == [[1000, 0, 0, 1000]] * 3


@pytest.mark.parametrize("mean", [1e-3, 0.5, 9.9, 10.0, 30.0, 3e4])
def test_poisson_counts_follow_their_law(mean):
    means = np.array([mean, 0.0, 0.7, 25.0])
    drawn = draw_poisson(np.tile(means, (REPLICATES, 1)), generator_of(0), str)
    assert not drawn[:, 1].any()
    for column in (0, 2, 3):
        accept(_poisson_law(drawn[:, column], means[column]), f"Poisson({means[column]})")
    for a, b in ((0, 2), (0, 3), (2, 3)):
        classes = [
            np.searchsorted(np.unique(np.quantile(drawn[:, c], [0.25, 0.5, 0.75])), drawn[:, c]) for c in (a, b)
        ]
        table = np.histogram2d(*classes, bins=(np.arange(5), np.arange(5)))[0]
        table = table[table.sum(1) > 0][:, table.sum(0) > 0]
        if min(table.shape) > 1:
            accept(float(chi2_contingency(table).pvalue), f"columns {a} and {b} are independent, mean {mean}")


@pytest.mark.parametrize("mean", [1e9, 1e11, 9e12])
def test_poisson_counts_of_any_size(mean):
    drawn = draw_poisson(np.full((REPLICATES, 5), mean), generator_of(0), str)
    z = ((drawn - np.int64(mean)) / np.sqrt(mean)).ravel()
    for moment, value, variance in ((z, 0.0, 1.0), (z**2, 1.0, 2.0), (z**3, 0.0, 15.0), (z**4, 3.0, 96.0)):
        deviation = (moment.mean() - value) / np.sqrt(variance / len(z))
        accept(float(chi2(1).sf(deviation**2)), f"moments of Poisson({mean})")


def test_jitter_is_multinomial_outcome_by_outcome():
    """A few records are displaced one by one, many by binomials: both follow the same law."""
    time = TimeAxis(8, 1e-9)
    cycle = cycle_of(time, Spad(jitter_fwhm_s=0.4e-9), Exposure(1e8))
    weights, before = cycle.after_avalanche.weights, cycle.after_avalanche.before
    tdc = Tdc(cycle)
    for count in (3, 2 * len(weights) + 1):
        detections = np.zeros((REPLICATES, len(cycle.gate)), np.int64)
        detections[:, 4] = count
        drawn = tdc.draw(detections, generator_of(0))
        assert (drawn.sum(1) == count).all()
        near = drawn[:, 4 - before : 4 - before + len(weights)]
        plain = np.random.default_rng(2).multinomial(count, weights, REPLICATES)
        outcomes_are_alike(near, plain, f"jitter of {count} records")


def test_few_and_many_detections_of_one_transient_are_counted_alike():
    """Dim histograms are drawn in order and bright ones bin by bin, side by side, without changing each other."""
    time, spad = TimeAxis(64, 1e-9), Spad(pde=1.0, dead_time_s=20e-9, mode="synchronous", jitter_fwhm_s=1e-9)
    bright = np.exp(-np.arange(64) / 9.0)
    transient = np.stack([bright * 1e-3, bright * 0.3] * 200)[:, None]
    counts = detect(transient, time, spad, Exposure(1e7, 20_000, 1.0), seed=5, tolerance=0.0)[:, 0]
    alone = detect(transient[1::2], time, spad, Exposure(1e7, 20_000, 1.0), seed=6, tolerance=0.0)[:, 0]
    same_law(counts[1::2].reshape(200, 16, 4).sum(2), alone.reshape(200, 16, 4).sum(2), "bright ones")
    assert counts[0::2].sum() < 0.01 * counts[1::2].sum()


def _poisson_law(drawn, mean: float) -> float:
    """p-value of counts against Poisson's law, values pooled into classes of at least twenty."""
    cuts = np.unique(poisson(mean).ppf(np.linspace(0.01, 0.99, 25)))
    law = np.diff(np.concatenate([[0.0], poisson(mean).cdf(cuts), [1.0]]))
    observed = np.bincount(np.searchsorted(cuts, drawn, side="left"), minlength=len(law))
    expected = len(drawn) * law
    use = expected >= 20
    if use.sum() < 2:
        return float(poisson.sf(drawn.sum() - 1, len(drawn) * mean)) if drawn.sum() else 1.0
    return float(chi2(use.sum() - 1).sf(np.sum((observed[use] - expected[use]) ** 2 / expected[use])))
