"""The spread of independent replicates: the standard error of their mean, and how many ways it can go wrong."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats
from datagen.transport.sampling import mix

SKETCH_SIZE = 4096


def standard_error(means: Sequence[Floats], squares: Floats, replicates: int) -> Floats:
    """Standard error of the sum of `means` from the replicates' sum of squares, which it overwrites.

    Laser point by laser point, so that no further array of a scan's full size is needed.
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
        """Effective number ν of independent ways in which a replicate deviates: for deviations of covariance Σ,
        ‖deviation‖² has mean tr Σ and variance 2 tr Σ² (if Gaussian), like χ² of ν = (tr Σ)² / tr Σ² degrees of
        freedom (Satterthwaite 1946). At least 1; tr Σ² by its unbiased estimate.
        """
        n = len(self.folded) - 1
        deviation = self.folded - self.folded.mean(axis=0)
        peak = float(np.abs(deviation).max())
        if n < 2 or peak == 0.0:
            return 1.0
        # By a power of two, which rounds nothing: of very little light the fourth power would be no number any more.
        deviation = np.ldexp(deviation, -math.frexp(peak)[1])
        products = deviation @ deviation.T / n
        trace, square = float(np.trace(products)), float((products**2).sum())
        unbiased = n * n / ((n - 1) * (n + 2)) * (square - trace * trace / n)
        return float(np.clip(trace * trace / max(unbiased, trace * trace / SKETCH_SIZE), 1.0, SKETCH_SIZE))


@compiled()
def _fold(values: Floats, first: int, out: Floats) -> None:
    for i in range(len(values)):
        if values[i] != 0.0:
            word = mix(np.uint64(first + i), np.uint64(1))
            place = np.int64(word >> np.uint64(1)) % len(out)
            out[place] += values[i] if word & np.uint64(1) else -values[i]
