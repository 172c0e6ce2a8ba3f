"""Binomial numbers inside compiled loops: right for any p > 0, where library forms lose a p below 1e-16.

`binomial` is inlined into the loop that calls it and asks the generator there: handing a numpy Generator on to
another compiled function costs more than a draw.
"""

from __future__ import annotations

import math

import numba
import numpy as np

_INVERSION_BELOW = 10.0
_REJECTION_UP_TO = 1_000_000_000

_RECIPROCALS = np.array([0.0] + [1.0 / k for k in range(1, 64)])

# log k! − Stirling's (k + ½) log(k + 1) − (k + 1) + ½ log 2π for k = 0 … 9 (Hörmann 1993, after Loader).
_STIRLING = np.array(
    [
        math.lgamma(k + 1.0) - ((k + 0.5) * math.log(k + 1.0) - (k + 1.0) + 0.5 * math.log(2 * math.pi))
        for k in range(10)
    ]
)


@numba.njit(inline="always")
def binomial(n: int, p: float, rng: np.random.Generator) -> int:
    """Binomial(n, p); a p that rounding put above 1 is taken as 1."""
    if n == 0 or p <= 0.0:
        drawn = 0
    elif p >= 1.0:
        drawn = n
    else:
        # 1 − p is exact where it is the smaller one, and its digits are all that matters.
        rare = p if p <= 0.5 else 1.0 - p
        mean = n * rare
        # Beyond 10⁹ numpy's algorithm, whose logarithms bear any n; with a mean below 30 that would take log(1 − p)
        # of a tiny p, so these few go by inversion too.
        if mean < _INVERSION_BELOW or (n > _REJECTION_UP_TO and mean <= 30.0):
            u = rng.random()
            # For (1 − p)^n ≥ 1 − n p.
            drawn = 0 if u <= 1.0 - mean else _inverse(n, rare, u)
        elif n > _REJECTION_UP_TO:
            drawn = _of_many(n, rare, rng)
        else:
            drawn = -1
            while drawn < 0:
                drawn = _accepted(n, rare, rng.random() - 0.5, rng.random())
        if p > 0.5:
            drawn = n - drawn
    return drawn


@numba.njit(cache=True)
def _of_many(n: int, p: float, rng: np.random.Generator) -> int:
    return int(rng.binomial(n, p))


@numba.njit(cache=True, error_model="numpy")
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
        term *= left * (_RECIPROCALS[k] if k < len(_RECIPROCALS) else 1.0 / k)
        if term < 1e-18 and k > n * p:
            break
    return k


@numba.njit(cache=True, error_model="numpy")
def _accepted(n: int, p: float, u: float, v: float) -> int:
    """A number made from two uniform ones, or −1: transformed rejection with squeeze, for n p ≥ 10.

    W. Hörmann, J. Stat. Comput. Simul. 46, 101, 1993: BTRS.
    """
    spread = math.sqrt(n * p * (1.0 - p))
    b = 1.15 + 2.53 * spread
    a = -0.0873 + 0.0248 * b + 0.01 * p
    edge = 0.5 - abs(u)
    if edge <= 0.0:
        return -1
    k = math.floor((2.0 * a / edge + b) * u + n * p + 0.5)
    if edge >= 0.07 and v <= 0.92 - 4.2 / b:
        return int(k)
    return int(k) if 0 <= k <= n and v > 0.0 and _below_density(n, p, spread, a, b, edge, v, k) else -1


@numba.njit(cache=True, error_model="numpy")
def _below_density(n: int, p: float, spread: float, a: float, b: float, edge: float, v: float, k: float) -> bool:
    """The exact test, where the squeeze does not decide."""
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
    return math.log(v * height) <= bound


@numba.njit(cache=True)
def _stirling(k: float) -> float:
    """What Stirling's formula lacks of log k!."""
    if k < 10:
        return float(_STIRLING[int(k)])
    s = (k + 1.0) * (k + 1.0)
    return (1.0 / 12 - (1.0 / 360 - 1.0 / 1260 / s) / s) / (k + 1.0)
