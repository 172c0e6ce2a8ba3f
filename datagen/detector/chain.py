"""Counting all cycles of an exposure at once, bin after bin (cases b and d, and their use for free running).

Cycles are exchangeable, so only the number of them in each state matters. In bin i each of the armed ones fires with
q_i = −expm1(−λ_i). Cost per histogram does not depend on the number of cycles.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from datagen.detector.binomials import binomial
from datagen.detector.equilibrium import Equilibrium
from datagen.detector.renewal import Pieces, Table, early_share, return_table

Flux = NDArray[np.float64]
Counts = NDArray[np.int64]


@numba.njit(cache=True, error_model="numpy")
def draw_hazard_chain(flux: Flux, cycles: int, rng: np.random.Generator) -> Counts:
    """At most one detection in a cycle: n_i ~ Binomial(R, q_i), R ← R − n_i, from R = `cycles`.

    The law is the multinomial with p_i = q_i exp(−Λ_{i−1}), without its sum that rounding may push beyond 1; right
    for λ from 1e-300 to infinity.
    """
    counts = np.zeros(len(flux), np.int64)
    left = cycles
    for i in range(len(flux)):
        counts[i] = binomial(left, -np.expm1(-flux[i]), rng)
        left -= counts[i]
    return counts


@numba.njit(cache=True, error_model="numpy")
def draw_return_chain(pieces: Pieces, bins: int, cycles: int, rng: np.random.Generator) -> Counts:
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
        fired = binomial(armed, fires[i], rng)
        armed -= fired
        fired += firing[i]
        if fired == 0:
            continue
        counts[bin_of[i]] += fired
        if first[i] == n:
            continue
        left = binomial(fired, soon[i], rng)
        arming[after[i]] += fired - left
        if left == 0:
            continue
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


@numba.njit(cache=True, error_model="numpy")
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


@numba.njit(cache=True, error_model="numpy")
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


def draw_cycle_ensemble(
    state: Equilibrium, bins: int, cycles: int, rng: np.random.Generator, together: int = 64
) -> Counts:
    """Free-running counts at a cost that does not depend on the exposure; exact in the mean only.

    The exposure is taken as independent runs of `together` cycles (more if the dead time spans cycles), each begun
    in equilibrium; lost is the correlation between runs, so that the total fluctuates a little too much.
    """
    pieces = state.pieces
    period = float(pieces.edges[-1])
    whole = int(pieces.dead_time // period)
    table = return_table(pieces.flux, pieces.edges, pieces.dead_time - whole * period)
    length = min(together * (whole + 1), cycles)
    runs, rest = divmod(cycles, length)
    pending = _pending(state.detections, table, whole)
    counts = _ensemble(table, pieces.bin_of, whole, pending, bins, runs, length, rng)
    if rest:
        counts += _ensemble(table, pieces.bin_of, whole, pending, bins, 1, rest, rng)
    return counts


@numba.njit(cache=True)
def _pending(detections: Flux, table: Table, whole: int) -> Flux:
    """(whole + 2, m) probability, in equilibrium at phase 0, to be due back in a piece of a coming cycle."""
    q, first, offset, weights = table
    m = len(q)
    pending = np.zeros((whole + 2, m))
    for i in range(m):
        if detections[i] <= 0.0:
            continue
        for k in range(offset[i + 1] - offset[i]):
            where = first[i] + k
            lap = where // m
            # Detections of every earlier cycle that is still due.
            for ahead in range(whole + lap):
                pending[ahead, where - lap * m] += weights[offset[i] + k] * detections[i]
    return pending


@numba.njit(cache=True)
def _ensemble(
    table: Table, bin_of: Counts, whole: int, pending: Flux, bins: int, runs: int, length: int,
    rng: np.random.Generator,
) -> Counts:  # fmt: skip
    q, first, offset, weights = table
    m = len(q)
    ring = whole + 3
    counts = np.zeros(bins, np.int64)
    returning = np.zeros((ring, m), np.int64)
    armed, free = runs, 1.0
    for lap in range(len(pending)):
        for i in range(m):
            if pending[lap, i] > 0.0 and armed > 0:
                returning[lap, i] = binomial(armed, min(pending[lap, i] / free, 1.0), rng)
                armed -= returning[lap, i]
                free -= pending[lap, i]
    for cycle in range(length):
        slot = cycle % ring
        for i in range(m):
            armed += returning[slot, i]
            returning[slot, i] = 0
            if armed == 0 or q[i] <= 0.0:
                continue
            fired = binomial(armed, q[i], rng)
            if fired == 0:
                continue
            armed -= fired
            counts[bin_of[i]] += fired
            left, rest, count = fired, 1.0, offset[i + 1] - offset[i]
            for k in range(count):
                if left == 0:
                    break
                weight = weights[offset[i] + k]
                moved = left if k == count - 1 else binomial(left, min(weight / rest, 1.0), rng)
                where = first[i] + k
                lap = where // m
                returning[(cycle + whole + lap) % ring, where - lap * m] += moved
                left -= moved
                rest -= weight
    return counts
