"""Light of an element and a cluster of FoV points over arrival times (`transport/cut_steps.py`), against small pieces
of both, each of which arrives at one time."""

from __future__ import annotations

import numpy as np
import pytest
from small_pieces import small_pieces

from datagen.transport.cut_steps import BETWEEN, CORNERS, LEVELS, PARTS, PLACES, Batch, pour_all

BINS, LIGHT, PIECES = 60, 2.5, 48
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
}
"""Arrival times at three corners, bins, weights there, and the change of times and weights along both sides of the
cluster."""


def spread(times: tuple[float, ...], weights: tuple[float, ...], change: tuple[float, ...], level: int) -> np.ndarray:
    """(BINS + 1,) the light of one element of LIGHT photons, and what is outside, last."""
    batch = Batch.of(1)
    s1, s2 = PLACES.T
    for values, corners in ((batch.time, times), (batch.at, weights)):
        values[0] = corners[0] * (1 - s1 - s2) + corners[1] * s1 + corners[2] * s2
    batch.row[0], batch.level[0], batch.change[0] = 0, level, change
    batch.light[0] = LIGHT / (4**level * sum(weights))
    histogram, outside, room = np.zeros((1, BINS)), np.zeros(1), int(abs(change[0]) + abs(change[1])) + 3
    pour_all(batch, np.array([0]), histogram, outside, np.zeros((1, BINS + 2 * room)), np.empty(2 * room + 1))
    return np.append(histogram[0], outside)


def of_small_pieces(times: tuple[float, ...], weights: tuple[float, ...], change: tuple[float, ...]) -> np.ndarray:
    """What `spread` should be."""
    time, weight = small_pieces(times, PIECES), small_pieces(weights, PIECES)
    middle = (np.arange(PIECES) + 0.5) / PIECES - 0.5
    p, q = (x.ravel() for x in np.meshgrid(middle, middle))
    later, more = p * change[0] + q * change[1], 1 + p * change[2] + q * change[3]
    place = np.floor(time[:, None] + later).astype(int)
    place[(place < 0) | (place >= BINS)] = BINS
    light = np.bincount(place.ravel(), np.outer(weight, more).ravel(), BINS + 1)
    return np.asarray(LIGHT * light / light.sum())


@pytest.mark.parametrize("level", [0, LEVELS])
@pytest.mark.parametrize("case", CASES)
def test_light_of_an_element_and_a_cluster(case: str, level: int) -> None:
    """Energy is exact; bins are off by 4 % (L2) at most, 6 % where all is within a bin or two."""
    found, truth = spread(*CASES[case], level), of_small_pieces(*CASES[case])
    assert found.sum() == pytest.approx(LIGHT, rel=1e-9)
    assert (found >= -1e-12).all()
    limit = 0.06 if np.count_nonzero(truth > 0.01 * LIGHT) < 4 else 0.04
    assert np.linalg.norm(found - truth) < limit * np.linalg.norm(truth)
    if truth[-1] == 0:
        at = np.arange(BINS + 1)
        mean = found @ at / LIGHT
        assert mean == pytest.approx(truth @ at / LIGHT, abs=0.05)
        assert found @ (at - mean) ** 2 / LIGHT == pytest.approx(truth @ (at - mean) ** 2 / LIGHT, rel=0.03, abs=0.02)


def test_halves_of_an_element_are_together_as_the_whole() -> None:
    """Spread about its own mean each half would leave a gap, or overlap the other."""
    change = (3.7, -1.6, 0.6, 0.2)
    a, b, c, middle = 20.3, 34.8, 27.1, 0.5 * (20.3 + 34.8)
    whole = spread((a, b, c), (1.0, 1.0, 1.0), change, 0)
    halves = [spread(times, (1.0, 1.0, 1.0), change, 0) / 2 for times in ((a, middle, c), (middle, b, c))]
    assert np.linalg.norm(sum(halves) - whole) < 0.002 * np.linalg.norm(whole)


def test_corners_of_parts_lie_between_those_of_coarser_ones() -> None:
    np.testing.assert_allclose(PLACES, PLACES[BETWEEN].mean(axis=1), rtol=0, atol=1e-15)
    for level, count in enumerate(CORNERS):
        assert BETWEEN[:count].max() < count
        a, b, c = (PLACES[PARTS[level, : 4**level, k]] for k in range(3))
        areas = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        np.testing.assert_allclose(areas, 4.0**-level, rtol=1e-12)
        assert PARTS[level].max() < count
