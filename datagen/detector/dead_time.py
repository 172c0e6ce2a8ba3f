"""The expected detections under a non-paralyzable dead time, from the share of cycles whose diode is armed.

Bins are cut into pieces of at most `PIECE_FLUX` events. With A_i the share of cycles that are armed for piece i,

    D_i = q_i A_i,   A_{i+1} = A_i − D_i + Σ_k w_{k → i+1} D_k,   q_i = −expm1(−λ_i).

A diode that fired in piece k is armed again a dead time later. Its detection is uniform in piece k, so its return is
uniform in the shifted piece, and w_{k → i} is the share of it that counts as armed from piece i on. For equal pieces
and small λ the weights are (1−f)²/2, ½+f−f², f²/2 at d, d+1, d+2 pieces, τ = d + f.
A synchronous detector starts every cycle armed. A free-running one hands its state on to the next cycle; its mean is
the state that no longer changes (`equilibrium`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.detector.flux import cut_edges
from datagen.errors import InputError
from datagen.records.arrays import Floats, Ints

PIECE_FLUX = 0.0125
"""Most events in a piece, within which the slope of the detections is neglected: an error of second order, which
stays invisible in 10⁸ cycles."""
_FLUX_PIECES = 16_384
"""At a flux of hundreds and more per cycle a piece may carry this part of the whole instead, to bound the time."""
_LONG_PIECE_FLUX = 0.002
"""Most events in a piece of a long background bin, in which detections may start or end abruptly."""
_MOST_PIECES = 4_000_000
"""Most pieces of a period: 0.2 GB of arrays."""
_SWEEPS = 24
"""Cycles after which an equilibrium that still changes is solved for as linear equations. A moderate flux settles in
three or four; several events a cycle keep detections in step for hundreds."""
_SETTLED = 1e-13
"""Change from one cycle to the next, in detections, at which a mean has settled: the rounding of a cycle's sums."""


class Pieces(NamedTuple):
    """The bins of a period cut into m pieces: (m,) flux and bin number, (m + 1,) edges and the dead time, seconds."""

    flux: Floats
    bin_of: Ints
    edges: Floats
    dead_time: float

    def per_bin(self, values: Floats, bins: int) -> Floats:
        """(bins,) sums of the pieces' values (m,) over each bin."""
        return np.bincount(self.bin_of, values, bins).astype(np.float64)


def pieces_of(
    flux: Floats, edges_s: Floats, width_s: float, dead_time_s: float, *, shorter_than_dead_time: bool = False
) -> Pieces:
    """The pieces of a period's bins. Bins longer than `width_s` are background, and are cut more finely.

    flux, edges_s : (n,) events per cycle and bin, (n + 1,) bin edges. Raises `InputError` for too many pieces.
    """
    length, total = np.diff(edges_s), float(flux.sum())
    most = max(PIECE_FLUX, total / _FLUX_PIECES)
    is_long = length > 1.5 * width_s
    # Returns from the bright window fall into a long bin, so that its pieces must also be short beside the dead time.
    short = np.minimum(np.ceil(4.0 * length / dead_time_s), 4096.0) if dead_time_s > 0.0 else np.ones(len(flux))
    parts = np.where(is_long, np.maximum(np.ceil(flux / min(_LONG_PIECE_FLUX, most)), short), np.ceil(flux / most))
    if shorter_than_dead_time:
        parts = np.maximum(parts, np.ceil(length / dead_time_s * (1.0 + 1e-12)))
    count = np.maximum(parts, 1.0)
    if not count.sum() <= _MOST_PIECES:
        raise InputError(
            f"flux of {total:g} per cycle, dead time {dead_time_s:g} s on {len(flux)} bins of {width_s:g} s: "
            f"needs {count.sum():g} pieces, at most {_MOST_PIECES}; lower photons_per_pulse or widen the bins"
        )
    if count.max() == 1.0:
        # Kernels would be compiled once more for edges that are read-only, as those of a `Cycle` are.
        return Pieces(np.ascontiguousarray(flux), np.arange(len(flux)), edges_s.copy(), dead_time_s)
    whole = count.astype(np.int64)
    bin_of = np.repeat(np.arange(len(flux)), whole)
    return Pieces((flux / whole)[bin_of], bin_of, cut_edges(edges_s, whole), dead_time_s)


def synchronous_mean(flux: Floats, edges_s: Floats, width_s: float, dead_time_s: float) -> Floats:
    """(…, n) expected detections per cycle and bin when every cycle starts armed.

    flux, edges_s : (…, n) events per cycle and bin, (n + 1,) bin edges from 0 to the period. Raises `InputError`
    where that takes too many pieces.
    """
    dead_time_s = min(dead_time_s, float(edges_s[-1]))
    rows = np.ascontiguousarray(flux).reshape(-1, flux.shape[-1])
    out = np.empty_like(rows)
    for row, own in enumerate(rows):
        pieces = pieces_of(own, edges_s, width_s, dead_time_s)
        none = np.zeros(len(pieces.flux) + 1)
        table = return_table(pieces.flux, pieces.edges, dead_time_s)
        out[row] = pieces.per_bin(run_cycle(table, 1.0, none, none.copy())[0], len(own))
    return out.reshape(flux.shape)


@compiled()
def fires_early(x: float, low: float, high: float) -> float:
    """Probability that a diode fires in the piece of flux x within which it is armed again.

    The share ρ of the piece that then lies ahead is uniform in `low … high`: this is the mean of 1 − e^{−xρ}.
    """
    middle, half = 0.5 * (high + low), 0.5 * (high - low)
    if x < 1e-3:
        # The closed form cancels here; the series is good to 10⁻¹⁰.
        square, cube = middle * middle + half * half / 3.0, middle * (middle * middle + half * half)
        return x * (middle - x * (0.5 * square - x * cube / 6.0))
    argument = x * half
    mean = 1.0 if argument < 1e-6 else np.sinh(argument) / argument
    return float(1.0 - np.exp(-x * middle) * mean)


@compiled()
def _return_weights(start: float, stop: float, first: int, edges: Floats, flux: Floats, weights: Floats) -> int:
    """Number of pieces, from `first` on, at whose start a return that is uniform in `start … stop` counts as armed;
    their weights are put into `weights`.

    A diode that returns within a piece and fires there with probability e is like one that is armed at the piece's
    start with probability e / (1 − e^{−x}), and otherwise at the next piece's start. Piece numbers run on past the
    end of the period into the next one.
    """
    m = len(flux)
    period = edges[m]
    weights[0] = 0.0
    k = 0
    while True:
        index, lap = first + k, 0.0
        if index >= m:
            index, lap = index - m, period
        low, high, x = edges[index] + lap, edges[index + 1] + lap, flux[index]
        share = max((min(stop, high) - max(start, low)) / (stop - start), 0.0)
        ahead = 0.0
        if x > 0.0 and share > 0.0:
            early = fires_early(x, (high - min(stop, high)) / (high - low), (high - max(start, low)) / (high - low))
            ahead = early / -np.expm1(-x) if early > 0.0 else 0.0
        weights[k] += share * ahead
        weights[k + 1] = share * (1.0 - ahead)
        k += 1
        if stop <= high or k >= m:
            return k + 1


Table = tuple[Floats, Ints, Ints, Floats]


@compiled()
def return_table(flux: Floats, edges: Floats, dead_time: float) -> Table:
    """The table by which `run_cycle` takes detections to their returns: (q, first, offset, weights).

    q : (m,) probability that an armed diode fires in a piece. A diode that fired in piece i returns to pieces
    `first[i]`, `first[i] + 1`, … with the weights `weights[offset[i]:offset[i + 1]]`; none where the flux is 0.
    """
    m = len(flux)
    period = edges[m]
    q, first, offset = np.zeros(m), np.zeros(m, np.int64), np.zeros(m + 1, np.int64)
    # The shifted pieces cross m edges in all; each may end within a piece, which adds two weights and a margin.
    weights = np.empty(5 * m + 64)
    here = np.empty(m + 3)
    target = 0
    for i in range(m):
        offset[i + 1] = offset[i]
        if flux[i] <= 0.0:
            continue
        # Pieces and their returns come in the same order, so that the target never moves back.
        while target < 2 * m and _edge_at(edges, target + 1, m, period) <= edges[i] + dead_time:
            target += 1
        count = _return_weights(edges[i] + dead_time, edges[i + 1] + dead_time, target, edges, flux, here)
        q[i], first[i] = -np.expm1(-flux[i]), target
        for k in range(count):
            weights[offset[i] + k] = here[k]
        offset[i + 1] += count
    return q, first, offset, weights[: offset[m]]


@compiled()
def run_cycle(table: Table, armed: float, returning: Floats, following: Floats) -> tuple[Floats, float]:
    """(m,) detections per piece in one cycle, and the share of diodes armed at its end.

    armed : the share at its start. returning : (m + 1,) shares that are armed again at the start of each piece, to
    which this cycle's own returns are added. following : (m + 1,) the same of the next cycle, likewise.
    """
    q, first, offset, weights = table
    m = len(q)
    detections = np.zeros(m)
    for i in range(m):
        armed += returning[i]
        # Where nothing can happen the state is carried on unchanged.
        if q[i] <= 0.0:
            continue
        fired = armed * q[i]
        start = offset[i]
        if first[i] == i:
            # A dead time shorter than the piece: some return within it and may fire again, a geometric series.
            fired /= 1.0 - weights[start] * q[i]
            armed += weights[start] * fired
        detections[i] = fired
        armed -= fired
        for k in range(1 if first[i] == i else 0, offset[i + 1] - start):
            # Returns after the end of this cycle are left to the next one.
            where = first[i] + k
            if where < m:
                returning[where] += weights[start + k] * fired
            else:
                following[where - m] += weights[start + k] * fired
    following[0] += returning[m]
    return detections, armed


@compiled()
def _edge_at(edges: Floats, index: int, m: int, period: float) -> float:
    """Seconds of edge number `index`, which may run past the end of the period."""
    return float(edges[index] if index <= m else edges[index - m] + period)


@dataclass(frozen=True)
class Equilibrium:
    """The state of a free-running detector long after it was switched on.

    flux : (n,) events per cycle and bin. pieces : the bins cut into pieces, and the dead time.
    detections : (m,) expected detections per cycle and piece.
    armed : probability that the diode is armed at phase 0.
    """

    flux: Floats
    pieces: Pieces
    detections: Floats
    armed: float

    @property
    def mean(self) -> Floats:
        """(n,) expected detections per cycle and bin."""
        return self.pieces.per_bin(self.detections, len(self.flux))


def equilibrium(flux: Floats, edges_s: Floats, width_s: float, dead_time_s: float) -> Equilibrium:
    """The equilibrium of a free-running detector with a dead time of any length.

    Whole periods in τ = m T_r + τ′ only rescale: D = X / (1 + m ΣX) with X the answer for τ′. X is the fixed point of
    one cycle's recursion. A moderate flux reaches it in a few cycles from a guess near equilibrium. A high flux keeps
    detections in step for very many cycles, so its fixed point is found from sparse linear equations.

    flux, edges_s : (n,) events per cycle and bin, (n + 1,) bin edges from 0 to the period.
    width_s : bins longer than this are background, cut more finely.
    """
    period = float(edges_s[-1])
    whole = int(np.floor(dead_time_s / period * (1 + 1e-15)))
    rest = max(dead_time_s - whole * period, 0.0)
    if rest < 1e-9 * width_s:
        rest = 0.0
    pieces = pieces_of(flux, edges_s, width_s, rest)
    most = float(most_in_window(flux, edges_s, rest))
    detections = _fixed_point(pieces, most) if rest > 0.0 else pieces.flux
    scale = 1.0 / (1.0 + whole * float(detections.sum()))
    detections = detections * scale
    # A diode is dead at phase 0 if it fired within the last dead time.
    dead = whole * float(detections.sum()) + _tail_sum(pieces.edges, detections, rest)
    long = Pieces(pieces.flux, pieces.bin_of, pieces.edges, dead_time_s)
    return Equilibrium(flux, long, detections, max(1.0 - dead, 0.0))


def _tail_sum(edges: Floats, values: Floats, length: float) -> float:
    """Sum of piecewise uniform `values` over the last `length` of the period."""
    if length <= 0:
        return 0.0
    cumulative = np.append(0.0, np.cumsum(values))
    return float(cumulative[-1] - np.interp(edges[-1] - length, edges, cumulative))


def _fixed_point(pieces: Pieces, most: float) -> Floats:
    """(m,) detections per cycle and piece in equilibrium, for a dead time shorter than the period.

    most : the most flux in any interval of the dead time.
    """
    table = return_table(pieces.flux, pieces.edges, pieces.dead_time)
    m = len(pieces.flux)
    # The first guess scales every piece alike, so that the share of dead diodes stays below 1.
    start = pieces.flux / (1.0 + most)
    piece, due_in = _returns(table)
    late = due_in >= m
    due = table[3][late] * start[piece[late]]
    returning: Floats = np.bincount(due_in[late] - m, due, m + 1).astype(np.float64)
    armed = max(1.0 - returning.sum(), 0.0)
    scale = armed + returning.sum()
    armed, returning = armed / scale, returning / scale
    for _ in range(_SWEEPS):
        following = np.zeros(m + 1)
        detections, armed_after = run_cycle(table, armed, returning.copy(), following)
        change = abs(armed_after - armed) + np.abs(following - returning).sum()
        armed, returning = armed_after, following
        if change < _SETTLED:
            return detections
    return _solve(table)


def _solve(table: Table) -> Floats:
    """(m,) detections of the fixed point, from A_{i+1} − A_i + D_i − Σ_k w_{k→i+1} D_k = 0 with D_k = g_k A_k.

    These equations add up to 0 = 0, so one of them is replaced: all shares, armed or due to return, add up to 1. The
    equations couple neighbours, and pieces a dead time apart, so that sparse elimination stays cheap.
    """
    q, _, _, weights = table
    m = len(q)
    piece, due_in = _returns(table)
    number, following = np.arange(m), (np.arange(m) + 1) % m
    # A diode that fired in a piece may return within it and fire again: a geometric series.
    at_once = due_in == piece
    itself = np.bincount(piece[at_once], weights[at_once], m)
    gain = q / (1.0 - itself * q)
    due = (weights * gain[piece])[~at_once]
    piece, due_in = piece[~at_once], due_in[~at_once]
    # Row j holds the equation for A_{j+1}; row m − 1, which would be that for A_0, holds the sum of all shares.
    rows = np.concatenate([number, number, number, (due_in - 1) % m])
    columns = np.concatenate([number, following, number, piece])
    values = np.concatenate([-np.ones(m), np.ones(m), gain * (1.0 - itself), -due])
    keep = rows != m - 1
    shares = np.bincount(piece, due * (due_in > m), m)
    shares[0] += 1.0
    counted = np.flatnonzero(shares)
    rows, columns = np.append(rows[keep], np.full(len(counted), m - 1)), np.append(columns[keep], counted)
    values = np.append(values[keep], shares[counted])
    # Imported here, because few calls need them and the import takes long.
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    matrix = csc_matrix((values, (rows, columns)), shape=(m, m))
    right = np.zeros(m)
    right[-1] = 1.0
    armed: Floats = splu(matrix).solve(right)
    return gain * np.maximum(armed, 0.0)


def _returns(table: Table) -> tuple[Ints, Ints]:
    """For every weight of the table its pieces of detection and of return, whose numbers run past the period."""
    _, first, offset, weights = table
    piece = np.repeat(np.arange(len(first)), np.diff(offset))
    return piece, first[piece] + np.arange(len(weights)) - offset[piece]


def most_in_window(flux: Floats, edges: Floats, length: float) -> Floats:
    """(…,) the most flux (…, n) in any interval of `length` < period seconds, across the end of the period too."""
    period = edges[-1]
    cumulative = np.concatenate([np.zeros((*flux.shape[:-1], 1)), np.cumsum(flux, axis=-1)], axis=-1)
    total, before = cumulative[..., -1:], cumulative[..., :-1]

    def until(times: Floats) -> Floats:
        """(…, n) the integral of the flux from the start of each bin until `times`, below two periods."""
        late = times >= period
        phase = times - np.where(late, period, 0.0)
        j = np.clip(np.searchsorted(edges, phase, side="right") - 1, 0, len(edges) - 2)
        share = np.clip((phase - edges[j]) / np.diff(edges)[j], 0.0, 1.0)
        return np.asarray(cumulative[..., j] + share * flux[..., j] + late * total - before)

    # The integral over a sliding interval is piecewise linear: it peaks where one of its ends meets an edge. An
    # interval that ends at an edge is the period without the interval that starts there.
    starting, ending = until(edges[:-1] + length), total[..., 0] - until(edges[:-1] + (period - length)).min(axis=-1)
    return np.asarray(np.maximum(np.maximum(starting.max(axis=-1), 0.0), ending), np.float64)
