"""What a histogram costs: every sampler at several fluxes, 1024 bins and 10⁶ cycles.

Beside the naive simulation in the same run: every photon drawn, sorted, and put to the detector's rule one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import click
import numpy as np
from numpy.typing import NDArray

from datagen.bench.measuring import machine, markdown, processor_seconds
from datagen.detector import Exposure, Spad, choose_sampler, detect, expected_histogram
from datagen.records import TimeAxis

BINS, BIN_WIDTH_S, CYCLES = 1024, 100e-12, 10**6
BLOCK = 16
EVENT_DRIVEN = ("free_running_events", "avalanches")
PERIOD_S = BINS * BIN_WIDTH_S
FLUXES = (0.01, 0.1, 1.0, 4.0)
_REPEATS = 5
_SECONDS = 0.4

CASES: dict[str, tuple[Spad, bool]] = {
    "a. ideal": (Spad(pde=1.0, mode="ideal"), False),
    "b. synchronous, one a cycle": (Spad(pde=1.0, mode="synchronous", dead_time_s=1e-6), False),
    "d. synchronous, 20 ns": (Spad(pde=1.0, mode="synchronous", dead_time_s=20e-9), False),
    "c. free running, 50 ns": (Spad(pde=1.0, dead_time_s=50e-9), False),
    "c. free running, 250 ns": (Spad(pde=1.0, dead_time_s=250e-9), False),
    "c. as ensemble, 50 ns": (Spad(pde=1.0, dead_time_s=50e-9), True),
    "e. afterpulses 2 %, 50 ns": (
        Spad(pde=1.0, dead_time_s=50e-9, afterpulse_probability=0.02, afterpulse_times_s=(60e-9,)),
        False,
    ),
}
"""Name → detector, and whether approximation is allowed."""


@dataclass(frozen=True)
class Row:
    """One case at one flux; milliseconds of processor time per histogram, medians of several runs.

    Attributes
    ----------
    detections : in a histogram.
    ms, mean_ms : of `detect` and `expected_histogram`, on `BLOCK` histograms at once where each takes little.
    naive_ms : of the naive simulation; NaN: not run.
    """

    case: str
    flux: float
    sampler: str
    detections: float
    ms: float
    mean_ms: float
    naive_ms: float

    def cells(self) -> list[str]:
        """Of the table."""
        each = self.ms * 1e6 / max(self.detections, 1.0)
        measured = [f"{value:.3g}" for value in (self.ms, self.mean_ms, each)]
        naive = f"{self.naive_ms:.4g}", f"{self.naive_ms / self.ms:.0f}×"
        return [self.case, f"{self.flux:g}", self.sampler, *measured, *naive]


HEAD = ("case", "flux / cycle", "sampler", "ms", "exact mean (ms)", "ns / detection", "naive (ms)", "ratio")


def measure(fluxes: Sequence[float] = FLUXES, naive: bool = True) -> list[Row]:
    """Time every case at every flux (events per cycle), with exact samplers only (tolerance 0)."""
    axis, exposure = TimeAxis(BINS, BIN_WIDTH_S), Exposure(1.0 / PERIOD_S, CYCLES, 1.0)
    rows = []
    for case, (spad, ensemble) in CASES.items():
        for flux in fluxes:
            shape = demonstration_shape() * flux
            plan = choose_sampler(shape, axis, spad, exposure, tolerance=0.0, approximate=ensemble)
            if ensemble and not plan.approximate:
                continue
            size = 1 if plan.sampler in EVENT_DRIVEN else BLOCK
            block = np.tile(shape, (size, 1, 1))
            draw = partial(detect, block, axis, spad, exposure, tolerance=0.0, approximate=ensemble)
            mean = partial(expected_histogram, block, axis, spad, exposure, approximate=True)
            detections, naive_ms = float(draw().sum()), 1e3 * naive_seconds(shape, spad) if naive else np.nan
            ms, mean_ms = 1e3 * _typical(draw), 1e3 * _typical(mean)
            rows.append(Row(case, flux, plan.sampler, detections / size, ms / size, mean_ms / size, naive_ms))
    return rows


def demonstration_shape() -> NDArray[np.float64]:
    """(BINS,) sums to 1: a direct return of half of all light, a hidden scene's two bumps, a floor."""
    i = np.arange(BINS)
    hidden = np.exp(-(((i - 420) / 35.0) ** 2)) + 0.4 * np.exp(-(((i - 600) / 70.0) ** 2)) + 0.01
    hidden[:200] = 0.01
    shape = 0.5 * hidden / hidden.sum()
    shape[120] += 0.5
    return np.asarray(shape)


def naive_seconds(flux: NDArray[np.float64], spad: Spad) -> float:
    """Seconds of one naive simulation. Afterpulses are left out of it."""
    rng = np.random.default_rng(0)
    synchronous, dead_time = spad.mode == "synchronous", spad.dead_time_s if spad.mode != "ideal" else 0.0

    def histogram() -> None:
        count = rng.poisson(flux.sum() * CYCLES)
        bins = np.searchsorted(np.cumsum(flux), rng.random(count) * flux.sum(), side="right")
        photons = rng.integers(CYCLES, size=count) * PERIOD_S + (bins + rng.random(count)) * BIN_WIDTH_S
        kept = detected(np.sort(photons).tolist(), PERIOD_S, dead_time, synchronous)
        np.histogram(np.asarray(kept) % PERIOD_S, BINS, (0, PERIOD_S))

    return float(np.median([processor_seconds(histogram)[1] for _ in range(3)]))


def detected(photons: Sequence[float], period: float, dead_time: float, synchronous: bool) -> list[float]:
    """The photons that are detected, in order; a synchronous detector is ready at the start of every cycle."""
    kept, ready, cycle_end = list[float](), -1.0, -1.0
    for t in photons:
        if synchronous and t >= cycle_end:
            ready, cycle_end = -1.0, (t // period + 1.0) * period
        if t >= ready:
            kept.append(t)
            ready = t + dead_time
    return kept


def _typical(call: Callable[[], object]) -> float:
    """Seconds of one call: the median of a few runs, each long enough to be timed."""
    _, once = processor_seconds(call)
    inner = max(1, min(200, int(_SECONDS / _REPEATS / max(once, 1e-6))))
    repeats = _REPEATS if once < 1.0 else 1
    runs = [processor_seconds(lambda: [call() for _ in range(inner)])[1] for _ in range(repeats)]
    return float(np.median(runs)) / inner


@click.command()
@click.option("--naive/--no-naive", default=True, show_default=True, help="Also time the naive simulation.")
@click.option("--flux", "fluxes", multiple=True, type=float, help=f"Events per cycle; left out: {FLUXES}.")
def main(naive: bool, fluxes: tuple[float, ...]) -> None:
    """Print milliseconds per histogram for every sampler and flux."""
    rows = measure(fluxes or FLUXES, naive)
    click.echo(f"{BINS} bins, {CYCLES:.0e} cycles, tolerance 0; processor time, {machine()}\n")
    click.echo(markdown(HEAD, [row.cells() for row in rows]))
