"""The time-to-digital converter: jitter of recorded events, the recorded window, counters that saturate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.detector.flux import Cycle, Fold, N, fold_of, on_lattice
from datagen.detector.irf import spread
from datagen.detector.random_numbers import Stream, binomial, uniform

Array = NDArray[np.float64]
Counts = NDArray[np.int64]


class Tdc:
    """Moves detections from the bins of the laser period to those of the recorded histogram.

    A detection in bin i is written down in bin i + k with the probability that the bin-integrated jitter gives to k.
    Displacements across the ends of the period come out at its other end; records outside the window are lost.
    """

    def __init__(self, cycle: Cycle) -> None:
        self._cycle = cycle
        jitter = cycle.after_avalanche
        self._merged = cycle.front < len(cycle.gate)
        lattice = cycle.back + cycle.front
        # A period that is no whole number of bins ends in a shorter one. Of its own records a displacement makes what
        # it makes of a moment in its middle; a full bin of the lattice displaced there is shared out by the fold.
        short = not self._merged and float(cycle.widths_s[-1]) < cycle.width_s * (1 - 1e-6)
        self._from_short: Counts | None = None
        if short and not jitter.is_identity:
            steps = np.arange(-jitter.before, jitter.after + 1) * cycle.width_s
            moments = (cycle.edges_s[-2:].mean() + steps) % cycle.period_s
            last = np.searchsorted(cycle.edges_s, moments, side="right") - 1
            self._from_short = np.minimum(last, len(cycle.gate) - 1).astype(np.int64)
        self._first = -cycle.back - jitter.before
        self._length = lattice + len(jitter.weights) - 1
        if jitter.is_identity:
            return
        # Displacements are handed out from the likeliest on, so that few are left to draw for the long wings.
        self._offsets = np.argsort(-jitter.weights, kind="stable")
        self._likeliest = jitter.weights[self._offsets]
        if self._merged:
            nothing = np.empty(0, np.int64)
            self._fold = Fold(self._first, cycle.bins, range(cycle.bins), nothing, nothing, np.empty(0))
            return
        self._fold = fold_of(self._first, self._length, cycle.width_s, cycle.edges_s)
        self._fold_rows, starts = np.unique(self._fold.rows, return_index=True)
        self._fold_starts = np.append(starts, len(self._fold.rows)).astype(np.int64)

    def mean(self, detections: Array) -> Array:
        """(…, n) expected detections per bin of the period → (…, bins) expected records."""
        cycle, jitter = self._cycle, self._cycle.after_avalanche
        if jitter.is_identity:
            folded = detections
        else:
            displaced = self._without_short(detections)
            folded = self._fold(spread(on_lattice(displaced, cycle.back, cycle.front), jitter))
            if self._from_short is not None:
                for column, weight in zip(self._from_short, jitter.weights, strict=True):
                    folded[..., column] += weight * detections[..., -1]
            if folded.shape[-1] == cycle.bins == cycle.window:
                return folded
        out = np.zeros((*detections.shape[:-1], cycle.bins))
        out[..., : cycle.window] = folded[..., : cycle.window]
        return out

    def draw(self, detections: Counts, streams: Stream) -> Counts:
        """(…, n) detections → (…, bins) records: a multinomial for each bin, from streams (…, 4)."""
        cycle, jitter = self._cycle, self._cycle.after_avalanche
        out = np.zeros((*detections.shape[:-1], cycle.bins), np.int64)
        if jitter.is_identity:
            out[..., : cycle.window] = detections[..., : cycle.window]
            return out
        ordered = on_lattice(self._without_short(detections), cycle.back, cycle.front)
        rows = np.ascontiguousarray(ordered.reshape(-1, cycle.back + cycle.front))
        row_streams = streams.reshape(-1, 4)
        scattered = _scatter(rows, self._likeliest, self._offsets, row_streams)
        if self._merged:
            out[...] = scattered[:, -self._first : -self._first + cycle.bins].reshape(out.shape)
            return out
        fold = self._fold
        folded = np.zeros((len(rows), fold.bins), np.int64)
        low, high = fold.aligned.start, fold.aligned.stop
        folded[:, low:high] = scattered[:, low - fold.first : high - fold.first]
        _share_out(scattered, self._fold_rows, self._fold_starts, fold.columns, fold.shares, folded, row_streams)
        if self._from_short is not None:
            alone = np.ascontiguousarray(detections[..., -1:].reshape(-1, 1))
            moved = _scatter(alone, self._likeliest, self._offsets, row_streams)
            for column, records in zip(self._from_short, moved.T, strict=True):
                folded[:, column] += records
        out[..., : cycle.window] = folded[:, : cycle.window].reshape(*out.shape[:-1], cycle.window)
        return out

    def _without_short(self, detections: NDArray[N]) -> NDArray[N]:
        """The detections less those in the short bin at the end of the period, if there is one."""
        if self._from_short is None:
            return detections
        full = detections.copy()
        full[..., -1] = 0
        return full


@compiled()
def _scatter(counts: Counts, weights: Array, offsets: Counts, streams: Stream) -> Counts:
    """(h, n) counts, each of which goes `offsets[k]` bins on with probability `weights[k]`, → (h, n + k − 1).

    Weights descend and sum to 1.
    """
    rows, n = counts.shape
    taps = len(weights)
    out = np.zeros((rows, n + taps - 1), np.int64)
    cumulative = np.cumsum(weights)
    for r in range(rows):
        stream = streams[r]
        for i in range(n):
            left = counts[r, i]
            if left == 0:
                continue
            # Few counts are moved one by one, by a search from the likeliest displacement on.
            if left <= 2 * taps:
                for _ in range(left):
                    u, k = uniform(stream) * cumulative[-1], 0
                    while k < taps - 1 and u >= cumulative[k]:
                        k += 1
                    out[r, i + offsets[k]] += 1
                continue
            # Many are dealt out as a multinomial: a binomial for each displacement, of what the ones before left.
            rest = 1.0
            for k in range(taps):
                if left == 0:
                    break
                share = weights[k] / rest
                moved = left if k == taps - 1 or share >= 1.0 else binomial(left, share, stream)
                out[r, i + offsets[k]] += moved
                left -= moved
                rest -= weights[k]
    return out


@compiled()
def _share_out(
    counts: Counts, places: Counts, starts: Counts, columns: Counts, shares: Array, out: Counts, streams: Stream
) -> None:
    """Add `counts[:, places[r]]` to `out`, split at random over columns `columns[starts[r]:starts[r + 1]]`."""
    for h in range(len(counts)):
        stream = streams[h]
        for r in range(len(places)):
            # The same multinomial: a bin of the lattice that straddles bins of the period is split at random.
            left, rest = counts[h, places[r]], 1.0
            for e in range(starts[r], starts[r + 1]):
                if left == 0:
                    break
                share = shares[e] / rest
                moved = left if share >= 1.0 - 1e-9 else binomial(left, share, stream)
                out[h, columns[e]] += moved
                left -= moved
                rest -= shares[e]
