"""Free-running counting in equilibrium, in the mean: the recursion of `renewal` with periodic indices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.detector.renewal import Array, Pieces, Table, pieces_of, return_table, run_cycle

_SWEEPS = 24
_SETTLED = 1e-13

FOR_A_START = 1e-8
"""Change of a sweep at which the state is settled enough to begin an exposure in: 10⁻⁸ detections, once."""


@dataclass(frozen=True)
class Equilibrium:
    """A free-running detector long after it was switched on.

    detections : (m,) expected detections per cycle and piece; armed : probability to be armed at phase 0.
    """

    pieces: Pieces
    detections: Array
    armed: float
    bins: int

    @property
    def mean(self) -> Array:
        """(n,) expected detections per cycle and bin."""
        return self.pieces.per_bin(self.detections, self.bins)


def equilibrium(
    flux: Array, edges_s: Array, width_s: float, dead_time_s: float, *, shorter_than_dead_time: bool = False,
    settled: float = _SETTLED,
) -> Equilibrium:  # fmt: skip
    """Expected detections per cycle of a free-running detector, dead time of any length.

    Whole periods in τ = m T_r + τ′ only rescale: D = X / (1 + m ΣX) with X the answer for τ′. X is the fixed point of
    one cycle's recursion: found by sweeps from near equilibrium, which a moderate flux settles at once, or else by a
    sparse solution of its linear equations (where a high flux keeps detections in step for very many cycles).

    Parameters
    ----------
    flux, edges_s : (n,) events per cycle and bin, (n + 1,) bin edges from 0 to the period.
    width_s : bins longer than this are background, cut more finely.
    shorter_than_dead_time : whether pieces must be shorter than the dead time, as `draw_cycle_ensemble` needs them.
    settled : change of a sweep, in detections per cycle, at which the fixed point is taken as found.
    """
    period = float(edges_s[-1])
    whole = int(np.floor(dead_time_s / period * (1 + 1e-15)))
    rest = max(dead_time_s - whole * period, 0.0)
    if rest < 1e-9 * width_s:
        rest = 0.0
    cut = shorter_than_dead_time and whole == 0
    pieces = pieces_of(flux, edges_s, width_s, rest, shorter_than_dead_time=cut)
    most = float(most_in_window(flux, edges_s, rest))
    detections = _fixed_point(pieces, most, settled) if rest > 0.0 else pieces.flux
    scale = 1.0 / (1.0 + whole * float(detections.sum()))
    detections = detections * scale
    dead = whole * float(detections.sum()) + _tail_sum(pieces.edges, detections, rest)
    return Equilibrium(
        Pieces(pieces.flux, pieces.bin_of, pieces.edges, dead_time_s), detections, max(1.0 - dead, 0.0), len(flux)
    )


def _tail_sum(edges: Array, values: Array, length: float) -> float:
    """Sum of piecewise uniform `values` over the last `length` of the period."""
    if length <= 0:
        return 0.0
    cumulative = np.append(0.0, np.cumsum(values))
    return float(cumulative[-1] - np.interp(edges[-1] - length, edges, cumulative))


def _fixed_point(pieces: Pieces, most: float, settled: float) -> Array:
    """(m,) detections per cycle that one cycle hands on to the next unchanged, dead time below a period."""
    table = return_table(pieces.flux, pieces.edges, pieces.dead_time)
    m = len(pieces.flux)
    # Near equilibrium: every piece scaled alike, by what keeps the detector's dead share below 1.
    returning = np.zeros(m + 1)
    _push_returns(pieces.flux / (1.0 + most), table, returning)
    armed = max(1.0 - returning.sum(), 0.0)
    scale = armed + returning.sum()
    armed, returning = armed / scale, returning / scale
    for _ in range(_SWEEPS):
        following = np.zeros(m + 1)
        detections, armed_after = run_cycle(table, armed, returning.copy(), following)
        change = abs(armed_after - armed) + np.abs(following - returning).sum()
        armed, returning = armed_after, following
        if change < settled:
            return detections
    return _solve(table)


def _solve(table: Table) -> Array:
    """The fixed point from A_{i+1} − A_i + D_i − Σ_k w_{k→i+1} D_k = 0 with D_k = g_k A_k.

    These add up to 0 = 0, so one of them makes room for the sum of all shares, armed or due to return, being 1. The
    equations couple neighbours and pieces a dead time apart, a narrow helix, so that elimination stays cheap.
    """
    m = len(table[0])
    rows, columns, values, gain, pending = _equations(table)
    ones = np.append(1.0, np.zeros(m - 1)) + pending
    keep = rows != m - 1
    tail = np.flatnonzero(ones)
    rows = np.concatenate([rows[keep], np.full(len(tail), m - 1)])
    columns = np.concatenate([columns[keep], tail])
    values = np.concatenate([values[keep], ones[tail]])
    # Here, because few ever need them, and they take long to import.
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    matrix = csc_matrix((values, (rows, columns)), shape=(m, m))
    right = np.zeros(m)
    right[-1] = 1.0
    armed: Array = splu(matrix).solve(right)
    return gain * np.maximum(armed, 0.0)


@compiled()
def _equations(table: Table) -> tuple[NDArray[np.int64], NDArray[np.int64], Array, Array, Array]:
    """Entries (row, column, value) of the equations for A, the gains g, and each A's share due beyond piece 0."""
    q, first, offset, weights = table
    m = len(q)
    size = 3 * m + len(weights)
    rows, columns, values = np.empty(size, np.int64), np.empty(size, np.int64), np.empty(size)
    gain, pending = np.zeros(m), np.zeros(m)
    used = 0
    for i in range(m):
        # Row j holds the equation for A_{j+1}; row m − 1 that for A_0 of the next cycle.
        rows[used], columns[used], values[used] = i, i, -1.0
        rows[used + 1], columns[used + 1], values[used + 1] = i, (i + 1) % m, 1.0
        used += 2
        if q[i] <= 0.0:
            continue
        start = offset[i]
        itself = weights[start] if first[i] == i else 0.0
        gain[i] = q[i] / (1.0 - itself * q[i])
        rows[used], columns[used], values[used] = i, i, gain[i] * (1.0 - itself)
        used += 1
        for k in range(1 if first[i] == i else 0, offset[i + 1] - start):
            due = weights[start + k] * gain[i]
            rows[used], columns[used], values[used] = (first[i] + k - 1) % m, i, -due
            used += 1
            if first[i] + k > m:
                pending[i] += due
    return rows[:used], columns[:used], values[:used], gain, pending


def most_in_window(flux: Array, edges: Array, length: float) -> Array:
    """(…,) the most flux (…, n) in any interval of `length` < period seconds, across the end of the period too."""
    period = edges[-1]
    # The integral over a sliding interval is piecewise linear: it peaks where one of its ends meets an edge. What
    # intervals that end at an edge leave of the period starts there.
    ahead, behind = _places(edges[:-1] + length, edges), _places(edges[:-1] + (period - length), edges)
    rows = np.ascontiguousarray(flux.reshape(-1, flux.shape[-1]))
    return _most(rows, *ahead, *behind).reshape(flux.shape[:-1])


def _places(times: Array, edges: Array) -> tuple[NDArray[np.int64], Array, Array]:
    """Bins of `times` < two periods, the shares of the bins before them, and 1 in the next period, 0 in this one."""
    late = times >= edges[-1]
    phase = times - np.where(late, edges[-1], 0.0)
    bins = np.clip(np.searchsorted(edges, phase, side="right") - 1, 0, len(edges) - 2)
    return bins, np.clip((phase - edges[bins]) / np.diff(edges)[bins], 0.0, 1.0), late.astype(np.float64)


@compiled()
def _most(
    flux: Array, ahead: NDArray[np.int64], ahead_share: Array, ahead_late: Array, behind: NDArray[np.int64],
    behind_share: Array, behind_late: Array,
) -> Array:  # fmt: skip
    rows, n = flux.shape
    out, before = np.zeros(rows), np.zeros(n + 1)
    for r in range(rows):
        for i in range(n):
            before[i + 1] = before[i] + flux[r, i]
        total, most, least = before[n], 0.0, before[n]
        for i in range(n):
            j, k = ahead[i], behind[i]
            until = before[j] + ahead_share[i] * flux[r, j] + ahead_late[i] * total
            most = max(most, until - before[i])
            until = before[k] + behind_share[i] * flux[r, k] + behind_late[i] * total
            least = min(least, until - before[i])
        out[r] = float(most) if most > total - least else float(total - least)
    return out


@compiled()
def _push_returns(detections: Array, table: Table, following: Array) -> None:
    """Returns due in the next cycle, were `detections` those of this one."""
    q, first, offset, weights = table
    m = len(q)
    for i in range(m):
        for k in range(offset[i], offset[i + 1]):
            where = first[i] + k - offset[i]
            if where >= m:
                following[where - m] += weights[k] * detections[i]
