"""What arrives at a lookin, convolved in time with what leaves it.

The paths into a Lambertian lookin and the paths out of it factorise: energies multiply, lengths add. So the double
sum over all pairs (Eq. 8 of Scholes & Leach, Sensors 24, 6522 (2024)) is a convolution of two histograms, O(Ñ) and
not O(Ñ²). What leaves towards a pixel fills few bins, so that a plain double loop over both histograms is as fast as
transforms are, or faster.

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

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.binning import put

SUB_BINS = 4
"""A power of two, so that bins and sub-bins have their edges in common to the last bit. With half as many, arrival
times spread twice as far."""


class Paths(NamedTuple):
    """Half paths, those of row r at `first[r] : first[r + 1]`.

    first : (rows + 1,); position : (n,) length in sub-bins; energy : (n,), 0 for a path that something hides.
    """

    first: Ints
    position: Floats
    energy: Floats

    def take(self, rows: Bools) -> Paths:
        """Those of some rows."""
        counts = np.diff(self.first)
        kept = np.repeat(rows, counts)
        return Paths(np.append(0, np.cumsum(counts[rows])), self.position[kept], self.energy[kept])


class Sums(NamedTuple):
    """transient (L, P, T) in bins of the window; overflow (L, P)."""

    transient: Floats
    overflow: Floats

    def of_laser(self, laser: int) -> Sums:
        """A view of one laser point: (P, T) and (P,) arrays."""
        return Sums(self.transient[laser], self.overflow[laser])


@compiled()
def convolve(ins: Paths, outs: Paths, displacement: Floats, sums: Sums) -> None:
    """Add what arrives from one laser point, row b, convolved with what leaves to each pixel, row (b, pixel).

    displacement : (lookins,) u of each. sums : (P, T) and (P,) arrays.
    """
    pixels, bins = sums.transient.shape[0], sums.transient.shape[1] * SUB_BINS
    summed = np.zeros((pixels, bins))
    for b in range(len(displacement)):
        base_in, arriving, before_in = _binned(ins, b, displacement[b])
        if len(arriving) == 0:
            continue
        for p in range(pixels):
            base_out, leaving, before_out = _binned(outs, b * pixels + p, 1.0 - displacement[b])
            # The inner loop runs over the longer of the two, which compilers turn into vector instructions.
            x, y, before = arriving, leaving, before_out
            if len(x) > len(y):
                x, y, before = leaving, arriving, before_in
            for i in range(len(x)):
                weight, start = x[i], base_in + base_out + i
                if weight == 0.0:
                    continue
                lower = min(max(0, -start), len(y))
                upper = max(min(len(y), bins - start), lower)
                row, part = summed[p, max(start, 0) :], y[lower:upper]
                for j in range(len(part)):
                    row[j] += weight * part[j]
                sums.overflow[p] += weight * (before[lower] + (before[len(y)] - before[upper]))
    for p in range(pixels):
        for i in range(bins):
            sums.transient[p, i // SUB_BINS] += summed[p, i]


@compiled()
def _binned(paths, r, displacement):  # type: ignore[no-untyped-def]
    """The first sub-bin of row r, its energy from there on, none if it has none, and the sums before each of them."""
    smallest, largest = np.int64(1) << 60, -(np.int64(1) << 60)
    for k in range(paths.first[r], paths.first[r + 1]):
        if paths.energy[k] > 0.0:
            bin_ = np.int64(math.floor(paths.position[k] + displacement))
            smallest, largest = min(smallest, bin_), max(largest, bin_)
    values = np.zeros(largest - smallest + 1 if largest >= smallest else 0)
    for k in range(paths.first[r], paths.first[r + 1]):
        if paths.energy[k] > 0.0:
            values[np.int64(math.floor(paths.position[k] + displacement)) - smallest] += paths.energy[k]
    before = np.zeros(len(values) + 1)
    for k in range(len(values)):
        before[k + 1] = before[k] + values[k]
    return smallest, values, before


@compiled()
def double_sum(ins: Paths, outs: Paths, sums: Sums) -> None:
    """Eq. 8 as it is written: every path into a lookin with every path out of it, each pair binned by itself.

    The plain version of `convolve` for one laser point (`sums` holds (P, T) and (P,) arrays), O(Ñ²). Positions
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
