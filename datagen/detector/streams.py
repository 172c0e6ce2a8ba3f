"""One random stream for each (seed, laser point, pixel), whatever the batching, and its numbers in compiled loops."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.errors import InputError
from datagen.seeding import Purpose

Stream = NDArray[np.uint64]
"""(4,) the state of xoshiro256++ (Blackman & Vigna, ACM Trans. Math. Softw. 47, 36, 2021)."""

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


def streams_of(seed: int, lasers: NDArray[np.int64], pixels: NDArray[np.int64]) -> Stream:
    """(…, 4) a stream for each of the laser points and pixels, numbers ≥ 0 that broadcast.

    Under one seed no two of them start alike: the first two words are a bijection of (laser, pixel). Raises
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


def stream_of(seed: int) -> Stream:
    """(4,) one stream for draws that belong to no histogram."""
    return np.asarray(streams_of(seed, np.zeros(1, np.int64), np.zeros(1, np.int64))[0])


def _mixed(words: Stream) -> Stream:
    """The finaliser of SplitMix64, a bijection (Steele, Lea & Flood, OOPSLA 2014)."""
    words = words + _GOLDEN
    words = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    words = (words ^ (words >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return words ^ (words >> np.uint64(31))


@compiled()
def uniform(stream: Stream) -> float:
    """The stream's next number, uniform in [0, 1), a multiple of 2⁻⁵³."""
    a, b, c, d = stream[0], stream[1], stream[2], stream[3]
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
    """Exponential of mean 1."""
    return -math.log(1.0 - uniform(stream))
