"""Case a: no dead time. Counts of disjoint bins are independent Poisson numbers."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.detector.binomials import REJECTION_FROM, stirling
from datagen.detector.streams import Stream, exponential, uniform
from datagen.errors import InputError

Array = NDArray[np.float64]

LARGEST_MEAN = 9.2e18
"""Counts of larger means would not fit 64 bits."""


def draw_poisson(mean: Array, streams: Stream, where: Callable[[int], str]) -> NDArray[np.int64]:
    """(h, bin) Poisson counts with these means, a stream (h, 4) for each row.

    Raises `InputError`, naming the row by `where`, for counts beyond 64 bits.
    """
    check_countable(mean, where)
    return _draw(np.ascontiguousarray(mean), streams)


def check_countable(mean: Array, where: Callable[[int], str]) -> None:
    """Raise `InputError`, naming the row of (h, bin) by `where` and the bin, where a mean is more than can be
    counted."""
    if not mean.max(initial=0.0) < LARGEST_MEAN:
        row, bin_ = (int(i) for i in np.argwhere(~(mean < LARGEST_MEAN))[0])
        raise InputError(
            f"{where(row)}, bin {bin_}: {mean[row, bin_]:g} expected counts, at most {LARGEST_MEAN:g} can be counted"
            "; lower cycles or photons_per_pulse"
        )


@compiled()
def _draw(mean: Array, streams: Stream) -> NDArray[np.int64]:
    """Events of rate 1 along the sum of the means: an exponential number an event, none for bins without; bins of
    large means, which that would take long, are drawn at once."""
    rows, bins = mean.shape
    counts = np.zeros((rows, bins), np.int64)
    for r in range(rows):
        stream = streams[r]
        # Until the next event; bins drawn at once do not count, for what is left has no memory.
        ahead = exponential(stream)
        for i in range(bins):
            if mean[r, i] >= REJECTION_FROM:
                counts[r, i] = _rejection(mean[r, i], stream)
                continue
            ahead -= mean[r, i]
            while ahead < 0.0:
                counts[r, i] += 1
                ahead += exponential(stream)
    return counts


@compiled()
def _rejection(mean: float, stream: Stream) -> int:
    """Transformed rejection with squeeze, for means ≥ 10 (W. Hörmann, Insur. Math. Econ. 12, 39, 1993: PTRS).

    As for `binomial`, the density goes through log1p, so that no mean is too large for its digits.
    """
    root = math.sqrt(mean)
    b = 0.931 + 2.53 * root
    a = -0.059 + 0.02483 * b
    while True:
        u, v = uniform(stream) - 0.5, uniform(stream)
        edge = 0.5 - abs(u)
        if edge <= 0.0:
            continue
        k = math.floor((2.0 * a / edge + b) * u + mean + 0.43)
        if edge >= 0.07 and v <= 0.9277 - 3.6224 / (b - 2.0):
            return int(k)
        if k < 0 or v <= 0.0 or (edge < 0.013 and v > edge):
            continue
        d = k + 1.0 - mean
        bound = d - (k + 0.5) * math.log1p(d / mean) - 0.5 * math.log(2 * math.pi * mean) - stirling(k)
        if math.log(v * (1.1239 + 1.1328 / (b - 3.4)) / (a / (edge * edge) + b)) <= bound:
            return int(k)
