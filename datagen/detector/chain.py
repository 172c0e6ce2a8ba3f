"""Samplers of synchronous detectors, which count all cycles of an exposure at once, in the order of phase.

The cycles of a synchronous detector are exchangeable, so a sampler only has to know how many of them are armed. Few
detections are drawn one by one (`draw_in_order`). Many are drawn bin after bin: in bin i each armed cycle fires with
probability q_i = −expm1(−λ_i), at a cost that does not depend on the number of cycles.
"""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from datagen.compiled import compiled
from datagen.detector.dead_time import Equilibrium, Pieces, fires_early
from datagen.detector.random_numbers import binomial
from datagen.records.arrays import Floats, Ints

_RUN_CYCLES = 64
"""Cycles of one run of the ensemble. The variance of a total is 10 % too large at worst; with half as many cycles its
error doubles, and the time is halved."""


@compiled()
def draw_in_order(flux: Floats, edges: Floats, dead_time: float, cycles: int, rng: Generator) -> Ints:
    """(h, n) detections of synchronous detectors with flux (h, n), detection by detection.

    R armed cycles fire together at the rate R λ(t): the next detection is where ∫ R dΛ has grown by Exp(1). It leaves
    R − 1 armed cycles until a dead time later. The draw is exact for a dead time of any length; its cost is a passage
    through the bins, and an exponential number for each detection.

    edges : (n + 1,) bin edges, in the unit of `dead_time`.
    """
    rows, n = flux.shape
    counts = np.zeros((rows, n), np.int64)
    # Phases at which dead cycles are armed again. They come in the order of detection: first in, first out.
    due = np.empty(256)
    for r in range(rows):
        armed, head, tail = float(cycles), 0, 0
        ahead = rng.standard_exponential()
        for i in range(n):
            # The cap keeps products finite; at this flux every armed cycle fires at once in any case.
            events, start, stop = min(flux[r, i], 1e200), edges[i], edges[i + 1]
            # Most bins end before the next detection and before the next cycle is armed again.
            if armed * events < ahead and (head == tail or due[head] >= stop):
                ahead -= armed * events
                continue
            if events == 0.0:
                # Without events the moment of return within the bin does not matter.
                while head < tail and due[head] < stop:
                    armed += 1.0
                    head += 1
                continue
            rate, t = events / (stop - start), start
            # The rate changes at each return, so the bin is passed in steps from one return to the next.
            while True:
                returns = head < tail and due[head] < stop
                until = due[head] if returns else stop
                load = armed * rate * (until - t)
                if load <= ahead:
                    ahead -= load
                    if not returns:
                        break
                    t = until
                    armed += 1.0
                    head += 1
                    continue
                t += ahead / (armed * rate)
                counts[r, i] += 1
                armed -= 1.0
                ahead = rng.standard_exponential()
                # A cycle that would return after the end of the period starts the next one armed anyway.
                if t + dead_time < edges[n]:
                    if tail == len(due):
                        # A full queue drops the entries that have returned, or doubles if they are few.
                        longer = due if 2 * head > tail else np.empty(2 * len(due))
                        for k in range(tail - head):
                            longer[k] = due[head + k]
                        due, head, tail = longer, 0, tail - head
                    due[tail] = t + dead_time
                    tail += 1
    return counts


@compiled()
def draw_hazard_chain(flux: Floats, cycles: int, rng: Generator) -> Ints:
    """(n,) counts with at most one detection in a cycle: n_i ~ Binomial(R, q_i), R ← R − n_i, from R = `cycles`.

    The law is the multinomial with p_i = q_i exp(−Λ_{i−1}), but no rounding can push a sum of probabilities beyond 1.
    It holds for λ from 1e-300 to infinity.
    """
    counts = np.zeros(len(flux), np.int64)
    left = cycles
    for i in range(len(flux)):
        counts[i] = binomial(left, -np.expm1(-flux[i]), rng)
        left -= counts[i]
    return counts


@compiled()
def draw_return_chain(pieces: Pieces, bins: int, cycles: int, rng: Generator) -> Ints:
    """(bins,) counts with several detections in a cycle: a cycle that fired is armed again after the dead time.

    A detection is uniform within its piece (`dead_time.PIECE_FLUX` keeps this error small), so its return is uniform
    in the piece shifted by the dead time, which overlaps a few pieces. The moments of return are not drawn. One rare
    binomial decides how many of the returning cycles fire within these pieces; all others count as armed from the
    next piece on. Pieces must be shorter than the dead time.
    """
    flux, bin_of, edges, dead_time = pieces
    fires, soon, first, after = _return_windows(flux, edges, dead_time)
    n = len(flux)
    counts = np.zeros(bins, np.int64)
    # For each piece, decided when cycles fire: how many returning ones fire in it, how many are armed at its start.
    firing, arming = np.zeros(n, np.int64), np.zeros(n + 1, np.int64)
    hazards = np.empty(n + 3)
    armed = cycles
    for i in range(n):
        armed += arming[i]
        fired = binomial(armed, fires[i], rng)
        armed -= fired
        # Returning cycles of which an earlier piece decided that they fire here.
        fired += firing[i]
        if fired == 0:
            continue
        counts[bin_of[i]] += fired
        # The return lies after the end of the period, where every cycle is armed afresh.
        if first[i] == n:
            continue
        left = binomial(fired, soon[i], rng)
        arming[after[i]] += fired - left
        if left == 0:
            continue
        # The cycles that fire soon are shared out over the pieces of their return: a multinomial by binomials.
        rest = soon[i]
        count = _hazards(edges[i] + dead_time, edges[i + 1] + dead_time, first[i], flux, fires, edges, hazards)
        for k in range(count):
            again = left if k == count - 1 else binomial(left, hazards[k] / rest, rng)
            firing[first[i] + k] += again
            left -= again
            rest -= hazards[k]
            if left == 0:
                break
    return counts


@compiled()
def _return_windows(flux: Floats, edges: Floats, dead_time: float) -> tuple[Floats, Floats, Ints, Ints]:
    """(n,) probability q that an armed cycle fires in a piece; (n,) probability that a cycle which fired in it fires
    again while it returns, in pieces `first … after − 1`; (n,) `first` and (n,) `after`.

    `first` is n where the return lies after the end of the period.
    """
    n = len(flux)
    fires = np.empty(n)
    # Not by numpy's expm1: its AVX-512 form leaves the processor slow for the scalar functions of the loops to come.
    for i in range(n):
        fires[i] = -np.expm1(-flux[i])
    soon, first, after = np.zeros(n), np.full(n, n), np.full(n, n)
    hazards, target = np.empty(n + 3), 0
    for i in range(n):
        start = edges[i] + dead_time
        if start >= edges[n]:
            break
        while edges[target + 1] <= start:
            target += 1
        count = _hazards(start, edges[i + 1] + dead_time, target, flux, fires, edges, hazards)
        for k in range(count):
            soon[i] += hazards[k]
        first[i], after[i] = target, min(target + count, n)
    return fires, soon, first, after


@compiled()
def _hazards(start: float, stop: float, first: int, flux: Floats, fires: Floats, edges: Floats, out: Floats) -> int:
    """Number of pieces, from `first` on, that overlap `start … stop`; `out` gets for each of them the probability
    that a cycle which returns at a uniform moment of `start … stop` fires there first.

    A return after the end of the period counts for nothing, for every cycle is armed afresh then.
    """
    n = len(flux)
    # Without slack, rounding of an edge would add an empty piece.
    slack = 1e-9 * (stop - start)
    per_length = 1.0 / (stop - start)
    back, k = 0.0, 0
    while True:
        low, high, x = edges[first + k], edges[first + k + 1], flux[first + k]
        begin, end = max(start, low), min(stop, high)
        share = max(end - begin, 0.0) * per_length
        early = fires_early(x, (high - end) / (high - low), (high - begin) / (high - low)) if x > 0.0 else 0.0
        # It returned before this piece and has not fired yet, or it returns within it.
        out[k] = back * fires[first + k] + share * early
        back += share - out[k]
        k += 1
        if stop <= high + slack or first + k >= n:
            return k


def draw_cycle_ensemble(state: Equilibrium, cycles: int, rng: Generator) -> Ints:
    """(n,) free-running counts at a cost that does not depend on the exposure; exact in the mean only.

    The exposure is split into independent runs of `_RUN_CYCLES` cycles (more if the dead time spans cycles), each of
    which begins in equilibrium. The correlation between runs is lost, so the total fluctuates a little too much. All
    runs pass through the chain together, as one long cycle. A dead time is put before that cycle, in which the last
    detection before each run is drawn as in equilibrium. The state's pieces must be shorter than the dead time.
    """
    pieces, bins = state.pieces, len(state.flux)
    period = float(pieces.edges[-1])
    before, before_edges = _flux_before(state)
    together = min(_RUN_CYCLES * (int(pieces.dead_time // period) + 1), cycles)
    runs, rest = divmod(cycles, together)
    counts = np.zeros(bins, np.int64)
    for many, length in ((runs, together), (1, rest)):
        if length == 0:
            continue
        later = pieces.dead_time + period * np.arange(length)[:, None] + pieces.edges[1:]
        long = Pieces(
            np.concatenate([before, np.tile(pieces.flux, length)]),
            # Detections before the run go into a bin of their own, which is left out.
            np.concatenate([np.full(len(before), bins), np.tile(pieces.bin_of, length)]),
            np.concatenate([before_edges, later.reshape(-1)]),
            pieces.dead_time,
        )
        counts += draw_return_chain(long, bins + 1, many, rng)[:bins]
    return counts


def _flux_before(state: Equilibrium) -> tuple[Floats, Floats]:
    """(m,) flux and (m,) ends of the pieces of a dead time that ends at phase 0, counted from its start.

    A diode armed at its start fires at most once in it, and this flux makes it fire with the density of detections
    that a diode in equilibrium has.
    """
    edges, dead_time = state.pieces.edges, state.pieces.dead_time
    period = float(edges[-1])
    laps = int(np.ceil(dead_time / period))
    ends = dead_time + (period * (np.arange(laps)[:, None] - laps) + edges[1:]).reshape(-1)
    starts = np.concatenate([[dead_time - laps * period], ends[:-1]])
    inside = ends > 1e-12 * period
    share = np.minimum((ends / (ends - starts))[inside], 1.0)
    fired = np.tile(state.detections, laps)[inside] * share
    armed = 1.0 - (np.cumsum(fired) - fired)
    hazard = np.divide(fired, armed, out=np.zeros_like(fired), where=armed > 0)
    return -np.log1p(-np.clip(hazard, 0.0, 1.0 - 1e-16)), np.append(0.0, ends[inside])
