"""Everything at once, avalanche by avalanche: afterpulsing (case e), crosstalk, paralyzable dead time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.detector.events import armed_again, fill_inverse, next_photon, release, run_alone
from datagen.detector.flux import Cycle
from datagen.detector.spad import Spad
from datagen.detector.streams import Stream, exponential, uniform

Array = NDArray[np.float64]

_BURN_IN_CYCLES = 24
_BURN_IN_TIMES = 8.0


def burn_in_cycles(spad: Spad, period_s: float) -> int:
    """Cycles simulated before the exposure, in which dead time and traps forget that they started empty."""
    longest = max(spad.dead_time_s, *(spad.afterpulse_times_s if spad.afterpulse_probability > 0 else (0.0,)))
    return _BURN_IN_CYCLES + int(np.ceil(_BURN_IN_TIMES * longest / period_s))


def draw_avalanches(flux: Array, cycle: Cycle, spad: Spad, cycles: int, stream: Stream) -> NDArray[np.int64]:
    """(pixel, n) detections in `cycles` periods of pixels with flux (pixel, n), coupled by crosstalk."""
    pixels, n = flux.shape
    # The bins at the front lie on the lattice (the last of all may be shorter): their number needs no search.
    lattice = min(cycle.front, n - 1)
    loads = np.array(spad.trap_loads) if spad.afterpulse_probability > 0 else np.zeros(0)
    times = np.array(spad.afterpulse_times_s) if spad.afterpulse_probability > 0 else np.zeros(0)
    burn_in, synchronous = burn_in_cycles(spad, cycle.period_s), spad.mode == "synchronous"
    if pixels == 1 and not spad.paralyzable:
        return run_alone(
            flux[0], cycle.edges_s, cycle.width_s, lattice, cycle.gate, spad.dead_time_s, synchronous, loads, times,
            -burn_in, 0.0, cycles, stream,
        )[None]  # fmt: skip
    return _run(
        flux, cycle.edges_s, cycle.width_s, lattice, cycle.gate, spad.dead_time_s, synchronous, spad.paralyzable,
        loads, times, spad.crosstalk_probability, spad.array_columns or pixels, burn_in, cycles, stream,
    )  # fmt: skip


@compiled()
def _run(
    flux: Array, edges: Array, width: float, lattice: int, gate: Array, dead_time: float, synchronous: bool,
    paralyzable: bool, loads: Array, times: Array, crosstalk: float, columns: int, burn_in: int, cycles: int,
    stream: Stream,
) -> NDArray[np.int64]:  # fmt: skip
    pixels, n = flux.shape
    period, per_width = float(edges[n]), 1.0 / width
    counts = np.zeros((pixels, n), np.int64)
    cumulative, guide = np.zeros((pixels, n + 1)), np.zeros((pixels, n), np.int64)
    for p in range(pixels):
        fill_inverse(flux[p], cumulative[p], guide[p])
    # The moment from which each pixel is armed, and its next avalanche.
    armed_cycle, armed_phase = np.full(pixels, -burn_in, np.int64), np.zeros(pixels)
    next_cycle, next_phase = np.full(pixels, -burn_in, np.int64), np.zeros(pixels)
    next_bin = np.zeros(pixels, np.int64)
    # Releases still expected of each trap from the moment its pixel is armed.
    level = np.zeros((pixels, len(loads)))
    # Pixels whose next avalanche is to be drawn: at first all of them, later those that avalanche at one moment.
    stack = np.empty(4 * pixels + 8, np.int64)
    for p in range(pixels):
        stack[p] = pixels - 1 - p
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
                new_cycle, new_phase = armed_again(now, phase + dead_time, period, synchronous)
                since = (new_cycle - armed_cycle[p]) * period + (new_phase - armed_phase[p])
                for t in range(len(loads)):
                    level[p, t] = level[p, t] * np.exp(-since / times[t]) + loads[t]
                armed_cycle[p], armed_phase[p] = new_cycle, new_phase
                # Under a paralyzable dead time the next photon matters even if it comes too early.
                from_cycle, from_phase = (now, phase) if paralyzable else (new_cycle, new_phase)
            later, at, k = cycles, 0.0, 0
            if cumulative[p, n] > 0.0:
                later, at, k = next_photon(
                    cumulative[p], edges, per_width, lattice, guide[p], from_cycle, from_phase, cycles, stream
                )
            for t in range(len(times)):
                e = exponential(stream)
                if e < level[p, t]:
                    later, at, k = release(
                        later, at, k, from_cycle, from_phase, e, level[p, t], times[t], edges, gate, stream
                    )
            next_cycle[p], next_phase[p], next_bin[p] = later, at, k
            if is_armed and crosstalk > 0.0:
                row, column = p // columns, p % columns
                for way in range(4):
                    r = row + (1 if way == 0 else -1 if way == 1 else 0)
                    c = column + (1 if way == 2 else -1 if way == 3 else 0)
                    q = r * columns + c
                    if r < 0 or c < 0 or c >= columns or q >= pixels or uniform(stream) >= crosstalk:
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
