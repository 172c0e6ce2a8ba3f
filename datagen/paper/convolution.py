"""Light that arrives at a hidden vertex, convolved in time with light that leaves it.

The hidden vertex is the last one before the FoV point; Scholes & Leach, Sensors 24, 6522 (2024), call it *lookin*,
and so does the code of this folder. A half path leads either from the laser into a lookin or from a lookin into the
aperture. If the lookin is Lambertian, every path in combines with every path out: their energies multiply and their
lengths add. So the double sum over all pairs (Eq. 8 there) is a convolution of two histograms, and its cost grows
with the number of half paths, not with its square. The light that leaves towards one pixel fills few bins, so that a
plain double loop over both histograms is at least as fast as Fourier transforms.

A pair of half paths belongs into the bin of its summed length, but binned half paths only tell that sum to within a
bin. Therefore half paths are binned finely, with `SUB_BINS` sub-bins to each bin of the window, and only the
convolution is added up into whole bins. In addition, the sub-bins of a lookin are displaced by u for arriving and by
−u for leaving half paths, with u stratified over the lookins. For u uniform in 0 … 1 a pair then falls into one of
the two sub-bins whose centres are nearest to its length, with probabilities linear in the distance. On average a bin
thus counts the flux smoothed over one sub-bin: only pairs within half a sub-bin of an edge can fall on its other
side, which spreads arrival times by 1/(12 SUB_BINS²) bin², whatever the width of the bins.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints

SUB_BINS = 4
"""Sub-bins per bin of the window. A power of two, so that bins and sub-bins share their edges to the last bit. With
half as many, arrival times spread twice as far."""


class Paths(NamedTuple):
    """n half paths in rows: row r holds the half paths `first[r] : first[r + 1]`.

    first : (rows + 1,). position : (n,) length in sub-bins. energy : (n,), 0 for a half path that a surface hides.
    """

    first: Ints
    position: Floats
    energy: Floats


@compiled()
def convolve(ins: Paths, outs: Paths, displacement: Floats, transient: Floats) -> None:
    """Add to `transient` (P, T) the light of one laser point by way of every lookin b to every pixel.

    ins : row b holds the half paths from the laser into lookin b. outs : row b · P + pixel holds those out of it.
    displacement : (lookins,) the u of each lookin's sub-bins. Light outside the window is left out.
    """
    pixels, bins = transient.shape[0], transient.shape[1] * SUB_BINS
    summed = np.zeros((pixels, bins))
    for b in range(len(displacement)):
        # The displacements u and 1 − u of a pair add up to the whole sub-bin that rounding down takes from its sum on
        # average, a half from each.
        base_in, arriving = _binned(ins, b, displacement[b])
        if len(arriving) == 0:
            continue
        for p in range(pixels):
            base_out, leaving = _binned(outs, b * pixels + p, 1.0 - displacement[b])
            # The inner loop runs over the longer of the two, which compilers turn into vector instructions.
            x, y = (arriving, leaving) if len(arriving) <= len(leaving) else (leaving, arriving)
            for i in range(len(x)):
                weight, start = x[i], base_in + base_out + i
                if weight == 0.0:
                    continue
                # y[lower:upper] falls into the window. The clamps allow for a y that lies wholly before or after it.
                lower = min(max(0, -start), len(y))
                upper = max(min(len(y), bins - start), lower)
                row, part = summed[p, max(start, 0) :], y[lower:upper]
                for j in range(len(part)):
                    row[j] += weight * part[j]
    # Sub-bins have served to place each pair; whole bins are what is stored.
    for p in range(pixels):
        for i in range(bins):
            transient[p, i // SUB_BINS] += summed[p, i]


@compiled()
def _binned(paths, r, displacement):  # type: ignore[no-untyped-def]
    """Row r as a histogram: its first sub-bin, and energies (n,) from there on; none for a row without energy."""
    # Only the sub-bins between the shortest and the longest half path: few of the window's, which keeps loops short.
    smallest, largest = np.int64(1) << 60, -(np.int64(1) << 60)
    for k in range(paths.first[r], paths.first[r + 1]):
        if paths.energy[k] > 0.0:
            bin_ = np.int64(math.floor(paths.position[k] + displacement))
            smallest, largest = min(smallest, bin_), max(largest, bin_)
    values = np.zeros(largest - smallest + 1 if largest >= smallest else 0)
    for k in range(paths.first[r], paths.first[r + 1]):
        if paths.energy[k] > 0.0:
            values[np.int64(math.floor(paths.position[k] + displacement)) - smallest] += paths.energy[k]
    return smallest, values


@compiled()
def double_sum(ins: Paths, outs: Paths, transient: Floats, overflow: Floats) -> None:
    """Add to `transient` (P, T) and `overflow` (P,) every path into a lookin with every path out of it (Eq. 8).

    Each pair is binned by itself, as the paper does it; tests hold `convolve` against it. Here positions count whole
    bins from the start of the window.
    """
    pixels, bins = transient.shape
    for b in range(len(ins.first) - 1):
        for p in range(pixels):
            r = b * pixels + p
            for i in range(ins.first[b], ins.first[b + 1]):
                for j in range(outs.first[r], outs.first[r + 1]):
                    position, energy = ins.position[i] + outs.position[j], ins.energy[i] * outs.energy[j]
                    if 0.0 <= position < bins:
                        transient[p, int(position)] += energy
                    else:
                        overflow[p] += energy


def keep_strongest(paths: Paths, count: int) -> None:
    """Set the energy of all but the `count` strongest paths of each row to zero."""
    for first, end in pairwise(paths.first):
        row = paths.energy[first:end]
        if len(row) > count:
            row[np.argpartition(row, len(row) - count)[: len(row) - count]] = 0.0
