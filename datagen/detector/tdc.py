"""The time-to-digital converter (TDC): the jitter of recorded events, the bins that count them, and their window.

Bins may differ in width, from bin to bin and from pixel to pixel. The true time of a record decides into which bin
it falls, so unequal bins only sort records anew: dead time and all else before the record knows nothing of them. A
record is taken as uniform within its bin of the time axis, like the light there. Where a dead time follows a
detection and jitter leaves most records in their bin, this holds only for short bins, and the bins of the time axis
are cut into `PIECES` first.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy.special
from numpy.random import Generator
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.detector.flux import Cycle, Fold, N, fold_of, on_lattice, uniform_of_pixels
from datagen.detector.irf import spread
from datagen.detector.random_numbers import binomial
from datagen.detector.spad import Spad
from datagen.errors import InputError
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import TDC_PERIOD_ACCURACY

PIECES = 8
"""Pieces of a bin, within which detections are taken as uniform. Of a bin with λ events per cycle at most the share
λ / (8 PIECES²) of the detections gets into the wrong bin of the TDC."""
_STEADY = 0.9
"""Least share of records that jitter leaves in their bin for their place in it to matter; a jitter of 0.7 bins FWHM
makes that place uniform."""
_SAME = 1e-9
"""Share of a bin by which edges may differ and count as equal: rounding must put no record into a neighbour."""
_NARROWEST = 1e-6
"""Least relative deviation of widths: below it the inverse of the gamma distribution loses digits."""


def pieces_for(cycle: Cycle, spad: Spad) -> int:
    """Number of pieces into which the bins of the time axis are cut before records are sorted; 1 if they are not."""
    has_memory = spad.dead_time_s > 0 and spad.mode != "ideal"
    jitter = cycle.after_avalanche
    if spad.tdc_bins_are_equal or not has_memory:
        return 1
    return PIECES if jitter.weights[jitter.before] > _STEADY else 1


@lru_cache(maxsize=8)
def tdc_widths(spad: Spad, pixels: int, first_pixel: int = 0) -> Floats:
    """(pixels or 1, bins of a period) widths of the TDC's bins over the mean width, of the pixels from number
    `first_pixel` on; one row if all pixels are alike.

    The drawn widths of a period follow a Dirichlet distribution: gamma numbers of shape a over their mean. Their
    variance (n − 1) / (n a + 1) is that of the widths asked for.

    Raises `InputError` if edges are given for fewer pixels.
    """
    if spad.tdc_edges_s is not None:
        edges = np.array(spad.tdc_edges_s)
        if len(edges) > 1 and len(edges) < first_pixel + pixels:
            raise InputError(
                f"Spad.tdc_edges_s: edges of {len(edges)} pixels, and pixels {first_pixel} … "
                f"{first_pixel + pixels - 1} are measured; give one row of edges for each pixel, or one for all"
            )
        rows = edges if len(edges) == 1 else edges[first_pixel : first_pixel + pixels]
        widths = np.diff(rows) / rows[:, -1:] * (edges.shape[1] - 1)
    else:
        n = spad.tdc_period_bins
        shape = ((n - 1) / max(spad.tdc_dnl, _NARROWEST) ** 2 - 1) / n
        widths = scipy.special.gammaincinv(shape, uniform_of_pixels(spad.tdc_seed, n, pixels, first_pixel))
        widths /= widths.mean(axis=1, keepdims=True)
    # The result is cached and shared by later calls.
    widths.flags.writeable = False
    return np.asarray(widths)


@dataclass(frozen=True)
class TdcBins:
    """The sorting of records into the bins of the TDC.

    pieces : number of pieces of a bin of the time axis.
    from_s : (n + 1,) edges of these pieces.
    to_s : (pixel or 1, bins + 1) edges of the TDC's bins of each pixel.
    bins : number of bins of the time axis.
    """

    pieces: int
    from_s: Floats
    to_s: Floats
    bins: int

    @classmethod
    def of(cls, cycle: Cycle, pieces: int, spad: Spad, pixels: int, first_pixel: int = 0) -> TdcBins:
        """The TDC's bins of pixels from number `first_pixel` on, for records in the bins of `cycle.cut(pieces)`.

        The record ends with the time axis: TDC bins are cut off there, and the last one is extended to it.

        Raises `InputError` for edges that do not fit the time axis or the number of pixels.
        """
        widths = tdc_widths(spad, pixels, first_pixel)
        codes, bins, width = widths.shape[1], cycle.bins, cycle.width_s
        if spad.tdc_edges_s is not None:
            length, wanted = spad.tdc_edges_s[0][-1], codes * width
            if abs(length - wanted) > TDC_PERIOD_ACCURACY * wanted:
                raise InputError(
                    f"Spad.tdc_edges_s: {codes} bins end at {length:g} s, and {codes} bins of {width:g} s at "
                    f"{wanted:g} s; set the time axis's bin width to {length / codes:.9g} s, or rescale the edges"
                )
        inside = np.zeros((len(widths), codes + 1))
        np.cumsum(widths, axis=1, out=inside[:, 1:])
        inside[:, -1] = codes
        number = np.arange(bins + 1)
        edges = (number // codes * codes) + inside[:, number % codes]
        nearest = np.rint(edges)
        edges = np.where(np.abs(edges - nearest) < _SAME, nearest, edges) * width
        fine = cycle if pieces == 1 else cycle.cut(pieces)
        end = cycle.edges_s[bins]
        edges = np.minimum(edges, end)
        edges[:, -1] = end
        return cls(pieces, fine.edges_s[: fine.bins + 1], edges, bins)

    @property
    def widths(self) -> Floats:
        """(pixel or 1, bins) widths of the TDC's bins, in bins of the time axis."""
        return np.asarray(np.diff(self.to_s) / (self.pieces * (self.from_s[1] - self.from_s[0])))

    @property
    def shares(self) -> tuple[Floats, Ints]:
        """(pixel or 1, bins) share of a bin's records that keep its number, and number of TDC bins that its records
        get into; for records in whole bins."""
        low, high = self.from_s[:-1], self.from_s[1:]
        within = np.minimum(high, self.to_s[:, 1:]) - np.maximum(low, self.to_s[:, :-1])
        # A TDC bin a … b gets records of the bins from the first one that ends after a to the last one that starts
        # before b; one of no width records nothing.
        begin, end = self.to_s[:, :-1], self.to_s[:, 1:]
        rows, bins = within.shape
        place = (bins + 1) * np.arange(rows)[:, None]
        first, past = np.searchsorted(high, begin, side="right") + place, np.searchsorted(low, end) + place
        starting, ending = (np.bincount(k[end > begin], minlength=rows * (bins + 1)) for k in (first, past))
        touched = np.cumsum((starting - ending).reshape(rows, -1), axis=1)[:, :-1]
        return np.maximum(within, 0.0) / (high - low), touched

    def mean(self, records: Floats, pixels: Ints | None = None) -> Floats:
        """(…, bins) expected records in the TDC's bins, from those in the incoming bins (…, m), m ≥ n.

        pixels : (…,) number of each row's pixel in this measurement; left out, the second last axis is that of all
        pixels.
        """
        rows = np.ascontiguousarray(records.reshape(-1, records.shape[-1]))
        out = np.zeros((len(rows), self.bins))
        _sort(rows, self.from_s, self.to_s, self._edges_of(records, pixels), None, out)
        return out.reshape(*records.shape[:-1], self.bins)

    def draw(self, records: Ints, rng: Generator, pixels: Ints | None = None) -> Ints:
        """(h, bins) records in the TDC's bins: a multinomial number for each incoming bin."""
        out = np.zeros((len(records), self.bins), np.int64)
        _sort(records, self.from_s, self.to_s, self._edges_of(records, pixels), rng, out)
        return out

    def _edges_of(self, records: NDArray[np.generic], pixels: Ints | None) -> Ints:
        """(rows,) row of `to_s` for each row of the records."""
        leading = records.shape[:-1]
        if len(self.to_s) == 1:
            return np.zeros(int(np.prod(leading)), np.int64)
        numbers = np.arange(len(self.to_s)) if pixels is None else pixels
        return np.ascontiguousarray(np.broadcast_to(numbers, leading)).reshape(-1)


class Tdc:
    """The converter from detections in the bins of the laser period to records in the bins of the histogram.

    A detection in bin i is recorded in bin i + k with the probability that the bin-integrated jitter gives to k. A
    record that is displaced beyond an end of the period appears at its other end; records outside the window are
    lost. Where the bins of the TDC are not equal (`unequal`), records are sorted into these in the end.
    """

    def __init__(self, cycle: Cycle, unequal: TdcBins | None = None) -> None:
        self._cycle, self._unequal = cycle, unequal
        self._pieces = 1 if unequal is None else unequal.pieces
        # Bins of full width at the start of the period.
        self._full = cycle.front - cycle.has_short_bin
        jitter = cycle.after_avalanche
        if jitter.is_identity:
            return
        # Displacements are drawn from the likeliest on, so that few records are left for the long wings.
        self._offsets = np.argsort(-jitter.weights, kind="stable")
        self._likeliest = jitter.weights[self._offsets]
        first, count = -cycle.back - jitter.before, cycle.back + self._full + len(jitter.weights) - 1
        if cycle.front < len(cycle.gate):
            # The background between the ends of the lattice is so long that records never wrap around the period.
            nothing = np.empty(0, np.int64)
            self._fold = Fold(first, cycle.bins, range(cycle.bins), nothing, nothing, np.empty(0))
        else:
            self._fold = fold_of(first, count, cycle.width_s, cycle.edges_s)
        if cycle.has_short_bin:
            # Records of the short bin at the end of the period are displaced like a moment in its middle. They come
            # after those of the lattice, and the fold takes them to their bins.
            steps = np.arange(-jitter.before, jitter.after + 1) * cycle.width_s
            moments = (cycle.edges_s[-2:].mean() + steps) % cycle.period_s
            bins = np.minimum(np.searchsorted(cycle.edges_s, moments, side="right") - 1, len(cycle.gate) - 1)
            self._fold = self._fold.with_row(count, bins, jitter.weights)

    def mean(self, detections: Floats, pixels: Ints | None = None) -> Floats:
        """(…, bins) expected records of expected detections (…, n) in the bins of the period, or in their pieces if
        the unequal bins ask for these.

        pixels : (…,) number of each row's pixel in the measurement, on which unequal bins depend; left out, the
            second last axis is that of all pixels.
        """
        if self._unequal is None:
            return self._mean_in_equal_bins(detections)
        records = [self._mean_in_equal_bins(part) for part in self._by_piece(detections)]
        return self._unequal.mean(self._records_in_order(records), pixels)

    def draw(self, detections: Ints, rng: Generator, pixels: Ints | None = None) -> Ints:
        """(h, bins) records of detections (h, n), multinomial; `pixels` (h,) as of `mean`."""
        if self._unequal is None:
            return self._draw_in_equal_bins(detections, rng)
        records = [self._draw_in_equal_bins(part, rng) for part in self._by_piece(detections)]
        return self._unequal.draw(self._records_in_order(records), rng, pixels)

    def _by_piece(self, detections: NDArray[N]) -> list[NDArray[N]]:
        """For each piece of a bin its (…, n) detections in all bins; whole bins count as the middle one."""
        parts = self._cycle.parts(self._pieces)
        starts, whole = np.cumsum(parts) - parts, parts == 1
        out = []
        for piece in range(self._pieces):
            chosen = detections[..., starts + np.where(whole, 0, piece)]
            if piece != self._pieces // 2:
                chosen[..., whole] = 0
            out.append(chosen)
        return out

    def _records_in_order(self, records: list[NDArray[N]]) -> NDArray[N]:
        """(…, m) records in the pieces of all bins, in order of time, from those of each piece (…, bins).

        A record is displaced by whole bins and stays in its piece.
        """
        return np.stack(records, axis=-1).reshape(*records[0].shape[:-1], -1)

    def _mean_in_equal_bins(self, detections: Floats) -> Floats:
        """(…, bins) expected records in bins of the cycle's width."""
        cycle, jitter = self._cycle, self._cycle.after_avalanche
        if jitter.is_identity:
            return detections[..., : cycle.bins]
        lattice, short = self._in_order(detections)
        moved = np.concatenate([spread(lattice, jitter), short], axis=-1)
        return self._fold(moved)[..., : cycle.bins]

    def _draw_in_equal_bins(self, detections: Ints, rng: Generator) -> Ints:
        """(h, bins) records in bins of the cycle's width."""
        cycle = self._cycle
        if cycle.after_avalanche.is_identity:
            return detections[..., : cycle.bins]
        lattice, short = self._in_order(detections)
        scattered = _scatter(np.ascontiguousarray(lattice), self._likeliest, self._offsets, rng)
        moved = np.concatenate([scattered, short], axis=1)
        return self._fold.draw(moved, rng)[:, : cycle.bins]

    def _in_order(self, detections: NDArray[N]) -> tuple[NDArray[N], NDArray[N]]:
        """Detections on the lattice, and those of the short bin at the end of the period: (…, 1), or (…, 0) where
        there is none."""
        full = on_lattice(detections, self._cycle.back, self._full)
        return full, detections[..., self._full : self._cycle.front]


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
def _sort(
    records: NDArray[Any], from_s: Floats, to_s: Floats, row_of: Ints, rng: Generator | None, out: NDArray[Any]
) -> None:
    """Add `records` (h, m) to the TDC's bins `out` (h, bins) according to the overlap: counts each at random, and
    expected records, for which `rng` is None, in proportion."""
    for h in range(len(records)):
        edges, k = to_s[row_of[h]], 0
        for i in range(len(from_s) - 1):
            left, low, high, rest = records[h, i], from_s[i], from_s[i + 1], 1.0
            # The last edge is the end of the time axis, so the search ends.
            while left > 0 and edges[k + 1] <= low:
                k += 1
            j = k
            while left > 0:
                # A share for each TDC bin, out of what is still left. The last bin takes the rest, so that rounding
                # loses none.
                share = max(min(high, edges[j + 1]) - max(low, edges[j]), 0.0) / (high - low)
                moved = left
                if edges[j + 1] < high and share < rest:
                    moved = left * (share / rest) if rng is None else binomial(left, share / rest, rng)
                out[h, j] += moved
                left -= moved
                rest -= share
                j += 1
