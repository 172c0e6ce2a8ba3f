"""Histograms as what is in them: most bins of a histogram are empty."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.records.checks import check_kind

_AT_ONCE = 2**20
"""Bins that are looked through at once, which bounds the memory for them: 10 MiB. Half as many change no time."""


def events_of(histograms: NDArray[np.generic]) -> tuple[NDArray[np.signedinteger[Any]], NDArray[np.generic]]:
    """(N, 4) histogram, laser, pixel and bin of every bin of histograms (n, L, P, T) that is not empty, in this
    order, and (N,) its counts. Indices are int16, or int32 where an axis is too long for that.
    """
    short = max(histograms.shape) <= np.iinfo(np.int16).max
    in_words = (
        histograms.dtype.kind == "u"
        and histograms.shape[-1] * histograms.itemsize % 8 == 0
        and histograms.flags.c_contiguous
        and sys.byteorder == "little"
    )
    if in_words and histograms.size:
        return _by_words(histograms, np.dtype(np.int16 if short else np.int32))
    filled = np.nonzero(histograms)
    return np.stack(filled, axis=1).astype(np.int16 if short else np.int32), histograms[filled]


def _by_words(
    histograms: NDArray[np.generic], kind: np.dtype[np.signedinteger[Any]]
) -> tuple[NDArray[np.signedinteger[Any]], NDArray[np.generic]]:
    """The same for histograms of whole 64-bit words, in a quarter of the time: a word of empty bins is one test."""
    from datagen.loader.filled_bins import take_filled

    _, lasers, pixels, bins = histograms.shape
    rows: NDArray[Any] = histograms.reshape(-1, bins)
    words, at_once = rows.view(np.uint64), max(1, _AT_ONCE // bins)
    # A bin more than there are: what follows the last filled one is written, too.
    room = np.empty((at_once * bins + 1, 4), kind), np.empty(at_once * bins + 1, histograms.dtype)
    pieces = []
    for first in range(0, len(rows), at_once):
        some = slice(first, first + at_once)
        found = take_filled(rows[some], words[some], first, lasers, pixels, *room)
        pieces.append([values[:found].copy() for values in room])
    events, counts = zip(*pieces, strict=True)
    return np.concatenate(events), np.concatenate(counts)


def dense(events: torch.Tensor, counts: torch.Tensor, shape: Sequence[int]) -> torch.Tensor:
    """Histograms of float32, of a batch's `events` and `counts`, on their device.

    Parameters
    ----------
    events : (N, 4) sample of the batch, laser, pixel, bin; of one sample (N, 3) laser, pixel, bin.
    counts : (N,) any type.
    shape : (samples, L, P, T), or (L, P, T): `(len(batch["scene"]), *data.shape("histogram"))`.

    Raises
    ------
    InputError : shape and events do not fit together.

    Examples
    --------
    >>> import datagen as dg, torch
    >>> dg.dense(torch.tensor([[0, 0, 1], [1, 0, 3]]), torch.tensor([5, 7]), (2, 1, 4)).int().tolist()
    [[[0, 5, 0, 0]], [[0, 0, 0, 7]]]
    """
    check_kind("events", events, torch.Tensor)
    check_kind("counts", counts, torch.Tensor)
    check_kind("shape", shape, Sequence, remedy="a size for each axis")
    if events.ndim != 2 or events.shape[1] != len(shape) or counts.shape != events.shape[:1]:
        raise InputError(
            f"events {tuple(events.shape)}, counts {tuple(counts.shape)}, shape {tuple(shape)}: must be (N, axes), "
            "(N,) and a size for each axis"
        )
    out = torch.zeros(math.prod(shape), dtype=torch.float32, device=events.device)
    # Columns are the axes, the last of them the fastest.
    flat = torch.zeros(len(events), dtype=torch.int64, device=events.device)
    for axis, size in enumerate(shape):
        flat = flat * size + events[:, axis]
    out[flat] = counts.to(torch.float32)
    return out.view(*shape)
