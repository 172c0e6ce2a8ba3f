"""What the detector's effects are judged by: the flux per laser cycle of all histograms, in one pass."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from datagen.detector import Exposure, Spad
from datagen.detector.equilibrium import most_in_window
from datagen.detector.flux import Cycle, checked_transient, cycle_of, dark_count_rates, flux_per_cycle
from datagen.detector.tdc import Tdc
from datagen.records import TimeAxis

VALUES_AT_ONCE = 1 << 21


@dataclass(frozen=True)
class FluxFigures:
    """Figures of the flux λ per cycle and bin, everything on, over all histograms; `window`: the recorded bins.

    Attributes
    ----------
    norm : ‖J λ‖ over the whole period, J the jitter of records: no histogram is larger.
    kept_norm : lower bound on the histogram itself, ‖min(J λ exp(−M), counter)‖ over the window, M of each histogram.
    ambient_norm, dark_norm : of what ambient light and dark counts add.
    shut_norm : of what a detector without a gate would have seen more; shut_everywhere : over the whole period.
    total : Λ, events per cycle, of the brightest histogram.
    most, most_shut : most flux within any one dead time, of λ and of what the gate shuts out.
    within : the same of λ with whole periods of a free-running dead time left aside.
    late : most flux within the last dead time (up to a period) of the cycle; late_share : as a share of Λ.
    brightest_bin : most flux in one bin.
    ambient_deviation, dark_deviation, shut_deviation : by how many standard deviations a histogram with ambient
        light, dark counts, or without a gate differs from one without, all bins together (√ Σ Δ²/μ), at most.
    """

    norm: float
    kept_norm: float
    ambient_norm: float
    dark_norm: float
    shut_norm: float
    shut_everywhere: float
    total: float
    most: float
    within: float
    most_shut: float
    late: float
    late_share: float
    brightest_bin: float
    ambient_deviation: float
    dark_deviation: float
    shut_deviation: float


@dataclass(frozen=True)
class DetectorWorld:
    """What there is to simulate in one detection.

    transient : (laser, pixel, bin) expected photons at the aperture per emitted photon.
    tolerance : `detector.tolerance`, the relative bias that a cheaper sampler may cause.
    leave : what may be left out together, at most: what surely changes more is not worked out any further.
    """

    transient: NDArray[np.float64]
    time: TimeAxis
    spad: Spad
    exposure: Exposure
    tolerance: float
    leave: float = math.inf

    def with_spad(self, **changes: object) -> DetectorWorld:
        return replace(self, spad=replace(self.spad, **changes))  # type: ignore[arg-type]

    def with_exposure(self, **changes: object) -> DetectorWorld:
        return replace(self, exposure=replace(self.exposure, **changes))  # type: ignore[arg-type]

    @cached_property
    def cycle(self) -> Cycle:
        return cycle_of(self.time, self.spad, self.exposure)

    @property
    def has_dead_time(self) -> bool:
        return self.spad.mode != "ideal" and self.spad.dead_time_s > 0

    @property
    def whole_periods(self) -> int:
        """Whole laser periods in the dead time."""
        return int(np.floor(self.spad.dead_time_s * self.exposure.repetition_rate_hz * (1 + 1e-15)))

    @property
    def looked(self) -> bool:
        """Whether the figures are there already, or wanted whatever they take. What costs nothing to simulate is not
        worth them: they take some tenths of the time of a detection."""
        return math.isinf(self.leave) or "figures" in vars(self)

    @cached_property
    def least_signal(self) -> float:
        """No more than the brightest histogram's photons detected per cycle, nearly for nothing: those whose response
        falls into the open gate from its first bin to its last."""
        cycle, kernel = self.cycle, self.cycle.before_avalanche
        values = checked_transient(self.transient, self.time, self.exposure.photons_per_pulse)
        whole = np.ones(values.shape[2])
        if (cycle.gate < 1).any():
            open_bins = (cycle.gate[: cycle.window] == 1).astype(np.float64)
            open_bins = np.pad(open_bins, (kernel.before, kernel.after + len(whole) - cycle.window))
            found = np.convolve(open_bins, np.ones(len(kernel.weights)), "valid")
            whole = (found > len(kernel.weights) - 0.5).astype(np.float64)
        return self.spad.pde * self.exposure.photons_per_pulse * float((values @ whole).max())

    @cached_property
    def least_total(self) -> float:
        """No more than Λ of the brightest histogram, nearly for nothing."""
        background = self.spad.pde * self.exposure.ambient_rate_hz + self.spad.dark_count_rate_hz
        return self.least_signal + background * float(self.cycle.gate @ self.cycle.widths_s)

    @cached_property
    def least_within(self) -> float:
        """No more than `FluxFigures.within`, nearly for nothing: of the dead times that the light lasts, one holds no
        less than the mean."""
        cycle = self.cycle
        if not self.has_dead_time:
            return 0.0
        if self.spad.mode == "synchronous" and self.whole_periods:
            return self.least_total
        rest = self.spad.dead_time_s - self.whole_periods * cycle.period_s
        lasts = min(cycle.period_s, (cycle.bins + len(cycle.before_avalanche.weights)) * cycle.width_s)
        return self.least_signal / math.ceil(lasts / rest) if rest > 1e-9 * cycle.width_s else 0.0

    @cached_property
    def most_events(self) -> float:
        """Events of all histograms together in the exposure, at most, nearly for nothing."""
        spad, exposure, cycle = self.spad, self.exposure, self.cycle
        background = (spad.pde * exposure.ambient_rate_hz + self._most_dark_hz) * cycle.period_s
        lasers, pixels, _ = self.transient.shape
        signal = spad.pde * exposure.photons_per_pulse * float(self.transient.sum())
        return (signal + lasers * pixels * background) * exposure.cycles

    @cached_property
    def most_in_bin(self) -> float:
        """No less than `FluxFigures.brightest_bin`, nearly for nothing: a response spreads light, and a time axis
        longer than the period lays some of it over other light."""
        spad, exposure, cycle = self.spad, self.exposure, self.cycle
        lasts = (cycle.bins + len(cycle.before_avalanche.weights)) * cycle.width_s
        laps = 1 if lasts <= cycle.period_s else 2 + int(lasts / cycle.period_s)
        signal = laps * exposure.photons_per_pulse * float(self.transient.max())
        background = spad.pde * exposure.ambient_rate_hz + self._most_dark_hz
        return spad.pde * signal + background * float(cycle.widths_s[: cycle.window].max())

    @property
    def _most_dark_hz(self) -> float:
        """Dark counts per second of a pixel, hot or not, at most."""
        factor = self.spad.hot_pixel_factor if self.spad.hot_pixel_fraction > 0 else 1.0
        return self.spad.dark_count_rate_hz * max(factor, 1.0)

    @cached_property
    def figures(self) -> FluxFigures:
        """One pass over all histograms' flux."""
        cycle, spad = self.cycle, self.spad
        lasers, pixels, _ = self.transient.shape
        opened, widths = cycle.gate[: cycle.window], cycle.widths_s[: cycle.window]
        ambient = opened * spad.pde * self.exposure.ambient_rate_hz * widths
        dark = opened * widths * dark_count_rates(spad, pixels)[:, None]
        tdc, gated = Tdc(cycle), bool((cycle.gate < 1).any())
        square = kept_square = shut_square = shut_before_jitter = 0.0
        most: dict[str, float] = {}
        for ungated in self._blocks(replace(cycle, gate=np.ones_like(cycle.gate))):
            flux = ungated * cycle.gate
            shut = ungated - flux
            inside = flux[..., : cycle.window]
            # With its jitter: some of what comes beside the window is recorded within it.
            shut_recorded = tdc.mean(shut) if gated else np.zeros((1, 1, 1))
            recorded = tdc.mean(flux)
            losses = self._in_dead_time(flux, cycle)
            # Bins beyond the window may be long: their density counts.
            density = cycle.width_s / cycle.widths_s[cycle.window :]
            square += float(np.square(recorded).sum() + (np.square(flux[..., cycle.window :]) * density).sum())
            shut_before_jitter += float(np.square(shut[..., : cycle.window]).sum())
            shut_before_jitter += float((np.square(shut[..., cycle.window :]) * density).sum())
            kept_square += float(np.square(self._kept(recorded * np.exp(-losses.sum(axis=0))[..., None])).sum())
            shut_square += float(np.square(shut_recorded).sum())
            totals, late = flux.sum(axis=2), self._late(flux, cycle)
            found = {
                "total": float(totals.max()),
                "most": float(losses.sum(axis=0).max()),
                "within": float(losses[0].max()),
                "shut": float(self._in_dead_time(shut, cycle).sum(axis=0).max()),
                "late": float(late.max()),
                "late_share": float(np.divide(late, totals, out=np.zeros_like(late), where=totals > 0).max()),
                "bin": float(inside.max()),
                "ambient": self._deviation(ambient, inside),
                "dark": self._deviation(dark, inside),
                "shut_deviation": self._deviation(shut_recorded, recorded + shut_recorded),
            }
            most = {key: max(value, most.get(key, 0.0)) for key, value in found.items()}
        return FluxFigures(
            norm=float(np.sqrt(square)),
            kept_norm=float(np.sqrt(kept_square)),
            ambient_norm=float(np.sqrt(lasers * pixels) * np.linalg.norm(ambient)),
            dark_norm=float(np.sqrt(lasers) * np.linalg.norm(dark)),
            shut_norm=float(np.sqrt(shut_square)),
            shut_everywhere=float(np.sqrt(shut_before_jitter)),
            total=most["total"],
            most=most["most"],
            within=most["within"],
            most_shut=most["shut"],
            late=most["late"],
            late_share=most["late_share"],
            brightest_bin=most["bin"],
            ambient_deviation=most["ambient"],
            dark_deviation=most["dark"],
            shut_deviation=most["shut_deviation"],
        )

    def _deviation(self, added: NDArray[np.float64], flux: NDArray[np.float64]) -> float:
        """Most √ Σ Δ²/μ over histograms for what is `added` to μ, both per cycle and (laser, pixel, bin)."""
        if not added.any():
            return 0.0
        ratio = np.divide(np.square(added), flux, out=np.zeros_like(flux), where=flux > 0)
        return float(np.sqrt(self.exposure.cycles * ratio.sum(axis=2).max()))

    def _blocks(self, cycle: Cycle) -> Iterator[NDArray[np.float64]]:
        values = checked_transient(self.transient, self.time, self.exposure.photons_per_pulse)
        step = max(VALUES_AT_ONCE // (values.shape[1] * len(cycle.gate)), 1)
        for start in range(0, len(values), step):
            yield flux_per_cycle(values[start : start + step], cycle, self.spad, self.exposure)

    def _kept(self, mean: NDArray[np.float64]) -> NDArray[np.float64]:
        """Lower bound on what counters keep of a mean per cycle: E[min(n, c)] ≥ (1 − 1/e) min(E[n], c)."""
        cycles, most = self.exposure.cycles, self.spad.counter_max
        if most is None:
            return mean
        counts = mean * cycles
        reached = counts + 8 * np.sqrt(counts) + 8 > most
        return np.where(reached, (1 - np.exp(-1.0)) * np.minimum(mean, most / cycles), mean)

    def _in_dead_time(self, flux: NDArray[np.float64], cycle: Cycle) -> NDArray[np.float64]:
        """Most flux (laser, pixel, n) of each histogram within one dead time: (2, laser, pixel), what is left of it
        beyond whole periods, and in those. A synchronous detector's dead time ends with the cycle."""
        found = np.zeros((2, *flux.shape[:2]))
        if not self.has_dead_time or not flux.any():
            return found
        whole, totals = self.whole_periods, flux.sum(axis=2)
        if self.spad.mode == "synchronous" and whole:
            found[0] = totals
            return found
        rest = max(self.spad.dead_time_s - whole * cycle.period_s, 0.0)
        for place in np.ndindex(*flux.shape[:2]):
            found[0][place] = most_in_window(flux[place], cycle.edges_s, rest)
        found[1] = whole * totals
        return found

    def _late(self, flux: NDArray[np.float64], cycle: Cycle) -> NDArray[np.float64]:
        """Flux within the last dead time of the cycle, or all of it, of histograms (laser, pixel, n)."""
        if not self.has_dead_time:
            return np.zeros(flux.shape[:2])
        start = max(cycle.period_s - self.spad.dead_time_s, 0.0)
        share = np.clip((cycle.edges_s[1:] - start) / cycle.widths_s, 0.0, 1.0)
        return np.asarray(flux @ share, np.float64)
