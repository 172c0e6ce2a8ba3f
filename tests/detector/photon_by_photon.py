"""The truth the samplers are held against: every photon drawn, sorted, and put to the rule one by one.

Nothing here is shared with the package: plain lists, absolute times, a heap of released carriers.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Rule:
    dead_time: float
    synchronous: bool = False
    paralyzable: bool = False
    loads: tuple[float, ...] = ()
    times: tuple[float, ...] = ()
    crosstalk: float = 0.0
    columns: int = 1


def arrivals(flux, edges, first_cycle, cycles, rng):
    """Sorted absolute times of one pixel's avalanche-capable events."""
    count = rng.poisson(flux.sum() * (cycles - first_cycle))
    if count == 0:
        return np.zeros(0)
    cumulative = np.cumsum(flux)
    bins = np.searchsorted(cumulative, rng.random(count) * cumulative[-1], side="right")
    phase = edges[bins] + rng.random(count) * np.diff(edges)[bins]
    return np.sort(rng.integers(first_cycle, cycles, count) * edges[-1] + phase)


def simulate(flux, edges, cycles: int, rule: Rule, rng, burn_in: int = 0, gate=None) -> NDArray[np.int64]:
    """(pixel, n) recorded detections per bin in cycles 0 … `cycles` − 1; flux (pixel, n)."""
    flux = np.atleast_2d(flux)
    if not rule.loads and rule.crosstalk == 0:
        return np.stack([_photons_only(f, edges, cycles, rule, rng, burn_in) for f in flux])
    return _with_carriers(flux, edges, cycles, rule, rng, burn_in, gate)


def _photons_only(flux, edges, cycles, rule, rng, burn_in):
    period = edges[-1]
    recorded = []
    ready, cycle_end = -np.inf, -np.inf
    for t in arrivals(flux, edges, -burn_in, cycles, rng).tolist():
        if rule.synchronous and t >= cycle_end:
            ready, cycle_end = -np.inf, (t // period + 1) * period
        if t >= ready:
            recorded.append(t)
            ready = t + rule.dead_time
        elif rule.paralyzable:
            ready = t + rule.dead_time
    return _histogram(recorded, edges)


def _with_carriers(flux, edges, cycles, rule, rng, burn_in, gate):
    pixels, period = len(flux), edges[-1]
    events = []
    for p, f in enumerate(flux):
        events += [(t, p, False) for t in arrivals(f, edges, -burn_in, cycles, rng).tolist()]
    heapq.heapify(events)
    ready = [-np.inf] * pixels
    recorded = [[] for _ in range(pixels)]
    while events:
        t, p, is_release = heapq.heappop(events)
        if t >= cycles * period:
            break
        if t < ready[p]:
            continue
        if is_release and gate is not None:
            sensitivity = gate[min(np.searchsorted(edges, t % period, side="right") - 1, len(gate) - 1)]
            if rng.random() >= sensitivity:
                continue
        recorded[p].append(t)
        ready[p] = t + rule.dead_time
        if rule.synchronous:
            ready[p] = min(ready[p], (t // period + 1) * period)
        for load, time in zip(rule.loads, rule.times, strict=True):
            for _ in range(rng.poisson(load)):
                heapq.heappush(events, (ready[p] + rng.exponential(time), p, True))
        for q in _neighbours(p, pixels, rule.columns):
            if rng.random() < rule.crosstalk:
                heapq.heappush(events, (t, q, False))
    return np.stack([_histogram(r, edges) for r in recorded])


def _neighbours(p, pixels, columns):
    row, column = divmod(p, columns)
    places = [(row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)]
    return [r * columns + c for r, c in places if r >= 0 and 0 <= c < columns and r * columns + c < pixels]


def _histogram(times, edges):
    times = np.asarray(times)
    phases = np.mod(times[times >= 0], edges[-1])
    return np.histogram(phases, edges)[0]
