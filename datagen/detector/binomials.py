"""Binomial numbers inside compiled loops: right for any p > 0, where library forms lose a p below 1e-16."""

from __future__ import annotations

import math

import numba
import numpy as np

_INVERSION_BELOW = 10.0
_REJECTION_UP_TO = 1_000_000_000

# log k! − Stirling's (k + ½) log(k + 1) − (k + 1) + ½ log 2π for k = 0 … 9 (Hörmann 1993, after Loader).
_STIRLING = np.array(
    [
        math.lgamma(k + 1.0) - ((k + 0.5) * math.log(k + 1.0) - (k + 1.0) + 0.5 * math.log(2 * math.pi))
        for k in range(10)
    ]
)


@numba.njit(cache=True)
def binomial(n: int, p: float, rng: np.random.Generator) -> int:
    """Binomial(n, p); a p that rounding put above 1 is taken as 1."""
    if n == 0 or p <= 0.0:
        return 0
    if p >= 1.0:
        return n
    if p > 0.5:
        # 1 − p is exact here, and its digits are all that matters.
        return n - _below_half(n, 1.0 - p, rng)
    return _below_half(n, p, rng)


@numba.njit(cache=True)
def _below_half(n: int, p: float, rng: np.random.Generator) -> int:
    if n * p < _INVERSION_BELOW:
        return _inversion(n, p, rng)
    if n <= _REJECTION_UP_TO:
        return _rejection(n, p, rng)
    # numpy's algorithm: its set-up is slower, its logarithms bear any n. Beyond 10⁹ a mean below 30 would make it
    # take log(1 − p) of a tiny p, so these few go by inversion too.
    return _inversion(n, p, rng) if n * p <= 30.0 else rng.binomial(n, p)


@numba.njit(cache=True)
def _inversion(n: int, p: float, rng: np.random.Generator) -> int:
    """Walk up the distribution until a uniform number is used up: P(0) = (1 − p)^n, by log1p."""
    u = rng.random()
    if u <= 1.0 - n * p:
        return 0  # for (1 − p)^n ≥ 1 − n p
    term = math.exp(n * math.log1p(-p))
    odds = p / (1.0 - p)
    k = 0
    while u > term and k < n:
        u -= term
        k += 1
        term *= (n - k + 1) * odds / k
        if term < 1e-18 and k > n * p:
            break
    return k


@numba.njit(cache=True)
def _rejection(n: int, p: float, rng: np.random.Generator) -> int:
    """Transformed rejection with squeeze, for n p ≥ 10 (W. Hörmann, J. Stat. Comput. Simul. 46, 101, 1993: BTRS)."""
    spread = math.sqrt(n * p * (1.0 - p))
    b = 1.15 + 2.53 * spread
    a = -0.0873 + 0.0248 * b + 0.01 * p
    while True:
        u = rng.random() - 0.5
        v = rng.random()
        edge = 0.5 - abs(u)
        if edge <= 0.0:
            continue
        k = math.floor((2.0 * a / edge + b) * u + n * p + 0.5)
        if edge >= 0.07 and v <= 0.92 - 4.2 / b:
            return int(k)
        if k < 0 or k > n or v <= 0.0:
            continue
        odds = p / (1.0 - p)
        mode = math.floor((n + 1) * p)
        height = (2.83 + 5.1 / b) * spread / (a / (edge * edge) + b)
        bound = (
            (mode + 0.5) * math.log((mode + 1.0) / (odds * (n - mode + 1.0)))
            + (n + 1.0) * math.log((n - mode + 1.0) / (n - k + 1.0))
            + (k + 0.5) * math.log(odds * (n - k + 1.0) / (k + 1.0))
            + _stirling(mode)
            + _stirling(n - mode)
            - _stirling(k)
            - _stirling(n - k)
        )
        if math.log(v * height) <= bound:
            return int(k)


@numba.njit(cache=True)
def _stirling(k: float) -> float:
    """What Stirling's formula lacks of log k!."""
    if k < 10:
        return _STIRLING[int(k)]
    s = (k + 1.0) * (k + 1.0)
    return (1.0 / 12 - (1.0 / 360 - 1.0 / 1260 / s) / s) / (k + 1.0)
