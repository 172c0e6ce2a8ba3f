"""Everything at once, avalanche by avalanche: afterpulsing (case e), crosstalk between pixels, paralyzable dead time.

Between avalanches a pixel's next one is the earlier of the next photon, where Λ(t) = Λ(s) + Exp(1), and the next
release of each trap: a trap expected to release A more carriers releases its next at −t_t ln(1 − E/A) if E < A, with
E ~ Exp(1). An avalanche leaves A ← A exp(−Δt/t_t) + μ for the moment the pixel is armed again; what is released
before is lost, and what is released while the gate is shut too.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from datagen.detector.events import MANY_LAPS, rest_of_lap
from datagen.detector.flux import Cycle
from datagen.detector.spad import Spad

Array = NDArray[np.float64]

_BURN_IN_CYCLES = 24
_BURN_IN_TIMES = 8.0


def burn_in_cycles(spad: Spad, period_s: float) -> int:
    """Cycles simulated before the exposure, in which dead time and traps forget that they started empty."""
    longest = max(spad.dead_time_s, *(spad.afterpulse_times_s if spad.afterpulse_probability > 0 else (0.0,)))
    return _BURN_IN_CYCLES + int(np.ceil(_BURN_IN_TIMES * longest / period_s))


def draw_avalanches(
    flux: Array, cycle: Cycle, spad: Spad, cycles: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """(pixel, n) detections in `cycles` periods of pixels with flux (pixel, n), coupled by crosstalk."""
    pixels = len(flux)
    cumulative = np.concatenate([np.zeros((pixels, 1)), np.cumsum(flux, axis=1)], axis=1)
    n = flux.shape[1]
    # The bins at the front lie on the lattice (the last of all may be shorter): their number needs no search.
    lattice = min(cycle.front, n - 1)
    shares = np.arange(n) / n
    guide = np.stack([np.searchsorted(c, c[-1] * shares, side="right") - 1 for c in cumulative])
    loads = np.array(spad.trap_loads) if spad.afterpulse_probability > 0 else np.zeros(0)
    times = np.array(spad.afterpulse_times_s) if spad.afterpulse_probability > 0 else np.zeros(0)
    if pixels == 1 and not spad.paralyzable:
        return _run_alone(
            cumulative[0], cycle.edges_s, cycle.width_s, lattice, guide[0], cycle.gate, spad.dead_time_s,
            spad.mode == "synchronous", loads, times, burn_in_cycles(spad, cycle.period_s), cycles, rng,
        )[None]  # fmt: skip
    return _run(
        cumulative, cycle.edges_s, cycle.width_s, lattice, guide, cycle.gate, spad.dead_time_s,
        spad.mode == "synchronous", spad.paralyzable, loads, times, spad.crosstalk_probability,
        spad.array_columns or pixels, burn_in_cycles(spad, cycle.period_s), cycles, rng,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def _run(
    cumulative: Array, edges: Array, width: float, lattice: int, guide: NDArray[np.int64], gate: Array,
    dead_time: float, synchronous: bool, paralyzable: bool, loads: Array, times: Array, crosstalk: float,
    columns: int, burn_in: int, cycles: int, rng: np.random.Generator,
) -> NDArray[np.int64]:  # fmt: skip
    pixels, n = cumulative.shape[0], cumulative.shape[1] - 1
    period, per_width = edges[n], 1.0 / width
    counts = np.zeros((pixels, n), np.int64)
    # The moment from which each pixel is armed, and its next avalanche.
    armed_cycle, armed_phase = np.full(pixels, -burn_in, np.int64), np.zeros(pixels)
    next_cycle, next_phase = np.full(pixels, -burn_in, np.int64), np.zeros(pixels)
    next_bin = np.zeros(pixels, np.int64)
    # Releases still expected of each trap from the moment its pixel is armed.
    level = np.zeros((pixels, len(loads)))
    # Pixels whose next avalanche is to be drawn: at first all of them, later those that avalanche at one moment.
    stack = np.empty(4 * pixels + 8, np.int64)
    stack[:pixels] = np.arange(pixels)[::-1]
    waiting, now, phase, j = pixels, -burn_in, 0.0, -1
    while True:
        while waiting > 0:
            waiting -= 1
            p = int(stack[waiting])
            from_cycle, from_phase, is_armed = -burn_in, 0.0, False
            if j >= 0:
                is_armed = bool(armed_cycle[p] < now or (armed_cycle[p] == now and armed_phase[p] <= phase))
                if not is_armed and not paralyzable:
                    continue
                if is_armed and now >= 0:
                    counts[p, j] += 1
                new_cycle, new_phase = _armed_again(now, phase + dead_time, period, synchronous)
                since = (new_cycle - armed_cycle[p]) * period + (new_phase - armed_phase[p])
                for t in range(len(loads)):
                    level[p, t] = level[p, t] * np.exp(-since / times[t]) + loads[t]
                armed_cycle[p], armed_phase[p] = new_cycle, new_phase
                # Under a paralyzable dead time the next photon matters even if it comes too early.
                from_cycle, from_phase = (now, phase) if paralyzable else (new_cycle, new_phase)
            later, at, k, total = cycles, 0.0, 0, cumulative[p, n]
            if total > 0.0:
                e = rng.standard_exponential()
                u = 0.0 if e <= MANY_LAPS * total else rng.random()
                later, at, k = _next_photon(
                    cumulative[p], edges, per_width, lattice, guide[p], from_cycle, from_phase, cycles, e, u
                )
            for t in range(len(times)):
                e = rng.standard_exponential()
                if e < level[p, t]:
                    later, at, k = _release(
                        later, at, k, from_cycle, from_phase, e, level[p, t], times[t], edges, gate, rng
                    )
            next_cycle[p], next_phase[p], next_bin[p] = later, at, k
            if is_armed and crosstalk > 0.0:
                row, column = p // columns, p % columns
                for way in range(4):
                    r = row + (1 if way == 0 else -1 if way == 1 else 0)
                    c = column + (1 if way == 2 else -1 if way == 3 else 0)
                    q = r * columns + c
                    if r < 0 or c < 0 or c >= columns or q >= pixels or rng.random() >= crosstalk:
                        continue
                    if waiting < len(stack):
                        stack[waiting] = q
                        waiting += 1
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


@numba.njit(cache=True, error_model="numpy")
def _run_alone(
    cumulative: Array, edges: Array, width: float, lattice: int, guide: NDArray[np.int64], gate: Array,
    dead_time: float, synchronous: bool, loads: Array, times: Array, burn_in: int, cycles: int,
    rng: np.random.Generator,
) -> NDArray[np.int64]:  # fmt: skip
    """The same, in half the time, for one pixel without neighbours and a dead time that nothing prolongs."""
    counts = np.zeros(len(edges) - 1, np.int64)
    level = np.zeros(len(loads))
    period, total, per_width = edges[-1], cumulative[-1], 1.0 / width
    if not total > 0.0:
        return counts
    cycle, phase = -burn_in, 0.0
    while True:
        e = rng.standard_exponential()
        u = 0.0 if e <= MANY_LAPS * total else rng.random()
        now, at, j = _next_photon(cumulative, edges, per_width, lattice, guide, cycle, phase, cycles, e, u)
        for t in range(len(loads)):
            e = rng.standard_exponential()
            if e < level[t]:
                now, at, j = _release(now, at, j, cycle, phase, e, level[t], times[t], edges, gate, rng)
        if now >= cycles:
            return counts
        if now >= 0:
            counts[j] += 1
        armed_cycle, armed_phase = _armed_again(now, at + dead_time, period, synchronous)
        since = (armed_cycle - cycle) * period + (armed_phase - phase)
        for t in range(len(loads)):
            level[t] = level[t] * np.exp(-since / times[t]) + loads[t]
        cycle, phase = armed_cycle, armed_phase


@numba.njit(inline="always")
def _armed_again(cycle: int, phase: float, period: float, synchronous: bool) -> tuple[int, float]:
    """(cycle, phase) at which a dead time that would end at `phase` of `cycle`, or later, is over."""
    if phase >= period:
        if synchronous:
            cycle, phase = cycle + 1, 0.0
        else:
            laps = np.floor(phase / period)
            cycle, phase = cycle + int(laps), max(phase - laps * period, 0.0)
    return cycle, phase


@numba.njit(cache=True, error_model="numpy")
def _release(
    now: int, at: float, j: int, cycle: int, phase: float, e: float, left: float, time: float, edges: Array,
    gate: Array, rng: np.random.Generator,
) -> tuple[int, float, int]:  # fmt: skip
    """(cycle, phase, bin) of the next avalanche: `now, at, j`, or an earlier release of a trap that holds `left`.

    The pixel is armed from (`cycle`, `phase`) on; `e` < `left` is the exponential number of the trap's first release.
    """
    period = edges[-1]
    delay = 0.0
    while e < left:
        delay -= time * np.log1p(-e / left)
        left -= e
        absolute = phase + delay
        laps = np.floor(absolute / period)
        if laps > now - cycle:
            break
        at_cycle, at_phase = cycle + int(laps), max(absolute - laps * period, 0.0)
        if at_cycle > now or (at_cycle == now and at_phase >= at):
            break
        k = min(max(int(np.searchsorted(edges, at_phase, side="right")) - 1, 0), len(gate) - 1)
        if gate[k] >= 1.0 or rng.random() < gate[k]:
            return at_cycle, at_phase, k
        e = rng.standard_exponential()
    return now, at, j


@numba.njit(cache=True, error_model="numpy")
def _next_photon(
    cumulative: Array, edges: Array, per_width: float, lattice: int, guide: NDArray[np.int64], cycle: int,
    phase: float, cycles: int, e: float, u: float,
) -> tuple[int, float, int]:  # fmt: skip
    """(cycle, phase, bin) of the first photon detected after (cycle, phase), where Λ has grown by `e`.

    `u` is a uniform number, used beyond `MANY_LAPS` periods. A cycle of `cycles` or later means that there is none.
    """
    n = len(edges) - 1
    total = cumulative[n]
    j = int(phase * per_width)
    if j >= lattice:
        j = min(max(int(np.searchsorted(edges, phase, side="right")) - 1, 0), n - 1)
    elif edges[j + 1] <= phase:
        j += 1
    share = min(max((phase - edges[j]) / (edges[j + 1] - edges[j]), 0.0), 1.0)
    target = cumulative[j] + share * (cumulative[j + 1] - cumulative[j]) + e
    if target >= total:
        laps = np.floor(target / total)
        target = max(target - laps * total, 0.0) if e <= MANY_LAPS * total else rest_of_lap(total, u)
        if target >= total:
            target, laps = 0.0, laps + 1.0
        cycle = cycle + int(laps) if laps < cycles - cycle else cycles
        j = 0
    # An empty bin adds nothing to Λ, so it is stepped over and never hit.
    j = max(j, int(guide[min(int(target * (n / total)), n - 1)]))
    while cumulative[j + 1] <= target:
        j += 1
    at = edges[j] + (edges[j + 1] - edges[j]) * (target - cumulative[j]) / (cumulative[j + 1] - cumulative[j])
    return cycle, at, j
