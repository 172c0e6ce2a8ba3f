"""Statistical tests whether two sets of histograms follow the same law, on one family-wise level."""

from __future__ import annotations

import numpy as np
import scipy.stats

FAMILY_LEVEL = 1e-3
"""Probability that any statistical test of tests/detector fails by chance, over all of them together."""

FAMILY_SIZE = 10_000
"""More p-values than tests/detector computes; the level of each is FAMILY_LEVEL / FAMILY_SIZE."""


def accept(p_value: float, what: str) -> None:
    assert p_value > FAMILY_LEVEL / FAMILY_SIZE, f"{what}: p = {p_value:.2e}"


def same_law(a, b, what: str) -> None:
    """(replicate, bin) counts a and b: per-bin χ², mean vector, totals (KS), variance of random projections."""
    a, b = np.asarray(a), np.asarray(b)
    for i in range(a.shape[1]):
        accept(_homogeneous(a[:, i], b[:, i]), f"{what}: χ² of bin {i}")
    accept(_same_mean(a, b), f"{what}: mean vector")
    accept(float(scipy.stats.ks_2samp(a.sum(1), b.sum(1)).pvalue), f"{what}: KS of totals")
    directions = np.random.default_rng(7).standard_normal((a.shape[1], 8))
    for k, direction in enumerate(directions.T):
        accept(_same_variance(a @ direction, b @ direction), f"{what}: variance of projection {k}")
    accept(_same_variance(a.sum(1), b.sum(1)), f"{what}: variance of totals")


def mean_is(samples, expected, what: str) -> None:
    """(replicate, bin) counts against their exact mean: Hotelling over bins with any spread."""
    samples = np.asarray(samples, np.float64)
    spread = samples.std(0) > 0
    assert np.all(np.abs(samples.mean(0) - expected)[~spread] <= 10 / len(samples)), f"{what}: bins without spread"
    accept(_hotelling(samples[:, spread] - np.asarray(expected)[spread]), f"{what}: exact mean")


def poisson_like_chi2(counts, mean, trials: int) -> float:
    """p-value of Σ (n − m)² / (m (1 − m / trials)) for single counts of independent trials, bins with m ≥ 10."""
    use = (mean >= 10) & (mean <= trials - 10)
    chi2 = float(np.sum((counts[use] - mean[use]) ** 2 / (mean[use] * (1 - mean[use] / trials))))
    # Two-sided: too good a fit betrays a wrong variance.
    law = scipy.stats.chi2(int(use.sum()))
    return 2 * min(law.sf(chi2), law.cdf(chi2))


def _homogeneous(x, y) -> float:
    """χ² test that two samples of counts come from one law; values are pooled into classes of at least ten."""
    values = np.sort(np.concatenate([x, y]))
    cuts = np.unique(values[:: max(len(values) // 12, 20)])
    table = np.stack([np.bincount(np.searchsorted(cuts, s, side="left"), minlength=len(cuts) + 1) for s in (x, y)])
    table = table[:, table.sum(0) > 0]
    return float(scipy.stats.chi2_contingency(table, correction=False).pvalue) if table.shape[1] > 1 else 1.0


def _same_mean(a, b) -> float:
    """Hotelling's two-sample test on the bins in which anything varies."""
    use = (a.std(0) > 0) & (b.std(0) > 0)
    a, b = a[:, use].astype(float), b[:, use].astype(float)
    n, m, d = len(a), len(b), a.shape[1]
    pooled = ((n - 1) * np.cov(a, rowvar=False) + (m - 1) * np.cov(b, rowvar=False)) / (n + m - 2)
    gap = a.mean(0) - b.mean(0)
    t2 = n * m / (n + m) * gap @ np.linalg.pinv(np.atleast_2d(pooled), rcond=1e-10) @ gap
    return float(scipy.stats.f(d, n + m - d - 1).sf(t2 * (n + m - d - 1) / ((n + m - 2) * d)))


def _hotelling(x) -> float:
    n, d = x.shape
    gap = x.mean(0)
    t2 = n * gap @ np.linalg.pinv(np.atleast_2d(np.cov(x, rowvar=False)), rcond=1e-10) @ gap
    return float(scipy.stats.f(d, n - d).sf(t2 * (n - d) / ((n - 1) * d)))


def _same_variance(x, y) -> float:
    """Difference of log variances over its standard error, which takes the samples' kurtosis into account."""

    def log_variance(s):
        excess = max(float(scipy.stats.kurtosis(s)), -1.9)
        return np.log(s.var(ddof=1)), (2.0 + excess) / len(s)

    (u, vu), (w, vw) = log_variance(x), log_variance(y)
    return float(2 * scipy.stats.norm.sf(abs(u - w) / np.sqrt(vu + vw)))
