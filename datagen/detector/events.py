"""One pixel, detection by detection, at a cost that depends on their number (case c; case e without neighbours).

From the moment s at which it is armed the next photon detected is where Λ(t) = Λ(s) + Exp(1), the integral of the
flux being inverted with a guide table; time is kept as (cycle, phase), so that it stays exact over any exposure.
Traps compete: one expected to release A more carriers releases its next at −t_t ln(1 − E/A) if E < A, with
E ~ Exp(1). An avalanche leaves A ← A exp(−Δt/t_t) + μ for the moment the pixel is armed again; what is released
before is lost, and what is released while the gate is shut too.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.detector.equilibrium import Equilibrium
from datagen.detector.streams import Stream, exponential, uniform

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

_MANY_LAPS = 2.0**20
"""Periods without an event after which the phase of the next one is drawn afresh, before rounding shows in it."""


def draw_free_running(
    flux: Array, edges_s: Array, width_s: float, front: int, dead_time_s: float, cycles: int, state: Equilibrium,
    stream: Stream,
) -> Ints:  # fmt: skip
    """(n,) detections in `cycles` laser periods of a detector that has been running for ever.

    The moment from which it is armed first is drawn from the equilibrium, hence the mean is exact for any number of
    cycles. `front` bins from phase 0 on have the width `width_s` (the last of all may be shorter).
    """
    cycle, phase = _first_armed(state, stream)
    gate, none = np.ones(len(flux)), np.zeros(0)
    # As that of a cycle: what is compiled for the one serves the other.
    gate.flags.writeable = False
    return run_alone(
        flux, edges_s, width_s, front, gate, dead_time_s, False, none, none, cycle, phase, cycles, stream
    )


def _first_armed(state: Equilibrium, stream: Stream) -> tuple[int, float]:
    """(cycle, phase) ≥ (0, 0) from which on a detector in equilibrium is armed."""
    edges = state.pieces.edges
    period, dead_time = float(edges[-1]), state.pieces.dead_time
    behind = uniform(stream) - state.armed
    per_cycle = float(state.detections.sum())
    if behind <= 0.0 or per_cycle <= 0.0:
        return 0, 0.0
    # The last detection was so long ago that `behind` detections are expected since then.
    laps, rest = divmod(behind, per_cycle)
    cumulative = np.append(0.0, np.cumsum(state.detections))
    ago = (laps + 1.0) * period - float(np.interp(per_cycle - rest, cumulative, edges))
    ahead = max(dead_time - ago, 0.0)
    cycle = int(ahead // period)
    return cycle, ahead - cycle * period


@compiled()
def run_alone(
    flux: Array, edges: Array, width: float, lattice: int, gate: Array, dead_time: float, synchronous: bool,
    loads: Array, times: Array, cycle: int, phase: float, cycles: int, stream: Stream,
) -> Ints:  # fmt: skip
    """(n,) detections in cycles 0 … `cycles` − 1 of a pixel that is armed from (`cycle`, `phase`) on."""
    n = len(flux)
    counts = np.zeros(n, np.int64)
    level = np.zeros(len(loads))
    period, per_width = edges[n], 1.0 / width
    cumulative, guide = np.zeros(n + 1), np.zeros(n, np.int64)
    fill_inverse(flux, cumulative, guide)
    if not cumulative[n] > 0.0:
        return counts
    while True:
        now, at, j = next_photon(cumulative, edges, per_width, lattice, guide, cycle, phase, cycles, stream)
        for t in range(len(loads)):
            e = exponential(stream)
            if e < level[t]:
                now, at, j = release(now, at, j, cycle, phase, e, level[t], times[t], edges, gate, stream)
        if now >= cycles:
            return counts
        if now >= 0:
            counts[j] += 1
        armed_cycle, armed_phase = armed_again(now, at + dead_time, period, synchronous)
        if len(loads):
            since = (armed_cycle - cycle) * period + (armed_phase - phase)
            for t in range(len(loads)):
                level[t] = level[t] * np.exp(-since / times[t]) + loads[t]
        cycle, phase = armed_cycle, armed_phase


@compiled()
def fill_inverse(flux: Array, cumulative: Array, guide: Ints) -> None:
    """Fill in sums Λ of the flux (n,) before each bin, (n + 1,) from 0 on, and (n,) the bins into which the shares
    0, 1/n, … of the whole fall."""
    n = len(flux)
    for i in range(n):
        cumulative[i + 1] = cumulative[i] + flux[i]
    j, step = 0, cumulative[n] / n
    for k in range(n):
        while j < n - 1 and cumulative[j + 1] <= k * step:
            j += 1
        guide[k] = j


@compiled()
def bin_of_phase(edges: Array, phase: float) -> int:
    """The bin that a phase lies in, by bisection."""
    low, high = 0, len(edges) - 1
    while high - low > 1:
        middle = (low + high) // 2
        if edges[middle] <= phase:
            low = middle
        else:
            high = middle
    return low


@compiled()
def next_photon(
    cumulative: Array, edges: Array, per_width: float, lattice: int, guide: Ints, cycle: int, phase: float,
    cycles: int, stream: Stream,
) -> tuple[int, float, int]:  # fmt: skip
    """(cycle, phase, bin) of the first photon detected after (cycle, phase), where Λ has grown by Exp(1).

    A cycle of `cycles` or later means that there is none.
    """
    n = len(edges) - 1
    total = cumulative[n]
    j = int(phase * per_width)
    if j >= lattice:
        j = bin_of_phase(edges, phase)
    elif edges[j + 1] <= phase and j + 1 < n:
        j += 1
    share = min(max((phase - edges[j]) / (edges[j + 1] - edges[j]), 0.0), 1.0)
    target = cumulative[j] + share * (cumulative[j + 1] - cumulative[j]) + exponential(stream)
    if target >= total:
        laps = np.floor(target / total)
        if laps >= cycles - cycle:
            return cycles, 0.0, 0
        # Subtracting many laps leaves only rounding, which may be far larger than Λ, or negative; what an exponential
        # number leaves of its last lap is independent of the laps before.
        target = max(target - laps * total, 0.0)
        if laps > _MANY_LAPS:
            target = -math.log1p(uniform(stream) * math.expm1(-total))
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
def armed_again(cycle: int, phase: float, period: float, synchronous: bool) -> tuple[int, float]:
    """(cycle, phase) at which a dead time that would end at `phase` of `cycle`, or later, is over."""
    if phase >= period:
        if synchronous:
            return cycle + 1, 0.0
        laps = np.floor(phase / period)
        return cycle + int(laps), max(phase - laps * period, 0.0)
    return cycle, phase


@compiled()
def release(
    now: int, at: float, j: int, cycle: int, phase: float, e: float, left: float, time: float, edges: Array,
    gate: Array, stream: Stream,
) -> tuple[int, float, int]:  # fmt: skip
    """(cycle, phase, bin) of the next avalanche: `now, at, j`, or an earlier release of a trap that holds `left`.

    The pixel is armed from (`cycle`, `phase`) on; `e` < `left` is the exponential number of the trap's first release.
    """
    period = edges[-1]
    delay = 0.0
    while e < left:
        delay -= time * math.log1p(-e / left)
        left -= e
        absolute = phase + delay
        laps = np.floor(absolute / period)
        if laps > now - cycle:
            break
        at_cycle, at_phase = cycle + int(laps), max(absolute - laps * period, 0.0)
        if at_cycle > now or (at_cycle == now and at_phase >= at):
            break
        k = bin_of_phase(edges, at_phase)
        if gate[k] >= 1.0 or uniform(stream) < gate[k]:
            return at_cycle, at_phase, k
        e = exponential(stream)
    return now, at, j
