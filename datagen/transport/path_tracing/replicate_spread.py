"""The spread of independent replicates: the standard error of their mean, and its number of degrees of freedom."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats
from datagen.transport.sampling import mix

SKETCH_SIZE = 4096
"""Numbers into which a transient is folded, 32 KiB for each replicate; with half as many, scalar products are √2
times as noisy."""


def standard_error(means: Sequence[Floats], squares: Floats, replicates: int) -> Floats:
    """(L, P, T) standard error of the sum of `means`, each (L, P, T); NaN for one replicate.

    squares : (L, P, T) sum of squares over the replicates, which is overwritten with the result. The laser points are
    taken one by one, so that no further array of the scan's full size is needed.
    """
    if replicates == 1:
        squares.fill(np.nan)
        return squares
    for laser, row in enumerate(squares):
        mean = sum(component[laser] for component in means)
        np.sqrt(np.maximum(row / replicates - mean**2, 0.0) / (replicates - 1), out=row)
    return squares


class Sketch:
    """Scalar products between the replicates' transients, without keeping them.

    Each transient is folded, with pseudo-random signs, into `SKETCH_SIZE` numbers, which keeps scalar products on
    average and to about 1/√size (Charikar, Chen & Farach-Colton, "Finding frequent items in data streams" (2004)).
    """

    def __init__(self, replicates: int) -> None:
        self.folded = np.zeros((replicates, SKETCH_SIZE))

    def add(self, replicate: int, transient: Floats, first: int) -> None:
        """Add a piece of a replicate's transient whose first entry has the flat index `first` in the whole."""
        _fold(transient.reshape(-1), first, self.folded[replicate])

    def freedom(self) -> float:
        """Effective number of degrees of freedom ν ≥ 1 of a replicate's deviation from the mean.

        For Gaussian deviations of covariance Σ, ‖deviation‖² has mean tr Σ and variance 2 tr Σ², like χ² with
        ν = (tr Σ)² / tr Σ² degrees of freedom (Satterthwaite 1946). tr Σ² is taken by its unbiased estimate.
        """
        n = len(self.folded) - 1
        deviation = self.folded - self.folded.mean(axis=0)
        peak = float(np.abs(deviation).max())
        if n < 2 or peak == 0.0:
            return 1.0
        # Scaled to about 1, as the fourth power of very little light would underflow. A power of two rounds nothing.
        deviation = np.ldexp(deviation, -math.frexp(peak)[1])
        products = deviation @ deviation.T / n
        trace, square = float(np.trace(products)), float((products**2).sum())
        unbiased = n * n / ((n - 1) * (n + 2)) * (square - trace * trace / n)
        return float(np.clip(trace * trace / max(unbiased, trace * trace / SKETCH_SIZE), 1.0, SKETCH_SIZE))


@compiled()
def _fold(values: Floats, first: int, out: Floats) -> None:
    """Add each of `values`, with a pseudo-random sign, to a pseudo-random entry of `out`."""
    for i in range(len(values)):
        if values[i] != 0.0:
            # A hash of the flat index: all replicates fold alike, and light from few bins is spread over all entries.
            word = mix(np.uint64(first + i), np.uint64(1))
            place = np.int64(word >> np.uint64(1)) % len(out)
            out[place] += values[i] if word & np.uint64(1) else -values[i]
