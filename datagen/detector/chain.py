"""Counting all cycles of an exposure at once, in the order of phase (cases b and d, and their use for free running).

Cycles are exchangeable, so only the number of them in each state matters. Few detections are drawn one by one
(`draw_in_order`); many bin after bin, where in bin i each of the armed cycles fires with q_i = −expm1(−λ_i), at a
cost that does not depend on their number.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.detector.dead_time import Equilibrium, Pieces, early_share
from datagen.detector.random_numbers import Stream, binomial, exponential

Flux = NDArray[np.float64]
Counts = NDArray[np.int64]

_TOGETHER = 64
"""Cycles of a run of the ensemble: with half as many the variance of a total, 10 % too large at worst, is off by
twice as much, and the time is halved."""


@compiled()
def draw_in_order(flux: Flux, edges: Flux, dead_time: float, cycles: int, streams: Stream) -> Counts:
    """(h, n) detections of synchronous detectors with flux (h, n), detection by detection.

    While R cycles are armed they fire together at the rate R λ(t): the next detection is where ∫ R dΛ has grown by
    Exp(1), which leaves R − 1 until a dead time later. Exact for a dead time of any length, at the cost of a passage
    through the bins and an exponential number for each detection.

    edges : (n + 1,) of the bins, in the unit of `dead_time`; streams : (h, 4).
    """
    rows, n = flux.shape
    counts = np.zeros((rows, n), np.int64)
    # Moments at which dead cycles are armed again: first in, first out.
    due = np.empty(256)
    for r in range(rows):
        stream = streams[r]
        armed, head, tail = float(cycles), 0, 0
        ahead = exponential(stream)
        for i in range(n):
            # Beyond the cap every armed cycle fires at once, as with it.
            events, start, stop = min(flux[r, i], 1e200), edges[i], edges[i + 1]
            if armed * events < ahead and (head == tail or due[head] >= stop):
                ahead -= armed * events
                continue
            if events == 0.0:
                # Whoever returns here is armed from the next bin on: the same.
                while head < tail and due[head] < stop:
                    armed += 1.0
                    head += 1
                continue
            rate, t = events / (stop - start), start
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
                ahead = exponential(stream)
                if t + dead_time < edges[n]:
                    if tail == len(due):
                        # What has returned makes room, or else there is to be more of it.
                        longer = due if 2 * head > tail else np.empty(2 * len(due))
                        for k in range(tail - head):
                            longer[k] = due[head + k]
                        due, head, tail = longer, 0, tail - head
                    due[tail] = t + dead_time
                    tail += 1
    return counts


@compiled()
def draw_hazard_chain(flux: Flux, cycles: int, stream: Stream) -> Counts:
    """At most one detection in a cycle: n_i ~ Binomial(R, q_i), R ← R − n_i, from R = `cycles`.

    The law is the multinomial with p_i = q_i exp(−Λ_{i−1}), without its sum that rounding may push beyond 1; right
    for λ from 1e-300 to infinity.
    """
    counts = np.zeros(len(flux), np.int64)
    left = cycles
    for i in range(len(flux)):
        counts[i] = binomial(left, -np.expm1(-flux[i]), stream)
        left -= counts[i]
    return counts


@compiled()
def draw_return_chain(pieces: Pieces, bins: int, cycles: int, stream: Stream) -> Counts:
    """Several detections in a cycle: those that fired come back after the dead time and can fire again.

    A detection is uniform within its piece (`renewal.PIECE_FLUX` keeps it so), hence its return in the piece shifted
    by the dead time. Where in the few pieces that it touches they come back need not be drawn: how many fire
    there decides one rare binomial, and all others are armed from the next piece on. Pieces must be shorter than
    the dead time.
    """
    flux, bin_of, edges, dead_time = pieces
    fires, soon, first, after = _windows(flux, edges, dead_time)
    n = len(flux)
    counts = np.zeros(bins, np.int64)
    # Decided ahead for each piece: how many just returned fire in it, how many are armed from its start on.
    firing, arming = np.zeros(n, np.int64), np.zeros(n + 1, np.int64)
    hazards = np.empty(n + 3)
    armed = cycles
    for i in range(n):
        armed += arming[i]
        fired = binomial(armed, fires[i], stream)
        armed -= fired
        # Those that were found to fire right upon their return, when they fired before.
        fired += firing[i]
        if fired == 0:
            continue
        counts[bin_of[i]] += fired
        if first[i] == n:
            continue
        left = binomial(fired, soon[i], stream)
        arming[after[i]] += fired - left
        if left == 0:
            continue
        rest = soon[i]
        count = _hazards(edges[i] + dead_time, edges[i + 1] + dead_time, first[i], flux, fires, edges, hazards)
        for k in range(count):
            again = left if k == count - 1 else binomial(left, hazards[k] / rest, stream)
            firing[first[i] + k] += again
            left -= again
            rest -= hazards[k]
            if left == 0:
                break
    return counts


@compiled()
def _windows(flux: Flux, edges: Flux, dead_time: float) -> tuple[Flux, Flux, Counts, Counts]:
    """For each piece: the chance q to fire in it if armed, and then that to fire again right upon the return.

    The latter is meant for pieces `first … after − 1`, in which one returns; `first` is the number of pieces where
    that is after the end of the cycle.
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
def _hazards(start: float, stop: float, first: int, flux: Flux, fires: Flux, edges: Flux, out: Flux) -> int:
    """Chance to fire in pieces `first`, `first + 1`, … of who returns at a uniform moment of `start … stop`.

    They are put into `out`, and the number of these pieces is returned. What returns after the end of the cycle is
    of no use to it.
    """
    n = len(flux)
    slack = 1e-9 * (stop - start)
    per_length = 1.0 / (stop - start)
    back, k = 0.0, 0
    while True:
        low, high, x = edges[first + k], edges[first + k + 1], flux[first + k]
        begin, end = max(start, low), min(stop, high)
        share = max(end - begin, 0.0) * per_length
        early = early_share(x, (high - end) / (high - low), (high - begin) / (high - low)) if x > 0.0 else 0.0
        out[k] = back * fires[first + k] + share * early
        back += share - out[k]
        k += 1
        if stop <= high + slack or first + k >= n:
            return k


def draw_cycle_ensemble(state: Equilibrium, cycles: int, stream: Stream) -> Counts:
    """(n,) free-running counts at a cost that does not depend on the exposure; exact in the mean only.

    The exposure is taken as independent runs of `_TOGETHER` cycles (more if the dead time spans cycles), each begun
    in equilibrium; lost is the correlation between runs, so that the total fluctuates a little too much. All runs go
    through the chain together, as one long cycle: before it lies a dead time in which the last detection of each run
    falls as it does in equilibrium. The state's pieces must be shorter than the dead time.
    """
    pieces, bins = state.pieces, len(state.flux)
    period = float(pieces.edges[-1])
    before, before_edges = _last_detection(state)
    together = min(_TOGETHER * (int(pieces.dead_time // period) + 1), cycles)
    runs, rest = divmod(cycles, together)
    counts = np.zeros(bins, np.int64)
    for many, length in ((runs, together), (1, rest)):
        if length == 0:
            continue
        later = pieces.dead_time + period * np.arange(length)[:, None] + pieces.edges[1:]
        long = Pieces(
            np.concatenate([before, np.tile(pieces.flux, length)]),
            # What is detected before the run goes into a bin of its own, which is left out.
            np.concatenate([np.full(len(before), bins), np.tile(pieces.bin_of, length)]),
            np.concatenate([before_edges, later.reshape(-1)]),
            pieces.dead_time,
        )
        counts += draw_return_chain(long, bins + 1, many, stream)[:bins]
    return counts


def _last_detection(state: Equilibrium) -> tuple[Flux, Flux]:
    """Flux and edges of a dead time in which a diode armed at its start fires as one in equilibrium does: at most
    once, with the density of its detections. It ends at phase 0; edges count from its start."""
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
