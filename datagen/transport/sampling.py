"""Quasi-random points: Sobol' sequences under independent nested uniform (Owen) scramblings.

Scrambling has three uses: each point is uniform, so every estimate is unbiased; the points stay evenly spread, so the
error for smooth integrands falls faster than 1/√N; and repetitions are independent, so their spread is a standard
error. Owen, "Randomly permuted (t,m,s)-nets and (t,s)-sequences" (1995); by hashing after Laine & Karras (2011) and
Burley, "Practical hash-based Owen scrambling", JCGT 9(4) (2020).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints

BITS = 32
"""Bits of a point's coordinates, and of the index of a point: a sequence has 2³² points."""
ROULETTE_FROM = 4
"""Bounces from which on Russian roulette may end paths of all orders, as those before bring most of the light."""
SURVIVAL = 0.05, 0.95
"""Least and greatest chance of a path to survive a bounce: the least bounds the growth of its weight (20-fold), the
greatest makes every path end."""

_JOE_KUO = (
    (1, 0, (1,)),
    (2, 1, (1, 3)),
    (3, 1, (1, 3, 1)),
    (3, 2, (1, 1, 1)),
    (4, 1, (1, 1, 3, 3)),
    (4, 4, (1, 3, 5, 13)),
    (5, 2, (1, 1, 5, 5, 17)),
    (5, 4, (1, 1, 5, 5, 5)),
    (5, 7, (1, 1, 7, 11, 19)),
    (5, 11, (1, 1, 5, 1, 1)),
    (5, 13, (1, 1, 1, 3, 11)),
    (5, 14, (1, 3, 5, 5, 31)),
    (6, 1, (1, 3, 3, 9, 7, 49)),
    (6, 13, (1, 1, 1, 15, 21, 21)),
    (6, 16, (1, 3, 1, 13, 27, 49)),
)
"""Degree and coefficients of the primitive polynomial and the initial numbers m, for dimension 2 onwards:
Joe & Kuo, "Constructing Sobol sequences with better two-dimensional projections", SIAM J. Sci. Comput. 30 (2008)."""


@lru_cache(maxsize=1)
def direction_numbers() -> NDArray[np.uint64]:
    """(16, 32) Sobol' direction numbers: row d belongs to dimension d, column j to bit j of the index."""
    numbers = np.zeros((len(_JOE_KUO) + 1, BITS), np.uint64)
    numbers[0] = [1 << (BITS - 1 - j) for j in range(BITS)]
    for d, (degree, coefficients, initial) in enumerate(_JOE_KUO, start=1):
        v = [m << (BITS - 1 - j) for j, m in enumerate(initial)]
        for j in range(degree, BITS):
            value = v[j - degree] ^ (v[j - degree] >> degree)
            for k in range(1, degree):
                if (coefficients >> (degree - 1 - k)) & 1:
                    value ^= v[j - k]
            v.append(value)
        numbers[d] = v
    return numbers


# numba widens every product of 32-bit words to 64 bits. So words are kept in 64 bits, and this mask cuts them back.
_WORD = np.uint64(0xFFFFFFFF)


@compiled()
def mix(a: np.uint64, b: np.uint64) -> np.uint64:
    """A 32-bit hash of two words: words that differ little give hashes that have nothing in common."""
    # Without the added constant two zeros would hash to 0.
    x = (a * np.uint64(0x9E3779B97F4A7C15)) ^ (b + np.uint64(0xD1B54A32D192ED03))
    for _ in range(2):
        x ^= x >> np.uint64(32)
        x *= np.uint64(0xD6E8FEB86659FD93)
    return (x ^ (x >> np.uint64(32))) & _WORD


@compiled()
def word_of(seed: int, row: int, number: int) -> np.uint64:
    """A 32-bit pseudo-random word: that of index `number` in row `row` of the stream with seed `seed`."""
    return mix(mix(np.uint64(seed), np.uint64(row)), np.uint64(number))


@compiled()
def _reverse_bits(x: np.uint64) -> np.uint64:
    """The 32-bit word with its bits in reverse order."""
    # Neighbouring bits change places, then pairs, fours, eights and halves.
    x = ((x >> np.uint64(1)) & np.uint64(0x55555555)) | ((x & np.uint64(0x55555555)) << np.uint64(1))
    x = ((x >> np.uint64(2)) & np.uint64(0x33333333)) | ((x & np.uint64(0x33333333)) << np.uint64(2))
    x = ((x >> np.uint64(4)) & np.uint64(0x0F0F0F0F)) | ((x & np.uint64(0x0F0F0F0F)) << np.uint64(4))
    x = ((x >> np.uint64(8)) & np.uint64(0x00FF00FF)) | ((x & np.uint64(0x00FF00FF)) << np.uint64(8))
    return (x >> np.uint64(16)) | ((x & np.uint64(0xFFFF)) << np.uint64(16))


@compiled()
def owen_scrambled(x: np.uint64, seed: np.uint64) -> np.uint64:
    """The word under nested uniform scrambling: each bit is flipped by a hash of `seed` and all higher bits."""
    # Products and sums carry only upwards. On the reversed word each bit therefore depends on the lower ones alone,
    # which are the higher ones of `x`.
    x = _reverse_bits(x)
    x ^= (x * np.uint64(0x3D20ADEA)) & _WORD
    x = (x + seed) & _WORD
    x = (x * ((seed >> np.uint64(16)) | np.uint64(1))) & _WORD
    x ^= (x * np.uint64(0x05526C56)) & _WORD
    x ^= (x * np.uint64(0x53A22864)) & _WORD
    return _reverse_bits(x)


@compiled()
def _fill(words: NDArray[np.uint64], seeds: NDArray[np.uint64], number: Ints, out: Floats) -> None:
    """Write the points of `sobol_points` to out (n, d)."""
    for d in range(out.shape[1]):
        x, seed, before = np.uint64(0), np.uint64(0), -2
        for i in range(len(out)):
            k = number[i]
            if i == 0 or seeds[i] != seeds[i - 1]:
                # The scrambling hash is good only for seeds whose bits are well mixed.
                seed = mix(seeds[i], np.uint64(d + 1))
            # In Gray-code order the next point differs by one direction number: that of the lowest zero bit. Only
            # the first point of a sequence, or of a part of it, needs all that its own code has.
            if k == before + 1:
                bit = 0
                while (before >> bit) & 1:
                    bit += 1
                x ^= words[d, bit]
            else:
                x, code, bit = np.uint64(0), k ^ (k >> 1), 0
                while code >> bit:
                    if (code >> bit) & 1:
                        x ^= words[d, bit]
                    bit += 1
            before = k
            out[i, d] = (np.float64(owen_scrambled(x, seed)) + 0.5) * 2.0**-BITS


def sobol_points(seeds: NDArray[np.uint64], number: Ints, dimensions: int) -> Floats:
    """(n, dimensions) points in the open interval (0, 1): point `number` (n,) of the Sobol' sequence under the
    scrambling of a seed (n,). Points that follow one another in the sequence are fastest in this order."""
    words = direction_numbers()
    if dimensions > len(words):
        raise ValueError(f"dimensions up to {len(words)} are tabulated, {dimensions} asked for")
    out = np.empty((len(number), dimensions))
    _fill(words, seeds, number, out)
    return out


def scrambled_sobol(seeds: NDArray[np.uint64], count: int, dimensions: int) -> Floats:
    """(s, count, dimensions) points in the open interval (0, 1): the first of s independent scramblings, one for each
    seed (s,), of one Sobol' sequence."""
    number = np.tile(np.arange(count), len(seeds))
    return sobol_points(np.repeat(seeds, count), number, dimensions).reshape(len(seeds), count, dimensions)


def stream_seeds(seed: int, *coordinates: NDArray[np.integer] | int) -> NDArray[np.uint64]:
    """(n,) 32-bit seeds, each a hash of (seed, coordinates …), such as purpose, replicate and laser point.

    The coordinates are broadcast against each other; the result is flat.
    """
    broadcast = np.broadcast_arrays(*[np.asarray(c, np.uint64) for c in coordinates])
    out = np.empty(broadcast[0].size, np.uint64)
    _hash_all(np.uint64(seed), np.stack([c.ravel() for c in broadcast], axis=1), out)
    return out


@compiled(allocates=False)
def _hash_all(seed: np.uint64, coordinates: NDArray[np.uint64], out: NDArray[np.uint64]) -> None:
    """Write 32-bit hashes of `seed` and each row of coordinates (n, k) to out (n,)."""
    start = (mix(seed >> np.uint64(32), np.uint64(1)) << np.uint64(32)) | mix(seed & _WORD, np.uint64(2))
    for i in range(len(coordinates)):
        h = start
        for k in range(coordinates.shape[1]):
            # Two hashes at each step keep 64 bits of state, so that few of many rows share a seed.
            h = (mix(h, coordinates[i, k]) << np.uint64(32)) | mix(h + np.uint64(k + 1), ~coordinates[i, k])
        out[i] = h >> np.uint64(32)
