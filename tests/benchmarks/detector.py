"""What a histogram costs: every sampler at several fluxes, 1024 bins and 10⁶ cycles.

`python tests/benchmarks/detector.py` prints the figures of docs/figures.md. Beside our samplers, in the same run, the
plain simulation: every photon drawn, sorted, and put to the detector's rule one by one (afterpulses left out).
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from datagen.bench.measuring import machine, markdown, processor_seconds
from datagen.detector import Exposure, Spad, choose_sampler, detect, expected_histogram
from datagen.records import TimeAxis

AXIS, CYCLES = TimeAxis(1024, 100e-12), 10**6
PERIOD_S = AXIS.bins * AXIS.width_s
FLUXES = (0.01, 0.1, 1.0, 4.0)
"""Events per cycle."""
BLOCK, SLOW = 16, ("events",)
"""Histograms drawn at once, and the sampler that goes event by event, of which one histogram is drawn."""
REPEATS, TIMED_S = 5, 0.08
CASES = {
    "ideal": Spad(pde=1.0, mode="ideal"),
    "synchronous, one a cycle": Spad(pde=1.0, mode="synchronous", dead_time_s=1e-6),
    "synchronous, 20 ns": Spad(pde=1.0, mode="synchronous", dead_time_s=20e-9),
    "free running, 50 ns": Spad(pde=1.0, dead_time_s=50e-9),
    "free running, 250 ns": Spad(pde=1.0, dead_time_s=250e-9),
    "afterpulses 2 %, 50 ns": Spad(
        pde=1.0, dead_time_s=50e-9, afterpulse_probability=0.02, afterpulse_times_s=(60e-9,)
    ),
}


def demonstration_shape() -> NDArray[np.float64]:
    """(bin,) sums to 1: a direct return of half of all light, a hidden scene's two bumps, a floor."""
    i = np.arange(AXIS.bins)
    hidden = np.exp(-(((i - 420) / 35.0) ** 2)) + 0.4 * np.exp(-(((i - 600) / 70.0) ** 2)) + 0.01
    hidden[:200] = 0.01
    shape = 0.5 * hidden / hidden.sum()
    shape[120] += 0.5
    return np.asarray(shape)


def plain_histogram(flux: NDArray[np.float64], spad: Spad) -> NDArray[np.int64]:
    """One histogram, photon by photon; a synchronous detector is ready at the start of every cycle."""
    rng = np.random.default_rng(0)
    dead_time = 0.0 if spad.mode == "ideal" else spad.dead_time_s
    count = rng.poisson(flux.sum() * CYCLES)
    bins = np.searchsorted(np.cumsum(flux), rng.random(count) * flux.sum(), side="right")
    photons = rng.integers(CYCLES, size=count) * PERIOD_S + (bins + rng.random(count)) * AXIS.width_s
    kept, ready, cycle_end = list[float](), -1.0, -1.0
    for t in np.sort(photons).tolist():
        if spad.mode == "synchronous" and t >= cycle_end:
            ready, cycle_end = -1.0, (t // PERIOD_S + 1.0) * PERIOD_S
        if t >= ready:
            kept.append(t)
            ready = t + dead_time
    return np.histogram(np.asarray(kept) % PERIOD_S, AXIS.bins, (0, PERIOD_S))[0]


def milliseconds(call: Callable[[], object]) -> float:
    """Processor time of one call: the median of a few runs, each long enough to be timed."""
    _, once = processor_seconds(call)
    inner = max(1, min(200, int(TIMED_S / max(once, 1e-6))))
    runs = [processor_seconds(lambda: [call() for _ in range(inner)])[1] for _ in range(REPEATS if once < 1 else 1)]
    return 1e3 * statistics.median(runs) / inner


def row(name: str, spad: Spad, flux: float) -> list[str]:
    """One case at one flux, exact samplers only (tolerance 0)."""
    exposure, shape = Exposure(1.0 / PERIOD_S, CYCLES, 1.0), demonstration_shape() * flux
    sampler = choose_sampler(shape, AXIS, spad, exposure, tolerance=0.0).sampler
    size = 1 if sampler in SLOW else BLOCK
    block = np.tile(shape, (size, 1, 1))
    draw = partial(detect, block, AXIS, spad, exposure, tolerance=0.0)
    mean = partial(expected_histogram, block, AXIS, spad, exposure, approximate=True)
    ms, plain_ms = milliseconds(draw) / size, milliseconds(lambda: plain_histogram(shape, spad))
    each = 1e6 * ms * size / max(float(draw().sum()), 1.0)
    return [name, f"{flux:g}", sampler, f"{ms:.3g}", f"{milliseconds(mean) / size:.3g}", f"{each:.3g}",
            f"{plain_ms:.4g}", f"{plain_ms / ms:.0f}×"]  # fmt: skip


def main() -> None:
    """Print milliseconds per histogram for every sampler and flux."""
    head = ["case", "flux / cycle", "sampler", "ms", "exact mean (ms)", "ns / detection", "plain (ms)", "ratio"]
    print(f"{AXIS.bins} bins, {CYCLES:.0e} cycles, tolerance 0; processor time, {machine()}\n")
    print(markdown(head, [row(name, spad, flux) for name, spad in CASES.items() for flux in FLUXES]))


if __name__ == "__main__":
    main()
