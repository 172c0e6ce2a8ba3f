"""The mean under a non-paralyzable dead time: the share of cycles in which the diode is armed, piece by piece.

Bins are cut into pieces of at most `PIECE_FLUX` events. With A_i the share of cycles that are armed for piece i,

    D_i = q_i A_i,   A_{i+1} = A_i − D_i + Σ_k w_{k → i+1} D_k,   q_i = −expm1(−λ_i)

where w shares out the returns of what was detected in piece k, uniform in that piece, to the pieces a dead time
later. For equal pieces and small λ the weights are (1−f)²/2, ½+f−f², f²/2 at d, d+1, d+2 pieces, τ = d + f.
A synchronous detector starts every cycle armed; a free-running one hands its state on to the next cycle, until that
no longer changes (`equilibrium`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.errors import InputError

Array = NDArray[np.float64]

PIECE_FLUX = 0.0125
"""Most events in a piece. What is neglected, the slope of the detections within it, is of second order in this."""
_FLUX_PIECES = 16_384
"""At a flux of hundreds and more per cycle pieces carry 1/16384 of it instead, for which they are short enough."""
_LONG_PIECE_FLUX = 0.002
"""The same for long background bins, in which detections may start or end abruptly."""
_MOST_PIECES = 4_000_000
"""Pieces of a period at most: 0.2 GB of arrays."""
_SWEEPS = 24
"""Cycles after which a fixed point that has not settled is solved for. Half as many save time only where a flux of
several events a cycle keeps detections in step; a moderate one settles in three or four."""
_SETTLED = 1e-13
"""Change of a sweep, in detections per cycle, at which a mean is settled: the rounding of a cycle's sums."""
FOR_A_START = 1e-8
"""Change of a sweep at which the state is settled enough to begin an exposure in: 10⁻⁸ detections, once."""


class Pieces(NamedTuple):
    """Bins of the period cut up: (m,) flux and bin number, (m + 1,) edges in seconds, and the dead time."""

    flux: Array
    bin_of: NDArray[np.int64]
    edges: Array
    dead_time: float

    def per_bin(self, values: Array, bins: int) -> Array:
        """(m,) values of the pieces summed over each of the `bins`: (bins,)."""
        return np.bincount(self.bin_of, values, bins).astype(np.float64)


def pieces_of(
    flux: Array, edges_s: Array, width_s: float, dead_time_s: float, *, shorter_than_dead_time: bool = False,
    piece_flux: float = PIECE_FLUX,
) -> Pieces:  # fmt: skip
    """Cut the bins of the period; bins longer than `width_s` are background and cut more finely.

    flux, edges_s : (n,) events per cycle and bin, (n + 1,) bin edges. Raises `InputError` for too many pieces.
    """
    count = _parts(flux, edges_s, width_s, dead_time_s, shorter_than_dead_time, piece_flux)
    total = float(count.sum())
    if not total <= _MOST_PIECES:
        raise InputError(
            f"flux of {flux.sum():g} per cycle, dead time {dead_time_s:g} s on {len(flux)} bins of {width_s:g} s: "
            f"needs {total:g} pieces, at most {_MOST_PIECES} are handled; lower photons_per_pulse or widen the bins"
        )
    if total == len(flux):
        # A copy of the edges, which are read-only: kernels are compiled anew for that.
        return Pieces(np.ascontiguousarray(flux), np.arange(len(flux)), edges_s.copy(), dead_time_s)
    return Pieces(*_cut(flux, edges_s, count.astype(np.int64)), dead_time_s)


@compiled()
def _parts(flux: Array, edges: Array, width: float, dead_time: float, shorter: bool, piece_flux: float) -> Array:
    """(n,) number of pieces of each bin, as floats: they may be too many to count."""
    most = max(piece_flux, flux.sum() / _FLUX_PIECES)
    parts = np.ones(len(flux))
    for i in range(len(flux)):
        length = edges[i + 1] - edges[i]
        # A bin that is as fine as everything asks stays whole: most bins are.
        is_short = not shorter or length * (1.0 + 1e-12) <= dead_time
        if is_short and flux[i] <= most and length <= 1.5 * width:
            continue
        if length > 1.5 * width:
            part = np.ceil(flux[i] / min(_LONG_PIECE_FLUX, most))
            if dead_time > 0.0:
                part = max(part, min(np.ceil(4.0 * length / dead_time), 4096.0))
        else:
            part = np.ceil(flux[i] / most)
        if not is_short:
            part = max(part, np.ceil(length / dead_time * (1.0 + 1e-12)))
        parts[i] = max(part, 1.0)
    return parts


@compiled()
def _cut(flux: Array, edges: Array, count: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64], Array]:
    """Flux, bin number and edges of the pieces."""
    total = count.sum()
    pieces, bin_of, cut = np.empty(total), np.empty(total, np.int64), np.empty(total + 1)
    k = 0
    for i in range(len(flux)):
        if count[i] == 1:
            pieces[k], bin_of[k], cut[k] = flux[i], i, edges[i]
            k += 1
            continue
        length = (edges[i + 1] - edges[i]) / count[i]
        for part in range(count[i]):
            pieces[k], bin_of[k], cut[k] = flux[i] / count[i], i, edges[i] + part * length
            k += 1
    cut[total] = edges[len(flux)]
    return pieces, bin_of, cut


def synchronous_mean(
    flux: Array, edges_s: Array, width_s: float, dead_time_s: float, *, piece_flux: float = PIECE_FLUX
) -> Array:
    """(…, n) expected detections per cycle and bin when every cycle starts armed.

    flux, edges_s : (…, n) events per cycle and bin, (n + 1,) bin edges from 0 to the period; piece_flux : most events
    in a piece. Raises `InputError` where that takes too many pieces.
    """
    dead_time_s = min(dead_time_s, float(edges_s[-1]))
    rows = np.ascontiguousarray(flux).reshape(-1, flux.shape[-1])
    out = np.empty_like(rows)
    for row, own in enumerate(rows):
        pieces = pieces_of(own, edges_s, width_s, dead_time_s, piece_flux=piece_flux)
        none = np.zeros(len(pieces.flux) + 1)
        table = return_table(pieces.flux, pieces.edges, dead_time_s)
        out[row] = pieces.per_bin(run_cycle(table, 1.0, none, none.copy())[0], len(own))
    return out.reshape(flux.shape)


@compiled()
def early_share(x: float, low: float, high: float) -> float:
    """Chance to fire in the piece of flux x of one's return, of which a uniform share ρ of `low … high` is left.

    The mean over ρ of 1 − e^{−xρ}.
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
def _return_weights(start: float, stop: float, first: int, edges: Array, flux: Array, weights: Array) -> int:
    """Where returns, uniform in `start … stop`, count as armed: how many pieces from `first` on, and their weights.

    A return that fires in its piece with probability e is as good as one armed from the piece's start with
    probability e / (1 − e^{−x}), and else from the next piece's start. Piece numbers run on past the end of the
    period into the next one.
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
            early = early_share(x, (high - min(stop, high)) / (high - low), (high - max(start, low)) / (high - low))
            ahead = early / -np.expm1(-x) if early > 0.0 else 0.0
        weights[k] += share * ahead
        weights[k + 1] = share * (1.0 - ahead)
        k += 1
        if stop <= high or k >= m:
            return k + 1


Table = tuple[Array, NDArray[np.int64], NDArray[np.int64], Array]


@compiled()
def return_table(flux: Array, edges: Array, dead_time: float) -> Table:
    """What one cycle after the other needs of every piece: q, first piece of its returns, and their weights.

    Piece i returns to pieces `first[i]`, `first[i] + 1`, … with `weights[offset[i]:offset[i + 1]]`; none for pieces
    in which nothing happens.
    """
    m = len(flux)
    period = edges[m]
    q, first, offset = np.zeros(m), np.zeros(m, np.int64), np.zeros(m + 1, np.int64)
    # Shifted pieces cross m edges between them, and each may end within a piece and wait for the next one.
    weights = np.empty(5 * m + 64)
    here = np.empty(m + 3)
    target = 0
    for i in range(m):
        offset[i + 1] = offset[i]
        if flux[i] <= 0.0:
            continue
        # Pieces and their returns come in the same order, so that the target only ever moves on.
        while target < 2 * m and _edge_at(edges, target + 1, m, period) <= edges[i] + dead_time:
            target += 1
        count = _return_weights(edges[i] + dead_time, edges[i + 1] + dead_time, target, edges, flux, here)
        q[i], first[i] = -np.expm1(-flux[i]), target
        for k in range(count):
            weights[offset[i] + k] = here[k]
        offset[i + 1] += count
    return q, first, offset, weights[: offset[m]]


@compiled()
def run_cycle(table: Table, armed: float, returning: Array, following: Array) -> tuple[Array, float]:
    """One cycle: detections per piece and the share still armed; returns due later are added to `following`."""
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
            # Part returns within the same piece and may fire again: a geometric series.
            fired /= 1.0 - weights[start] * q[i]
            armed += weights[start] * fired
        detections[i] = fired
        armed -= fired
        for k in range(1 if first[i] == i else 0, offset[i + 1] - start):
            # What returns after the end of this cycle is handed to the next one.
            where = first[i] + k
            if where < m:
                returning[where] += weights[start + k] * fired
            else:
                following[where - m] += weights[start + k] * fired
    following[0] += returning[m]
    return detections, armed


@compiled()
def _edge_at(edges: Array, index: int, m: int, period: float) -> float:
    """Edge number `index`, counted on past the end of the period."""
    return float(edges[index] if index <= m else edges[index - m] + period)


@dataclass(frozen=True)
class Equilibrium:
    """A free-running detector long after it was switched on.

    Attributes
    ----------
    flux : (n,) events per cycle and bin. pieces : the bins cut up, and the dead time.
    detections : (m,) expected detections per cycle and piece.
    armed : probability to be armed at phase 0.
    """

    flux: Array
    pieces: Pieces
    detections: Array
    armed: float

    @property
    def mean(self) -> Array:
        """(n,) expected detections per cycle and bin."""
        return self.pieces.per_bin(self.detections, len(self.flux))


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
    long = Pieces(pieces.flux, pieces.bin_of, pieces.edges, dead_time_s)
    return Equilibrium(flux, long, detections, max(1.0 - dead, 0.0))


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
    start = pieces.flux / (1.0 + most)
    piece, due_in = _returns(table)
    late = due_in >= m
    due = table[3][late] * start[piece[late]]
    returning: Array = np.bincount(due_in[late] - m, due, m + 1).astype(np.float64)
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
    q, _, _, weights = table
    m = len(q)
    piece, due_in = _returns(table)
    number, following = np.arange(m), (np.arange(m) + 1) % m
    # Part of what is detected in a piece returns within it, and may fire again: a geometric series.
    at_once = due_in == piece
    itself = np.bincount(piece[at_once], weights[at_once], m)
    gain = q / (1.0 - itself * q)
    due = (weights * gain[piece])[~at_once]
    piece, due_in = piece[~at_once], due_in[~at_once]
    # Row j holds the equation for A_{j+1}; row m − 1, which would be that for A_0, the sum of all shares.
    rows = np.concatenate([number, number, number, (due_in - 1) % m])
    columns = np.concatenate([number, following, number, piece])
    values = np.concatenate([-np.ones(m), np.ones(m), gain * (1.0 - itself), -due])
    keep = rows != m - 1
    shares = np.bincount(piece, due * (due_in > m), m)
    shares[0] += 1.0
    counted = np.flatnonzero(shares)
    rows, columns = np.append(rows[keep], np.full(len(counted), m - 1)), np.append(columns[keep], counted)
    values = np.append(values[keep], shares[counted])
    # Here, because few ever need them, and they take long to import.
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    matrix = csc_matrix((values, (rows, columns)), shape=(m, m))
    right = np.zeros(m)
    right[-1] = 1.0
    armed: Array = splu(matrix).solve(right)
    return gain * np.maximum(armed, 0.0)


def _returns(table: Table) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Of every weight of the table the piece that is detected in, and the piece, counted on past the end of the
    period, that it returns to."""
    _, first, offset, weights = table
    piece = np.repeat(np.arange(len(first)), np.diff(offset))
    return piece, first[piece] + np.arange(len(weights)) - offset[piece]


def most_in_window(flux: Array, edges: Array, length: float) -> Array:
    """(…,) the most flux (…, n) in any interval of `length` < period seconds, across the end of the period too."""
    period = edges[-1]
    cumulative = np.concatenate([np.zeros((*flux.shape[:-1], 1)), np.cumsum(flux, axis=-1)], axis=-1)
    total, before = cumulative[..., -1:], cumulative[..., :-1]

    def until(times: Array) -> Array:
        """(…, n) the integral of the flux from the start of each bin until `times`, below two periods."""
        late = times >= period
        phase = times - np.where(late, period, 0.0)
        j = np.clip(np.searchsorted(edges, phase, side="right") - 1, 0, len(edges) - 2)
        share = np.clip((phase - edges[j]) / np.diff(edges)[j], 0.0, 1.0)
        return np.asarray(cumulative[..., j] + share * flux[..., j] + late * total - before)

    # The integral over a sliding interval is piecewise linear: it peaks where one of its ends meets an edge. What
    # intervals that end at an edge leave of the period starts there.
    starting, ending = until(edges[:-1] + length), total[..., 0] - until(edges[:-1] + (period - length)).min(axis=-1)
    return np.asarray(np.maximum(np.maximum(starting.max(axis=-1), 0.0), ending), np.float64)
