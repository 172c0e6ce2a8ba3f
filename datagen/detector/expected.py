"""The exact mean of every sampler: expected detections per laser cycle and bin, in a time linear in the bins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.special

from datagen.compiled import compiled
from datagen.detector.dead_time import equilibrium, synchronous_mean
from datagen.detector.flux import Cycle, cut_edges
from datagen.detector.spad import Spad
from datagen.records.arrays import Floats, Ints

_ROUNDS = 200
"""Most rounds of a self-consistent mean, which settles in 5 to 30."""
_SETTLED = 1e-11
"""Share of the detections that a round may change in a settled mean."""
_PIECES, _MOST_PIECES = 32, 4096
"""Long background bins are cut into pieces of a 32nd of the shortest of trap times and dead time, at most 4096 a bin:
avalanches caused in a piece are taken as uniform there."""


def one_per_cycle_mean(flux: Floats) -> Floats:
    """(…, n) probability p_i = −expm1(−λ_i) exp(−Λ_{i−1}) that the first event of a cycle falls into bin i."""
    before = np.cumsum(flux, axis=-1) - flux
    return -np.expm1(-flux) * np.exp(-np.maximum(before, 0.0))


def mean_detections(flux: Floats, cycle: Cycle, spad: Spad) -> Floats:
    """(pixel, n) expected detections per cycle of the pixels of one laser point with flux (pixel, n).

    Exact, except for afterpulsing and crosstalk together with a dead time (`has_exact_mean`). There the events that
    avalanches cause are added to the flux, and the mean is repeated until it agrees with itself. The correlations
    between pixels and between avalanches are neglected, an error of second order in the probabilities.
    """
    return detections_and_events(flux, cycle, spad)[0]


def detections_and_events(flux: Floats, cycle: Cycle, spad: Spad) -> tuple[Floats, Floats]:
    """(pixel, n) `mean_detections`, and (pixel, n) all events per cycle: those of `flux` and those that avalanches
    cause. Their ratio is the probability that an event finds the diode armed."""
    has_traps, has_crosstalk = spad.afterpulse_probability > 0, spad.crosstalk_probability > 0 and len(flux) > 1
    if spad.mode == "ideal":
        return flux, flux
    if not (has_traps or has_crosstalk):
        return _mean_of_photons(flux, cycle, spad), flux
    scales = (spad.dead_time_s, *(spad.afterpulse_times_s if has_traps else ()))
    finer, parts = _with_short_bins(cycle, min((scale for scale in scales if scale > 0), default=np.inf) / _PIECES)
    flux = np.repeat(flux / parts, parts, axis=1)
    both = _self_consistent(flux, finer, spad, has_traps, has_crosstalk)
    detections, events = (np.add.reduceat(values, np.cumsum(parts) - parts, axis=1) for values in both)
    return detections, events


def _with_short_bins(cycle: Cycle, longest_s: float) -> tuple[Cycle, Ints]:
    """The cycle with its long bins cut into equal parts of about `longest_s`, and (n,) the number of parts of each
    bin.

    The whole period counts as recorded, since detections after the record fill traps that release in the next cycle.
    """
    parts = np.ceil(cycle.widths_s / max(longest_s, cycle.width_s) * (1.0 - 1e-6))
    parts = np.clip(parts, 1, _MOST_PIECES).astype(np.int64)
    edges = cut_edges(cycle.edges_s, parts)
    return replace(cycle, edges_s=edges, gate=np.repeat(cycle.gate, parts), front=len(edges) - 1), parts


def _self_consistent(
    flux: Floats, cycle: Cycle, spad: Spad, has_traps: bool, has_crosstalk: bool
) -> tuple[Floats, Floats]:
    """(pixel, n) detections and (pixel, n) all events per cycle, repeated until they agree with each other."""
    shared, released = np.zeros_like(flux), np.zeros_like(flux)
    detections, total = np.zeros_like(flux), flux
    for _ in range(_ROUNDS):
        total = flux + shared + released
        previous, detections = detections, _mean_of_photons(total, cycle, spad)
        if np.abs(detections - previous).sum() <= _SETTLED * detections.sum():
            break
        if has_traps:
            # Afterpulses come from diodes that are armed again; as flux they meet armed and dead ones alike.
            armed = np.divide(detections, total, out=np.ones_like(total), where=total > 0)
            pairs = zip(detections, flux + shared, strict=True)
            released = np.stack([_afterpulses(d, f, cycle, spad) for d, f in pairs]) / np.maximum(armed, 1e-12)
        if has_crosstalk:
            shared = spad.crosstalk_probability * neighbour_sum(detections, spad.array_columns or len(flux))
    return detections, total


def has_exact_mean(spad: Spad, pixels: int) -> bool:
    """Whether `mean_detections` is exact."""
    return spad.dead_time_s == 0 or not _is_coupled(spad, pixels)


def counts_are_poisson(spad: Spad, pixels: int) -> bool:
    """Whether detections are independent of one another, so that a bin's count is a Poisson number."""
    return spad.mode == "ideal" or (spad.dead_time_s == 0 and not _is_coupled(spad, pixels))


def counts_are_binomial(flux: Floats, cycle: Cycle, spad: Spad, pixels: int) -> bool:
    """Whether each bin counts a cycle at most once and cycles are independent, for flux (…, n).

    This holds where the dead time leaves one detection a cycle, or one a bin, all bins being equal, and no jitter
    moves its record.
    """
    if spad.mode != "synchronous" or _is_coupled(spad, pixels):
        return False
    once_a_bin = spad.tdc_bins_are_equal and spad.dead_time_s >= cycle.width_s * (1 - 1e-9)
    once_a_bin = once_a_bin and cycle.after_avalanche.is_identity
    return once_a_bin or bool((spad.dead_time_s >= active_span(flux, cycle)).all())


def _is_coupled(spad: Spad, pixels: int) -> bool:
    """Whether avalanches cause others: in the same pixel later, or in its neighbours."""
    causes = spad.afterpulse_probability > 0 or (spad.crosstalk_probability > 0 and pixels > 1)
    return causes and spad.mode != "ideal"


def neighbour_sum(values: Floats, columns: int) -> Floats:
    """(pixel, n) sum of `values` (pixel, n) over each pixel's nearest neighbours, in rows of `columns` pixels."""
    pixels, n = values.shape
    rows = -(-pixels // columns)
    grid = np.zeros((rows * columns, n))
    grid[:pixels] = values
    grid = grid.reshape(rows, columns, n)
    out = np.zeros_like(grid)
    out[1:] += grid[:-1]
    out[:-1] += grid[1:]
    out[:, 1:] += grid[:, :-1]
    out[:, :-1] += grid[:, 1:]
    return out.reshape(rows * columns, n)[:pixels]


def _mean_of_photons(flux: Floats, cycle: Cycle, spad: Spad) -> Floats:
    """(k, n) expected detections per cycle of independent events with flux (k, n)."""
    dead_time, synchronous = spad.dead_time_s, spad.mode == "synchronous"
    if dead_time == 0:
        return flux.copy()
    out = np.zeros_like(flux)
    lit = flux.any(axis=1)
    if synchronous:
        once = lit & (dead_time >= active_span(flux, cycle))
        out[once] = one_per_cycle_mean(flux[once])
        lit &= ~once
    if spad.paralyzable:
        for row in np.flatnonzero(lit):
            out[row] = _paralyzable_mean(flux[row], cycle.edges_s, dead_time, synchronous)
    elif synchronous:
        out[lit] = synchronous_mean(flux[lit], cycle.edges_s, cycle.width_s, dead_time)
    else:
        for row in np.flatnonzero(lit):
            out[row] = equilibrium(flux[row], cycle.edges_s, cycle.width_s, dead_time).mean
    return out


def active_span(flux: Floats, cycle: Cycle) -> Floats:
    """(…,) seconds from the first event that is possible with flux (…, n) to the last one that can be recorded."""
    active = flux[..., : cycle.front] > 0
    first = active.argmax(axis=-1)
    last = cycle.front - 1 - active[..., ::-1].argmax(axis=-1)
    return np.where(active.any(axis=-1), cycle.edges_s[last + 1] - cycle.edges_s[first], 0.0)


def _paralyzable_mean(flux: Floats, edges: Floats, dead_time: float, synchronous: bool) -> Floats:
    """(n,) ∫ λ(t) exp(−[Λ(t) − Λ(t − τ)]) dt over each bin, the exponent being linear between edges and edges + τ."""
    period = edges[-1]
    cumulative = np.append(0.0, np.cumsum(flux))
    total = cumulative[-1]

    def flux_before(t: Floats) -> Floats:
        """Λ(t), continued over the periods before; 0 before the start of a synchronous cycle."""
        laps = np.floor(t / period)
        value: Floats = np.interp(t - laps * period, edges, cumulative) + laps * total
        return np.maximum(value, 0.0) if synchronous else value

    knots = np.unique(np.concatenate([edges, (edges + dead_time) % period]))
    exponent = np.interp(knots, edges, cumulative) - flux_before(knots - dead_time)
    bin_of = np.clip(np.searchsorted(edges, 0.5 * (knots[1:] + knots[:-1]), side="right") - 1, 0, len(flux) - 1)
    events = flux[bin_of] * np.diff(knots) / np.diff(edges)[bin_of]
    # The mean of exp(−y) over a piece on which y is linear, counted from its lower end; by a series where y hardly
    # changes, for the closed form would divide 0 by 0 there.
    rise, low = np.abs(np.diff(exponent)), np.minimum(exponent[1:], exponent[:-1])
    tiny = rise < 1e-6
    safe = np.where(tiny, 1.0, rise)
    mean = np.where(tiny, 1.0 - 0.5 * rise, -np.expm1(-safe) / safe) * np.exp(-low)
    return np.bincount(bin_of, events * mean, len(flux)).astype(np.float64)


def _afterpulses(detections: Floats, flux: Floats, cycle: Cycle, spad: Spad) -> Floats:
    """(n,) expected afterpulses per cycle and bin that avalanches `detections` (n,) cause beside other flux (n,)."""
    edges, synchronous = cycle.edges_s, spad.mode == "synchronous"
    cumulative = np.append(0.0, np.cumsum(detections))
    # Number of avalanches, until each edge, after which the diode is armed again.
    laps, phase = np.divmod(edges - spad.dead_time_s, edges[-1])
    rearmed = np.interp(phase, edges, cumulative) + laps * cumulative[-1]
    if synchronous:
        rearmed = np.where(edges > spad.dead_time_s, rearmed, 0.0)
    out = np.zeros_like(detections)
    for load, time in zip(spad.trap_loads, spad.afterpulse_times_s, strict=True):
        # A photon that comes first makes the diode dead once more: the share `kept` of the carriers outlasts that.
        kept = float(np.exp(-spad.dead_time_s / time))
        effective = -np.expm1(-load) + (load + np.expm1(-load)) * kept
        # A synchronous diode that is dead at the end of the cycle is armed again at the start of the next one.
        first = effective * float(cumulative[-1] - rearmed[-1]) if synchronous else 0.0
        rates = np.diff(edges) / time + (1.0 - kept) * flux
        out += _release_one_trap(effective * np.diff(rearmed), rates, np.diff(edges) / time, first)
    return out * cycle.gate


@compiled()
def _release_one_trap(arriving: Floats, rates: Floats, releasing: Floats, first: float) -> Floats:
    """(n,) releases per cycle of a trap. Each bin adds `arriving` carriers, the first bin also `first`; carriers
    decay over a bin by e^{−rate}, and the share `releasing / rate` of these are released."""
    out = np.zeros(len(rates))
    level, decay = 0.0, 1.0
    for lap in range(2):
        # The first lap starts empty and gives the level at the end of a cycle, from which the periodic level follows.
        # The second lap starts with that.
        level = level + first
        for i in range(len(rates)):
            rate = rates[i]
            part = -np.expm1(-rate) / rate
            # Carriers that arrive during the bin have less of it left; the series avoids cancellation.
            rest = 0.5 - rate / 6.0 if rate < 1e-5 else (1.0 - part) / rate
            out[i] = releasing[i] * (level * part + arriving[i] * rest)
            level = level * np.exp(-rate) + arriving[i] * part
            if lap == 0:
                decay *= np.exp(-rate)
        if lap == 0:
            level = level / (1.0 - decay) if decay < 1.0 else level
    return out


def saturated_mean(mean: Floats, cycles: int, counter_max: int, binomial: bool) -> Floats:
    """E[min(n, c)] for Poisson, or Binomial(cycles, mean / cycles), counts n of a counter that stays at c.

    E[min(n, c)] = E[n] P(n′ ≤ c − 2) + c P(n ≥ c), n′ the same count with one trial less: incomplete beta and gamma
    functions (Abramowitz & Stegun 26.5.24, 26.4.21).
    """
    c = counter_max
    if binomial and c > cycles:
        return mean
    if binomial:
        p = np.clip(mean / cycles, 0.0, 1.0)
        reached = scipy.special.betainc(c, cycles - c + 1, p)
        below = scipy.special.betaincc(c - 1, cycles - c + 1, p) if c > 1 else 0.0
    else:
        reached = scipy.special.gammainc(c, mean)
        below = scipy.special.gammaincc(c - 1, mean) if c > 1 else 0.0
    return np.asarray(mean * below + c * reached, np.float64)
