"""Histograms as events, one for each filled bin, and back. Events are smaller, since most bins are empty."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.errors import InputError
from datagen.records.checks import check_integer, check_kind


def events_of(histograms: NDArray[np.generic]) -> tuple[NDArray[np.signedinteger[Any]], NDArray[np.generic]]:
    """The filled bins of histograms (n, L, P, T): (N, 4) indices of histogram, laser, pixel and bin, in this order,
    and (N,) counts; of sequences (n, F, L, P, T) (N, 5), with the frame second. Indices are int16, or int32 if an
    axis, or n · F, is too long for that."""
    if histograms.ndim == 5:
        frames = histograms.shape[1]
        found, counts = events_of(histograms.reshape(-1, *histograms.shape[2:]))
        sample, frame = np.divmod(found[:, :1], frames)
        return np.concatenate([sample, frame, found[:, 1:]], axis=1), counts
    filled = np.count_nonzero(histograms)
    short = max(histograms.shape) <= np.iinfo(np.int16).max
    kind: np.dtype[np.signedinteger[Any]] = np.dtype(np.int16 if short else np.int32)
    events, counts = np.empty((filled, 4), kind), np.empty(filled, histograms.dtype)
    _list_filled_bins(histograms, events, counts)
    return events, counts


@compiled()
def _list_filled_bins(histograms: NDArray[Any], events: NDArray[np.signedinteger[Any]], counts: NDArray[Any]) -> None:
    """Write a row of indices and the counts of every filled bin. `numpy.nonzero` takes up to four times as long,
    which is longer than decoding the histograms takes."""
    found = 0
    for histogram in range(histograms.shape[0]):
        for laser in range(histograms.shape[1]):
            for pixel in range(histograms.shape[2]):
                # With the time series in a variable, the compiler addresses a bin without three multiplications.
                series = histograms[histogram, laser, pixel]
                for bin in range(len(series)):
                    if series[bin] != 0:
                        events[found, 0] = histogram
                        events[found, 1] = laser
                        events[found, 2] = pixel
                        events[found, 3] = bin
                        counts[found] = series[bin]
                        found += 1


def dense(events: torch.Tensor, counts: torch.Tensor, shape: Sequence[int]) -> torch.Tensor:
    """float32 histograms of `shape`, filled with a batch's `events` and `counts`, on the device of the events.

    Parameters
    ----------
    events : (N, 4) index of the sample in the batch, laser, pixel, bin; for one sample (N, 3) laser, pixel, bin; of
        sequences with a column for the frame before that of the laser point.
    counts : (N,) numbers of any type.
    shape : (samples, L, P, T), as `(len(batch["scene"]), *data.shape("histogram"))`, or (L, P, T) for one sample;
        with an axis of frames before L of sequences.

    Raises
    ------
    InputError : the shapes of the arguments do not fit together.

    Examples
    --------
    >>> import datagen as dg, torch
    >>> dg.dense(torch.tensor([[0, 0, 1], [1, 0, 3]]), torch.tensor([5, 7]), (2, 1, 4)).int().tolist()
    [[[0, 5, 0, 0]], [[0, 0, 0, 7]]]
    """
    check_kind("events", events, torch.Tensor)
    check_kind("counts", counts, torch.Tensor)
    check_kind("shape", shape, Sequence, remedy="a size for each axis")
    for axis, size in enumerate(shape):
        check_integer("dense", f"shape[{axis}]", size, 0, 2**62)
    if events.ndim != 2 or events.shape[1] != len(shape) or counts.shape != events.shape[:1]:
        raise InputError(
            f"events {tuple(events.shape)}, counts {tuple(counts.shape)}, shape {tuple(shape)}: must be (N, axes), "
            "(N,) and a size for each axis"
        )
    whole = not (events.is_floating_point() or events.is_complex() or events.dtype == torch.bool)
    if not whole or counts.is_complex():
        raise InputError(
            f"events of {events.dtype}, counts of {counts.dtype}: whole numbers and real numbers are needed, as in a "
            "batch of representation='events'"
        )
    out = torch.zeros(math.prod(shape), dtype=torch.float32, device=events.device)
    # The place of each event in the flattened histograms, whose last axis runs fastest.
    flat = torch.zeros(len(events), dtype=torch.int64, device=events.device)
    outside = torch.zeros(len(events), dtype=torch.bool, device=events.device)
    for axis, size in enumerate(shape):
        place = events[:, axis].to(torch.int64)
        outside |= (place < 0) | (place >= size)
        flat = flat * size + place
    # Axes in another order would fill other bins, and nobody would notice.
    if outside.any():
        first = events[int(outside.to(torch.int8).argmax())].tolist()
        raise InputError(
            f"events: {first} lies outside of shape = {tuple(shape)}; give the shape of these histograms"
        )
    out[flat] = counts.to(torch.float32)
    return out.view(*shape)
