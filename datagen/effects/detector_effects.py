"""The detector's rows of the table of effects.

Only leaving out the timing response saves time, a third to two thirds of a detection. Background, gate and counters
are one addend, factor or comparison a bin. For dead time, afterpulsing and crosstalk the choice of the sampler
(`detector/sampler_choice.py`) decides histogram by histogram: where they do not matter, counts are drawn as Poisson
numbers, at the cost of a detector without these effects.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from datagen.detector import Exposure, Spad
from datagen.detector.flux import cycle_of, dark_count_rates, photon_kernel
from datagen.detector.irf import response_kernel
from datagen.detector.sampler_choice import avalanches_caused
from datagen.effects.rule import Change, Effect
from datagen.records import TimeAxis

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

    Attributes
    ----------
    transient : (laser, pixel, bin) expected photons at the aperture per emitted photon.
    tolerance : `detector.tolerance`, the relative bias that a cheaper sampler may have.
    """

    transient: NDArray[np.float64]
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
    pulse = photon_kernel(time.width_s, spad, exposure)
    jitter = response_kernel(time.width_s, spad.jitter_fwhm_s)
    share = float(pulse.weights[pulse.before] * jitter.weights[jitter.before])
    moved = 2.0 * (1.0 - share)
    if moved < 1e-14:
        return Change(0.0, "bound", "far narrower than a bin")
    reason = f"it moves {1 - share:.2g} of the photons into other bins"
    too_long = not given.counts_all and time.bins * time.width_s > exposure.period_s * (1 + 1e-9)
    if moved > _MOST_MOVED or too_long:
        return Change(None, "bound", reason)
    light, ambient_hz = spad.pde * exposure.photons_per_pulse, spad.pde * exposure.ambient_rate_hz
    background_hz = ambient_hz + dark_count_rates(spad, transient.shape[1])
    most = shifted = 0.0
    gated = spad.gate_start_s is not None
    opened = cycle_of(time, spad, exposure).gate[: time.bins] if gated else np.ones(time.bins)
    if given.has_dead_time:
        # The response may move light that the gate shuts out into the open gate.
        brightest = admitted = float(transient.sum(axis=2).max())
        if gated:
            admitted = float(np.einsum("lpt,t->lp", transient, opened).max()) + moved * brightest
        background = float(background_hz.max()) * exposure.period_s
        laps = (1.0 if spad.mode == "synchronous" else given.whole_periods + 1.0) * (1.0 + given.caused)
        most = min(laps * (light * admitted + background), _LARGEST_EXPONENT)
        shifted = moved * laps * (light * brightest + background)
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
    return Change(value if math.isfinite(value) else None, "bound", reason)


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
        "tdc_saturation", "TDC saturation", "detector", "`detector.counter_max`",
        "min(n, c) of counts n (`detector/expected.py`)",
        0.0, lambda d: d.spad.counter_max is not None, _ONE_OPERATION, lambda d: d.with_spad(counter_max=None),
    ),
)  # fmt: skip
