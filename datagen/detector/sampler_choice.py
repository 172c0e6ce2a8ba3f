"""Which sampler draws a histogram: the cheapest one that is exact, or biased by less than the tolerance."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from datagen.detector.dead_time import PIECE_FLUX, most_in_window
from datagen.detector.events import burn_in_cycles
from datagen.detector.expected import active_span
from datagen.detector.flux import Cycle
from datagen.detector.random_numbers import LARGEST_MEAN, check_countable
from datagen.detector.spad import Exposure, Spad
from datagen.errors import InputError

Array = NDArray[np.float64]
Where = Callable[[int], str]
"""What names the histogram of a number."""

DEFAULT_TOLERANCE = 1e-3
"""Largest relative bias that a cheaper sampler may cause."""
HIDDEN_DEVIATION = 0.1
"""Largest bias of a total in its own standard deviations: one that no test of a single histogram could find."""
ENSEMBLE_EVENTS = 2e6
"""Detections per histogram above which, if allowed, free running is drawn by the approximate ensemble."""
MOST_EVENTS = 2e7
"""Events per histogram above which event-driven samplers would take seconds and more, and are refused."""

_CHAIN_NS, _EVENT_NS = 120.0, 40.0
"""Time for a piece in chains of binomials, and for a detection drawn in order."""


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
class Choices:
    """How each of h histograms is drawn, or all pixels of each of h laser points where crosstalk couples them.

    Attributes
    ----------
    sampler : (h,) of `Sampler`.
    few : (h,) whether a synchronous detector's detections are few enough to be drawn one by one, in order.
    flux, bias, deviation, detections : (h,) as of `SamplerChoice`.
    """

    sampler: NDArray[np.int64]
    few: NDArray[np.bool_]
    flux: Array
    bias: Array
    deviation: Array
    detections: Array


def choose(
    flux: Array, cycle: Cycle, spad: Spad, exposure: Exposure, tolerance: float, approximate: bool, where: Where
) -> Choices:
    """Decide for each histogram's flux (h, n); for pixels coupled by crosstalk give the sums of theirs.

    Raises `InputError`, naming the histogram by `where`, for what can only be done approximately, unless
    `approximate`, and for what would take too long.
    """
    totals = flux.sum(axis=1)
    events = totals * exposure.cycles
    bias = poisson_bias(flux, cycle, spad)
    deviation = bias * np.sqrt(events)
    detections = events
    if spad.dead_time_s > 0 and not spad.paralyzable and spad.mode != "ideal":
        share = spad.dead_time_s / cycle.period_s
        most = 1.0 / share + (1.0 if spad.mode == "synchronous" else 0.0)
        detections = np.minimum(events, exposure.cycles * most)
        if spad.mode == "free_running":
            detections = events / (1.0 + totals * share)
    sampler = np.full(len(flux), int(Sampler.POISSON))
    few = np.zeros(len(flux), bool)
    beyond = np.flatnonzero((bias > 0) & ~((bias <= tolerance) & (deviation <= HIDDEN_DEVIATION)))
    if len(beyond):
        limits = _Limits(spad, exposure.cycles, cycle.period_s, beyond, where)
        own = flux if len(beyond) == len(flux) else flux[beyond]
        sampler[beyond] = _beyond_poisson(own, cycle, spad, approximate, events[beyond], detections[beyond], limits)
        chained = beyond[(sampler[beyond] == Sampler.HAZARD_CHAIN) | (sampler[beyond] == Sampler.RETURN_CHAIN)]
        if len(chained):
            few[chained] = _are_few(totals[chained], detections[chained], cycle, spad)
    uncountable = np.flatnonzero((sampler == Sampler.POISSON) & ~(events < LARGEST_MEAN))
    if len(uncountable):
        check_countable(flux[uncountable] * exposure.cycles, lambda row: where(int(uncountable[row])))
    return Choices(sampler, few, totals, bias, deviation, detections)


def _beyond_poisson(
    flux: Array, cycle: Cycle, spad: Spad, approximate: bool, events: Array, detections: Array, limits: _Limits
) -> NDArray[np.int64] | Sampler:
    """Samplers of histograms that the dead time, afterpulses or crosstalk tell from Poisson's."""
    if spad.afterpulse_probability > 0 or spad.crosstalk_probability > 0:
        what = "afterpulsing" if spad.afterpulse_probability > 0 else "crosstalk"
        limits.check_events(detections, what)
        limits.check_burn_in(detections, what)
        return Sampler.AVALANCHES
    if spad.mode == "synchronous":
        one = spad.dead_time_s >= active_span(flux, cycle)
        if not spad.paralyzable:
            return np.where(one, Sampler.HAZARD_CHAIN, Sampler.RETURN_CHAIN)
        limits.check_events(np.where(one, 0.0, events), "a paralyzable dead time")
        return np.where(one, Sampler.HAZARD_CHAIN, Sampler.AVALANCHES)
    if spad.paralyzable:
        limits.check_events(events, "a paralyzable dead time")
        return Sampler.AVALANCHES
    many = approximate & (detections > ENSEMBLE_EVENTS)
    limits.check_free_running(np.where(many, 0.0, detections))
    return np.where(many, Sampler.CYCLE_ENSEMBLE, Sampler.FREE_RUNNING_EVENTS)


def _are_few(totals: Array, detections: Array, cycle: Cycle, spad: Spad) -> NDArray[np.bool_]:
    """Whether it takes less time to draw a synchronous detector's detections one by one than bin by bin."""
    # A dead time far below a bin needs pieces as short.
    pieces = len(cycle.gate) + totals / PIECE_FLUX + cycle.period_s / spad.dead_time_s
    return np.asarray((detections * _EVENT_NS < pieces * _CHAIN_NS) & (detections <= MOST_EVENTS))


@dataclass(frozen=True)
class _Limits:
    """What takes too long is refused, with the number of the histogram: `rows` of those that `where` names."""

    spad: Spad
    cycles: int
    period_s: float
    rows: NDArray[np.int64]
    where: Where

    def check_events(self, events: Array, what: str) -> None:
        """Raise `InputError` for more than can be drawn avalanche by avalanche."""
        for place, value in self._beyond(events):
            raise InputError(
                f"{place}: {value:.2g} events with {what}, at most {MOST_EVENTS:.0e} are drawn one by one and no "
                f"faster sampler exists; lower cycles or photons_per_pulse, close the gate on the direct return, or "
                f"switch {what} off"
            )

    def check_burn_in(self, detections: Array, what: str) -> None:
        """Raise `InputError` for traps and dead times that remember for too long."""
        for place, value in self._beyond(detections * burn_in_cycles(self.spad, self.period_s) / self.cycles):
            raise InputError(
                f"{place}: {value:.2g} events before the exposure, at most {MOST_EVENTS:.0e} are drawn one by one, "
                f"until traps of {max(self.spad.afterpulse_times_s):g} s and a dead time of "
                f"{self.spad.dead_time_s:g} s forget how they started; shorten afterpulse_times_s or dead_time_s, or "
                f"switch {what} off"
            )

    def check_free_running(self, detections: Array) -> None:
        """Raise `InputError` for more than can be drawn detection by detection."""
        for place, value in self._beyond(detections):
            raise InputError(
                f"{place}: {value:.2g} free-running detections, at most {MOST_EVENTS:.0e} are drawn one by one; "
                "allow an approximate variance with approximate=True, or lower cycles or photons_per_pulse"
            )

    def _beyond(self, events: Array) -> Iterator[tuple[str, float]]:
        for row in np.flatnonzero(events > MOST_EVENTS):
            yield self.where(int(self.rows[row])), float(events[row])


def poisson_bias(flux: Array, cycle: Cycle, spad: Spad) -> Array:
    """(…,) bound on the relative bias of any bin's mean, were counts of flux (…, n) drawn as Poisson; 0: they are.

    Dead time takes from a bin at most the share M, the most flux in any interval of the dead time: M = ⌊τ/T_r⌋ Λ +
    the most in any τ mod T_r. An avalanche adds at most μ/(1 − μ) afterpulses and 4p/(1 − 4p) by crosstalk.
    """
    bias = np.zeros(flux.shape[:-1])
    if spad.mode == "ideal":
        return bias
    if spad.dead_time_s > 0:
        total = flux.sum(axis=-1)
        whole = np.floor(spad.dead_time_s / cycle.period_s)
        rest = spad.dead_time_s - whole * cycle.period_s
        if whole and spad.mode == "synchronous":
            bias = total
        else:
            bias = whole * total + most_in_window(flux, cycle.edges_s, rest)
    return bias + sum(caused(spad))


def caused(spad: Spad) -> tuple[float, float]:
    """Avalanches that one causes at most by afterpulsing and by crosstalk, those caused by these included."""
    load = sum(spad.trap_loads) if spad.afterpulse_probability > 0 else 0.0
    shared = min(4 * spad.crosstalk_probability, 0.99)
    return load / (1.0 - load), shared / (1.0 - shared)


def summarise(choices: list[Choices], spad: Spad, tolerance: float) -> SamplerChoice:
    """One record for all histograms; the numbers are those of the brightest."""
    sampler = np.concatenate([c.sampler for c in choices])
    figures = np.concatenate([[c.flux, c.bias, c.deviation, c.detections] for c in choices], axis=1)
    brightest = int(figures[0].argmax())
    flux, bias, deviation, detections = (float(f) for f in figures[:, brightest])
    counted = {Sampler(code).name.lower(): int((sampler == code).sum()) for code in np.unique(sampler)}
    chosen = Sampler(int(sampler[brightest]))
    reason = _reason(chosen, spad, bias, deviation, detections, tolerance)
    approximate = bool((sampler == Sampler.CYCLE_ENSEMBLE).any())
    return SamplerChoice(
        chosen.name.lower(), reason, dict(sorted(counted.items())), flux, bias, deviation, detections, tolerance,
        approximate,
    )  # fmt: skip


def _reason(sampler: Sampler, spad: Spad, bias: float, deviation: float, detections: float, tolerance: float) -> str:
    if sampler is Sampler.POISSON:
        if spad.mode == "ideal":
            return "mode 'ideal' counts every event"
        if bias == 0.0:
            return "nothing is lost to dead time and nothing added: counts are Poisson"
        return (
            f"relative bias ≤ {bias:.2g} (tolerance {tolerance:.2g}) and ≤ {deviation:.2g} standard deviations "
            f"(allowed {HIDDEN_DEVIATION:g})"
        )
    cause = "afterpulsing" if spad.afterpulse_probability > 0 else "crosstalk"
    why = {
        Sampler.HAZARD_CHAIN: "the dead time lasts to the end of the cycle",
        Sampler.RETURN_CHAIN: "the dead time is shorter than the cycle",
        Sampler.FREE_RUNNING_EVENTS: "the dead time spans cycles",
        Sampler.CYCLE_ENSEMBLE: (
            f"{detections:.2g} detections, more than {ENSEMBLE_EVENTS:.0e}, are drawn as independent runs of cycles: "
            "exact in the mean, approximate in the variance"
        ),
        Sampler.AVALANCHES: (
            "every photon restarts the dead time" if spad.paralyzable else f"{cause} is drawn avalanche by avalanche"
        ),
    }[sampler]
    return f"Poisson would be biased by up to {bias:.2g} ({deviation:.2g} standard deviations); {why}"
