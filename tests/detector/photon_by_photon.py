"""The reference for the samplers: every photon is drawn, and the photons are handled one by one in the order of time.

The package shares nothing with this simulation. It uses absolute times, and handles one photon of all replicates at a
time; where avalanches cause others it uses plain lists and a heap of these.
"""

from __future__ import annotations

import heapq
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
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


def simulate(
    flux, edges, cycles: int, rule: Rule, rng, replicates: int, burn_in: int = 0, gate=None
) -> NDArray[np.int64]:
    """(replicate, pixel, n) recorded detections per bin in cycles 0 … `cycles` − 1; flux (pixel, n)."""
    flux = np.atleast_2d(flux)
    if not rule.loads and rule.crosstalk == 0:
        return np.stack([_photons_only(f, edges, cycles, rule, rng, replicates, burn_in) for f in flux], axis=1)
    alone = _with_carriers(flux, edges, cycles, rule, rng, burn_in, gate)
    return np.stack([next(alone) for _ in range(replicates)])


def arrivals(flux, edges, first_cycle, cycles, rng, replicates):
    """(most, replicate) sorted absolute times of one pixel's avalanche-capable events; infinite after the last."""
    count = rng.poisson(flux.sum() * (cycles - first_cycle), replicates)
    cumulative = np.cumsum(flux)
    shape = (count.max(), replicates)
    bins = np.minimum(np.searchsorted(cumulative, rng.random(shape) * cumulative[-1], side="right"), len(flux) - 1)
    phase = edges[bins] + rng.random(shape) * np.diff(edges)[bins]
    times = rng.integers(first_cycle, cycles, shape) * edges[-1] + phase
    return np.sort(np.where(np.arange(shape[0])[:, None] < count, times, np.inf), axis=0)


def _photons_only(flux, edges, cycles, rule, rng, replicates, burn_in):
    times = arrivals(flux, edges, -burn_in, cycles, rng, replicates)
    there = np.isfinite(times)
    cycle = np.floor_divide(times, edges[-1], where=there, out=np.full(times.shape, np.inf))
    recorded = np.zeros(times.shape, bool)
    ready, current = np.full(replicates, -np.inf), np.full(replicates, -np.inf)
    for k, t in enumerate(times):
        if rule.synchronous:
            ready = np.where(cycle[k] > current, -np.inf, ready)
            current = cycle[k]
        recorded[k] = t >= ready
        ready = t + rule.dead_time if rule.paralyzable else np.where(recorded[k], t + rule.dead_time, ready)
    recorded &= there & (times >= 0)
    bins = np.searchsorted(edges, np.mod(times[recorded], edges[-1]), side="right") - 1
    return np.bincount(np.nonzero(recorded)[1] * len(flux) + bins, minlength=replicates * len(flux)).reshape(
        replicates, -1
    )


def _with_carriers(flux, edges, cycles, rule, rng, burn_in, gate) -> Iterator[NDArray[np.int64]]:
    """Endless replicates, (pixel, n) detections each."""
    pixels, period, ends = len(flux), edges[-1], edges.tolist()
    neighbours = [_neighbours(p, pixels, rule.columns) for p in range(pixels)]
    uniform, wait = _one_by_one(rng.random), _one_by_one(rng.standard_exponential)
    carriers = [_one_by_one(lambda n, load=load: rng.poisson(load, n)) for load in rule.loads]
    while True:
        photons = [arrivals(f, edges, -burn_in, cycles, rng, 1)[:, 0].tolist() for f in flux]
        # The next photon of each pixel, and the events that avalanches caused.
        events = [(times[0], p, "photon") for p, times in enumerate(photons) if times]
        heapq.heapify(events)
        ready = [-np.inf] * pixels
        recorded: list[list[float]] = [[] for _ in range(pixels)]
        while events:
            t, p, kind = heapq.heappop(events)
            if t >= cycles * period:
                break
            seen = t >= ready[p]
            if kind == "release" and seen and gate is not None:
                seen = uniform() < gate[min(bisect_right(ends, t % period) - 1, len(gate) - 1)]
            if seen:
                recorded[p].append(t)
                ready[p] = t + rule.dead_time
                if rule.synchronous:
                    ready[p] = min(ready[p], (t // period + 1) * period)
                for number, time in zip(carriers, rule.times, strict=True):
                    for _ in range(number()):
                        heapq.heappush(events, (ready[p] + time * wait(), p, "release"))
                for q in neighbours[p]:
                    if uniform() < rule.crosstalk:
                        heapq.heappush(events, (t, q, "crosstalk"))
            if kind == "photon":
                # Photons that arrive before the pixel is ready again are lost.
                following = max(bisect_right(photons[p], t), bisect_left(photons[p], ready[p]))
                if following < len(photons[p]):
                    heapq.heappush(events, (photons[p][following], p, "photon"))
        yield np.stack([_histogram(r, edges) for r in recorded])


def _one_by_one(draw: Callable[[int], NDArray]) -> Callable[[], float]:
    """A function that returns one random number of a law, which are drawn 4096 at a time."""

    def numbers() -> Iterator[float]:
        while True:
            yield from draw(4096).tolist()

    return numbers().__next__


def _neighbours(p, pixels, columns):
    row, column = divmod(p, columns)
    places = [(row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)]
    return [r * columns + c for r, c in places if r >= 0 and 0 <= c < columns and r * columns + c < pixels]


def _histogram(times, edges):
    times = np.asarray(times)
    phases = np.mod(times[times >= 0], edges[-1])
    return np.histogram(phases, edges)[0]
