"""Which sampler draws a histogram: the cheapest one that is exact, or biased by less than the tolerance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from datagen.detector.avalanches import burn_in_cycles
from datagen.detector.equilibrium import most_in_window
from datagen.detector.expected import active_span
from datagen.detector.flux import Cycle
from datagen.detector.poisson import LARGEST_MEAN, check_countable
from datagen.detector.renewal import PIECE_FLUX
from datagen.detector.spad import Exposure, Spad
from datagen.errors import InputError

Array = NDArray[np.float64]

DEFAULT_TOLERANCE = 1e-3
"""Largest relative bias that a cheaper sampler may cause."""
HIDDEN_DEVIATION = 0.1
"""Largest bias of a total in its own standard deviations: one that no test of a single histogram could find."""
ENSEMBLE_EVENTS = 2e6
"""Detections per histogram above which, if allowed, free running is drawn by the approximate ensemble."""
MOST_EVENTS = 2e7
"""Events per histogram above which event-driven samplers would take seconds and more, and are refused."""

_CHAIN_NS, _EVENT_NS = 180.0, 90.0


class Sampler(IntEnum):
    """How counts are drawn; DETECTOR cases in brackets."""

    POISSON = 0
    """(a) independent Poisson counts."""
    HAZARD_CHAIN = 1
    """(b) synchronous, one detection in a cycle."""
    RETURN_CHAIN = 2
    """(d) synchronous, several detections in a cycle."""
    FREE_RUNNING_EVENTS = 3
    """(c) free running, detection by detection."""
    CYCLE_ENSEMBLE = 4
    """free running by (d), approximate in the variance."""
    AVALANCHES = 5
    """(e) afterpulsing, paralyzable dead time or crosstalk, avalanche by avalanche."""


@dataclass(frozen=True)
class SamplerChoice:
    """By which samplers a transient's histograms are drawn; numbers are of the brightest unless said otherwise.

    Attributes
    ----------
    sampler : name of the sampler of the brightest histogram.
    reason : why, in words.
    histograms : sampler name → number of histograms that it draws.
    flux_per_cycle : expected avalanche-capable events per laser cycle, Λ.
    poisson_bias : bound on the relative bias of any bin, were counts drawn as Poisson.
    poisson_deviation : bound on the bias of the total count then, in standard deviations.
    detections : expected detections in the exposure, roughly.
    tolerance : the bias allowed.
    approximate : whether any histogram is drawn by a sampler that is exact in the mean only.
    """

    sampler: str
    reason: str
    histograms: Mapping[str, int] = field(default_factory=dict)
    flux_per_cycle: float = 0.0
    poisson_bias: float = 0.0
    poisson_deviation: float = 0.0
    detections: float = 0.0
    tolerance: float = DEFAULT_TOLERANCE
    approximate: bool = False

    def parameters(self) -> dict[str, float | str | bool]:
        """The decision as scalars, to be stored with a sample."""
        kept = ("reason", "flux_per_cycle", "poisson_bias", "poisson_deviation", "detections", "approximate")
        return {"name": self.sampler, **{key: getattr(self, key) for key in kept}}


@dataclass(frozen=True)
class Choice:
    """The sampler of one histogram, or of all pixels of a laser point where crosstalk couples them."""

    sampler: Sampler
    reason: str
    flux: float
    bias: float
    deviation: float
    detections: float


def choose(
    flux: Array, total: float, cycle: Cycle, spad: Spad, exposure: Exposure, tolerance: float, approximate: bool,
    where: str,
) -> Choice:  # fmt: skip
    """Decide for one histogram's (n,) flux and its sum; for pixels coupled by crosstalk give the sum of theirs.

    Raises `InputError`, naming the histogram `where`, for what can only be done approximately unless `approximate`.
    """
    events = total * exposure.cycles
    bias = poisson_bias(flux, cycle, spad)
    deviation = float(bias * np.sqrt(events))
    detections = events
    if spad.dead_time_s > 0 and not spad.paralyzable and spad.mode != "ideal":
        share = spad.dead_time_s / cycle.period_s
        most = 1.0 / share + (1.0 if spad.mode == "synchronous" else 0.0)
        detections = min(events, exposure.cycles * most)
        if spad.mode == "free_running":
            detections = events / (1.0 + total * share)
    if spad.mode == "ideal":
        sampler, reason = Sampler.POISSON, "mode 'ideal' counts every event"
    elif bias == 0.0:
        sampler, reason = Sampler.POISSON, "nothing is lost to dead time and nothing added: counts are Poisson"
    elif bias <= tolerance and deviation <= HIDDEN_DEVIATION:
        sampler = Sampler.POISSON
        reason = (
            f"relative bias ≤ {bias:.2g} (tolerance {tolerance:.2g}) and ≤ {deviation:.2g} standard deviations "
            f"(allowed {HIDDEN_DEVIATION:g})"
        )
    else:
        sampler, why = _beyond_poisson(flux, cycle, spad, exposure.cycles, events, detections, approximate, where)
        reason = f"Poisson would be biased by up to {bias:.2g} ({deviation:.2g} standard deviations); {why}"
    if sampler is Sampler.POISSON and not events < LARGEST_MEAN:
        check_countable(flux * exposure.cycles, where)
    return Choice(sampler, reason, total, bias, deviation, detections)


def _beyond_poisson(
    flux: Array, cycle: Cycle, spad: Spad, cycles: int, events: float, detections: float, approximate: bool,
    where: str,
) -> tuple[Sampler, str]:  # fmt: skip
    if spad.afterpulse_probability > 0 or spad.crosstalk_probability > 0:
        what = "afterpulsing" if spad.afterpulse_probability > 0 else "crosstalk"
        _limit(detections, what, where)
        before = detections * burn_in_cycles(spad, cycle.period_s) / cycles
        if before > MOST_EVENTS:
            raise InputError(
                f"{where}: {before:.2g} events before the exposure, at most {MOST_EVENTS:.0e} are drawn one by one, "
                f"until traps of {max(spad.afterpulse_times_s):g} s and a dead time of {spad.dead_time_s:g} s forget "
                f"how they started; shorten afterpulse_times_s or dead_time_s, or switch {what} off"
            )
        return Sampler.AVALANCHES, f"{what} is drawn avalanche by avalanche"
    if spad.mode == "synchronous" and spad.dead_time_s >= active_span(flux, cycle):
        return Sampler.HAZARD_CHAIN, "the dead time lasts to the end of the cycle"
    if spad.paralyzable:
        _limit(events, "a paralyzable dead time", where)
        return Sampler.AVALANCHES, "every photon restarts the dead time"
    if spad.mode == "synchronous":
        # A dead time far below a bin would need pieces as short; single events then cost less.
        pieces = len(flux) + flux.sum() / PIECE_FLUX + cycle.period_s / spad.dead_time_s
        if pieces * _CHAIN_NS <= detections * _EVENT_NS or detections > MOST_EVENTS:
            return Sampler.RETURN_CHAIN, "the dead time is shorter than the cycle"
        return Sampler.AVALANCHES, "few enough detections to draw them one by one"
    if approximate and detections > ENSEMBLE_EVENTS:
        return Sampler.CYCLE_ENSEMBLE, (
            f"{detections:.2g} detections, more than {ENSEMBLE_EVENTS:.0e}, are drawn as independent runs of cycles: "
            "exact in the mean, approximate in the variance"
        )
    if detections > MOST_EVENTS:
        raise InputError(
            f"{where}: {detections:.2g} free-running detections, at most {MOST_EVENTS:.0e} are drawn one by one; "
            "allow an approximate variance with approximate=True, or lower cycles or photons_per_pulse"
        )
    return Sampler.FREE_RUNNING_EVENTS, "the dead time spans cycles"


def _limit(events: float, what: str, where: str) -> None:
    if events > MOST_EVENTS:
        raise InputError(
            f"{where}: {events:.2g} events with {what}, at most {MOST_EVENTS:.0e} are drawn one by one and no faster "
            f"sampler exists; lower cycles or photons_per_pulse, close the gate on the direct return, or switch "
            f"{what} off"
        )


def poisson_bias(flux: Array, cycle: Cycle, spad: Spad) -> float:
    """Bound on the relative bias of any bin's mean if counts were drawn as Poisson; 0: they are Poisson.

    Dead time takes from a bin at most the share M, the most flux in any interval of the dead time: M = ⌊τ/T_r⌋ Λ +
    the most in any τ mod T_r. An avalanche adds at most μ/(1 − μ) afterpulses and 4p/(1 − 4p) by crosstalk.
    """
    if spad.mode == "ideal":
        return 0.0
    total = float(flux.sum())
    bias = 0.0
    if spad.dead_time_s > 0:
        whole = np.floor(spad.dead_time_s / cycle.period_s)
        rest = spad.dead_time_s - whole * cycle.period_s
        if whole and spad.mode == "synchronous":
            bias = total
        else:
            bias = whole * total + most_in_window(flux, cycle.edges_s, rest)
    return float(sum(caused(spad), bias))


def caused(spad: Spad) -> tuple[float, float]:
    """Avalanches that one causes at most by afterpulsing and by crosstalk, those caused by these included."""
    load = sum(spad.trap_loads) if spad.afterpulse_probability > 0 else 0.0
    shared = min(4 * spad.crosstalk_probability, 0.99)
    return load / (1.0 - load), shared / (1.0 - shared)


def summarise(choices: list[Choice], tolerance: float) -> SamplerChoice:
    """One record for all histograms; the numbers are those of the brightest."""
    b = max(choices, key=lambda c: c.flux)
    names = dict(sorted(Counter(c.sampler.name.lower() for c in choices).items()))
    approximate = any(c.sampler is Sampler.CYCLE_ENSEMBLE for c in choices)
    figures = b.flux, b.bias, b.deviation, b.detections
    return SamplerChoice(b.sampler.name.lower(), b.reason, names, *figures, tolerance, approximate)
