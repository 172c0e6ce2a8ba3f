"""The sampler: Sobol' nets under scrambling, uniformity, honest standard errors, order of convergence."""

from __future__ import annotations

import numpy as np
from rooms import bins_of_path, furnished_box, one_point_capture
from scipy import stats
from scipy.stats import qmc

from datagen import Accuracy, simulate
from datagen.transport.brdf import cosine_directions
from datagen.transport.sampling import direction_numbers, scrambled_sobol, stream_seeds


def test_direction_numbers_are_those_of_an_independent_implementation() -> None:
    dimensions = len(direction_numbers())
    reference = (qmc.Sobol(dimensions, scramble=False, bits=32).random(1 << 11) * 2.0**32).astype(np.uint64)
    point = np.zeros(dimensions, np.uint64)
    for i in range(1 << 11):
        np.testing.assert_array_equal(reference[i], point)
        point ^= direction_numbers()[:, (~i & (i + 1)).bit_length() - 1]


def test_every_scrambling_is_a_net() -> None:
    """2¹⁰ points of the first two dimensions put exactly one point into every elementary interval of that area."""
    for points in scrambled_sobol(stream_seeds(7, np.arange(32)), 1 << 10, 2):
        for k in range(11):
            cell = np.floor(points[:, 0] * 2**k) * 2 ** (10 - k) + np.floor(points[:, 1] * 2 ** (10 - k))
            assert len(np.unique(cell)) == 1 << 10


def test_each_point_is_uniform_over_scramblings() -> None:
    """χ² of single coordinates over 20 000 scramblings; Bonferroni over 3 points × 6 dimensions at 10⁻³."""
    points = scrambled_sobol(stream_seeds(3, np.arange(20_000)), 3, 6)
    for i in range(3):
        for d in range(6):
            counts = np.histogram(points[:, i, d], 50, (0, 1))[0]
            assert stats.chisquare(counts).pvalue > 1e-3 / 18
    assert ((points > 0) & (points < 1)).all()


def test_dimensions_and_streams_are_independent() -> None:
    points = scrambled_sobol(stream_seeds(3, np.arange(20_000)), 1, 6)[:, 0]
    correlation = np.corrcoef(points.T)[np.triu_indices(6, 1)]
    assert np.abs(correlation).max() < stats.norm.ppf(1 - 0.5e-3 / 15) / np.sqrt(20_000)


def test_cosine_directions_have_density_cos_over_pi() -> None:
    """χ² of 200 000 independent directions over cos²θ × φ, in which the density is flat; level 10⁻³."""
    rng = np.random.default_rng(0)
    for normal in ([0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0], [-0.6, 0.64, -0.48]):
        n = np.asarray(normal)
        w = cosine_directions(np.tile(n, (200_000, 1)), rng.random((200_000, 2)))
        np.testing.assert_allclose(np.linalg.norm(w, axis=1), 1, atol=1e-12)
        cosine = w @ n
        assert (cosine > -1e-12).all()
        helper = np.eye(3)[np.argmin(np.abs(n))]
        t = np.cross(n, helper) / np.linalg.norm(np.cross(n, helper))
        phi = np.arctan2(w @ np.cross(n, t), w @ t)
        counts = np.histogram2d(cosine**2, phi, (20, 20), ((0, 1), (-np.pi, np.pi)))[0]
        assert stats.chisquare(counts.ravel()).pvalue > 1e-3 / 4


def test_standard_error_is_honest() -> None:
    """The estimates of 40 seeds scatter by the standard error that each of them states, in total energy and in single
    bins."""
    scene, capture = furnished_box(), one_point_capture(time=bins_of_path(60, 0.3, 0.0))
    runs = [simulate(scene, capture, Accuracy(samples=1024, max_bounces=3), seed=s) for s in range(40)]
    totals = np.array([r.total[0, 0] for r in runs])
    stated = np.sqrt(np.mean([r.stderr[0, 0] ** 2 for r in runs], axis=0))
    scatter = totals.std(axis=0, ddof=1)
    filled = totals.mean(axis=0) > 1e-3 * totals.mean(axis=0).max()
    ratio = np.sqrt((scatter[filled] ** 2).sum() / (stated[filled] ** 2).sum())
    # Some 20 independent bins × 39 degrees of freedom: the ratio of variances is known to about 5 %.
    assert 0.85 < ratio < 1.15


def test_order_of_convergence() -> None:
    """The error of the total energy falls with the number of samples N clearly faster than Monte Carlo's N^-1/2:
    about as N^-0.9."""
    scene, capture = furnished_box(), one_point_capture(half_side_m=0.01, time=bins_of_path(1, 40.0, 0.0))
    counts = np.array([256, 1024, 4096, 16384])
    errors = []
    for count in counts:
        runs = [
            float(
                (r := simulate(scene, capture, Accuracy(samples=int(count)), seed=s)).total.sum() + r.overflow.sum()
            )
            for s in range(32)
        ]
        errors.append(np.std(runs, ddof=1))
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert order > 0.65
