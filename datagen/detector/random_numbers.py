"""Random numbers of the detector: numpy's, which compiled loops draw from the same `Generator`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from datagen.compiled import compiled
from datagen.errors import InputError, shown
from datagen.records.arrays import Floats, Ints
from datagen.seeding import Purpose

LARGEST_MEAN = 1e13
"""Largest mean of a Poisson number: of larger ones numpy's have too large a variance, as digits cancel in it."""


def generator_of(seed: int) -> Generator:
    """The generator of all counts of one call of `detect`. Raises `InputError` for a negative seed."""
    if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool) or seed < 0:
        raise InputError(f"seed = {shown(seed)}: must be an integer ≥ 0")
    return Generator(np.random.SFC64(np.random.SeedSequence(int(seed), spawn_key=(int(Purpose.DETECTOR),))))


@compiled()
def binomial(n: int, p: float, rng: Generator) -> int:
    """A Binomial(n, p) number; a p that rounding put above 1 is taken as 1."""
    if n == 0 or p <= 0.0:
        return 0
    return n if p >= 1.0 else rng.binomial(n, p)


def draw_poisson(mean: Floats, rng: Generator, where: Callable[[int], str]) -> Ints:
    """(h, bin) Poisson counts of means (h, bin). Raises as `check_countable` does."""
    check_countable(mean, where)
    return rng.poisson(mean)


def check_countable(mean: Floats, where: Callable[[int], str]) -> None:
    """Raise `InputError`, naming the row by `where` and the bin, if one of the means (h, bin) cannot be counted."""
    if not mean.max(initial=0.0) < LARGEST_MEAN:
        row, bin_ = (int(i) for i in np.argwhere(~(mean < LARGEST_MEAN))[0])
        raise InputError(
            f"{where(row)}, bin {bin_}: {mean[row, bin_]:g} expected counts, at most {LARGEST_MEAN:g} can be counted"
            "; lower cycles or photons_per_pulse"
        )
