"""Light of an element and a cluster of FoV points over arrival times (`transport/arrival_times.py`): against small
pieces of both, each of which arrives at one time, and against itself, in parts of parts and windows of windows."""

from __future__ import annotations

import numpy as np
import pytest
from small_pieces import small_pieces

from datagen.transport.arrival_times import BETWEEN, CORNERS, LEVELS, PARTS, PLACES, SPANS, Work, spread
from datagen.transport.cut_steps import Batch

BINS, LIGHT = 60, 2.5
STILL = (0.0, 0.0, 0.0, 0.0)
CASES = {
    "a point": ((30.3, 30.3, 30.3), (1.0, 1.0, 1.0), (5.2, -2.1, 0.0, 0.0)),
    "a point, weights that change": ((30.7, 30.7, 30.7), (1.0, 1.0, 1.0), (5.2, 7.5, 0.8, 1.1)),
    "a small element": ((30.1, 30.6, 30.9), (1.0, 0.4, 0.7), (3.0, 0.4, 0.4, -1.0)),
    "as large": ((28.2, 33.1, 31.4), (0.2, 1.4, 0.7), (4.5, -1.3, 1.1, 0.3)),
    "a larger one": ((12.2, 43.1, 31.4), (0.2, 1.4, 0.7), (9.5, 6.3, -1.1, 0.3)),
    "both within a bin": ((30.2, 30.8, 30.4), (1.0, 0.0, 2.0), (0.1, 0.2, 1.0, 1.0)),
    "a narrow cluster": ((27.0, 30.0, 36.0), (1.0, 2.0, 1.0), (0.3, -0.2, 0.5, 0.0)),
    "one side only": ((27.0, 30.0, 36.0), (1.0, 2.0, 1.0), (6.0, 0.0, 1.0, 1.0)),
    "from before the window to within": ((-3.0, 2.0, 4.0), (1.0, 2.0, 1.0), (6.0, 2.0, 1.0, 0.3)),
    "a point at its end": ((59.0, 59.0, 59.0), (1.0, 2.0, 1.0), (6.0, 2.0, -1.0, 0.3)),
    "outside of it": ((90.0, 99.0, 94.0), (1.0, 2.0, 1.0), (6.0, 2.0, -1.0, 0.3)),
    "no cluster": ((20.3, 34.9, 22.2), (1.0, 0.2, 3.0), STILL),
    "no cluster, over all of the window": ((98.2, -17.7, 24.0), (0.0, 1.0, 2.0), STILL),
    "no cluster, its middle before the window": ((-23.3, -4.4, 27.0), (3.0, 0.2, 1.0), STILL),
    "two corners at once": ((20.6, 20.6, 44.4), (1.0, 0.0, 2.0), STILL),
    "all corners at once": ((20.6, 20.6, 20.6), (1.0, 0.0, 2.0), STILL),
    "in one bin": ((20.1, 20.9, 20.4), (1.0, 2.0, 3.0), STILL),
}
"""Arrival times at three corners, bins, weights there, and the change of times and weights along both sides of the
cluster."""
Corners = tuple[float, ...]


def found(
    times: Corners, weights: Corners, change: Corners, level: int = 0, shift: int = len(SPANS), bins: int = BINS
) -> np.ndarray:
    """(bins + 1,) the light of one element of LIGHT photons, and what is outside, last."""
    s1, s2 = PLACES.T
    batch, histogram = Batch.of(1), np.zeros(bins)
    batch.time[0], batch.at[0] = (of[0] * (1 - s1 - s2) + of[1] * s1 + of[2] * s2 for of in (times, weights))
    batch.light[0], batch.level[0], batch.change[0], batch.shift[0] = LIGHT, level, change, shift
    work = Work.of(bins, 2**shift * (abs(change[0]) + abs(change[1])))
    outside = spread(batch, 0, histogram, work)
    assert not any(of.any() for of in (work.steps, work.own, work.once))
    return np.append(histogram, outside)


def of_small_pieces(times: Corners, weights: Corners, change: Corners) -> np.ndarray:
    """What `found` should be."""
    pieces, places = (400, 1) if change == STILL else (96, 96)
    time, weight = small_pieces(times, pieces), small_pieces(weights, pieces)
    middle = (np.arange(places) + 0.5) / places - 0.5
    p, q = (x.ravel() for x in np.meshgrid(middle, middle))
    later, more = p * change[0] + q * change[1], (1 + p * change[2]) * (1 + q * change[3])
    place = np.floor(time[:, None] + later).astype(int)
    place[(place < 0) | (place >= BINS)] = BINS
    light = np.bincount(place.ravel(), np.outer(weight, more).ravel(), BINS + 1)
    return np.asarray(LIGHT * light / light.sum())


@pytest.mark.parametrize("level", [0, LEVELS])
@pytest.mark.parametrize("case", CASES)
def test_light_of_an_element_and_a_cluster(case: str, level: int) -> None:
    """Energy is exact; bins are off by 2 % (L2) at most, 4 % for what is narrower than the steps of its cluster."""
    light, truth = found(*CASES[case], level), of_small_pieces(*CASES[case])
    assert light.sum() == pytest.approx(LIGHT, rel=1e-6)
    assert (light >= 0).all()
    limit = 0.04 if np.ptp(CASES[case][0]) < 0.5 and CASES[case][2] != STILL else 0.02
    assert np.linalg.norm(light - truth) < limit * np.linalg.norm(truth)
    if truth[-1] == 0:
        at = np.arange(BINS + 1)
        mean = light @ at / LIGHT
        assert mean == pytest.approx(truth @ at / LIGHT, abs=0.02)
        assert light @ (at - mean) ** 2 / LIGHT == pytest.approx(truth @ (at - mean) ** 2 / LIGHT, rel=0.01, abs=0.02)


def random_element(rng: np.random.Generator) -> tuple[Corners, Corners, Corners]:
    """Times about a window, from a hundredth of a bin wide to far beyond it, weights, and a cluster or none."""
    times = rng.uniform(-30, BINS + 30) + 10 ** rng.uniform(-2, 3) * rng.random(3)
    tied = np.where(rng.random(3) < 0.2, times[0], times)
    change = np.where(rng.random() < 0.5, rng.uniform(-1, 1, 4) * [12, 12, 1, 1], 0.0)
    return tuple(tied), tuple(rng.random(3)), tuple(change)


@pytest.mark.parametrize("shift", range(len(SPANS) + 1))
def test_windows_of_windows(shift: int) -> None:
    """What arrives within a window does not depend on what is recorded outside of it."""
    rng, before = np.random.default_rng([3, shift]), 1500
    for _ in range(200):
        times, weights, change = random_element(rng)
        level = int(rng.integers(LEVELS + 1))
        light = found(times, weights, change, level, shift)
        later = tuple(time + before for time in times)
        wide = found(later, weights, change, level, shift, 2 * before + BINS)[before : before + BINS]
        np.testing.assert_allclose(light[:-1], wide, rtol=1e-6, atol=3e-6 * LIGHT)
        assert light[-1] == pytest.approx(LIGHT - wide.sum(), abs=1e-4 * LIGHT)


def test_parts_of_parts() -> None:
    """Where times and weights are linear, the parts of a triangle have its light together."""
    rng = np.random.default_rng(4)
    for _ in range(200):
        times, weights, change = random_element(rng)
        whole = found(times, weights, change)
        for level in range(1, LEVELS + 1):
            np.testing.assert_allclose(found(times, weights, change, level), whole, atol=1e-3 * LIGHT)


@pytest.mark.parametrize("shift", range(len(SPANS) + 1))
def test_halves_of_an_element_are_together_as_the_whole(shift: int) -> None:
    """Spread about its own mean each half would leave a gap, or overlap the other."""
    change = (3.7, -1.6, 0.6, 0.2)
    a, b, c, middle = 20.3, 34.8, 27.1, 0.5 * (20.3 + 34.8)
    whole = found((a, b, c), (1.0, 1.0, 1.0), change, 0, shift)
    halves = [
        found(times, (1.0, 1.0, 1.0), change, 0, shift) / 2 for times in ((a, middle, c), (middle, b, c))
    ]  # fmt: skip
    assert np.linalg.norm(sum(halves) - whole) < 0.003 * np.linalg.norm(whole)


@pytest.mark.parametrize("off", [0.0, 0.13, 0.37, 0.5, 0.71])
def test_a_rising_edge_does_not_hang_on_where_in_a_bin_it_is(off: float) -> None:
    """Narrow elements spread by whole bins had the first bin of an edge wrong by a tenth of its light."""
    for times in ((20.0, 20.8, 27.0), (20.01, 20.0, 20.02)):
        case = (tuple(time + off for time in times), (2.0, 2.0, 0.2), (1.4, 0.6, 0.2, 0.1))
        light, truth = found(*case), of_small_pieces(*case)
        assert np.abs(light - truth).max() < 0.025 * truth.max()


def test_corners_of_parts_lie_between_those_of_coarser_ones() -> None:
    np.testing.assert_allclose(PLACES, PLACES[BETWEEN].mean(axis=1), rtol=0, atol=1e-15)
    for level, count in enumerate(CORNERS):
        assert BETWEEN[:count].max() < count
        a, b, c = (PLACES[PARTS[level, : 4**level, k]] for k in range(3))
        areas = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        np.testing.assert_allclose(areas, 4.0**-level, rtol=1e-12)
        assert PARTS[level].max() < count
