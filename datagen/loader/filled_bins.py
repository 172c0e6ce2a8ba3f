"""Which bins are filled, by a look at eight bytes at a time: most of them are empty."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled


@compiled()
def take_filled(
    rows: NDArray[np.unsignedinteger[Any]],
    words: NDArray[np.uint64],
    first: int,
    lasers: int,
    pixels: int,
    events: NDArray[np.signedinteger[Any]],
    counts: NDArray[np.unsignedinteger[Any]],
) -> int:
    """Write histogram, laser, pixel and bin of every filled bin, and its counts, from the front; returns how many.

    rows : time series (n, T), of which the first is number `first` of all. words : the same seen as words of 64 bits.
    events, counts : (n T, 4) and (n T,), room for what may come.
    """
    found, per_word = 0, 8 // rows.itemsize
    filled = np.empty(words.shape[1] + 1, np.int32)
    for row in range(len(rows)):
        # Written always, kept where it is wanted: a processor guesses wrong at every third filled word.
        some = 0
        for at in range(words.shape[1]):
            filled[some] = at
            some += words[row, at] != 0
        pair, pixel = divmod(first + row, pixels)
        histogram, laser = divmod(pair, lasers)
        for k in range(some):
            for bin in range(filled[k] * per_word, (filled[k] + 1) * per_word):
                count = rows[row, bin]
                events[found, 0] = histogram
                events[found, 1] = laser
                events[found, 2] = pixel
                events[found, 3] = bin
                counts[found] = count
                found += count != 0
    return found
