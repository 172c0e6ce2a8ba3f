"""Counting with a non-paralyzable dead time, in the mean: the armed share of cycles, piece by piece.

Bins are cut into pieces of at most `PIECE_FLUX` events. With A_i the share of cycles that are armed for piece i,

    D_i = q_i A_i,   A_{i+1} = A_i − D_i + Σ_k w_{k → i+1} D_k,   q_i = −expm1(−λ_i)

where w shares out the returns of what was detected in piece k, uniform in that piece, to the pieces a dead time
later. For equal pieces and small λ the weights are (1−f)²/2, ½+f−f², f²/2 at d, d+1, d+2 pieces, τ = d + f.
"""

from __future__ import annotations

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
    out = np.zeros_like(rows)
    done = _started_armed(rows, edges_s.copy(), width_s, dead_time_s, piece_flux, out)
    if done < len(rows):
        pieces_of(rows[done], edges_s, width_s, dead_time_s, piece_flux=piece_flux)
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
            where = first[i] + k
            if where < m:
                returning[where] += weights[start + k] * fired
            else:
                following[where - m] += weights[start + k] * fired
    following[0] += returning[m]
    return detections, armed


@compiled()
def _started_armed(flux: Array, edges: Array, width: float, dead_time: float, piece_flux: float, out: Array) -> int:
    """The detections of one cycle of each row, added to `out`; how many rows come before one of too many pieces."""
    for row in range(len(flux)):
        count = _parts(flux[row], edges, width, dead_time, False, piece_flux)
        if not count.sum() <= _MOST_PIECES:
            return row
        pieces, bin_of, cut = _cut(flux[row], edges, count.astype(np.int64))
        none = np.zeros(len(pieces) + 1)
        detections, _ = run_cycle(return_table(pieces, cut, dead_time), 1.0, none, none.copy())
        for piece in range(len(pieces)):
            out[row, bin_of[piece]] += detections[piece]
    return len(flux)


@compiled()
def _edge_at(edges: Array, index: int, m: int, period: float) -> float:
    """Edge number `index`, counted on past the end of the period."""
    return float(edges[index] if index <= m else edges[index - m] + period)
