"""The time-to-digital converter (TDC): the jitter of recorded events, and the window in which they are recorded."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.detector.flux import Cycle, Fold, N, fold_of, on_lattice
from datagen.detector.irf import spread
from datagen.detector.random_numbers import binomial
from datagen.detector.tdc_bins import TdcBins
from datagen.records.arrays import Floats, Ints


class Tdc:
    """The converter from detections in the bins of the laser period to records in the bins of the histogram.

    A detection in bin i is recorded in bin i + k with the probability that the bin-integrated jitter gives to k. A
    record that is displaced beyond an end of the period appears at its other end; records outside the window are
    lost. Where the bins of the TDC are not equal (`unequal`), records are sorted into these in the end.
    """

    def __init__(self, cycle: Cycle, unequal: TdcBins | None = None) -> None:
        self._cycle, self._unequal = cycle, unequal
        self._pieces = 1 if unequal is None else unequal.pieces
        jitter = cycle.after_avalanche
        lattice = cycle.back + cycle.front
        # A period that is no whole number of bins ends in a shorter one. Its own records are displaced like a moment
        # in its middle. Records of full bins that are displaced into it are split by the fold.
        self._from_short: Ints | None = None
        if cycle.has_short_bin and not jitter.is_identity:
            steps = np.arange(-jitter.before, jitter.after + 1) * cycle.width_s
            moments = (cycle.edges_s[-2:].mean() + steps) % cycle.period_s
            last = np.searchsorted(cycle.edges_s, moments, side="right") - 1
            self._from_short = np.minimum(last, len(cycle.gate) - 1).astype(np.int64)
        first = -cycle.back - jitter.before
        if jitter.is_identity:
            return
        # Displacements are drawn from the likeliest on, so that few records are left for the long wings.
        self._offsets = np.argsort(-jitter.weights, kind="stable")
        self._likeliest = jitter.weights[self._offsets]
        if cycle.front < len(cycle.gate):
            # The background between the ends of the lattice is so long that records never wrap around the period.
            nothing = np.empty(0, np.int64)
            self._fold = Fold(first, cycle.bins, range(cycle.bins), nothing, nothing, np.empty(0))
        else:
            self._fold = fold_of(first, lattice + len(jitter.weights) - 1, cycle.width_s, cycle.edges_s)
        self._fold_rows, starts = np.unique(self._fold.rows, return_index=True)
        self._fold_starts = np.append(starts, len(self._fold.rows)).astype(np.int64)

    def mean(self, detections: Floats, pixels: Ints | None = None) -> Floats:
        """(…, bins) expected records of expected detections (…, n) in the bins of the period, or in their pieces if
        the unequal bins ask for these.

        pixels : (…,) number of each row's pixel in the measurement, on which unequal bins depend; left out, the
            second last axis is that of all pixels.
        """
        if self._unequal is None:
            return self._mean_in_equal_bins(detections)
        records = [self._mean_in_equal_bins(part) for part in self._by_piece(detections)]
        return self._unequal.mean(self._joined(records), pixels)

    def draw(self, detections: Ints, rng: Generator, pixels: Ints | None = None) -> Ints:
        """(…, bins) records of detections (…, n), multinomial; `pixels` as of `mean`."""
        if self._unequal is None:
            return self._draw_in_equal_bins(detections, rng)
        records = [self._draw_in_equal_bins(part, rng) for part in self._by_piece(detections)]
        return self._unequal.draw(self._joined(records), rng, pixels)

    def _by_piece(self, detections: NDArray[N]) -> list[NDArray[N]]:
        """For each piece of a bin its (…, n) detections in all bins; whole bins count as the middle one."""
        if self._pieces == 1:
            return [detections]
        parts = self._cycle.parts(self._pieces)
        starts, whole = np.cumsum(parts) - parts, parts == 1
        out = []
        for piece in range(self._pieces):
            chosen = detections[..., starts + np.where(whole, 0, piece)]
            if piece != self._pieces // 2:
                chosen[..., whole] = 0
            out.append(chosen)
        return out

    def _joined(self, records: list[NDArray[N]]) -> NDArray[N]:
        """(…, m) records in the pieces of all bins, in order of time, from those of each piece (…, bins).

        A record is displaced by whole bins and stays in its piece.
        """
        if self._pieces == 1:
            return records[0]
        return np.stack(records, axis=-1).reshape(*records[0].shape[:-1], -1)

    def _mean_in_equal_bins(self, detections: Floats) -> Floats:
        """(…, bins) expected records in bins of the cycle's width."""
        cycle, jitter = self._cycle, self._cycle.after_avalanche
        if jitter.is_identity:
            folded = detections
        else:
            displaced = self._without_short(detections)
            folded = self._fold(spread(on_lattice(displaced, cycle.back, cycle.front), jitter))
            if self._from_short is not None:
                for column, weight in zip(self._from_short, jitter.weights, strict=True):
                    folded[..., column] += weight * detections[..., -1]
        return folded[..., : cycle.bins]

    def _draw_in_equal_bins(self, detections: Ints, rng: Generator) -> Ints:
        """(…, bins) records in bins of the cycle's width."""
        cycle, jitter = self._cycle, self._cycle.after_avalanche
        if jitter.is_identity:
            return detections[..., : cycle.bins]
        ordered = on_lattice(self._without_short(detections), cycle.back, cycle.front)
        rows = np.ascontiguousarray(ordered.reshape(-1, cycle.back + cycle.front))
        scattered = _scatter(rows, self._likeliest, self._offsets, rng)
        fold = self._fold
        folded = np.zeros((len(rows), fold.bins), np.int64)
        low, high = fold.aligned.start, fold.aligned.stop
        folded[:, low:high] = scattered[:, low - fold.first : high - fold.first]
        _share_out(scattered, self._fold_rows, self._fold_starts, fold.columns, fold.shares, folded, rng)
        if self._from_short is not None:
            alone = np.ascontiguousarray(detections[..., -1:].reshape(-1, 1))
            moved = _scatter(alone, self._likeliest, self._offsets, rng)
            for column, records in zip(self._from_short, moved.T, strict=True):
                folded[:, column] += records
        return folded[:, : cycle.bins].reshape(*detections.shape[:-1], cycle.bins)

    def _without_short(self, detections: NDArray[N]) -> NDArray[N]:
        """The detections without those in the short bin at the end of the period, if there is one."""
        if self._from_short is None:
            return detections
        full = detections.copy()
        full[..., -1] = 0
        return full


@compiled()
def _scatter(counts: Ints, weights: Floats, offsets: Ints, rng: Generator) -> Ints:
    """(h, n + taps − 1) counts after each of `counts` (h, n) has moved by `offsets[k]` bins with probability
    `weights[k]`. The weights descend and sum to 1.
    """
    rows, n = counts.shape
    taps = len(weights)
    out = np.zeros((rows, n + taps - 1), np.int64)
    cumulative = np.cumsum(weights)
    for r in range(rows):
        for i in range(n):
            left = counts[r, i]
            if left == 0:
                continue
            # A few counts are moved one by one, by a search from the likeliest displacement on.
            if left <= 2 * taps:
                for _ in range(left):
                    u, k = rng.random() * cumulative[-1], 0
                    while k < taps - 1 and u >= cumulative[k]:
                        k += 1
                    out[r, i + offsets[k]] += 1
                continue
            # Many counts are a multinomial: a binomial for each displacement, out of those that are still left.
            rest = 1.0
            for k in range(taps):
                if left == 0:
                    break
                share = weights[k] / rest
                moved = left if k == taps - 1 or share >= 1.0 else binomial(left, share, rng)
                out[r, i + offsets[k]] += moved
                left -= moved
                rest -= weights[k]
    return out


@compiled()
def _share_out(
    counts: Ints, places: Ints, starts: Ints, columns: Ints, shares: Floats, out: Ints, rng: Generator
) -> None:
    """Add `counts[:, places[r]]` to `out`, split at random over the bins `columns[starts[r]:starts[r + 1]]`."""
    for h in range(len(counts)):
        for r in range(len(places)):
            # A bin of the lattice that straddles bins of the period is a multinomial over these, as in `_scatter`.
            left, rest = counts[h, places[r]], 1.0
            for e in range(starts[r], starts[r + 1]):
                if left == 0:
                    break
                share = shares[e] / rest
                moved = left if share >= 1.0 - 1e-9 else binomial(left, share, rng)
                out[h, columns[e]] += moved
                left -= moved
                rest -= shares[e]
