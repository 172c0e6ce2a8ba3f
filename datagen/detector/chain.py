"""The sampler of synchronous detectors, which counts all cycles of an exposure at once, in the order of phase.

The cycles of a synchronous detector are exchangeable, so a sampler only has to know how many of them are armed. In
bin i each armed cycle fires with probability q_i = −expm1(−λ_i). The cost does not depend on the number of cycles.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from datagen.compiled import compiled
from datagen.detector.dead_time import Table, pieces_of, return_table
from datagen.detector.expected import active_span
from datagen.detector.flux import Cycle
from datagen.detector.random_numbers import binomial
from datagen.records.arrays import Floats, Ints


def draw_chain(flux: Floats, cycle: Cycle, dead_time_s: float, cycles: int, rng: Generator) -> Ints:
    """(n,) detections in `cycles` laser periods of a synchronous detector with flux (n,).

    Where the dead time lasts to the end of the cycle, the law is the multinomial with p_i = q_i exp(−Λ_{i−1}); no
    rounding can push a sum of probabilities beyond 1, so that it holds for λ from 1e-300 to 1e300. Otherwise cycles
    that fired return as they do in the expected histogram (`datagen.detector.dead_time`): each counts as armed from
    the start of a piece on that is drawn by the table's weights. Pieces are shorter than the dead time, so that no
    cycle returns within the piece in which it fired.
    """
    bins = len(flux)
    if dead_time_s >= active_span(flux, cycle):
        return np.asarray(_run(_without_return(flux), np.arange(bins), bins, cycles, rng))
    pieces = pieces_of(flux, cycle.edges_s, cycle.width_s, dead_time_s, shorter_than_dead_time=True)
    table = return_table(pieces.flux, pieces.edges, dead_time_s)
    return np.asarray(_run(table, pieces.bin_of, bins, cycles, rng))


@compiled()
def _without_return(flux: Floats) -> Table:
    """The table of bins, as of `return_table`, from which no cycle returns."""
    n = len(flux)
    # Not by numpy's expm1: its AVX-512 form leaves the processor slow for the scalar functions of the loops to come.
    q = np.empty(n)
    for i in range(n):
        q[i] = -np.expm1(-flux[i])
    return q, np.zeros(n, np.int64), np.zeros(n + 1, np.int64), np.empty(0)


@compiled()
def _run(table: Table, bin_of: Ints, bins: int, cycles: int, rng: Generator) -> Ints:
    """(bins,) counts, from the table of the pieces and (m,) the bins in which these lie."""
    q, first, offset, weights = table
    m = len(q)
    counts = np.zeros(bins, np.int64)
    # Cycles that are armed from the start of each piece on, decided when they fire.
    returning = np.zeros(m, np.int64)
    armed = cycles
    for i in range(m):
        armed += returning[i]
        fired = binomial(armed, q[i], rng)
        counts[bin_of[i]] += fired
        armed -= fired
        # The pieces of return are a multinomial number by binomials: the last one takes all that are left.
        left, rest = fired, 1.0
        for k in range(offset[i], offset[i + 1]):
            where = first[i] + k - offset[i]
            # Every cycle is armed anew after the end of the period, so these returns count for nothing.
            if left == 0 or where >= m:
                break
            back = left if k == offset[i + 1] - 1 else binomial(left, weights[k] / rest, rng)
            returning[where] += back
            left -= back
            rest -= weights[k]
    return counts
