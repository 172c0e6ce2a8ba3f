"""Random numbers in compiled loops, from one stream for each (seed, laser point, pixel), whatever the batching.

The numbers are uniform, exponential, binomial or Poisson. Binomial ones are right for any p > 0, whereas library
functions lose a p below 1e-16 or have an overhead for each call. Poisson ones are right for any mean that 64 bits can
count.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.errors import InputError
from datagen.records.arrays import Floats, Ints
from datagen.seeding import Purpose

Stream = NDArray[np.uint64]
"""(4,) the state of xoshiro256++ (Blackman & Vigna, ACM Trans. Math. Softw. 47, 36, 2021)."""

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


def streams_of(seed: int, lasers: Ints, pixels: Ints) -> Stream:
    """(…, 4) a stream for each of the laser points and pixels, whose numbers ≥ 0 are broadcast.

    Under one seed no two streams start alike, because the first two words are a bijection of (laser, pixel). Raises
    `InputError` for a negative seed.
    """
    if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool) or seed < 0:
        raise InputError(f"seed = {seed!r}: must be an integer ≥ 0")
    key = np.random.SeedSequence(int(seed), spawn_key=(int(Purpose.DETECTOR),)).generate_state(2, np.uint64)
    numbers = np.broadcast_arrays(np.atleast_1d(lasers), np.atleast_1d(pixels))
    laser, pixel = (number.astype(np.uint64) for number in numbers)
    first = _mixed(laser + key[:1])
    second = _mixed(first ^ _mixed(pixel + key[1:]))
    return np.stack([first, second, _mixed(first + second), _mixed(first - second)], axis=-1)


def _mixed(words: Stream) -> Stream:
    """Words mixed by the finaliser of SplitMix64, a bijection (Steele, Lea & Flood, OOPSLA 2014)."""
    words = words + _GOLDEN
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))


@compiled()
def uniform(stream: Stream) -> float:
    """The stream's next number, uniform in [0, 1), a multiple of 2⁻⁵³."""
    a, b, c, d = stream[0], stream[1], stream[2], stream[3]
    # The output is taken before the state moves on (the order of the published generator).
    total = a + d
    word = ((total << np.uint64(23)) | (total >> np.uint64(41))) + a
    c ^= a
    d ^= b
    stream[1], stream[0] = b ^ c, a ^ d
    stream[2] = c ^ (b << np.uint64(17))
    stream[3] = (d << np.uint64(45)) | (d >> np.uint64(19))
    return np.int64(word >> np.uint64(11)) * 2.0**-53


@compiled()
def exponential(stream: Stream) -> float:
    """An exponential number of mean 1."""
    return -math.log(1.0 - uniform(stream))


REJECTION_FROM = 10.0
"""Mean from which on numbers are drawn by W. Hörmann's transformed rejection, which is wrong for half of it."""

# The remainder of Stirling's formula, see `_stirling_rest`, for k = 0 … 9 (Hörmann 1993, after Loader).
_STIRLING = np.array(
    [
        math.lgamma(k + 1.0) - ((k + 0.5) * math.log(k + 1.0) - (k + 1.0) + 0.5 * math.log(2 * math.pi))
        for k in range(10)
    ]
)


@compiled()
def binomial(n: int, p: float, stream: Stream) -> int:
    """A Binomial(n, p) number for n up to 2⁵³; a p that rounding put above 1 is taken as 1."""
    if n == 0 or p <= 0.0:
        return 0
    if p >= 1.0:
        return n
    # The smaller of p and 1 − p has the digits that matter; 1 − p is exact where it is the smaller one.
    rare = p if p <= 0.5 else 1.0 - p
    mean = n * rare
    if mean < REJECTION_FROM:
        u = uniform(stream)
        # Most numbers are 0: the bound (1 − p)^n ≥ 1 − n p saves their logarithm and exponential.
        drawn = 0 if u <= 1.0 - mean else _by_inversion(n, rare, u)
    else:
        drawn = _binomial_rejection(n, rare, stream)
    return n - drawn if p > 0.5 else drawn


@compiled()
def _by_inversion(n: int, p: float, u: float) -> int:
    """The quantile of a uniform number u: P(0), P(1), … are subtracted from u until it is used up."""
    # P(0) = (1 − p)^n goes through log1p, which keeps a p below 1e-16.
    term = math.exp(n * math.log1p(-p))
    odds = p / (1.0 - p)
    left = (n + 1.0) * odds
    k = 0
    while u > term and k < n:
        u -= term
        k += 1
        left -= odds
        term *= left / k
        # Beyond the mode the terms fall, and the rest of u is rounding.
        if term < 1e-18 and k > n * p:
            break
    return k


@compiled()
def _binomial_rejection(n: int, p: float, stream: Stream) -> int:
    """A binomial number by transformed rejection with squeeze, for n p ≥ 10 (BTRS of W. Hörmann, J. Stat. Comput.
    Simul. 46, 101, 1993).

    The comparison with the density is rearranged: differences to the mode go through log1p, so that their digits do
    not cancel for any number of trials.
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
        # The squeeze accepts most numbers without a logarithm.
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
            + _stirling_rest(mode)
            + _stirling_rest(n - mode)
            - _stirling_rest(k)
            - _stirling_rest(n - k)
        )
        if math.log(v * height) <= bound:
            return int(k)


@compiled()
def _stirling_rest(k: float) -> float:
    """log k! − [(k + ½) log(k + 1) − (k + 1) + ½ log 2π], the remainder of Stirling's formula."""
    # Stirling's series is too coarse for small k.
    if k < 10:
        return float(_STIRLING[int(k)])
    s = (k + 1.0) * (k + 1.0)
    return (1.0 / 12 - (1.0 / 360 - 1.0 / 1260 / s) / s) / (k + 1.0)


LARGEST_MEAN = 9.2e18
"""Largest mean of a Poisson number: counts of larger ones do not fit 64 bits. Halved, some that fit are refused."""


def draw_poisson(mean: Floats, streams: Stream, where: Callable[[int], str]) -> Ints:
    """(h, bin) Poisson counts of means (h, bin), from streams (h, 4), one for each row.

    Raises `InputError`, naming the row by `where`, for counts beyond 64 bits.
    """
    check_countable(mean, where)
    return _poisson_counts(np.ascontiguousarray(mean), streams)


def check_countable(mean: Floats, where: Callable[[int], str]) -> None:
    """Raise `InputError`, naming the row by `where` and the bin, if one of the means (h, bin) cannot be counted."""
    if not mean.max(initial=0.0) < LARGEST_MEAN:
        row, bin_ = (int(i) for i in np.argwhere(~(mean < LARGEST_MEAN))[0])
        raise InputError(
            f"{where(row)}, bin {bin_}: {mean[row, bin_]:g} expected counts, at most {LARGEST_MEAN:g} can be counted"
            "; lower cycles or photons_per_pulse"
        )


@compiled()
def _poisson_counts(mean: Floats, streams: Stream) -> Ints:
    """(h, bin) counts of means (h, bin): the events of a Poisson process of rate 1 along the running sum of the
    means.

    It takes an exponential number for each event and none for an empty bin. Bins of large means are drawn at once.
    """
    rows, bins = mean.shape
    counts = np.zeros((rows, bins), np.int64)
    for r in range(rows):
        stream = streams[r]
        # The mean that is left until the next event. Bins drawn at once are left out of the sum: an exponential
        # number has no memory.
        ahead = exponential(stream)
        for i in range(bins):
            # One rejection costs less than an exponential number for each of ten events and more.
            if mean[r, i] >= REJECTION_FROM:
                counts[r, i] = _poisson_rejection(mean[r, i], stream)
                continue
            ahead -= mean[r, i]
            while ahead < 0.0:
                counts[r, i] += 1
                ahead += exponential(stream)
    return counts


@compiled()
def _poisson_rejection(mean: float, stream: Stream) -> int:
    """A Poisson number by transformed rejection with squeeze, for means ≥ 10 (PTRS of W. Hörmann, Insur. Math. Econ.
    12, 39, 1993).

    As in `_binomial_rejection` the density goes through log1p, which keeps its digits for any mean.
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
        bound = d - (k + 0.5) * math.log1p(d / mean) - 0.5 * math.log(2 * math.pi * mean) - _stirling_rest(k)
        if math.log(v * (1.1239 + 1.1328 / (b - 3.4)) / (a / (edge * edge) + b)) <= bound:
            return int(k)
