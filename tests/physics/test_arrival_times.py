"""Time bins of an element's light (`transport/arrival_times.py`) are what its triangle holds between their edges: by
small pieces of the triangle, each of which arrives at one time."""

from __future__ import annotations

import numpy as np
import pytest
from small_pieces import small_pieces

from datagen.transport.arrival_times import pour, tent

BINS, ENERGY, PARTS = 6, 2.5, 400
TRIANGLES = {
    "within the window": ((1.3, 4.9, 2.2), (1.0, 0.2, 3.0)),
    "from before it": ((-1.4, 2.6, 3.1), (0.3, 4.0, 1.0)),
    "its middle before it": ((-2.3, -0.4, 2.7), (3.0, 0.2, 1.0)),
    "to after it": ((3.2, 7.9, 4.1), (1.0, 2.0, 0.1)),
    "over all of it": ((8.2, -1.7, 2.4), (0.0, 1.0, 2.0)),
    "two corners at once": ((0.6, 0.6, 4.4), (1.0, 0.0, 2.0)),
    "in one bin": ((2.1, 2.9, 2.4), (1.0, 2.0, 3.0)),
}
"""Arrival times at three corners, bins, and the light there."""


@pytest.mark.parametrize("case", TRIANGLES)
def test_bins_of_a_triangle(case: str) -> None:
    times, light = TRIANGLES[case]
    found = np.zeros((1, BINS))
    outside = pour(found, 0, tent(*times, *light, ENERGY), ENERGY)
    weight = small_pieces(light, PARTS)
    place = np.floor(small_pieces(times, PARTS)).astype(int)
    inside = (place >= 0) & (place < BINS)
    truth = ENERGY / weight.sum() * np.bincount(place[inside], weight[inside], BINS)
    # An edge of a bin runs through a row of pieces, each of which counts as if on one side.
    np.testing.assert_allclose(found[0], truth, atol=3e-3 * ENERGY)
    assert outside == pytest.approx(ENERGY - truth.sum(), abs=3e-3 * ENERGY)
    assert found.sum() + outside == pytest.approx(ENERGY, rel=1e-12, abs=0)
