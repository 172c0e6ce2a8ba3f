"""The factorised secondary equals the plain double sum, closed forms, and path tracing."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from rooms import bins_of_path, furnished_box, one_point_capture
from scipy import stats
from sphere_chords import QUAD, SPOT, WIDTH_M, stored, unit_ball

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor
from datagen.transport.factorised import secondary
from datagen.transport.factorised.convolution import SUB_BINS, Paths, Sums, convolve, double_sum, keep_strongest
from datagen.transport.fields_of_view import PixelCones
from datagen.transport.simulate import prepared


class Found(NamedTuple):
    mean: NDArray[np.float64]
    stderr: NDArray[np.float64]
    overflow: NDArray[np.float64]


def secondary_of(
    scene: Scene, capture: Capture, seed: int = 0, observed: int = 64, strongest: int | None = None,
    lookins: int = 256, fov_samples: int = 32, replicates: int = 1, **changes: Any,
) -> Found:  # fmt: skip
    kept = "all" if strongest is None else strongest
    accuracy = Accuracy(lookins, fov_samples, 4, replicates, observed=observed, secondary=kept)
    task = prepared(scene, capture, accuracy, seed, split_parts=False)
    got = secondary.secondary_transient(task, observed, **changes)
    return Found(got.rows[0], got.stderr, got.overflow)


def energies(estimates: list[Found]) -> NDArray[np.float64]:
    return np.array([e.mean.sum() + e.overflow.sum() for e in estimates])


@pytest.mark.parametrize(("low", "bins", "strongest"), [(0.0, 30, 1), (-9.0, 30, None), (0.0, 12, 5)])
def test_the_convolution_equals_the_plain_double_sum(low: float, bins: int, strongest: int | None) -> None:
    """From the same half paths, in windows that hold all light or cut its start or end: the energy is the same to
    rounding, and each bin too, apart from pairs near an edge that the displaced grids put on its other side."""
    rng = np.random.default_rng(1)
    lookins, pixels, each = 400, 3, 20
    ins = Paths(
        np.arange(lookins + 1) * each, rng.uniform(4, 14, lookins * each), rng.exponential(size=lookins * each)
    )
    outs = Paths(
        np.arange(lookins * pixels + 1) * each, low + rng.uniform(0, 15, lookins * pixels * each),
        rng.exponential(size=lookins * pixels * each),
    )  # fmt: skip
    if strongest is not None:
        keep_strongest(ins, strongest)
        assert (np.add.reduceat(ins.energy > 0, ins.first[:-1]) == strongest).all()
    u = (rng.permutation(lookins) + 0.5) / lookins
    fast, plain = (Sums(np.zeros((pixels, bins)), np.zeros(pixels)) for _ in range(2))
    in_sub_bins = [paths._replace(position=paths.position * SUB_BINS) for paths in (ins, outs)]
    # The displaced grids round times to the centres of sub-bins.
    in_sub_bins[1] = in_sub_bins[1]._replace(position=in_sub_bins[1].position - 0.5)
    convolve(*in_sub_bins, u, fast)
    double_sum(ins, outs, plain)
    np.testing.assert_allclose(
        fast.transient.sum(axis=1) + fast.overflow, plain.transient.sum(axis=1) + plain.overflow
    )
    assert (plain.overflow > 0).all() == (fast.overflow > 0).all() == (low < 0.0 or bins < 20)
    np.testing.assert_allclose(fast.overflow, plain.overflow, rtol=2e-2)
    difference = np.linalg.norm(fast.transient - plain.transient) / np.linalg.norm(plain.transient)
    assert difference < (0.01 if strongest is None else 0.04)


@pytest.mark.parametrize("after_edge", [-0.7, -0.4, 0.2])
def test_pairs_near_an_edge_are_shared_by_its_two_sides_linearly(after_edge: float) -> None:
    """In units of sub-bins, a pair at x behind an edge counts behind the edge with probability ½ + x, clipped to 0 …
    1."""
    count, bins = 1000, 10
    edge = 6 * SUB_BINS
    u = (np.arange(count) + 0.5) / count
    rows = np.arange(count + 1)
    into, out = (
        Paths(rows, np.full(count, position), np.ones(count)) for position in (7.3, edge + after_edge - 7.3 - 0.5)
    )
    sums = Sums(np.zeros((1, bins)), np.zeros(1))
    convolve(into, out, u, sums)
    behind = min(max(0.5 + after_edge, 0.0), 1.0)
    np.testing.assert_allclose(sums.transient[0, 5:7] / count, [1.0 - behind, behind], atol=1.5 / count)


def in_a_ball(albedo: float) -> tuple[Scene, Capture, float]:
    scene = Scene.from_parts([Part("sphere", unit_ball(5), Lambertian(albedo), "structure")])
    capture = Capture(Laser((0, 0, 0.0), [SPOT]), Sensor((0, 0, 0.0), QUAD), bins_of_path(60, WIDTH_M, 0.0))
    omega = PixelCones.of(capture.sensor).solid_angle[0]
    return scene, capture, albedo**4 / np.pi * np.pi * 0.02**2 * omega / (4 * np.pi)


def test_inside_of_a_sphere_shape() -> None:
    """Arrival times are distributed as three chords between uniform points: 16 runs, Student's t, family-wise level
    10⁻³ over the bins."""
    scene, capture, expected = in_a_ball(0.8)
    runs = np.array([secondary_of(scene, capture, lookins=512, seed=s).mean[0, 0] for s in range(16)])
    truth, truth_error = (expected * values[:60] for values in stored().of(4))
    mean, error = runs.mean(axis=0), runs.std(axis=0, ddof=1) / 4
    filled = truth > 1e-3 * truth.max()
    error = np.hypot(error, truth_error)
    t = np.abs(mean - truth)[filled] / error[filled]
    assert t.max() < stats.t.ppf(1 - 0.5e-3 / filled.sum(), 15)


def test_one_sample_is_unbiased_and_bounded() -> None:
    """One hidden vertex, one second hidden vertex, one FoV point, laser point 1 mm from a corner: no sample dominates
    the mean."""
    scene, capture = furnished_box(), one_point_capture((0, -1.499, 0.001))
    truth = energies([secondary_of(scene, capture, lookins=1 << 13, seed=9)])[0]
    ones = energies([secondary_of(scene, capture, lookins=1, observed=1, fov_samples=1, seed=s) for s in range(300)])
    assert abs(ones.mean() - truth) < stats.norm.ppf(1 - 0.5e-3) * ones.std(ddof=1) / np.sqrt(len(ones))
    assert ones.max() < 200 * truth


def test_standard_error_is_that_of_repeated_runs() -> None:
    scene, capture = furnished_box(), one_point_capture()
    estimates = [secondary_of(scene, capture, replicates=8, seed=s) for s in range(12)]
    means = np.array([e.mean[0, 0] for e in estimates])
    filled = means.mean(axis=0) > 0.05 * means.mean(axis=0).max()
    claimed = np.sqrt(np.mean([e.stderr[0, 0, filled] ** 2 for e in estimates], axis=0))
    ratio = (claimed / means.std(axis=0, ddof=1)[filled]).mean()
    assert 0.8 < ratio < 1.25
    assert np.isnan(secondary_of(scene, capture).stderr).all()
