"""The detector's rows of the table of effects.

Leaving out the timing response saves a third to two thirds of a detection, leaving out unequal bins of the TDC a
tenth to two fifths. All else saves nothing: background, gate and counters are one addend, factor or comparison a bin.
For dead time, afterpulsing and crosstalk the choice of the sampler (`detector/sampler_choice.py`) decides histogram
by histogram: where they do not matter, counts are drawn as Poisson numbers, at the cost of a detector without these
effects.
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
from datagen.detector.tdc_bins import TdcBins, pieces_for
from datagen.effects.rule import Change, Effect
from datagen.records import TimeAxis
from datagen.records.arrays import Floats

_ONE_OPERATION = "one operation a bin: leaving it out saves nothing"
_SAMPLER = "the sampler of each histogram is chosen by how much it matters there: leaving it out saves nothing more"
_LARGEST_EXPONENT = 350.0
"""Cap of an exponent, so that the square of its exponential is finite. Halved, bounds far beyond 1 are smaller."""
_MOST_MOVED = 0.1
"""Twice the share of photons moved into other bins, beyond which no sensible tolerance would leave the response out,
so that its bound is not computed. Halved, a tolerance of 0.1 leaves it out less often."""


@dataclass(frozen=True)
class Detection:
    """A transient, and the detector whose counts of it are simulated.

    transient : (laser, pixel, bin) expected photons at the aperture per emitted photon.
    tolerance : `detector.tolerance`, the relative bias that a cheaper sampler may have.
    """

    transient: Floats
    time: TimeAxis
    spad: Spad
    exposure: Exposure
    tolerance: float

    def with_spad(self, **changes: object) -> Detection:
        """The detection with other values of some fields of `Spad`."""
        return replace(self, spad=replace(self.spad, **changes))  # type: ignore[arg-type]

    def with_exposure(self, **changes: object) -> Detection:
        """The detection with other values of some fields of `Exposure`."""
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

    @property
    def thins_evenly(self) -> bool:
        """Whether pile-up is left out by a dead time of whole periods, which thins all bins alike."""
        return self.spad.mode == "free_running" and not self.spad.paralyzable and self.whole_periods > 0

    @property
    def photons(self) -> float:
        """Detections per cycle for each photon at the aperture per emitted photon, without losses."""
        return self.spad.pde * self.exposure.photons_per_pulse

    @property
    def background_hz(self) -> Floats:
        """(pixel,) rate of events by ambient light and dark counts."""
        ambient_hz = self.spad.pde * self.exposure.ambient_rate_hz
        return ambient_hz + dark_count_rates(self.spad, self.transient.shape[1])

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
        return (1.0 if self.spad.mode == "synchronous" else self.whole_periods + 1.0) * (1.0 + self.caused)

    def events_per_cycle(self, light: float) -> float:
        """Events per cycle, background included, of a histogram with so much light per emitted photon."""
        return self.photons * light + float(self.background_hz.max()) * self.exposure.period_s

    def may_saturate(self, width: float) -> bool:
        """Whether a counter of a bin of so many bins' width may reach its maximum."""
        if self.spad.counter_max is None:
            return False
        background = float(self.background_hz.max())
        peak = self.photons * float(self.transient.max()) + background * self.time.width_s
        total = self.photons * float(self.transient.sum(axis=2).max()) + background * self.exposure.period_s
        # All avalanches that others cause may come together.
        most = self.exposure.cycles * (width * peak + self.caused * total)
        return most + 8 * math.sqrt(most) + 8 > self.spad.counter_max

    @property
    def caused(self) -> float:
        """The most avalanches that one avalanche causes by afterpulsing and crosstalk, in turn included."""
        by_traps, by_neighbours = avalanches_caused(self.spad)
        return 0.0 if self.counts_all else by_traps + (by_neighbours if self.transient.shape[1] > 1 else 0.0)


def _timing(given: Detection) -> Change:
    """Bound on the change of the expected histogram without the timing response.

    By Young's inequality a response that leaves the share w in its bin changes λ by at most 2 (1 − w) ‖λ‖.

    The expected histogram is at least exp(−M) of the light that the response leaves in its bins, with M the most
    events within a dead time. A displaced event also displaces its dead time, and with it later events, until no
    event comes for a dead time: on average for at most exp(M) dead times. Relative to the armed share this is exp(M)
    times more.
    """
    time, spad, exposure, transient = given.time, given.spad, given.exposure, given.transient
    unequal = given.unequal_bins
    pulse = photon_kernel(time.width_s, spad, exposure)
    jitter = response_kernel(time.width_s, spad.jitter_fwhm_s)
    share = float(pulse.weights[pulse.before] * jitter.weights[jitter.before])
    moved = 2.0 * (1.0 - share)
    if moved < 1e-14:
        return Change(0.0, "bound", "far narrower than a bin")
    reason = f"it moves {1 - share:.2g} of the photons into other bins"
    if moved > _MOST_MOVED or (unequal is not None and spad.counter_max is not None):
        return Change(None, "bound", reason)
    light, background_hz = given.photons, given.background_hz
    most = shifted = 0.0
    gated = spad.gate_start_s is not None
    opened = cycle_of(time, spad, exposure).gate[: time.bins] if gated else np.ones(time.bins)
    if given.has_dead_time:
        # The response may move light that the gate shuts out into the open gate.
        brightest = admitted = float(transient.sum(axis=2).max())
        if gated:
            admitted = float(np.einsum("lpt,t->lp", transient, opened).max()) + moved * brightest
        most = min(given.dead_periods * given.events_per_cycle(admitted), _LARGEST_EXPONENT)
        shifted = moved * given.dead_periods * given.events_per_cycle(brightest)
    beside = 2 * (len(pulse.weights) + len(jitter.weights))
    if not gated and spad.counter_max is None:
        ratio = math.sqrt(1.0 + beside / time.bins) * math.exp(most)
    else:
        steady = background_hz[:, None] * time.width_s
        flux = light * transient + steady
        kept = flux * opened * math.exp(-most)
        if spad.counter_max is not None:
            # A counter that may saturate keeps at least E[min(n, c)] ≥ (1 − 1/e) min(E[n], c).
            counts = kept * exposure.cycles
            reached = counts + 8 * np.sqrt(counts) + 8 > spad.counter_max
            kept = np.where(reached, (1 - 1 / math.e) * np.minimum(kept, spad.counter_max / exposure.cycles), kept)
        square = float(np.square(flux).sum() + beside * len(transient) * np.square(steady).sum())
        norm = math.sqrt(float(np.square(kept).sum()))
        ratio = math.sqrt(square) / norm if norm > 0 else math.inf
    value = moved / (1.0 - moved) * (1.0 + given.caused) * ratio + shifted * math.exp(2.0 * most)
    if unequal is not None:
        # A TDC bin of width w counts records of at most w + 2 bins, and records of a bin get into at most k TDC bins.
        # So the sorting enlarges the change at most by √(w + 2), and reduces the norm of counts x ≥ 0 at most by √k.
        value *= math.sqrt(float((unequal.widths.max() + 2) * unequal.shares[1].max()))
    return Change(value if math.isfinite(value) else None, "bound", reason)


def _unequal_bins(given: Detection) -> Change:
    """Bound on the change of the expected histogram if all bins of the TDC were equal.

    Let A_ji be the share of the records of bin i that TDC bin j counts, and w_j = Σ_i A_ji its width. Then
    ‖(A − 1) x‖ ≤ m ‖x‖, m² = max_i 2 (1 − A_ii) · max_j (1 − A_jj + w_j − A_jj), the product of the largest sums of a
    column and of a row. Where detections are not uniform within a bin (`tdc_bins.PIECES`), at most exp(M) times as
    many records change their bin, with M the most events within a dead time. Afterpulses may come in any part of a
    bin.
    """
    unequal = given.unequal_bins
    assert unequal is not None
    kept, widths = unequal.shares[0], unequal.widths
    column, row = 2.0 * (1.0 - kept).max(axis=1), (1.0 + widths - 2.0 * kept).max(axis=1)
    moved = math.sqrt(float((column * row).max()))
    reason = f"it moves up to {1 - kept.min():.2g} of a bin's records into other bins"
    cut = pieces_for(cycle_of(given.time, given.spad, given.exposure), given.spad) > 1
    if given.may_saturate(float(widths.max())) or (cut and given.caused > 0):
        return Change(None, "bound", reason)
    if cut:
        most = given.dead_periods * given.events_per_cycle(float(given.transient.sum(axis=2).max()))
        moved *= math.exp(min(most, _LARGEST_EXPONENT))
    return Change(moved / (1.0 - moved) if moved < 1.0 else None, "bound", reason)


def _without_pile_up(given: Detection) -> Detection:
    """The detection without distortion by dead time."""
    if given.thins_evenly:
        return given.with_spad(dead_time_s=given.whole_periods * given.exposure.period_s)
    return given.with_spad(dead_time_s=0.0, paralyzable=False)


def _exactly(given: Detection, setting: str | int) -> Detection:
    """The detection with exact samplers only."""
    return replace(given, tolerance=0.0)


DETECTOR_EFFECTS: tuple[Effect[Detection], ...] = (
    Effect(
        "timing_response", "laser pulse and jitter (IRF)", "detector", "a pulse, tail or jitter of some width",
        "Young's inequality: ‖w * h − h‖ ≤ 2 (1 − w₀) ‖h‖ for the bin-integrated response w", 0.4,
        lambda d: d.exposure.pulse is not None or d.exposure.pulse_fwhm_s > 0 or d.spad.jitter_fwhm_s > 0
        or d.spad.jitter_tail_s * d.spad.jitter_tail_fraction > 0, _timing,
        lambda d: d.with_spad(jitter_fwhm_s=0.0, jitter_tail_s=0.0).with_exposure(pulse_fwhm_s=0.0, pulse=None),
    ),
    Effect(
        "ambient_light", "ambient light", "detector", "`detector.ambient_rate_hz` > 0",
        "A constant addend of the flux λ", 0.0, lambda d: d.spad.pde * d.exposure.ambient_rate_hz > 0, _ONE_OPERATION,
        lambda d: d.with_exposure(ambient_rate_hz=0.0),
    ),
    Effect(
        "dark_counts", "dark counts", "detector", "`detector.dark_count_rate_hz` > 0",
        "A constant addend of the flux λ", 0.0, lambda d: d.spad.dark_count_rate_hz > 0, _ONE_OPERATION,
        lambda d: d.with_spad(dark_count_rate_hz=0.0),
    ),
    Effect(
        "pile_up", "pile-up", "detector", "a dead time, and a mode other than `ideal`",
        "When Poisson is enough: `detector/sampler_choice.py`",
        0.0, lambda d: d.has_dead_time, _SAMPLER, _without_pile_up, _exactly,
    ),
    Effect(
        "dead_time_across_cycles", "dead time across cycles", "detector", "mode `free_running` with a dead time",
        "Events in order, each after its dead time: `detector/events.py`",
        0.0, lambda d: d.has_dead_time and d.spad.mode == "free_running", _SAMPLER,
        lambda d: d.with_spad(mode="synchronous"), _exactly,
    ),
    Effect(
        "afterpulsing", "afterpulsing", "detector",
        "`detector.afterpulse_probability` > 0, and a mode other than `ideal`",
        "Competing traps and neighbours: `detector/events.py`",
        0.0, lambda d: d.spad.afterpulse_probability > 0 and not d.counts_all, _SAMPLER,
        lambda d: d.with_spad(afterpulse_probability=0.0), _exactly,
    ),
    Effect(
        "crosstalk", "crosstalk", "detector",
        "`detector.crosstalk_probability` > 0, several pixels, and a mode other than `ideal`",
        "Competing traps and neighbours: `detector/events.py`",
        0.0, lambda d: d.spad.crosstalk_probability > 0 and d.transient.shape[1] > 1 and not d.counts_all, _SAMPLER,
        lambda d: d.with_spad(crosstalk_probability=0.0), _exactly,
    ),
    Effect(
        "gate", "gate", "detector", "`detector.gate`", "A factor of the flux λ",
        0.0, lambda d: d.spad.gate_start_s is not None, _ONE_OPERATION,
        lambda d: d.with_spad(gate_start_s=None, gate_width_s=None, gate_rise_s=0.0),
    ),
    Effect(
        "tdc_nonlinearity", "TDC nonlinearity", "detector", "`detector.tdc_dnl` > 0 or `.tdc_edges_ps`",
        "Records sorted by the edges of the TDC's bins: `detector/tdc_bins.py`; ‖A − 1‖² ≤ ‖A − 1‖₁ ‖A − 1‖_∞",
        0.4, lambda d: not d.spad.tdc_bins_are_equal, _unequal_bins,
        lambda d: d.with_spad(tdc_dnl=0.0, tdc_edges_s=None),
    ),
    Effect(
        "tdc_saturation", "TDC saturation", "detector", "`detector.counter_max`",
        "min(n, c) of counts n (`detector/expected.py`)",
        0.0, lambda d: d.spad.counter_max is not None, _ONE_OPERATION, lambda d: d.with_spad(counter_max=None),
    ),
)  # fmt: skip
