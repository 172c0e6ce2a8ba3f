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
from datagen.records.arrays import Bools, Floats, Ints

Where = Callable[[int], str]
"""Name of a histogram for error messages, from its number."""

DEFAULT_TOLERANCE = 1e-3
"""Largest relative bias of a cheaper sampler. Halved, exact samplers are used from half the flux on."""
HIDDEN_DEVIATION = 0.1
"""Largest bias of a total count in its own standard deviations, too small for any test of a single histogram. Halved,
exact samplers are used from a quarter of the exposure on."""
ENSEMBLE_EVENTS = 2e6
"""Detections per histogram above which free running is drawn by the approximate ensemble, if that is allowed. So many
events take 0.2 s one by one; halved, the ensemble is used from 0.1 s on."""
MOST_EVENTS = 2e7
"""Events per histogram above which samplers that draw them one by one are refused, as they would take seconds and
more. Halved, exposures are refused from half of that time on."""

_CHAIN_NS, _EVENT_NS = 120.0, 40.0
"""Nanoseconds for a piece in a chain of binomials, and for a detection drawn in order. Their ratio decides from how
many detections on the chain is used; with either halved the slower way takes at most twice as long as the other."""


class Sampler(IntEnum):
    """The ways in which counts are drawn."""

    POISSON = 0
    """Independent Poisson counts."""
    HAZARD_CHAIN = 1
    """Synchronous, one detection in a cycle at most."""
    RETURN_CHAIN = 2
    """Synchronous, several detections in a cycle."""
    FREE_RUNNING_EVENTS = 3
    """Free running, one detection after another."""
    CYCLE_ENSEMBLE = 4
    """Free running as independent runs of cycles; exact in the mean, approximate in the variance."""
    AVALANCHES = 5
    """Afterpulsing, paralyzable dead time or crosstalk, one avalanche after another."""


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
    in_order : (h,) whether the detections of a synchronous detector are so few that they are drawn one by one.
    flux, bias, deviation, detections : (h,) as of `SamplerChoice`.
    """

    sampler: Ints
    in_order: Bools
    flux: Floats
    bias: Floats
    deviation: Floats
    detections: Floats


def choose(
    flux: Floats, cycle: Cycle, spad: Spad, exposure: Exposure, tolerance: float, approximate: bool, where: Where
) -> Choices:
    """The choice for each of h histograms, from their flux (h, n); for pixels coupled by crosstalk, from its sum.

    Raises `InputError`, naming the histogram by `where`, if it can only be drawn approximately and not `approximate`,
    or if it would take too long.
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
    in_order = np.zeros(len(flux), bool)
    beyond = np.flatnonzero((bias > 0) & ~((bias <= tolerance) & (deviation <= HIDDEN_DEVIATION)))
    if len(beyond):
        burn_in = detections[beyond] * burn_in_cycles(spad, cycle.period_s) / exposure.cycles
        sampler[beyond] = _beyond_poisson(
            flux[beyond], cycle, spad, approximate, events[beyond], detections[beyond], burn_in,
            lambda row: where(int(beyond[row])),
        )  # fmt: skip
        chained = beyond[(sampler[beyond] == Sampler.HAZARD_CHAIN) | (sampler[beyond] == Sampler.RETURN_CHAIN)]
        if len(chained):
            # A chain cuts bins by their flux, and into pieces shorter than the dead time.
            pieces = len(cycle.gate) + totals[chained] / PIECE_FLUX + cycle.period_s / spad.dead_time_s
            few = detections[chained]
            in_order[chained] = (few * _EVENT_NS < pieces * _CHAIN_NS) & (few <= MOST_EVENTS)
    uncountable = np.flatnonzero((sampler == Sampler.POISSON) & ~(events < LARGEST_MEAN))
    if len(uncountable):
        check_countable(flux[uncountable] * exposure.cycles, lambda row: where(int(uncountable[row])))
    return Choices(sampler, in_order, totals, bias, deviation, detections)


def _beyond_poisson(
    flux: Floats, cycle: Cycle, spad: Spad, approximate: bool, events: Floats, detections: Floats, burn_in: Floats,
    where: Where,
) -> Ints | Sampler:  # fmt: skip
    """(h,) samplers of histograms for which Poisson numbers would be too biased; parameters as of `choose`.

    events, detections : (h,) expected in the exposure. burn_in : (h,) detections simulated before the exposure, in
    which a diode forgets how it started.
    """
    fewer = "lower cycles or photons_per_pulse, close the gate on the direct return"
    no_faster = f" and no faster sampler exists; {fewer}"
    if spad.afterpulse_probability > 0 or spad.crosstalk_probability > 0:
        what = "afterpulsing" if spad.afterpulse_probability > 0 else "crosstalk"
        _check_few(detections, where, f"events with {what}", f"{no_faster}, or switch {what} off")
        memory = f"traps of {max(spad.afterpulse_times_s):g} s and a dead time of {spad.dead_time_s:g} s"
        _check_few(
            burn_in, where, "events before the exposure",
            f", until {memory} forget how they started; shorten afterpulse_times_s or dead_time_s, or switch {what} "
            "off",
        )  # fmt: skip
        return Sampler.AVALANCHES
    one = spad.dead_time_s >= active_span(flux, cycle) if spad.mode == "synchronous" else np.zeros(len(flux), bool)
    if spad.paralyzable:
        what = "a paralyzable dead time"
        each = np.where(one, 0.0, events)
        _check_few(each, where, f"events with {what}", f"{no_faster}, or switch {what} off")
        return np.where(one, Sampler.HAZARD_CHAIN, Sampler.AVALANCHES)
    if spad.mode == "synchronous":
        return np.where(one, Sampler.HAZARD_CHAIN, Sampler.RETURN_CHAIN)
    many = approximate & (detections > ENSEMBLE_EVENTS)
    _check_few(
        np.where(many, 0.0, detections), where, "free-running detections",
        "; allow an approximate variance with approximate=True, or lower cycles or photons_per_pulse",
    )  # fmt: skip
    return np.where(many, Sampler.CYCLE_ENSEMBLE, Sampler.FREE_RUNNING_EVENTS)


def _check_few(events: Floats, where: Where, what: str, remedy: str) -> None:
    """Raise `InputError` for the first histogram whose events (h,) are too many to be drawn one by one."""
    for row in np.flatnonzero(events > MOST_EVENTS):
        raise InputError(
            f"{where(int(row))}: {events[row]:.2g} {what}, at most {MOST_EVENTS:.0e} are drawn one by one{remedy}"
        )


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
    approximate = bool((sampler == Sampler.CYCLE_ENSEMBLE).any())
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
