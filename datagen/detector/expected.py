"""The exact mean of every sampler: expected detections per laser cycle and bin, in O(n)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.special
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.detector.dead_time import equilibrium, synchronous_mean
from datagen.detector.flux import Cycle
from datagen.detector.spad import Spad

Array = NDArray[np.float64]

_ROUNDS = 200
"""Rounds after which a self-consistent mean is taken as it is; it settles in 5 to 30. Half would do."""
_SETTLED = 1e-11
"""Share of the detections that a round may still change in a settled mean: halved, it takes a round more at most."""
_PIECES, _MOST_PIECES = 32, 4096
"""Long background bins are cut into pieces of a 32nd of the shortest of trap times and dead time, 4096 a bin at most:
avalanches caused in a piece are taken as uniform there. Half as many double the error of where afterpulses fall."""


def one_per_cycle_mean(flux: Array) -> Array:
    """p_i = −expm1(−λ_i) exp(−Λ_{i−1}): the first event of the cycle falls into bin i. Any leading axes."""
    before = np.cumsum(flux, axis=-1) - flux
    return -np.expm1(-flux) * np.exp(-np.maximum(before, 0.0))


def mean_detections(flux: Array, cycle: Cycle, spad: Spad) -> Array:
    """(pixel, n) expected detections per cycle of the pixels of one laser point with flux (pixel, n).

    Exact, except for afterpulsing and crosstalk together with a dead time: see `has_exact_mean`. There the events
    that avalanches cause are put in as flux, afterpulses as the survivors of what the last avalanche trapped, until
    the answer agrees with itself; neglected is the correlation between pixels and between avalanches, an error of
    second order in the probabilities.
    """
    return detections_and_events(flux, cycle, spad)[0]


def detections_and_events(flux: Array, cycle: Cycle, spad: Spad) -> tuple[Array, Array]:
    """(pixel, n) `mean_detections`, and (pixel, n) all events per cycle: those of `flux` and those that avalanches
    cause. The ratio of the two is the chance that an event finds the diode armed."""
    has_traps, has_crosstalk = spad.afterpulse_probability > 0, spad.crosstalk_probability > 0 and len(flux) > 1
    if spad.mode == "ideal":
        return flux, flux
    if not (has_traps or has_crosstalk):
        return _mean_of_photons(flux, cycle, spad), flux
    scales = (spad.dead_time_s, *(spad.afterpulse_times_s if has_traps else ()))
    finer, parts = _cut(cycle, min((scale for scale in scales if scale > 0), default=np.inf) / _PIECES)
    flux = np.repeat(flux / parts, parts, axis=1)
    found = _self_consistent(flux, finer, spad, has_traps, has_crosstalk)
    detections, events = (np.add.reduceat(values, np.cumsum(parts) - parts, axis=1) for values in found)
    return detections, events


def _cut(cycle: Cycle, longest_s: float) -> tuple[Cycle, NDArray[np.int64]]:
    """The cycle with its long bins in equal parts of about `longest_s`, and (n,) how many parts each has.

    All of it counts as recorded: what is detected later than the record fills traps that empty in the next cycle.
    """
    parts = np.ceil(cycle.widths_s / max(longest_s, cycle.width_s) * (1.0 - 1e-6))
    parts = np.clip(parts, 1, _MOST_PIECES).astype(np.int64)
    number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    starts = np.repeat(cycle.edges_s[:-1], parts) + number * np.repeat(cycle.widths_s / parts, parts)
    edges = np.append(starts, cycle.period_s)
    return replace(cycle, edges_s=edges, gate=np.repeat(cycle.gate, parts), front=len(number)), parts


def _self_consistent(
    flux: Array, cycle: Cycle, spad: Spad, has_traps: bool, has_crosstalk: bool
) -> tuple[Array, Array]:
    shared, released = np.zeros_like(flux), np.zeros_like(flux)
    detections, total = np.zeros_like(flux), flux
    for _ in range(_ROUNDS):
        total = flux + shared + released
        previous, detections = detections, _mean_of_photons(total, cycle, spad)
        if np.abs(detections - previous).sum() <= _SETTLED * detections.sum():
            break
        if has_traps:
            armed = np.divide(detections, total, out=np.ones_like(total), where=total > 0)
            pairs = zip(detections, flux + shared, strict=True)
            released = np.stack([_releases(d, f, cycle, spad) for d, f in pairs]) / np.maximum(armed, 1e-12)
        if has_crosstalk:
            shared = spad.crosstalk_probability * neighbour_sum(detections, spad.array_columns or len(flux))
    return detections, total


def has_exact_mean(spad: Spad, pixels: int) -> bool:
    """Whether `mean_detections` is exact."""
    return spad.dead_time_s == 0 or not _is_coupled(spad, pixels)


def counts_are_poisson(spad: Spad, pixels: int) -> bool:
    """Whether detections are independent of one another, so that a bin's count is a Poisson number."""
    return spad.mode == "ideal" or (spad.dead_time_s == 0 and not _is_coupled(spad, pixels))


def counts_are_binomial(flux: Array, cycle: Cycle, spad: Spad, pixels: int) -> bool:
    """Whether a bin counts each cycle at most once, and cycles are independent; of flux (…, n).

    So it is where the dead time leaves one detection a cycle, or one a bin and nothing moves its record.
    """
    if spad.mode != "synchronous" or _is_coupled(spad, pixels):
        return False
    once_a_bin = cycle.after_avalanche.is_identity and spad.dead_time_s >= cycle.width_s * (1 - 1e-9)
    return once_a_bin or bool((spad.dead_time_s >= active_span(flux, cycle)).all())


def _is_coupled(spad: Spad, pixels: int) -> bool:
    """Whether avalanches cause others: in the same pixel later, or in its neighbours."""
    causes = spad.afterpulse_probability > 0 or (spad.crosstalk_probability > 0 and pixels > 1)
    return causes and spad.mode != "ideal"


def neighbour_sum(values: Array, columns: int) -> Array:
    """(pixel, n) sum over each pixel's nearest neighbours in an array of `columns` pixels a row."""
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


def _mean_of_photons(flux: Array, cycle: Cycle, spad: Spad) -> Array:
    """(k, n) expected detections per cycle when events come independently, of flux (k, n)."""
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


def active_span(flux: Array, cycle: Cycle) -> Array:
    """(…,) seconds from the first moment of the cycle at which something can happen to the last that can be recorded,
    of flux (…, n)."""
    active = flux[..., : cycle.front] > 0
    first = active.argmax(axis=-1)
    last = cycle.front - 1 - active[..., ::-1].argmax(axis=-1)
    return np.where(active.any(axis=-1), cycle.edges_s[last + 1] - cycle.edges_s[first], 0.0)


def _paralyzable_mean(flux: Array, edges: Array, dead_time: float, synchronous: bool) -> Array:
    """∫ λ(t) exp(−[Λ(t) − Λ(t − τ)]) dt over each bin: the exponent is linear between edges and delayed edges."""
    period = edges[-1]
    cumulative = np.append(0.0, np.cumsum(flux))
    total = cumulative[-1]

    def flux_before(t: Array) -> Array:
        """Λ(t), periodically continued."""
        laps = np.floor(t / period)
        value: Array = np.interp(t - laps * period, edges, cumulative) + laps * total
        return np.maximum(value, 0.0) if synchronous else value

    knots = np.unique(np.concatenate([edges, (edges + dead_time) % period]))
    exponent = np.interp(knots, edges, cumulative) - flux_before(knots - dead_time)
    bin_of = np.clip(np.searchsorted(edges, 0.5 * (knots[1:] + knots[:-1]), side="right") - 1, 0, len(flux) - 1)
    events = flux[bin_of] * np.diff(knots) / np.diff(edges)[bin_of]
    # Mean of exp(−y) over a piece on which y is linear, from its lower end; by its series where y hardly changes.
    rise, low = np.abs(np.diff(exponent)), np.minimum(exponent[1:], exponent[:-1])
    tiny = rise < 1e-6
    safe = np.where(tiny, 1.0, rise)
    mean = np.where(tiny, 1.0 - 0.5 * rise, -np.expm1(-safe) / safe) * np.exp(-low)
    return np.bincount(bin_of, events * mean, len(flux)).astype(np.float64)


def _releases(detections: Array, flux: Array, cycle: Cycle, spad: Spad) -> Array:
    """(n,) expected afterpulses per cycle and bin of avalanches `detections`."""
    edges, synchronous = cycle.edges_s, spad.mode == "synchronous"
    cumulative = np.append(0.0, np.cumsum(detections))
    # Avalanches after which the diode is armed again, until each edge.
    laps, phase = np.divmod(edges - spad.dead_time_s, edges[-1])
    rearmed = np.interp(phase, edges, cumulative) + laps * cumulative[-1]
    if synchronous:
        rearmed = np.where(edges > spad.dead_time_s, rearmed, 0.0)
    out = np.zeros_like(detections)
    for load, time in zip(spad.trap_loads, spad.afterpulse_times_s, strict=True):
        # What an older trap still holds survives a further dead time in the share `kept`: only the rest is lost when
        # a photon comes first.
        kept = float(np.exp(-spad.dead_time_s / time))
        effective = -np.expm1(-load) + (load + np.expm1(-load)) * kept
        # Synchronous: those still dead at the end of the cycle are armed again at the start of the next one.
        first = effective * float(cumulative[-1] - rearmed[-1]) if synchronous else 0.0
        rates = np.diff(edges) / time + (1.0 - kept) * flux
        out += _release_one_trap(effective * np.diff(rearmed), rates, np.diff(edges) / time, first)
    return out * cycle.gate


@compiled()
def _release_one_trap(arriving: Array, rates: Array, releasing: Array, first: float) -> Array:
    """(n,) releases per cycle of a trap to which each bin adds `arriving`, the first one `first` more, and which it
    leaves by e^{−rate}, a share `releasing / rate` of that by release."""
    out = np.zeros(len(rates))
    level, decay = 0.0, 1.0
    for lap in range(2):
        # The first lap finds what a cycle leaves behind, hence the periodic level; the second uses it.
        level = level + first
        for i in range(len(rates)):
            rate = rates[i]
            part = -np.expm1(-rate) / rate
            rest = 0.5 - rate / 6.0 if rate < 1e-5 else (1.0 - part) / rate
            out[i] = releasing[i] * (level * part + arriving[i] * rest)
            level = level * np.exp(-rate) + arriving[i] * part
            if lap == 0:
                decay *= np.exp(-rate)
        if lap == 0:
            level = level / (1.0 - decay) if decay < 1.0 else level
    return out


def saturated_mean(mean: Array, cycles: int, counter_max: int, binomial: bool) -> Array:
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
