"""The choice of sampler for each histogram: the cheapest one that is exact, or biased by less than the tolerance."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from datagen.detector.dead_time import PIECE_FLUX, most_in_window
from datagen.detector.events import burn_in_cycles
from datagen.detector.expected import active_span
from datagen.detector.flux import Cycle
from datagen.detector.random_numbers import LARGEST_MEAN, check_countable
from datagen.detector.spad import Exposure, Spad
from datagen.errors import InputError
from datagen.records.arrays import Floats, Ints

Where = Callable[[int], str]
"""Name of a histogram for error messages, from its number."""

DEFAULT_TOLERANCE = 1e-3
"""Largest relative bias of a cheaper sampler: less than the flux of a real measurement is known to."""
HIDDEN_DEVIATION = 0.1
"""Largest bias of a total count in its own standard deviations, too small for any test of a single histogram."""
MANY_EVENTS = 2e6
"""Events per histogram from which on detections are not drawn one by one, if an approximate variance is allowed. So
many events take 0.1 s."""
MOST_EVENTS = 2e7
"""Events per histogram above which drawing them one by one is refused, as it would take seconds and more."""


class Sampler(IntEnum):
    """The ways in which counts are drawn."""

    POISSON = 0
    """Independent Poisson counts of the flux."""
    CHAIN = 1
    """Synchronous: all cycles at once, bin after bin, where bins are fewer than detections."""
    EVENTS = 2
    """One detection after another: free running, afterpulsing, paralyzable dead time, crosstalk."""
    MULTINOMIAL = 3
    """A normal total, shared out as in the expected histogram: exact in the mean, approximate in the variance."""


@dataclass(frozen=True)
class SamplerChoice:
    """The samplers of a transient's histograms; numbers are those of the brightest histogram unless stated otherwise.

    sampler : name of the sampler of the brightest histogram.
    reason : why, in words.
    histograms : sampler name → number of histograms that it draws.
    flux_per_cycle : expected avalanche-capable events per laser cycle, Λ.
    poisson_bias : bound on the relative bias of any bin if counts were drawn as Poisson numbers.
    poisson_deviation : bound on the bias of the total count in that case, in standard deviations.
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
        """The choice as scalars, which are stored with a sample."""
        kept = ("reason", "flux_per_cycle", "poisson_bias", "poisson_deviation", "detections", "approximate")
        return {"name": self.sampler, **{key: getattr(self, key) for key in kept}}


@dataclass(frozen=True)
class Choices:
    """How each of h histograms is drawn, or all pixels of each of h laser points if crosstalk couples them.

    sampler : (h,) values of `Sampler`.
    flux, bias, deviation, detections : (h,) as of `SamplerChoice`.
    """

    sampler: Ints
    flux: Floats
    bias: Floats
    deviation: Floats
    detections: Floats


def choose(
    flux: Floats, cycle: Cycle, spad: Spad, exposure: Exposure, tolerance: float, approximate: bool, where: Where
) -> Choices:
    """The choice for each of h histograms, from their flux (h, n); for pixels coupled by crosstalk, from its sum.

    Raises `InputError`, naming the histogram by `where`, if it can only be drawn approximately and not `approximate`.
    """
    totals = flux.sum(axis=1)
    events = totals * exposure.cycles
    bias = poisson_bias(flux, cycle, spad)
    deviation = bias * np.sqrt(events)
    detections = events
    if spad.dead_time_s > 0 and not spad.paralyzable and spad.mode != "ideal":
        # A cycle has room for so many dead times; a free-running detector loses the share λτ/(1 + λτ) on average.
        share = spad.dead_time_s / cycle.period_s
        most = 1.0 / share + (1.0 if spad.mode == "synchronous" else 0.0)
        detections = np.minimum(events, exposure.cycles * most)
        if spad.mode == "free_running":
            detections = events / (1.0 + totals * share)
    sampler = np.full(len(flux), int(Sampler.POISSON))
    beyond = (bias > 0) & ~((bias <= tolerance) & (deviation <= HIDDEN_DEVIATION))
    if beyond.any():
        sampler[beyond] = Sampler.EVENTS
        causes = spad.afterpulse_probability > 0 or spad.crosstalk_probability > 0
        if spad.mode == "synchronous" and not causes:
            # With one detection a cycle it does not matter what restarts the dead time.
            once = spad.dead_time_s >= active_span(flux, cycle)
            # Otherwise the chain cuts bins by their flux, and into pieces shorter than the dead time.
            cuts = np.where(once, 0.0, totals / PIECE_FLUX + cycle.period_s / spad.dead_time_s)
            chained = (once | (not spad.paralyzable)) & (len(cycle.gate) + cuts <= detections)
            sampler[beyond & chained] = Sampler.CHAIN
        burn_in = detections * (burn_in_cycles(spad, cycle.period_s) / exposure.cycles)
        # Every photon restarts a paralyzable dead time, so all of them are drawn.
        drawn = np.where(sampler == Sampler.EVENTS, np.maximum(detections, burn_in), 0.0)
        if approximate:
            sampler[drawn > MANY_EVENTS] = Sampler.MULTINOMIAL
        elif len(many := np.flatnonzero(drawn > MOST_EVENTS)):
            raise InputError(f"{where(int(many[0]))}: {_too_many(detections[many[0]], burn_in[many[0]], spad)}")
    uncountable = np.flatnonzero((sampler == Sampler.POISSON) & ~(events < LARGEST_MEAN))
    if len(uncountable):
        check_countable(flux[uncountable] * exposure.cycles, lambda row: where(int(uncountable[row])))
    return Choices(sampler, totals, bias, deviation, detections)


def _too_many(detections: float, burn_in: float, spad: Spad) -> str:
    """Why events of a detector cannot be drawn one by one, and what to do."""
    remedy = "lower cycles or photons_per_pulse, close the gate on the direct return"
    when = ""
    if burn_in > detections:
        when, remedy = " before the exposure, until the detector forgets how it started", "shorten dead_time_s"
        if spad.afterpulse_probability > 0:
            remedy = "shorten afterpulse_times_s or dead_time_s"
    return (
        f"{max(detections, burn_in):.2g} events with {_kind(spad)}{when}, at most {MOST_EVENTS:.0e} are drawn one by "
        f"one; {remedy}, or allow an approximate variance with approximate=True"
    )


def _kind(spad: Spad) -> str:
    """What makes detections depend on one another, so that they are drawn one after another."""
    if spad.afterpulse_probability > 0:
        return "afterpulsing"
    if spad.crosstalk_probability > 0:
        return "crosstalk"
    return "a paralyzable dead time" if spad.paralyzable else "a dead time"


def poisson_bias(flux: Floats, cycle: Cycle, spad: Spad) -> Floats:
    """(…,) bound on the relative bias of any bin's mean if counts of flux (…, n) were drawn as Poisson numbers; 0 if
    they are Poisson numbers.

    Dead time takes from a bin at most the share M, the most flux in any interval of the dead time: M = ⌊τ/T_r⌋ Λ +
    the most in any τ mod T_r. An avalanche adds at most μ/(1 − μ) afterpulses, and 4p/(1 − 4p) by crosstalk.
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
    return bias + sum(avalanches_caused(spad))


def avalanches_caused(spad: Spad) -> tuple[float, float]:
    """The most avalanches that one causes, directly and in turn, by afterpulsing and by crosstalk."""
    load = sum(spad.trap_loads) if spad.afterpulse_probability > 0 else 0.0
    shared = min(4 * spad.crosstalk_probability, 0.99)
    return load / (1.0 - load), shared / (1.0 - shared)


def summarise(choices: list[Choices], spad: Spad, tolerance: float) -> SamplerChoice:
    """The record of all histograms' choices; its numbers are those of the brightest histogram."""
    sampler = np.concatenate([c.sampler for c in choices])
    figures = np.concatenate([[c.flux, c.bias, c.deviation, c.detections] for c in choices], axis=1)
    brightest = int(figures[0].argmax())
    flux, bias, deviation, detections = (float(f) for f in figures[:, brightest])
    counted = {Sampler(code).name.lower(): int((sampler == code).sum()) for code in np.unique(sampler)}
    chosen = Sampler(int(sampler[brightest]))
    reason = _reason(chosen, spad, bias, deviation, detections, tolerance)
    approximate = bool((sampler == Sampler.MULTINOMIAL).any())
    return SamplerChoice(
        chosen.name.lower(), reason, dict(sorted(counted.items())), flux, bias, deviation, detections, tolerance,
        approximate,
    )  # fmt: skip


def _reason(sampler: Sampler, spad: Spad, bias: float, deviation: float, detections: float, tolerance: float) -> str:
    """Why a sampler was chosen, one sentence for people."""
    if sampler is Sampler.POISSON:
        if spad.mode == "ideal":
            return "mode 'ideal' counts every event"
        if bias == 0.0:
            return "nothing is lost to dead time and nothing added: counts are Poisson"
        return (
            f"relative bias ≤ {bias:.2g} (tolerance {tolerance:.2g}) and ≤ {deviation:.2g} standard deviations "
            f"(allowed {HIDDEN_DEVIATION:g})"
        )
    why = {
        Sampler.CHAIN: "all laser cycles are counted together, bin after bin",
        Sampler.EVENTS: f"detections with {_kind(spad)} are drawn one by one",
        Sampler.MULTINOMIAL: (
            f"{detections:.2g} detections, more than {MANY_EVENTS:.0e}, are shared out at random around their mean; "
            "their variance is approximate"
        ),
    }[sampler]
    return f"Poisson would be biased by up to {bias:.2g} ({deviation:.2g} standard deviations); {why}"
