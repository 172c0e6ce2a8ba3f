"""The detector's rows of the table: what becomes of photons, and by how much the expected histogram would change.

What is said is relative to the expected histogram h = λ · s, with s the share of cycles in which the detector is
armed. At least exp(−M) of them are, M the most flux within one dead time: only if nothing came for so long, for sure.
An effect reaches h in two ways:

- it adds, takes or moves events: those are compared with a lower bound on ‖h‖ (`FluxFigures.kept_norm`), which knows
  of dead time, of jitter that flattens peaks, and of counters that saturate;
- its events make the detector dead, or cease to. An event does so for a dead time, and what it shifts shifts the next
  until nothing comes for a dead time: for exp(M) dead times at most, on average. Relative to the armed share that is
  again exp(M) times more, hence exp(2M).

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
EVENTS_PER_ENTRY = 8.0
"""Events for each entry of a histogram from which the flux is worth a look only to draw cycles apart: an event takes
0.1 µs to draw, an entry's figures 0.1 to 0.6 µs to work out."""
_FEW_EVENTS = "few avalanches, drawn one by one"
_ONE_BY_ONE = "avalanches are drawn one by one in any case"


def _exp(value: float) -> float:
    return math.exp(min(value, _LARGEST_EXPONENT))


def _most(world: DetectorWorld) -> float:
    """M, with the events that avalanches cause."""
    return world.figures.most * (1.0 + _caused(world))


def _by_dead_time(world: DetectorWorld, events: float) -> float:
    """Relative change of the armed share by a number of `events` more or less within a dead time."""
    return events * _exp(2.0 * _most(world))


def _least_by_dead_time(world: DetectorWorld, events: float) -> float:
    """No more than `_by_dead_time`, nearly for nothing."""
    return events * _exp(2.0 * world.least_within)


def _by_norm(world: DetectorWorld, norm: float) -> float:
    """Relative change by events of this norm per cycle, and by those that they cause."""
    kept = world.figures.kept_norm * _exp(-world.figures.most * _caused(world))
    norm *= 1.0 + _caused(world)
    return norm / kept if kept > 0 else (math.inf if norm > 0 else 0.0)


def _bounded(value: float, reason: str, allowed: bool = True) -> Estimate:
    return Estimate(value if math.isfinite(value) else None, "bound", reason, allowed)


def _loss(world: DetectorWorld, value: float, reason: str) -> Estimate:
    """An effect that changes the law of the counts is also held to what the planner of samplers allows."""
    figures, allowed = world.figures, world.tolerance
    deviation = value * math.sqrt(figures.total * world.exposure.cycles)
    hidden = value <= allowed and deviation <= HIDDEN_DEVIATION
    if value > 0 and not hidden:
        reason += f", {deviation:.2g} standard deviations (allowed: {allowed:.2g} and {HIDDEN_DEVIATION:g})"
    return _bounded(value, reason, hidden or value == 0)


def _plainly_more(world: DetectorWorld, least: float, reason: str) -> Estimate | None:
    """Where an effect on the law of the counts is plainly too strong, `least` being no more than what it changes."""
    deviation = least * math.sqrt(world.least_total * world.exposure.cycles)
    if world.looked or (least <= min(world.tolerance, world.leave) and deviation <= HIDDEN_DEVIATION):
        return None
    allowed = f"(allowed: {world.tolerance:.2g} and {HIDDEN_DEVIATION:g})"
    return Estimate(least, "bound", f"{reason}, at least {deviation:.2g} standard deviations {allowed}", False)


def _not_worth_it(what: str) -> Estimate:
    return Estimate(None, "bound", f"{what}: that costs less than to work out how much it matters", False)


def _timing(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    cycle = world.cycle
    kept = 1.0
    for kernel in (cycle.before_avalanche, cycle.after_avalanche):
        kept *= float(kernel.weights[kernel.before])
    moved = 2.0 * (1.0 - kept)
    if moved < 1e-14:
        return _bounded(0.0, "far narrower than a bin")
    reason = f"it moves {1 - kept:.2g} of the photons into other bins"
    if moved >= 1.0:
        return Estimate(None, "bound", reason)
    # What is kept of the light is no more than the light.
    least = moved / (1.0 - moved) + _least_by_dead_time(world, moved * world.least_within)
    if not world.looked and least > world.leave:
        return Estimate(least, "bound", f"{reason}: more than may be left out")
    # Light that the gate would shut out may be moved into it.
    light = math.hypot(world.figures.norm, world.figures.shut_everywhere)
    value = _by_norm(world, moved / (1.0 - moved) * light)
    return _bounded(value + _by_dead_time(world, moved * _most(world)), reason)


def _background(world: DetectorWorld, norm: float, rate_hz: float, deviation: float, what: str) -> Estimate:
    """‖Δλ‖/‖h‖, and the dead time that background causes; in empty bins it must not be seen either."""
    dead = rate_hz * world.spad.dead_time_s if world.has_dead_time else 0.0
    value = _by_norm(world, norm) + _by_dead_time(world, min(dead, world.figures.most))
    hidden = deviation <= HIDDEN_DEVIATION
    reason = f"{what}: {deviation:.2g} standard deviations of a histogram (allowed {HIDDEN_DEVIATION:g})"
    return _bounded(value, reason, hidden)


def _ambient(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    if not world.looked:
        return _not_worth_it("one more addend")
    rate_hz = world.spad.pde * world.exposure.ambient_rate_hz
    return _background(world, world.figures.ambient_norm, rate_hz, world.figures.ambient_deviation, "ambient light")


def _dark(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    if not world.looked:
        return _not_worth_it("one more addend")
    spad = world.spad
    rate_hz = spad.dark_count_rate_hz * (spad.hot_pixel_factor if spad.hot_pixel_fraction > 0 else 1.0)
    return _background(world, world.figures.dark_norm, rate_hz, world.figures.dark_deviation, "dark counts")


def _pile_up(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    if not world.looked and not gone >= {"afterpulsing", "crosstalk"}:
        return _not_worth_it(_ONE_BY_ONE)
    least = world.least_within
    if more := _plainly_more(world, least, f"≥ {least:.2g} events within a dead time"):
        return more
    most = world.figures.most if world.spad.paralyzable else world.figures.within
    # Afterpulses come once the dead time is over, and crosstalk dies out in it: both then move, at most all of them.
    moved = ("afterpulsing" not in gone) * _afterpulses(world) + ("crosstalk" not in gone) * _shared(world)
    reason = f"≤ {most:.2g} events within a dead time"
    if moved > 0:
        reason += f", and ≤ {moved:.2g} afterpulses and crosstalk an avalanche move"
    value = math.expm1(min(most * (1.0 + _caused(world)), _LARGEST_EXPONENT)) + 2.0 * _by_events(world, moved)
    return _loss(world, value, reason)


def _by_events(world: DetectorWorld, more: float) -> float:
    """Relative change by `more` events for each avalanche (Young's inequality), the dead time they cause included."""
    return _by_norm(world, more * world.figures.norm) + _by_dead_time(world, more * min(_most(world), 1.0))


def _least_by_events(world: DetectorWorld, more: float) -> float:
    """No more than `_by_events`, nearly for nothing."""
    return more + _least_by_dead_time(world, more * min(world.least_within, 1.0))


def _across(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    if "pile_up" in gone and not _thins_evenly(world):
        return _bounded(0.0, "left out together with pile-up: it is the same dead time")
    if not world.looked and not gone >= {"afterpulsing", "crosstalk"}:
        return _not_worth_it(_ONE_BY_ONE)
    least = world.whole_periods * world.least_total
    if more := _plainly_more(world, least, f"≥ {least:.2g} events of earlier cycles within a dead time"):
        return more
    if not world.looked and world.most_events < EVENTS_PER_ENTRY * world.transient.size:
        return _not_worth_it(f"≤ {world.most_events:.2g} events")
    earlier = world.whole_periods * world.figures.total + world.figures.late
    value = earlier * _exp(_most(world))
    if "afterpulsing" not in gone:
        # What is armed again by the next pulse, before its dead time is over, has its afterpulses earlier.
        value += 2.0 * world.figures.late_share * _by_events(world, _afterpulses(world))
    return _loss(world, value, f"≤ {earlier:.2g} events of earlier cycles within a dead time")


def _thins_evenly(world: DetectorWorld) -> bool:
    """Whether a dead time of whole periods, which thins all bins alike, remains when pile-up is left out."""
    return world.spad.mode == "free_running" and not world.spad.paralyzable and world.whole_periods > 0


def _afterpulsing(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    more, reason = _afterpulses(world), f"≤ {_afterpulses(world):.2g} afterpulses an avalanche"
    if plain := _plainly_more(world, _least_by_events(world, more), reason):
        return plain
    if not world.looked and (
        world.spad.paralyzable or _plainly_more(world, _least_by_events(world, _shared(world)), "")
    ):
        return _not_worth_it(_ONE_BY_ONE)
    if _sooner_drawn(world):
        return _not_worth_it(_FEW_EVENTS)
    return _loss(world, _by_events(world, more), reason)


def _crosstalk(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    more, reason = _shared(world), f"≤ {_shared(world):.2g} avalanches in neighbours for each"
    if plain := _plainly_more(world, _least_by_events(world, more), reason):
        return plain
    if not world.looked and (world.spad.paralyzable or "afterpulsing" not in gone):
        return _not_worth_it(_ONE_BY_ONE)
    if _sooner_drawn(world):
        return _not_worth_it(_FEW_EVENTS)
    return _loss(world, _by_events(world, more), reason)


def _sooner_drawn(world: DetectorWorld) -> bool:
    """Whether avalanches are so few that they are drawn one by one sooner than a dead time alone is reckoned with,
    which would remain without their afterpulses and crosstalk."""
    many = world.most_events >= EVENTS_PER_ENTRY * world.transient.size
    if math.isinf(world.leave) or many or not world.has_dead_time:
        return False
    rest = _pile_up(world, frozenset({"afterpulsing", "crosstalk"}))
    return not (rest.allowed and rest.value is not None and rest.value <= world.leave)


def _caused(world: DetectorWorld) -> float:
    """Avalanches that one causes, at most."""
    return 0.0 if _counts_all(world) else _afterpulses(world) + _shared(world)


def _afterpulses(world: DetectorWorld) -> float:
    """Afterpulses that an avalanche causes at most, those of afterpulses included."""
    load = sum(world.spad.trap_loads) if world.spad.afterpulse_probability > 0 else 0.0
    return load / (1.0 - load)


def _shared(world: DetectorWorld) -> float:
    """Avalanches that one causes in other pixels at most, those of theirs included."""
    shared = min(4.0 * world.spad.crosstalk_probability, 0.99) if world.transient.shape[1] > 1 else 0.0
    return shared / (1.0 - shared)


def _gate(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    if not world.looked:
        return _not_worth_it("one more factor")
    figures = world.figures
    more = _exp(2.0 * figures.most_shut * (1.0 + _caused(world)))
    added = figures.shut_norm + _caused(world) * figures.shut_everywhere
    value = _by_norm(world, added) + _by_dead_time(world, figures.most_shut) * more
    if not _counts_all(world):
        # What is trapped when the gate shuts is released into other bins, at most all of it.
        value += _by_norm(world, _afterpulses(world) * figures.norm)
    hidden = figures.shut_deviation <= HIDDEN_DEVIATION
    return _bounded(
        value,
        f"without it {figures.shut_deviation:.2g} standard deviations of a histogram (allowed {HIDDEN_DEVIATION:g})",
        hidden,
    )


def _saturation(world: DetectorWorld, gone: frozenset[str]) -> Estimate:
    counter_max = world.spad.counter_max or 0
    if not world.looked:
        highest = world.most_in_bin * world.exposure.cycles * (1.0 + _caused(world))
        if highest + 8.0 * math.sqrt(highest) + 8.0 <= counter_max:
            return _bounded(0.0, f"at most {highest:.2g} counts are expected in a bin, {counter_max} fit")
        return _not_worth_it("one comparison a bin")
    # The most counts that dead time would leave, with all that avalanches may add; jitter only spreads them. What is
    # lost of a bin is less of a fainter one.
    highest = world.figures.brightest_bin * world.exposure.cycles * (1.0 + _caused(world))
    reason = f"at most {highest:.2g} counts are expected in a bin, {counter_max} fit"
    if highest + 8.0 * math.sqrt(highest) + 8.0 <= counter_max:
        return _bounded(0.0, reason)
    kept = float(saturated_mean(np.array([highest]), world.exposure.cycles, counter_max, False)[0])
    return _bounded(highest / kept - 1.0, reason)


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
