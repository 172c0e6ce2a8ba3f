"""How large the error of an estimate may be: an upper confidence bound from the scatter of its replicates."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

CONFIDENCE = 0.97
"""Probability that the true squared error stays below its bound, at one look. A run looks after each of its two to
four rounds and stops at the first that satisfies it, which costs some of that; 95 % are promised."""
AGREEMENT = 0.999
"""Quantile beyond which a round's difference from the rounds before it is taken for missed light, not for noise."""


@dataclass(frozen=True)
class Scatter:
    """One independent contribution to an error.

    variance : expected square of the L2 error that it adds, as estimated.
    freedom : ν, in how many independent ways that error can fall out (`spread.Sketch.freedom`).
    replicates : from how many repetitions the variance was estimated.
    """

    variance: float
    freedom: float
    replicates: int


def total_variance(scatters: Iterable[Scatter]) -> float:
    """Sum of the variances of independent scatters."""
    return sum(one.variance for one in scatters)


def bound_factor(scatters: Iterable[Scatter], confidence: float = CONFIDENCE) -> float:
    """What the summed variance is to be multiplied by, to give an upper bound of the squared error.

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
    # By a power of two, which rounds nothing: the squares of very small variances would be no numbers any more.
    power = -math.frexp(total)[1]
    squares = sum(math.ldexp(one.variance, power) ** 2 / one.freedom for one in scatters)
    return math.ldexp(total, power) ** 2 / squares


def disagreement(square: float, expected: Scatter, before: Iterable[Scatter]) -> float:
    """How many times larger the squared difference between a round and those before it is than their errors make it;
    1 where it lies within `AGREEMENT`."""
    parts = [expected, *before]
    variance = total_variance(parts)
    if square <= variance * bound_factor(parts, AGREEMENT):
        return 1.0
    return square / variance if variance > 0 else np.inf
