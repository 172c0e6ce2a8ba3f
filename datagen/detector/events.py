"""Free-running counting, detection by detection (case c), at a cost that depends on their number only."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from datagen.detector.equilibrium import Equilibrium

Array = NDArray[np.float64]

MANY_LAPS = 2.0**20
"""Periods without an event after which the phase of the next one is drawn afresh, before rounding shows in it."""


def draw_free_running(
    flux: Array, edges_s: Array, width_s: float, front: int, dead_time_s: float, cycles: int, state: Equilibrium,
    rng: np.random.Generator,
) -> NDArray[np.int64]:  # fmt: skip
    """(n,) detections in `cycles` laser periods of a detector that has been running for ever.

    From the moment s at which it is armed the next event is where Λ(t) = Λ(s) + Exp(1), the integral of the flux
    being inverted with a guide table; time is kept as (cycle, phase), so that it stays exact over any exposure. The
    first moment is drawn from the equilibrium, hence the mean is exact for any number of cycles.

    `front` bins from phase 0 on have the width `width_s` (the last of all may be shorter).
    """
    cumulative = np.append(0.0, np.cumsum(flux))
    total = cumulative[-1]
    if not total > 0.0:
        return np.zeros(len(flux), np.int64)
    cycle, phase = _first_armed(state, rng)
    guide = np.searchsorted(cumulative, total * np.arange(len(flux)) / len(flux), side="right") - 1
    return _run(cumulative, edges_s, width_s, front, guide, dead_time_s, cycles, cycle, phase, rng)


def _first_armed(state: Equilibrium, rng: np.random.Generator) -> tuple[int, float]:
    """(cycle, phase) ≥ (0, 0) from which on a detector in equilibrium is armed."""
    edges = state.pieces.edges
    period, dead_time = float(edges[-1]), state.pieces.dead_time
    behind = rng.random() - state.armed
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


@numba.njit(cache=True)
def rest_of_lap(total: float, u: float) -> float:
    """What an exponential number leaves of its last lap of length `total`, u uniform: independent of the laps before.

    Subtracting many laps leaves only rounding, which may be far larger than `total`, or negative.
    """
    return float(-np.log1p(u * np.expm1(-total)))


@numba.njit(cache=True)
def _run(
    cumulative: Array, edges: Array, width: float, front: int, guide: NDArray[np.int64], dead_time: float,
    cycles: int, cycle: int, phase: float, rng: np.random.Generator,
) -> NDArray[np.int64]:  # fmt: skip
    n = len(guide)
    total, period = cumulative[n], edges[n]
    per_total = n / total
    whole = int(np.floor(dead_time / period))
    rest = dead_time - whole * period
    per_width = 1.0 / width
    counts = np.zeros(n, np.int64)
    while True:
        # Λ at the phase from which the detector is armed.
        j = int(phase * per_width)
        if j >= front:
            j = min(max(int(np.searchsorted(edges, phase, side="right")) - 1, 0), n - 1)
        elif edges[j + 1] <= phase and j + 1 < n:
            j += 1
        share = min(max((phase - edges[j]) / (edges[j + 1] - edges[j]), 0.0), 1.0)
        target = cumulative[j] + share * (cumulative[j + 1] - cumulative[j]) + rng.standard_exponential()
        if target >= total:
            laps = np.floor(target / total)
            if laps >= cycles - cycle:
                return counts
            cycle += int(laps)
            target = max(target - laps * total, 0.0)
            if laps > MANY_LAPS:
                target = rest_of_lap(total, rng.random())
            if target >= total:
                target = 0.0
                cycle += 1
            j = 0
        j = max(j, int(guide[min(int(target * per_total), n - 1)]))
        # An empty bin adds nothing to Λ, so it is stepped over and never hit.
        while cumulative[j + 1] <= target:
            j += 1
        if cycle >= cycles:
            return counts
        counts[j] += 1
        phase = edges[j] + (edges[j + 1] - edges[j]) * (target - cumulative[j]) / (cumulative[j + 1] - cumulative[j])
        phase += rest
        cycle += whole
        if phase >= period:
            phase -= period
            cycle += 1
        if cycle >= cycles:
            return counts
