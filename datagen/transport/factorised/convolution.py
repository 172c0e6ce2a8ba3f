"""What arrives at a lookin, convolved in time with what leaves it.

The paths into a Lambertian lookin and the paths out of it factorise: energies multiply, lengths add. So the double
sum over all pairs (Eq. 8 of Scholes & Leach, Sensors 24, 6522 (2024)) is a convolution of two histograms, O(Ñ) and
not O(Ñ²).

A pair belongs into the bin that holds its length, but of two binned halves only the sum to within a bin is known. So
the halves are held in sub-bins, `SUB_BINS` to each bin of the window, and only their convolution is added up into
bins. Each half is put whole into one sub-bin of a grid that is displaced by u sub-bins for the arriving and by −u for
the leaving half, u stratified over the lookins: for u uniform in 0 … 1 the pair then falls into one of the two
sub-bins whose centres are nearest to it, with probabilities linear in the distance. On average a bin thus counts the
flux smoothed over one sub-bin: only pairs within half a sub-bin of an edge can fall on its other side, which spreads
arrival times by 1/(12 SUB_BINS²) bin², whatever the width of the bins.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import scipy.fft

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.binning import put

SUB_BINS = 4
"""A power of two, so that bins and sub-bins have their edges in common to the last bit."""
VALUES_AT_ONCE = 1 << 22
"""Entries of a dense table of spectra (64 MiB)."""
NANOSECONDS_PER_TERM, NANOSECONDS_PER_STEP = 0.3, 4.0
NANOSECONDS_PER_BUTTERFLY, NANOSECONDS_PER_PRODUCT = 0.8, 1.5
"""Costs of the direct convolution (a term, a turn of its outer loop) and of the spectral one; only ratios matter."""


class Paths(NamedTuple):
    """Half paths, those of row r at `first[r] : first[r + 1]`.

    first : (rows + 1,); position : (n,) length in sub-bins; energy : (n,), 0 for a path that something hides.
    """

    first: Ints
    position: Floats
    energy: Floats


class Histograms(NamedTuple):
    """One histogram a row, each over its own span of sub-bins.

    base : (rows,) first sub-bin. first : (rows + 1,) where the row starts in `values`. total : (rows,) energy, inside
    and outside the span. outside : (rows,) energy of paths that can reach no bin of the window.
    """

    base: Ints
    first: Ints
    values: Floats
    total: Floats
    outside: Floats


class Sums(NamedTuple):
    """transient (L, P, T) in bins of the window; overflow (L, P)."""

    transient: Floats
    overflow: Floats

    @classmethod
    def zeros(cls, lasers: int, pixels: int, bins: int) -> Sums:
        """Nothing yet."""
        return cls(np.zeros((lasers, pixels, bins)), np.zeros((lasers, pixels)))

    def take(self, lasers: Ints) -> Sums:
        """A view of some consecutive laser points."""
        rows = slice(lasers[0], lasers[-1] + 1)
        return Sums(*(array[rows] for array in self))

    def of_laser(self, laser: int) -> Sums:
        """A view of one laser point: (P, T) and (P,) arrays."""
        return Sums(*(array[laser] for array in self))


@compiled()
def histograms(paths: Paths, displacement: Floats, low: Ints, high: Ints) -> Histograms:
    """Put every path into sub-bin floor(position + displacement); only low … high of each row are kept."""
    rows = len(paths.first) - 1
    base, first = np.zeros(rows, np.int64), np.zeros(rows + 1, np.int64)
    total, outside = np.zeros(rows), np.zeros(rows)
    for r in range(rows):
        smallest, largest = high[r] + 1, low[r] - 1
        for k in range(paths.first[r], paths.first[r + 1]):
            if paths.energy[k] > 0.0:
                bin_ = math.floor(paths.position[k] + displacement[r])
                total[r] += paths.energy[k]
                if low[r] <= bin_ <= high[r]:
                    smallest, largest = min(smallest, bin_), max(largest, bin_)
                else:
                    outside[r] += paths.energy[k]
        base[r] = smallest if largest >= smallest else 0
        first[r + 1] = first[r] + max(largest - smallest + 1, 0)
    values = np.zeros(first[rows])
    for r in range(rows):
        start = first[r] - base[r]
        for k in range(paths.first[r], paths.first[r + 1]):
            if paths.energy[k] > 0.0:
                bin_ = math.floor(paths.position[k] + displacement[r])
                if low[r] <= bin_ <= high[r]:
                    values[start + bin_] += paths.energy[k]
    return Histograms(base, first, values, total, outside)


@compiled()
def reachable(outs: Histograms, lookins: int, pixels: int, bins: int) -> tuple[Ints, Ints]:
    """(lookins,) first and last arriving sub-bin from which some pixel's leaving histogram reaches the window."""
    low, high = np.full(lookins, np.iinfo(np.int64).max), np.full(lookins, np.iinfo(np.int64).min)
    for b in range(lookins):
        for p in range(pixels):
            r = b * pixels + p
            if outs.first[r + 1] > outs.first[r]:
                last = outs.base[r] + outs.first[r + 1] - outs.first[r] - 1
                low[b], high[b] = min(low[b], -last), max(high[b], bins * SUB_BINS - 1 - outs.base[r])
        if low[b] > high[b]:
            low[b], high[b] = 0, -1
    return low, high


def convolve(ins: list[Histograms], outs: Histograms, sums: Sums) -> None:
    """Add Σ over lookins of arriving ∗ leaving for each laser point and pixel, by whichever way costs less.

    ins : one `Histograms` for each laser point, a row for each lookin. outs : rows (lookin, pixel).
    """
    pixels, lookins = sums.transient.shape[1], len(ins[0].base)
    spans_out = np.diff(outs.first).reshape(lookins, pixels)
    if not spans_out.any():
        return
    spans_in = np.stack([np.diff(one.first) for one in ins], axis=1)
    longest = np.maximum(spans_in.max(axis=1), 1)[:, None]
    long, short = np.maximum(spans_out, longest), np.minimum(spans_out, longest)
    direct = len(ins) * float((short * (NANOSECONDS_PER_STEP + NANOSECONDS_PER_TERM * long)).sum())
    grid = _Grid.of(ins, outs)
    transforms = len(ins) * lookins + lookins * pixels + len(ins) * pixels
    spectral = grid.size * (
        NANOSECONDS_PER_BUTTERFLY * transforms * math.log2(grid.size)
        + NANOSECONDS_PER_PRODUCT * len(ins) * pixels * lookins
    )
    if direct <= spectral:
        for laser, one in enumerate(ins):
            convolve_directly(one, outs, sums.of_laser(laser))
    else:
        convolve_spectrally(ins, outs, sums)


@compiled()
def convolve_directly(ins: Histograms, outs: Histograms, sums: Sums) -> None:
    """One laser point: `sums` holds (P, T) and (P,) arrays."""
    pixels, bins = sums.transient.shape[0], sums.transient.shape[1] * SUB_BINS
    summed = np.zeros(bins)
    for p in range(pixels):
        summed[:] = 0.0
        for b in range(len(ins.base)):
            r = b * pixels + p
            if ins.total[b] <= 0.0 or outs.total[r] <= 0.0:
                continue
            sums.overflow[p] += ins.outside[b] * outs.total[r] + (ins.total[b] - ins.outside[b]) * outs.outside[r]
            x = ins.values[ins.first[b] : ins.first[b + 1]]
            y = outs.values[outs.first[r] : outs.first[r + 1]]
            if len(x) > len(y):
                x, y = y, x
            for i in range(len(x)):
                weight = x[i]
                if weight == 0.0:
                    continue
                start = ins.base[b] + outs.base[r] + i
                lower, upper = min(max(0, -start), len(y)), max(min(len(y), bins - start), 0)
                row = summed[max(start, 0) :]
                part = y[lower : max(upper, lower)]
                for j in range(len(part)):
                    row[j] += weight * part[j]
                if lower > 0 or upper < len(y):
                    sums.overflow[p] += weight * (y[:lower].sum() + y[max(upper, lower) :].sum())
        for i in range(bins):
            sums.transient[p, i // SUB_BINS] += summed[i]


class _Grid(NamedTuple):
    """Sub-bins of a transform that holds every row without wrapping."""

    base_in: int
    base_out: int
    size: int

    @classmethod
    def of(cls, ins: list[Histograms], outs: Histograms) -> _Grid:
        low_in, high_in = np.array([_extent(one) for one in ins]).T
        low_out, high_out = _extent(outs)
        base_in, end_in = int(low_in.min()), int(high_in.max())
        size = max(end_in - base_in, 1) + max(high_out - low_out, 1) - 1
        return cls(base_in, low_out, int(scipy.fft.next_fast_len(size, real=True)))


def _extent(rows: Histograms) -> tuple[int, int]:
    filled = np.flatnonzero(np.diff(rows.first))
    if not len(filled):
        return 0, 0
    return int(rows.base[filled].min()), int((rows.base + np.diff(rows.first))[filled].max())


def convolve_spectrally(ins: list[Histograms], outs: Histograms, sums: Sums) -> None:
    """The same in the frequency domain: products of spectra summed over the lookins, then one inverse transform.

    Rounding leaves noise of 10⁻¹⁶ of the largest bin, of either sign; what lies under it is set to zero.
    """
    pixels, bins = sums.transient.shape[1], sums.transient.shape[2] * SUB_BINS
    grid = _Grid.of(ins, outs)
    lookins = len(ins[0].base)
    at_once = max(1, VALUES_AT_ONCE // (grid.size * pixels))
    lasers_at_once = max(1, VALUES_AT_ONCE // (grid.size * max(pixels, min(at_once, lookins))))
    for first in range(0, len(ins), lasers_at_once):
        some = ins[first : first + lasers_at_once]
        spectrum = np.zeros((grid.size // 2 + 1, len(some), pixels), np.complex128)
        for start in range(0, lookins, at_once):
            rows = np.arange(start, min(start + at_once, lookins))
            leaving = _dense(outs, rows[0] * pixels, (rows[-1] + 1) * pixels, grid.base_out, grid.size)
            # (frequency, lookin, pixel) and (frequency, laser, lookin): one matrix product for each frequency.
            q = scipy.fft.rfft(leaving, axis=0).reshape(-1, len(rows), pixels)
            arriving = np.stack([_dense(one, rows[0], rows[-1] + 1, grid.base_in, grid.size) for one in some], axis=1)
            spectrum += np.matmul(scipy.fft.rfft(arriving, axis=0), q)
        summed = scipy.fft.irfft(spectrum, grid.size, axis=0).transpose(1, 2, 0)
        floor = 8 * np.finfo(float).eps * summed.max(axis=2, initial=0.0, keepdims=True)
        summed = np.where(summed > floor, summed, 0.0)
        base = grid.base_in + grid.base_out
        lower, upper = min(max(0, -base), grid.size), max(min(grid.size, bins - base), 0)
        place = slice(first, first + len(some))
        if upper > lower:
            inside = np.zeros((len(some), pixels, bins))
            inside[:, :, base + lower : base + upper] = summed[:, :, lower:upper]
            sums.transient[place] += inside.reshape(len(some), pixels, -1, SUB_BINS).sum(axis=3)
        beyond = summed[:, :, :lower].sum(axis=2) + summed[:, :, max(upper, lower) :].sum(axis=2)
        sums.overflow[place] += beyond
        shape = (lookins, pixels)
        total, outside = outs.total.reshape(shape), outs.outside.reshape(shape)
        for k, one in enumerate(some, start=first):
            sums.overflow[k] += one.outside @ total + (one.total - one.outside) @ outside


@compiled()
def _dense(rows: Histograms, start: int, stop: int, base: int, size: int) -> Floats:
    """(size, rows) with every histogram from bin `base` on."""
    out = np.zeros((size, stop - start))
    for r in range(start, stop):
        offset = rows.base[r] - base
        for k in range(rows.first[r + 1] - rows.first[r]):
            out[offset + k, r - start] = rows.values[rows.first[r] + k]
    return out


@compiled()
def double_sum(ins: Paths, outs: Paths, sums: Sums) -> None:
    """Eq. 8 as it is written: every path into a lookin with every path out of it, each pair binned by itself.

    The slow plain version of `convolve` for one laser point (`sums` holds (P, T) and (P,) arrays), O(Ñ²). Positions
    count bins, from the start of the window.
    """
    pixels = sums.transient.shape[0]
    for b in range(len(ins.first) - 1):
        for p in range(pixels):
            r = b * pixels + p
            for i in range(ins.first[b], ins.first[b + 1]):
                for j in range(outs.first[r], outs.first[r + 1]):
                    energy = ins.energy[i] * outs.energy[j]
                    if energy > 0.0:
                        position = ins.position[i] + outs.position[j]
                        sums.overflow[p] += put(sums.transient[p], position, energy)


def take_rows(rows: Histograms, kept: Bools) -> Histograms:
    """The rows for which `kept` (rows,) is true."""
    spans = np.diff(rows.first)
    first = np.concatenate([[0], np.cumsum(spans[kept])])
    values = rows.values[np.repeat(kept, spans)]
    return Histograms(rows.base[kept], first, values, rows.total[kept], rows.outside[kept])


@compiled()
def keep_strongest(paths: Paths, count: int) -> None:
    """Leave each row its `count` strongest paths and set the energy of the others to zero."""
    for r in range(len(paths.first) - 1):
        row = paths.energy[paths.first[r] : paths.first[r + 1]]
        if len(row) <= count:
            continue
        threshold = _ranked(row.copy(), len(row) - count)
        room = count
        for k in range(len(row)):
            room -= row[k] > threshold
        for k in range(len(row)):
            if row[k] == threshold and room > 0:
                room -= 1
            elif row[k] <= threshold:
                row[k] = 0.0


@compiled()
def _ranked(values: Floats, rank: int) -> float:
    """The value that would stand at a rank if they were sorted, which puts them into another order (Hoare, "Algorithm
    65: Find", Communications of the ACM 4 (1961)); numpy's own takes ten times as long to compile."""
    low, high = 0, len(values) - 1
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        low, high = (low, j) if rank <= j else (i, high) if rank >= i else (rank, rank)
    return float(values[rank])
