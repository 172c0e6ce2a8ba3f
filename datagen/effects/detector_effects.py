"""The detector's rows of the table of effects.

Leaving out the timing response saves a third to two thirds of a detection, leaving out unequal bins of the TDC a
tenth to two fifths: bounds decide on these. The others cost nothing of their own, and `auto` always simulates them. A
gate and counters are one factor or comparison a bin. For dead time, afterpulsing and crosstalk the choice of the
sampler (`detector/sampler_choice.py`) decides histogram by histogram: counts are drawn as Poisson numbers where these
effects do not matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from datagen.detector import Exposure, Spad
from datagen.detector.flux import cycle_of, dark_count_rates, photon_kernel
from datagen.detector.irf import response_kernel
from datagen.detector.sampler_choice import avalanches_caused
from datagen.detector.tdc import TdcBins, pieces_for
from datagen.effects.rule import Change, Effect
from datagen.records import TimeAxis
from datagen.records.arrays import Floats

_LARGEST_EXPONENT = 350.0
"""Cap of an exponent, so that the square of its exponential is finite."""
_MOST_MOVED = 0.1
"""Twice the share of photons moved into other bins, beyond which no sensible tolerance would leave the response out,
so that its bound is not computed."""


@dataclass(frozen=True)
class Detector:
    """What an effect is left out of: a detector, its exposure, and how exactly counts are drawn.

    tolerance : `detector.tolerance`, the relative bias that a cheaper sampler may have.
    """

    spad: Spad
    exposure: Exposure
    tolerance: float

    def with_spad(self, **changes: object) -> Detector:
        """The detector with other values of some fields of `Spad`."""
        return replace(self, spad=replace(self.spad, **changes))  # type: ignore[arg-type]

    def with_exposure(self, **changes: object) -> Detector:
        """The detector with other values of some fields of `Exposure`."""
        return replace(self, exposure=replace(self.exposure, **changes))  # type: ignore[arg-type]

    @property
    def counts_all(self) -> bool:
        """Whether every event is counted, whatever was detected before."""
        return self.spad.mode == "ideal"

    @property
    def has_dead_time(self) -> bool:
        """Whether a dead time removes events."""
        return self.spad.dead_time_s > 0 and not self.counts_all

    @property
    def whole_periods(self) -> int:
        """Number of whole laser periods in the dead time."""
        return int(np.floor(self.spad.dead_time_s * self.exposure.repetition_rate_hz * (1 + 1e-15)))


@dataclass(frozen=True)
class Detection(Detector):
    """A transient, and the detector whose counts of it are simulated: what decisions rest on.

    transient : (laser, pixel, bin) expected photons at the aperture per emitted photon.
    """

    transient: Floats
    time: TimeAxis

    @property
    def most_events_per_cycle(self) -> float:
        """Events per cycle of the brightest histogram, background included, without losses."""
        ambient_hz = self.spad.pde * self.exposure.ambient_rate_hz
        background_hz = float((ambient_hz + dark_count_rates(self.spad, self.transient.shape[1])).max())
        light = self.spad.pde * self.exposure.photons_per_pulse * float(self.transient.sum(axis=2).max())
        return light + background_hz * self.exposure.period_s

    @cached_property
    def unequal_bins(self) -> TdcBins | None:
        """The bins of the TDC, for records in whole bins of the time axis; None if they are equal."""
        if self.spad.tdc_bins_are_equal:
            return None
        cycle = cycle_of(self.time, self.spad, self.exposure)
        return TdcBins.of(cycle, 1, self.spad, self.transient.shape[1])

    @property
    def dead_periods(self) -> float:
        """The most laser periods of light whose events, caused ones included, a dead time can meet."""
        return (1.0 if self.spad.mode == "synchronous" else self.whole_periods + 1.0) * (1.0 + self.caused_avalanches)

    @property
    def caused_avalanches(self) -> float:
        """The most avalanches that one avalanche causes by afterpulsing and crosstalk, in turn included."""
        by_traps, by_neighbours = avalanches_caused(self.spad)
        return 0.0 if self.counts_all else by_traps + (by_neighbours if self.transient.shape[1] > 1 else 0.0)


def _timing(given: Detection) -> Change:
    """Bound on the change of the expected histogram without the timing response; none with a gate or counters.

    By Young's inequality a response that leaves the share w in its bin changes λ by at most 2 (1 − w) ‖λ‖.

    The expected histogram is at least exp(−M) of the light that the response leaves in its bins, with M the most
    events within a dead time. A displaced event also displaces its dead time, and with it later events, until no
    event comes for a dead time: on average for at most exp(M) dead times. Relative to the armed share this is exp(M)
    times more.
    """
    time, spad, unequal = given.time, given.spad, given.unequal_bins
    pulse = photon_kernel(time.width_s, spad, given.exposure)
    jitter = response_kernel(time.width_s, spad.jitter_fwhm_s)
    share = float(pulse.weights[pulse.before] * jitter.weights[jitter.before])
    moved = 2.0 * (1.0 - share)
    if moved < 1e-14:
        return Change(0.0, "bound", "far narrower than a bin")
    reason = f"it moves {1 - share:.2g} of the photons into other bins"
    cut = spad.gate_start_s is not None or spad.counter_max is not None
    if moved > _MOST_MOVED or cut:
        return Change(None, "bound", reason)
    most = shifted = 0.0
    if given.has_dead_time:
        events = given.dead_periods * given.most_events_per_cycle
        most, shifted = min(events, _LARGEST_EXPONENT), moved * events
    # Events before and after the recorded bins may be moved into them.
    beside = 2 * (len(pulse.weights) + len(jitter.weights))
    ratio = math.sqrt(1.0 + beside / time.bins) * math.exp(most)
    value = moved / (1.0 - moved) * (1.0 + given.caused_avalanches) * ratio + shifted * math.exp(2.0 * most)
    if unequal is not None:
        # A TDC bin of width w counts records of at most w + 2 bins, and records of a bin get into at most k TDC bins.
        # So the sorting enlarges the change at most by √(w + 2), and reduces the norm of counts x ≥ 0 at most by √k.
        value *= math.sqrt(float((unequal.widths.max() + 2) * unequal.shares[1].max()))
    return Change(value if math.isfinite(value) else None, "bound", reason)


def _unequal_bins(given: Detection) -> Change:
    """Bound on the change of the expected histogram if all bins of the TDC were equal; none with counters.

    Let A_ji be the share of the records of bin i that TDC bin j counts, and w_j = Σ_i A_ji its width. Then
    ‖(A − 1) x‖ ≤ m ‖x‖, m² = max_i 2 (1 − A_ii) · max_j (1 − A_jj + w_j − A_jj), the product of the largest sums of a
    column and of a row: ‖A − 1‖² ≤ ‖A − 1‖₁ ‖A − 1‖_∞. Where detections are not uniform within a bin
    (`tdc.PIECES`), at most exp(M) times as many records change their bin, with M the most events within a dead
    time. Afterpulses may come in any part of a bin.
    """
    unequal, spad = given.unequal_bins, given.spad
    assert unequal is not None
    kept, widths = unequal.shares[0], unequal.widths
    column, row = 2.0 * (1.0 - kept).max(axis=1), (1.0 + widths - 2.0 * kept).max(axis=1)
    moved = math.sqrt(float((column * row).max()))
    reason = f"it moves up to {1 - kept.min():.2g} of a bin's records into other bins"
    cut = pieces_for(cycle_of(given.time, spad, given.exposure), spad) > 1
    if spad.counter_max is not None or (cut and given.caused_avalanches > 0):
        return Change(None, "bound", reason)
    if cut:
        moved *= math.exp(min(given.dead_periods * given.most_events_per_cycle, _LARGEST_EXPONENT))
    return Change(moved / (1.0 - moved) if moved < 1.0 else None, "bound", reason)


def _without_pile_up(given: Detector) -> Detector:
    """The detector without distortion by dead time. In whole laser periods a dead time thins all bins alike."""
    periods = given.whole_periods
    if given.spad.mode == "free_running" and not given.spad.paralyzable and periods > 0:
        return given.with_spad(dead_time_s=periods * given.exposure.period_s)
    return given.with_spad(dead_time_s=0.0, paralyzable=False)


def _with_exact_samplers(given: Detector, setting: str) -> Detector:
    """The detector with exact samplers only."""
    return replace(given, tolerance=0.0)


DETECTOR_EFFECTS: tuple[Effect[Detection, Detector], ...] = (
    Effect(
        "timing_response", "laser pulse and jitter (IRF)",
        lambda d: d.exposure.pulse is not None or d.exposure.pulse_fwhm_s > 0 or d.spad.jitter_fwhm_s > 0
        or d.spad.jitter_tail_s * d.spad.jitter_tail_fraction > 0,
        lambda d: d.with_spad(jitter_fwhm_s=0.0, jitter_tail_s=0.0).with_exposure(pulse_fwhm_s=0.0, pulse=None),
        _timing, 0.4,
    ),
    Effect("pile_up", "pile-up", lambda d: d.has_dead_time, _without_pile_up, always=_with_exact_samplers),
    Effect(
        "dead_time_across_cycles", "dead time across cycles",
        lambda d: d.has_dead_time and d.spad.mode == "free_running", lambda d: d.with_spad(mode="synchronous"),
        always=_with_exact_samplers,
    ),
    Effect(
        "afterpulsing", "afterpulsing", lambda d: d.spad.afterpulse_probability > 0 and not d.counts_all,
        lambda d: d.with_spad(afterpulse_probability=0.0), always=_with_exact_samplers,
    ),
    Effect(
        "crosstalk", "crosstalk",
        lambda d: d.spad.crosstalk_probability > 0 and d.transient.shape[1] > 1 and not d.counts_all,
        lambda d: d.with_spad(crosstalk_probability=0.0), always=_with_exact_samplers,
    ),
    Effect(
        "gate", "gate", lambda d: d.spad.gate_start_s is not None,
        lambda d: d.with_spad(gate_start_s=None, gate_width_s=None, gate_rise_s=0.0),
    ),
    Effect(
        "tdc_nonlinearity", "TDC nonlinearity", lambda d: not d.spad.tdc_bins_are_equal,
        lambda d: d.with_spad(tdc_dnl=0.0, tdc_edges_s=None), _unequal_bins, 0.4,
    ),
    Effect(
        "tdc_saturation", "TDC saturation", lambda d: d.spad.counter_max is not None,
        lambda d: d.with_spad(counter_max=None),
    ),
)  # fmt: skip
