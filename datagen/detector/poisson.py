"""Case a: no dead time. Counts of disjoint bins are independent Poisson numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError

LARGEST_MEAN = 9.2e18
"""numpy's Poisson sampler refuses means beyond it: its counts would not fit 64 bits."""


def draw_poisson(mean: NDArray[np.float64], rng: np.random.Generator, where: str) -> NDArray[np.int64]:
    """Poisson counts of any shape; raises `InputError`, naming the histogram `where`, for counts beyond 64 bits."""
    check_countable(mean, where)
    return rng.poisson(mean) if mean.any() else np.zeros(mean.shape, np.int64)


def check_countable(mean: NDArray[np.float64], where: str) -> None:
    """Raise `InputError`, naming the histogram `where` and the bin, where a mean is more than can be counted."""
    largest = float(mean.max(initial=0.0))
    if not largest < LARGEST_MEAN:
        bin_ = int(np.argmax(mean))
        raise InputError(
            f"{where}, bin {bin_}: {largest:g} expected counts, at most {LARGEST_MEAN:g} can be counted; "
            "lower cycles or photons_per_pulse"
        )
