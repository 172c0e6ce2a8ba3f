"""What the detector's effects are judged by: the flux per laser cycle of all histograms, in one pass."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from datagen.detector import Exposure, Spad
from datagen.detector.equilibrium import most_in_window
from datagen.detector.flux import Cycle, checked_transient, cycle_of, dark_count_rates, flux_per_cycle
from datagen.records import TimeAxis

VALUES_AT_ONCE = 1 << 21


@dataclass(frozen=True)
class FluxFigures:
    """Figures of the flux λ per cycle and bin, everything on, over all histograms; `window`: the recorded bins.

    Attributes
    ----------
    norm : ‖λ‖ over the window. ambient_norm, dark_norm : of what ambient light and dark counts add.
    shut_norm : of what a detector without a gate would have seen more.
    total : Λ, events per cycle, of the brightest histogram.
    most, most_shut : most flux within any one dead time, of λ and of what the gate shuts out.
    within : the same of λ with whole periods of a free-running dead time left aside.
    late : most flux within the last dead time (up to a period) of the cycle.
    brightest : (window,) flux of the histogram that holds the brightest bin.
    ambient_deviation, dark_deviation, shut_deviation : by how many standard deviations a histogram with ambient
        light, dark counts, or without a gate differs from one without, all bins together (√ Σ Δ²/μ), at most.
    """

    norm: float
    ambient_norm: float
    dark_norm: float
    shut_norm: float
    total: float
    most: float
    within: float
    most_shut: float
    late: float
    brightest: NDArray[np.float64]
    ambient_deviation: float
    dark_deviation: float
    shut_deviation: float


@dataclass(frozen=True)
class DetectorWorld:
    """What there is to simulate in one detection.

    transient : (laser, pixel, bin) expected photons at the aperture per emitted photon.
    tolerance : `detector.tolerance`, the relative bias that a cheaper sampler may cause.
    """

    transient: NDArray[np.float64]
    time: TimeAxis
    spad: Spad
    exposure: Exposure
    tolerance: float

    def with_spad(self, **changes: object) -> DetectorWorld:
        return replace(self, spad=replace(self.spad, **changes))  # type: ignore[arg-type]

    def with_exposure(self, **changes: object) -> DetectorWorld:
        return replace(self, exposure=replace(self.exposure, **changes))  # type: ignore[arg-type]

    @property
    def cycle(self) -> Cycle:
        return cycle_of(self.time, self.spad, self.exposure)

    @property
    def has_dead_time(self) -> bool:
        return self.spad.mode != "ideal" and self.spad.dead_time_s > 0

    @property
    def whole_periods(self) -> int:
        """Whole laser periods in the dead time."""
        return int(np.floor(self.spad.dead_time_s * self.exposure.repetition_rate_hz * (1 + 1e-15)))

    @cached_property
    def figures(self) -> FluxFigures:
        """One pass over all histograms' flux."""
        cycle, spad = self.cycle, self.spad
        lasers, pixels, _ = self.transient.shape
        opened, widths = cycle.gate[: cycle.window], cycle.widths_s[: cycle.window]
        ambient = opened * spad.pde * self.exposure.ambient_rate_hz * widths
        dark = opened * widths * dark_count_rates(spad, pixels)[:, None]
        square = shut_square = 0.0
        most: dict[str, float] = {}
        brightest = np.zeros(cycle.window)
        for ungated in self._blocks(replace(cycle, gate=np.ones_like(cycle.gate))):
            flux = ungated * cycle.gate
            shut = ungated - flux
            inside, shut_inside = flux[..., : cycle.window], shut[..., : cycle.window]
            square += float(np.square(inside).sum())
            shut_square += float(np.square(shut_inside).sum())
            found = {
                "total": float(flux.sum(axis=2).max()),
                "most": self._in_dead_time(flux, cycle),
                "within": self._in_dead_time(flux, cycle, whole_periods=False),
                "shut": self._in_dead_time(shut, cycle),
                "late": self._late(flux, cycle),
                "bin": float(inside.max()),
                "ambient": self._deviation(ambient, inside),
                "dark": self._deviation(dark, inside),
                "shut_deviation": self._deviation(shut_inside, ungated[..., : cycle.window]),
            }
            if found["bin"] > most.get("bin", 0.0):
                laser, pixel, _ = np.unravel_index(int(inside.argmax()), inside.shape)
                brightest = inside[laser, pixel].copy()
            most = {key: max(value, most.get(key, 0.0)) for key, value in found.items()}
        return FluxFigures(
            norm=float(np.sqrt(square)),
            ambient_norm=float(np.sqrt(lasers * pixels) * np.linalg.norm(ambient)),
            dark_norm=float(np.sqrt(lasers) * np.linalg.norm(dark)),
            shut_norm=float(np.sqrt(shut_square)),
            total=most["total"],
            most=most["most"],
            within=most["within"],
            most_shut=most["shut"],
            late=most["late"],
            brightest=brightest,
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

    def _in_dead_time(self, flux: NDArray[np.float64], cycle: Cycle, whole_periods: bool = True) -> float:
        """Most flux (laser, pixel, n) within one dead time, over histograms; a synchronous detector's ends with the
        cycle. Without `whole_periods` only what is left of the dead time beyond them counts."""
        if not self.has_dead_time or not flux.any():
            return 0.0
        rows = flux.reshape(-1, flux.shape[-1])
        whole, totals = self.whole_periods, rows.sum(axis=1)
        rest = max(self.spad.dead_time_s - whole * cycle.period_s, 0.0)
        if self.spad.mode == "synchronous" and whole:
            return float(totals.max())
        most = np.array([most_in_window(row, cycle.edges_s, rest) for row in rows])
        return float((most + whole * totals * whole_periods).max())

    def _late(self, flux: NDArray[np.float64], cycle: Cycle) -> float:
        """Most flux within the last dead time of the cycle, or all of it, over histograms (laser, pixel, n)."""
        if not self.has_dead_time:
            return 0.0
        start = max(cycle.period_s - self.spad.dead_time_s, 0.0)
        share = np.clip((cycle.edges_s[1:] - start) / cycle.widths_s, 0.0, 1.0)
        return float((flux @ share).max())
