"""Binomial numbers inside compiled loops: right for any p > 0, where library forms lose a p below 1e-16."""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.detector.streams import Stream, uniform

REJECTION_FROM = 10.0
"""Mean from which on the transformed rejections of W. Hörmann hold, here and in `poisson`."""

# log k! − Stirling's (k + ½) log(k + 1) − (k + 1) + ½ log 2π for k = 0 … 9 (Hörmann 1993, after Loader).
_STIRLING = np.array(
    [
        math.lgamma(k + 1.0) - ((k + 0.5) * math.log(k + 1.0) - (k + 1.0) + 0.5 * math.log(2 * math.pi))
        for k in range(10)
    ]
)


@compiled()
def binomial(n: int, p: float, stream: Stream) -> int:
    """Binomial(n, p) for n up to 2⁵³; a p that rounding put above 1 is taken as 1."""
    if n == 0 or p <= 0.0:
        return 0
    if p >= 1.0:
        return n
    # 1 − p is exact where it is the smaller one, and its digits are all that matters.
    rare = p if p <= 0.5 else 1.0 - p
    mean = n * rare
    if mean < REJECTION_FROM:
        u = uniform(stream)
        # For (1 − p)^n ≥ 1 − n p.
        drawn = 0 if u <= 1.0 - mean else _inverse(n, rare, u)
    else:
        drawn = _rejection(n, rare, stream)
    return n - drawn if p > 0.5 else drawn


@compiled()
def _inverse(n: int, p: float, u: float) -> int:
    """Walk up the distribution until a uniform number is used up: P(0) = (1 − p)^n, by log1p."""
    term = math.exp(n * math.log1p(-p))
    odds = p / (1.0 - p)
    left = (n + 1.0) * odds
    k = 0
    while u > term and k < n:
        u -= term
        k += 1
        left -= odds
        term *= left / k
        if term < 1e-18 and k > n * p:
            break
    return k


@compiled()
def _rejection(n: int, p: float, stream: Stream) -> int:
    """Transformed rejection with squeeze, for n p ≥ 10 (W. Hörmann, J. Stat. Comput. Simul. 46, 101, 1993: BTRS).

    Its test against the density is rearranged: differences to the mode go through log1p, so that no number of trials
    cancels their digits.
    """
    odds = p / (1.0 - p)
    spread = math.sqrt(n * p * (1.0 - p))
    b = 1.15 + 2.53 * spread
    a = -0.0873 + 0.0248 * b + 0.01 * p
    mode = math.floor((n + 1) * p)
    while True:
        u, v = uniform(stream) - 0.5, uniform(stream)
        edge = 0.5 - abs(u)
        if edge <= 0.0:
            continue
        k = math.floor((2.0 * a / edge + b) * u + n * p + 0.5)
        if edge >= 0.07 and v <= 0.92 - 4.2 / b:
            return int(k)
        if k < 0 or k > n or v <= 0.0:
            continue
        height = (2.83 + 5.1 / b) * spread / (a / (edge * edge) + b)
        d = k - mode
        bound = (
            d * math.log(odds * (n - mode + 1.0) / (mode + 1.0))
            - (k + 0.5) * math.log1p(d / (mode + 1.0))
            - (n - k + 0.5) * math.log1p(-d / (n - mode + 1.0))
            + stirling(mode)
            + stirling(n - mode)
            - stirling(k)
            - stirling(n - k)
        )
        if math.log(v * height) <= bound:
            return int(k)


@compiled()
def stirling(k: float) -> float:
    """What Stirling's formula, (k + ½) log(k + 1) − (k + 1) + ½ log 2π, lacks of log k!."""
    if k < 10:
        return float(_STIRLING[int(k)])
    s = (k + 1.0) * (k + 1.0)
    return (1.0 / 12 - (1.0 / 360 - 1.0 / 1260 / s) / s) / (k + 1.0)
