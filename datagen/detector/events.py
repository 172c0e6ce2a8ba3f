"""Samplers that draw one detection after the other, at a cost in proportion to their number: free running,
afterpulsing, a paralyzable dead time, crosstalk.

A pixel that is armed at the moment s detects its next photon where Λ(t) = Λ(s) + Exp(1). The integral Λ of the flux
is inverted with a guide table. Time is kept as (cycle, phase), so that it stays exact over any exposure.
A trap competes with the photons: if A more releases are expected of it, it releases its next carrier after
−t_t ln(1 − E/A) if E < A, with E ~ Exp(1), and otherwise none. An avalanche leaves A ← A exp(−Δt/t_t) + μ for the
moment at which the pixel is armed again. Carriers released before that moment, or while the gate is shut, are lost.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from datagen.compiled import compiled
from datagen.detector.dead_time import Equilibrium, equilibrium
from datagen.detector.flux import Cycle
from datagen.detector.spad import Spad
from datagen.records.arrays import Floats, Ints

_BURN_IN_CYCLES = 24
"""Least number of cycles simulated before an exposure, in which pixels forget that they started armed, even where
several events a cycle keep a diode in step with its start."""
_BURN_IN_TIMES = 8.0
"""Release times (or dead times) simulated before an exposure: a trap is then within e⁻⁸ of its level."""
_MANY_LAPS = 2.0**20
"""Periods without an event after which the phase of the next event is drawn afresh: the rounding of Λ over so many
periods is 10⁻¹⁰ of one period."""


class _Period(NamedTuple):
    """The bins of a laser period, in the form that kernels take; see `Cycle`."""

    edges: Floats
    width: float
    # Number of the first bins, which lie on multiples of the bin width: their numbers need no search.
    lattice: int
    gate: Floats


class _Diode(NamedTuple):
    """The properties of a diode on which the next avalanche depends; see `Spad`."""

    dead_time: float
    synchronous: bool
    paralyzable: bool
    # Expected releases that an avalanche adds to each trap, and the release times of the traps.
    loads: Floats
    times: Floats
    crosstalk: float
    columns: int


def burn_in_cycles(spad: Spad, period_s: float) -> int:
    """Number of cycles simulated before the exposure, in which dead time and traps forget how they started."""
    if spad.mode == "synchronous" and spad.afterpulse_probability == 0:
        # Every cycle starts armed, whatever went before.
        return 0
    longest = max(spad.dead_time_s, *(spad.afterpulse_times_s if spad.afterpulse_probability > 0 else (0.0,)))
    return _BURN_IN_CYCLES + int(np.ceil(_BURN_IN_TIMES * longest / period_s))


def draw_events(flux: Floats, cycle: Cycle, spad: Spad, cycles: int, rng: Generator) -> Ints:
    """(pixel, n) detections in `cycles` laser periods of pixels with flux (pixel, n), coupled by crosstalk.

    A free-running pixel without traps and neighbours is armed first at a moment that is drawn from its equilibrium,
    so that its mean is exact for any number of cycles. Other pixels start armed some cycles before the exposure.
    """
    pixels, n = flux.shape
    has_traps = spad.afterpulse_probability > 0
    if spad.mode == "free_running" and not (has_traps or spad.paralyzable or pixels > 1):
        start = _first_moment_armed(equilibrium(flux[0], cycle.edges_s, cycle.width_s, spad.dead_time_s), rng)
    else:
        start = -burn_in_cycles(spad, cycle.period_s), 0.0
    # The last bin of all may be shorter than the others.
    period = _Period(cycle.edges_s, cycle.width_s, min(cycle.front, n - 1), cycle.gate)
    diode = _Diode(
        spad.dead_time_s, spad.mode == "synchronous", spad.paralyzable,
        np.array(spad.trap_loads if has_traps else ()), np.array(spad.afterpulse_times_s if has_traps else ()),
        spad.crosstalk_probability, spad.array_columns or pixels,
    )  # fmt: skip
    return np.asarray(_run(flux, period, diode, *start, cycles, rng))


def _first_moment_armed(state: Equilibrium, rng: Generator) -> tuple[int, float]:
    """(cycle, phase) at which a detector in equilibrium is armed for the first time from (0, 0) on."""
    edges = state.pieces.edges
    period, dead_time = float(edges[-1]), state.pieces.dead_time
    # The probability not to be armed is the sum of the detections within the last dead time: the one at which this
    # uniform number is used up keeps the detector dead.
    behind = rng.random() - state.armed
    per_cycle = float(state.detections.sum())
    if behind <= 0.0 or per_cycle <= 0.0:
        return 0, 0.0
    # Since that detection `behind` detections are expected.
    laps, rest = divmod(behind, per_cycle)
    cumulative = np.append(0.0, np.cumsum(state.detections))
    ago = (laps + 1.0) * period - float(np.interp(per_cycle - rest, cumulative, edges))
    ahead = max(dead_time - ago, 0.0)
    cycle = int(ahead // period)
    return cycle, ahead - cycle * period


@compiled()
def _run(
    flux: Floats, period: _Period, diode: _Diode, first_cycle: int, first_phase: float, cycles: int, rng: Generator
) -> Ints:
    """(pixel, n) detections in cycles 0 … `cycles` − 1; all pixels are armed from the first moment on."""
    pixels, n = flux.shape
    counts = np.zeros((pixels, n), np.int64)
    cumulative, guide = np.zeros((pixels, n + 1)), np.zeros((pixels, n), np.int64)
    for p in range(pixels):
        _fill_inverse(flux[p], cumulative[p], guide[p])
    # The moment at which each pixel is armed again, and the moment and bin of its next avalanche.
    armed_cycle, armed_phase = np.full(pixels, first_cycle), np.full(pixels, first_phase)
    next_cycle, next_phase = np.full(pixels, first_cycle), np.full(pixels, first_phase)
    next_bin = np.zeros(pixels, np.int64)
    # Releases expected of each trap from the moment at which its pixel is armed.
    level = np.zeros((pixels, len(diode.loads)))
    # Pixels whose next avalanche has to be drawn: at first all of them, later those that fire at one moment.
    stack = np.empty(4 * pixels + 8, np.int64)
    for p in range(pixels):
        stack[p] = pixels - 1 - p
    waiting, now, phase, j = pixels, first_cycle, first_phase, -1
    while True:
        while waiting > 0:
            waiting -= 1
            p = int(stack[waiting])
            from_cycle, from_phase, is_armed = first_cycle, first_phase, False
            if j >= 0:
                is_armed = bool(armed_cycle[p] < now or (armed_cycle[p] == now and armed_phase[p] <= phase))
                # A dead diode is not set off by its neighbour; only a paralyzable one becomes dead anew.
                if not is_armed and not diode.paralyzable:
                    continue
                if is_armed and now >= 0:
                    counts[p, j] += 1
                new_cycle, new_phase = _moment_armed_again(
                    now, phase + diode.dead_time, float(period.edges[n]), diode.synchronous
                )
                # Traps go on releasing carriers while the diode is dead; these are lost.
                since = (new_cycle - armed_cycle[p]) * float(period.edges[n]) + (new_phase - armed_phase[p])
                for t in range(len(diode.loads)):
                    level[p, t] = level[p, t] * np.exp(-since / diode.times[t]) + diode.loads[t]
                armed_cycle[p], armed_phase[p] = new_cycle, new_phase
                # A paralyzable dead time is restarted even by a photon that comes too early.
                from_cycle, from_phase = (now, phase) if diode.paralyzable else (new_cycle, new_phase)
            later, at, k = cycles, 0.0, 0
            if cumulative[p, n] > 0.0:
                later, at, k = _next_photon(cumulative[p], period, guide[p], from_cycle, from_phase, cycles, rng)
            # Each trap competes with the photon: the earliest of all is the next avalanche.
            for t in range(len(diode.times)):
                e = rng.standard_exponential()
                if e < level[p, t]:
                    later, at, k = _release(
                        later, at, k, from_cycle, from_phase, e, level[p, t], diode.times[t], period, rng
                    )
            next_cycle[p], next_phase[p], next_bin[p] = later, at, k
            if is_armed and diode.crosstalk > 0.0:
                waiting = _set_off_neighbours(p, pixels, diode, stack, waiting, rng)
        # The pixel with the earliest avalanche is next. Arrays are small, so a search in order is fastest.
        p = 0
        for other in range(1, pixels):
            if next_cycle[other] < next_cycle[p] or (
                next_cycle[other] == next_cycle[p] and next_phase[other] < next_phase[p]
            ):
                p = other
        now, phase, j = int(next_cycle[p]), float(next_phase[p]), int(next_bin[p])
        if now >= cycles:
            return counts
        stack[0] = p
        waiting = 1


@compiled()
def _set_off_neighbours(p: int, pixels: int, diode: _Diode, stack: Ints, waiting: int, rng: Generator) -> int:
    """Number of pixels on `stack`, of which `waiting` are there already, once the neighbours that an avalanche of
    pixel `p` sets off are added."""
    row, column = p // diode.columns, p % diode.columns
    for side in range(4):
        r = row + (1 if side == 0 else -1 if side == 1 else 0)
        c = column + (1 if side == 2 else -1 if side == 3 else 0)
        q = r * diode.columns + c
        if r < 0 or c < 0 or c >= diode.columns or q >= pixels or rng.random() >= diode.crosstalk:
            continue
        if waiting < len(stack):
            stack[waiting] = q
            waiting += 1
    return waiting


@compiled()
def _fill_inverse(flux: Floats, cumulative: Floats, guide: Ints) -> None:
    """Fill in `cumulative` (n + 1,), the flux Λ before each bin, and `guide` (n,), the bins in which Λ reaches the
    shares 0, 1/n, 2/n, … of the whole: there the search for a value of Λ starts."""
    n = len(flux)
    for i in range(n):
        cumulative[i + 1] = cumulative[i] + flux[i]
    j, step = 0, cumulative[n] / n
    for k in range(n):
        while j < n - 1 and cumulative[j + 1] <= k * step:
            j += 1
        guide[k] = j


@compiled()
def _bin_of(edges: Floats, phase: float) -> int:
    """Number of the bin in which a phase lies, by bisection."""
    low, high = 0, len(edges) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if edges[middle] <= phase:
            low = middle
        else:
            high = middle
    return low


@compiled()
def _next_photon(
    cumulative: Floats, period: _Period, guide: Ints, cycle: int, phase: float, cycles: int, rng: Generator
) -> tuple[int, float, int]:
    """(cycle, phase, bin) of the first photon detected after (`cycle`, `phase`), where Λ has grown by Exp(1).

    A cycle of `cycles` or later means that no photon is detected in the exposure.
    """
    edges = period.edges
    n = len(edges) - 1
    total = cumulative[n]
    j = int(phase * (1.0 / period.width))
    if j >= period.lattice:
        j = _bin_of(edges, phase)
    elif edges[j + 1] <= phase and j + 1 < n:
        # Rounding gave the number of the bin before.
        j += 1
    share = min(max((phase - edges[j]) / (edges[j + 1] - edges[j]), 0.0), 1.0)
    target = cumulative[j] + share * (cumulative[j + 1] - cumulative[j]) + rng.standard_exponential()
    if target >= total:
        laps = np.floor(target / total)
        if laps >= cycles - cycle:
            return cycles, 0.0, 0
        # After very many laps the rest of the target is mere rounding. An exponential number has no memory, so the
        # rest is independent of the number of laps and can be drawn afresh.
        target = max(target - laps * total, 0.0)
        if laps > _MANY_LAPS:
            target = -math.log1p(rng.random() * math.expm1(-total))
        if target >= total:
            target, laps = 0.0, laps + 1.0
        cycle += int(laps)
        j = 0
    # An empty bin adds nothing to Λ, so it is stepped over and never hit.
    j = max(j, guide[min(int(target * (n / total)), n - 1)])
    while cumulative[j + 1] <= target:
        j += 1
    at = edges[j] + (edges[j + 1] - edges[j]) * (target - cumulative[j]) / (cumulative[j + 1] - cumulative[j])
    return cycle, at, j


@compiled()
def _moment_armed_again(cycle: int, phase: float, period: float, synchronous: bool) -> tuple[int, float]:
    """(cycle, phase) at which a diode is armed again whose dead time ends at `phase`, perhaps beyond the period, of
    `cycle`: a synchronous one at the start of the next cycle at the latest."""
    if phase >= period:
        if synchronous:
            return cycle + 1, 0.0
        laps = np.floor(phase / period)
        return cycle + int(laps), max(phase - laps * period, 0.0)
    return cycle, phase


@compiled()
def _release(
    next_cycle: int, next_phase: float, j: int, cycle: int, phase: float, e: float, left: float, time: float,
    period: _Period, rng: Generator,
) -> tuple[int, float, int]:  # fmt: skip
    """(cycle, phase, bin) of the next avalanche: the photon's (`next_cycle`, `next_phase`, `j`), or an earlier
    release of a trap of which `left` releases are expected.

    The pixel is armed from (`cycle`, `phase`) on; `e` < `left` is the exponential number of the trap's first release.
    """
    length = period.edges[-1]
    delay = 0.0
    while e < left:
        delay -= time * math.log1p(-e / left)
        left -= e
        absolute = phase + delay
        laps = np.floor(absolute / length)
        if laps > next_cycle - cycle:
            break
        at_cycle, at_phase = cycle + int(laps), max(absolute - laps * length, 0.0)
        if at_cycle > next_cycle or (at_cycle == next_cycle and at_phase >= next_phase):
            break
        k = _bin_of(period.edges, at_phase)
        # A carrier is lost while the gate is shut, and the trap may release another one.
        if period.gate[k] >= 1.0 or rng.random() < period.gate[k]:
            return at_cycle, at_phase, k
        e = rng.standard_exponential()
    return next_cycle, next_phase, j
