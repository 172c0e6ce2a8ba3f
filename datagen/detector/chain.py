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
    the start of one of a few pieces on, by the table's weights. Pieces are shorter than the dead time, so that no
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
    # Decided when cycles fire: how many are armed from the start of each piece on, and how many fire again in it.
    arming, firing = np.zeros(m, np.int64), np.zeros(m, np.int64)
    hazards = np.empty(m)
    armed = cycles
    for i in range(m):
        armed += arming[i]
        fired = binomial(armed, q[i], rng)
        armed -= fired
        fired += firing[i]
        counts[bin_of[i]] += fired
        last = first[i] + offset[i + 1] - offset[i] - 1
        if fired == 0 or first[i] > last:
            continue
        # Few cycles fire again before the last piece of their return, and one rare number says how many. All others
        # are armed there. Returns after the end of the period count for nothing, for every cycle starts armed.
        soon, waiting = 0.0, 0.0
        for k in range(first[i], min(last, m)):
            waiting += weights[offset[i] + k - first[i]]
            hazards[k] = waiting * q[k]
            waiting -= hazards[k]
            soon += hazards[k]
        left = binomial(fired, soon, rng)
        if last < m:
            arming[last] += fired - left
        # They are shared out over the pieces by binomials: the last one takes the rest.
        for k in range(first[i], min(last, m)):
            if left == 0:
                break
            here = left if k == min(last, m) - 1 else binomial(left, hazards[k] / soon, rng)
            firing[k] += here
            left -= here
            soon -= hazards[k]
    return counts
