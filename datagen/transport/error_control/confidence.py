"""An upper confidence bound of an estimate's error, from the scatter of the estimate's replicates."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

CONFIDENCE = 0.97
"""Probability that the true squared error stays below its bound, after one round. A run computes the bound after each
of its two to four rounds and stops at the first that meets the target, which lowers the probability; 95 % are
promised."""
AGREEMENT = 0.999
"""Quantile beyond which the difference between a round and the rounds before it is taken for missed light, not for
noise: one round in a thousand is distrusted without reason."""


@dataclass(frozen=True)
class Scatter:
    """One independent contribution to an error.

    variance : estimated mean square of the L2 error that this contribution adds.
    freedom : ν, degrees of freedom of that error (`replicate_spread.Sketch.freedom`).
    replicates : number of repetitions that the variance was estimated from.
    """

    variance: float
    freedom: float
    replicates: int


def total_variance(scatters: Iterable[Scatter]) -> float:
    """Sum of the variances of independent scatters."""
    return sum(one.variance for one in scatters)


def bound_factor(scatters: Iterable[Scatter], confidence: float = CONFIDENCE) -> float:
    """Factor from the summed variance to an upper bound of the squared error.

    The squared error of a mean over R replicates is distributed like V χ²_ν / ν, and V itself is known only from
    ν (R − 1) degrees of freedom: their ratio follows Fisher's F.
    """
    kept = [one for one in scatters if one.variance > 0]
    if not kept:
        return 1.0
    ways = effective_freedom(kept)
    known = effective_freedom([replace(one, freedom=one.freedom * (one.replicates - 1)) for one in kept])
    return float(fdtri(ways, known, confidence))


def effective_freedom(scatters: Sequence[Scatter]) -> float:
    """ν = (Σ V)² / Σ (V²/ν) of a sum of scatters (Satterthwaite 1946); 1 where there is no variance."""
    total = total_variance(scatters)
    if total <= 0:
        return 1.0
    # Scaled by a power of two, which rounds nothing: the squares of very small variances would underflow to zero.
    power = -math.frexp(total)[1]
    squares = sum(math.ldexp(one.variance, power) ** 2 / one.freedom for one in scatters)
    return math.ldexp(total, power) ** 2 / squares


def disagreement(square: float, expected: Scatter, before: Iterable[Scatter]) -> float:
    """Ratio of the squared difference between a round and those before it to what their variances explain; 1 where
    the difference lies within `AGREEMENT`.

    square : squared L2 difference. expected, before : scatter of the round, and of the rounds before it.
    """
    parts = [expected, *before]
    variance = total_variance(parts)
    if square <= variance * bound_factor(parts, AGREEMENT):
        return 1.0
    return square / variance if variance > 0 else np.inf
