"""The detector's rows of the table: what becomes of photons, and by how much the expected histogram would change.

What is said is relative to the expected histogram h = λ · s, with s the share of cycles in which the detector is
armed. At least exp(−M) of them are, M the most flux within one dead time: only if nothing came for so long, for sure.
So ‖h‖ ≥ exp(−M) ‖λ‖, and whatever changes the events by a share changes h by no more than exp(M) times that.
The bounds on dead time, afterpulses and crosstalk are those of `detector/plan.py`, effect by effect.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from datagen.detector.expected import saturated_mean
from datagen.detector.plan import HIDDEN_DEVIATION
from datagen.effects.decision import Effect, Estimate
from datagen.effects.detector_world import DetectorWorld

_LARGEST_EXPONENT = 700.0


def _exp(value: float) -> float:
    return math.exp(min(value, _LARGEST_EXPONENT))


def _armed(world: DetectorWorld) -> float:
    """exp(M): what a change of the flux is multiplied by, at most, relative to the histogram."""
    return _exp(world.figures.most)


def _bounded(value: float, reason: str, allowed: bool = True) -> Estimate:
    return Estimate(value, "bound", reason, allowed)


def _loss(world: DetectorWorld, value: float, reason: str) -> Estimate:
    """An effect that changes the law of the counts is also held to what the planner of samplers allows."""
    figures, allowed = world.figures, world.tolerance
    deviation = value * math.sqrt(figures.total * world.exposure.cycles)
    hidden = value <= allowed and deviation <= HIDDEN_DEVIATION
    if value > 0 and not hidden:
        reason += f", {deviation:.2g} standard deviations (allowed: {allowed:.2g} and {HIDDEN_DEVIATION:g})"
    return _bounded(value, reason, hidden or value == 0)


def _timing(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    cycle = world.cycle
    kept = 1.0
    for kernel in (cycle.before_avalanche, cycle.after_avalanche):
        kept *= float(kernel.weights[kernel.before])
    moved = 2.0 * (1.0 - kept)
    if moved < 1e-14:
        return _bounded(0.0, "far narrower than a bin")
    value = moved / (1.0 - moved) * _armed(world) * (1.0 + world.figures.most) if moved < 1.0 else None
    return Estimate(value, "bound", f"it moves {1 - kept:.2g} of the photons into other bins")


def _background(world: DetectorWorld, norm: float, rate_hz: float, deviation: float, what: str) -> Estimate:
    """‖Δλ‖/‖λ‖, and the dead time that background causes; in empty bins it must not be seen either."""
    figures = world.figures
    added = norm / figures.norm if figures.norm > 0 else 0.0
    dead = rate_hz * world.spad.dead_time_s if world.has_dead_time else 0.0
    value = (added + min(dead, figures.most)) * _armed(world)
    hidden = deviation <= HIDDEN_DEVIATION
    reason = f"{what} is {added:.2g} of the flux, {deviation:.2g} standard deviations (allowed {HIDDEN_DEVIATION:g})"
    return _bounded(value, reason, hidden)


def _ambient(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    rate_hz = world.spad.pde * world.exposure.ambient_rate_hz
    return _background(world, world.figures.ambient_norm, rate_hz, world.figures.ambient_deviation, "ambient light")


def _dark(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    spad = world.spad
    rate_hz = spad.dark_count_rate_hz * (spad.hot_pixel_factor if spad.hot_pixel_fraction > 0 else 1.0)
    return _background(world, world.figures.dark_norm, rate_hz, world.figures.dark_deviation, "dark counts")


def _pile_up(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    most = world.figures.most if world.spad.paralyzable else world.figures.within
    return _loss(world, math.expm1(min(most, _LARGEST_EXPONENT)), f"≤ {most:.2g} events within a dead time")


def _across(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    if "pile_up" in gone and not _thins_evenly(world):
        return _bounded(0.0, "left out together with pile-up: it is the same dead time")
    earlier = world.whole_periods * world.figures.total + world.figures.late
    return _loss(world, earlier * _armed(world), f"≤ {earlier:.2g} events of earlier cycles within a dead time")


def _thins_evenly(world: DetectorWorld) -> bool:
    """Whether a dead time of whole periods, which thins all bins alike, remains when pile-up is left out."""
    return world.spad.mode == "free_running" and not world.spad.paralyzable and world.whole_periods > 0


def _afterpulsing(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    load = sum(world.spad.trap_loads)
    return _loss(world, load / (1.0 - load) * _armed(world), f"≤ {load / (1.0 - load):.2g} afterpulses an avalanche")


def _crosstalk(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    shared = 4.0 * world.spad.crosstalk_probability
    value = shared / (1.0 - shared) * _armed(world)
    return _loss(world, value, f"≤ {shared / (1.0 - shared):.2g} avalanches in neighbours for each")


def _gate(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    figures = world.figures
    if figures.norm == 0:
        return Estimate(None, "bound", "the gate lets no light through")
    shut = figures.shut_norm / figures.norm
    value = (shut + figures.most_shut) * _exp(figures.most + figures.most_shut)
    hidden = figures.shut_deviation <= HIDDEN_DEVIATION
    return _bounded(
        value,
        f"it shuts out {shut:.2g} of what it lets through, {figures.shut_deviation:.2g} standard deviations "
        f"(allowed {HIDDEN_DEVIATION:g})",
        hidden,
    )


def _saturation(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    spad, figures, cycles = world.spad, world.figures, world.exposure.cycles
    counter_max = spad.counter_max or 0
    shared = 4.0 * spad.crosstalk_probability if spad.mode != "ideal" else 0.0
    load = sum(spad.trap_loads) if spad.afterpulse_probability > 0 and spad.mode != "ideal" else 0.0
    # The most counts that dead time would leave, with all that avalanches may add; jitter only spreads them.
    mean = figures.brightest * cycles / (1.0 - load) / max(1.0 - shared, 0.01)
    highest = float(mean.max(initial=0.0))
    if highest + 8.0 * math.sqrt(highest) + 8.0 <= counter_max:
        return _bounded(0.0, f"at most {highest:.2g} counts are expected in a bin, {counter_max} fit")
    lost = mean - saturated_mean(mean, cycles, counter_max, False)
    value = float(np.linalg.norm(lost) / np.linalg.norm(mean - lost)) * _armed(world)
    return _bounded(value, f"{highest:.2g} counts may be expected in a bin, {counter_max} fit")


def _without_pile_up(world: DetectorWorld) -> DetectorWorld:
    if _thins_evenly(world):
        return world.with_spad(dead_time_s=world.whole_periods * world.exposure.period_s)
    return world.with_spad(dead_time_s=0.0, paralyzable=False)


def _exactly(world: DetectorWorld, setting: str | int) -> DetectorWorld:
    """No sampler that is only nearly right."""
    return replace(world, tolerance=0.0)


def _counts_all(world: DetectorWorld) -> bool:
    return world.spad.mode == "ideal"


DETECTOR_EFFECTS: tuple[Effect[DetectorWorld], ...] = (
    Effect(
        "timing_response", "laser pulse and jitter (IRF)", "detector",
        "a pulse, tail or jitter of some width",
        "Young's inequality: ‖w * h − h‖ ≤ 2 (1 − w₀) ‖h‖ for the bin-integrated response w",
        0.4,
        lambda w: w.exposure.pulse_fwhm_s > 0 or w.spad.jitter_fwhm_s > 0
        or w.spad.jitter_tail_s * w.spad.jitter_tail_fraction > 0,
        _timing,
        lambda w: w.with_spad(jitter_fwhm_s=0.0, jitter_tail_s=0.0).with_exposure(pulse_fwhm_s=0.0),
    ),
    Effect(
        "ambient_light", "ambient light", "detector",
        "`detector.ambient_rate_hz` > 0",
        "Its flux beside the whole (DETECTOR, λ)",
        0.1, lambda w: w.spad.pde * w.exposure.ambient_rate_hz > 0, _ambient,
        lambda w: w.with_exposure(ambient_rate_hz=0.0),
    ),
    Effect(
        "dark_counts", "dark counts", "detector",
        "`detector.dark_count_rate_hz` > 0",
        "Its flux beside the whole (DETECTOR, λ)",
        0.1, lambda w: w.spad.dark_count_rate_hz > 0, _dark,
        lambda w: w.with_spad(dark_count_rate_hz=0.0),
    ),
    Effect(
        "pile_up", "pile-up", "detector",
        "a dead time, and a mode other than `ideal`",
        "M of DETECTOR, When Poisson is enough; λ/h ≤ exp(M)",
        0.8, lambda w: w.has_dead_time, _pile_up, _without_pile_up, _exactly,
    ),
    Effect(
        "dead_time_across_cycles", "dead time across cycles", "detector",
        "mode `free_running` with a dead time",
        "The same, with the flux of earlier cycles that reaches into one",
        0.7, lambda w: w.has_dead_time and w.spad.mode == "free_running", _across,
        lambda w: w.with_spad(mode="synchronous"), _exactly,
    ),
    Effect(
        "afterpulsing", "afterpulsing", "detector",
        "`detector.afterpulse_probability` > 0, and a mode other than `ideal`",
        "μ/(1 − μ) afterpulses an avalanche, μ = −ln(1 − p) (DETECTOR, case e)",
        0.95, lambda w: w.spad.afterpulse_probability > 0 and not _counts_all(w), _afterpulsing,
        lambda w: w.with_spad(afterpulse_probability=0.0), _exactly,
    ),
    Effect(
        "crosstalk", "crosstalk", "detector",
        "`detector.crosstalk_probability` > 0, several pixels, and a mode other than `ideal`",
        "4p/(1 − 4p) avalanches in neighbours for each",
        0.9,
        lambda w: w.spad.crosstalk_probability > 0 and w.transient.shape[1] > 1 and not _counts_all(w), _crosstalk,
        lambda w: w.with_spad(crosstalk_probability=0.0), _exactly,
    ),
    Effect(
        "gate", "gate", "detector",
        "`detector.gate`",
        "The flux that it shuts out beside what it lets through",
        0.05, lambda w: w.spad.gate_start_s is not None, _gate,
        lambda w: w.with_spad(gate_start_s=None, gate_width_s=None, gate_rise_s=0.0),
    ),
    Effect(
        "tdc_saturation", "TDC saturation", "detector",
        "`detector.counter_max`",
        "E[max(n − c, 0)] of Poisson counts n (`detector/expected.py`)",
        0.02, lambda w: w.spad.counter_max is not None, _saturation,
        lambda w: w.with_spad(counter_max=None),
    ),
)  # fmt: skip
