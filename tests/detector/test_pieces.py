"""The error of cutting bins into pieces, the only error of the return chain and of means under a dead time."""

from __future__ import annotations

import numpy as np
import pytest

from datagen.detector import Exposure, Spad, expected_histogram
from datagen.detector.dead_time import PIECE_FLUX
from datagen.records import TimeAxis

BINS, WIDTH = 64, 1e-9
CYCLES = 10**8


def _mean(flux: float, dead_time_s: float) -> np.ndarray:
    shape = 0.02 + np.exp(-(((np.arange(BINS) - 20) / 6.0) ** 2))
    spad = Spad(pde=1.0, mode="synchronous", dead_time_s=dead_time_s)
    exposure = Exposure(1 / (BINS * WIDTH), CYCLES, 1.0)
    return expected_histogram(shape * flux / shape.sum(), TimeAxis(BINS, WIDTH), spad, exposure)


@pytest.mark.parametrize("dead_time_s", [0.37e-9, 7.3e-9, 31.4e-9])
@pytest.mark.parametrize("flux", [0.1, 1.0, 4.0, 40.0])
def test_the_error_is_invisible_in_a_hundred_million_cycles(
    flux: float, dead_time_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    mean = _mean(flux, dead_time_s)
    monkeypatch.setattr("datagen.detector.dead_time.PIECE_FLUX", PIECE_FLUX / 16)
    finest = _mean(flux, dead_time_s)
    assert not np.array_equal(mean, finest)
    # The increase of χ² over all 64 bins, which is 64 ± 11.
    assert np.sum((mean - finest) ** 2 / finest) < 0.2
    if flux <= 4.0:
        assert np.max(np.abs(mean / finest - 1)) < 2e-4
