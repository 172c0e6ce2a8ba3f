"""The switchboard's promise: `python tests/effects/everything_on.py [SCENES]`.

Random scenes are simulated twice, as planned and with every effect on. The planned transient and the planned expected
histogram must differ from the full ones by no more than the tolerance (relative L2), and cost less.

Transients are compared by two independent pairs of runs, a and b, of P planned and of F everything on:

    error² = (P_a − F_a)·(P_b − F_b) / (F_a · F_b),

in which the noise of the runs cancels on average; the standard error is found by leaving out channels one at a time.
That is asked of the whole transient, and again of its light of three bounces and more, which the direct return would
dwarf; the larger one counts.
Histograms are compared by their exact means (where there is one), of the same transient.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from random_scenes import nearly_everything_skipped, nearly_nothing_skipped, random_case

from datagen.capture import capture_for
from datagen.config import DatasetConfig, EffectsConfig
from datagen.detector import Exposure, Spad, detect, detector_for, expected_histogram
from datagen.effects import EFFECTS, EffectPlan, plan_detector_effects, plan_transport_effects
from datagen.errors import InputError
from datagen.records import TimeAxis, Transient
from datagen.scene import generate_scene
from datagen.store.environment import cores, processor
from datagen.transport import simulate

T = TypeVar("T")

MOST_TIMES = 5
"""Times that a stage is run, at most, to find its processor seconds."""
SECONDS_KNOWN_WELL = 0.5
"""Stages that take as long are run twice only."""

EVERYTHING = EffectsConfig.model_validate({"tolerance": 0.0} | {row.name: "on" for row in EFFECTS})
"""Every effect switched on."""


@dataclass(frozen=True)
class Outcome:
    """What became of one case.

    Attributes
    ----------
    states : effect → `on`, `off` (left out) or `absent`. change : stage → what the plan promised at most.
    transient_error, transient_least : relative L2 difference of the planned transient, and the same less two standard
        errors.
    histogram_error : of the planned expected histogram.
    seconds : processor seconds of planning and transport, planning and detection, and of both with everything on.
    refused : why the detector with everything on could not be run; empty where it could.
    """

    name: str
    states: dict[str, str]
    change: dict[str, float]
    transient_error: float
    transient_least: float
    histogram_error: float
    seconds: dict[str, float]
    refused: str = ""

    @property
    def transport_ratio(self) -> float:
        return self.seconds["transport planned"] / self.seconds["transport full"]

    @property
    def detector_ratio(self) -> float | None:
        return None if self.refused else self.seconds["detector planned"] / self.seconds["detector full"]

    def broken(self, tolerance: float) -> list[str]:
        """Promises not kept: differences beyond the tolerance, and beyond what noise could be."""
        found = []
        if self.transient_least > tolerance:
            found.append(f"{self.name}: the transient differs by {self.transient_error:.3g}")
        if self.histogram_error > tolerance:
            found.append(f"{self.name}: the expected histogram differs by {self.histogram_error:.3g}")
        return found


def run_case(config: DatasetConfig) -> Outcome:
    """Simulate one scene as planned and with everything on, and compare."""
    scene = generate_scene(config.scene, config.seed, 0)
    capture = capture_for(config, scene, config.seed, 0)
    accuracy = config.transport.accuracy()
    seconds: dict[str, float] = {}

    def plan_of(settings: EffectsConfig) -> EffectPlan:
        return plan_transport_effects(scene, capture, accuracy, settings, seed=config.seed)

    def lit(plan: EffectPlan, seed: int) -> Transient:
        reduced_scene, reduced = plan.apply_transport(scene, capture, accuracy)
        return simulate(reduced_scene, capture, reduced, seed=seed, split_parts=False)

    plan, full_plan = plan_of(config.effects), plan_of(EVERYTHING)
    (full, planned), (seconds["transport full"], seconds["transport planned"]) = _in_turn(
        lambda: lit(full_plan, 1), lambda: lit(plan_of(config.effects), 1)
    )
    error = least = 0.0
    if any(decision.left_out for decision in plan.decisions):
        pairs = (planned, lit(plan, 2)), (full, lit(full_plan, 2))
        error, least = (
            max(pair) for pair in zip(*(difference(*pairs, part) for part in (whole, indirect)), strict=True)
        )
    spad, exposure = detector_for(config.detector, config.seed, 0, capture.time)
    plan += plan_detector_effects(full.total, capture.time, spad, exposure, config.effects, config.detector.tolerance)
    histogram_error, refused = _detected(config, full, capture.time, spad, exposure, plan, seconds)
    states = {d.effect: "on" if d.simulated else "off" if d.left_out else "absent" for d in plan.decisions}
    change = {"transport": plan.change("transport"), "detector": plan.change("detector")}
    return Outcome(config.name, states, change, error, least, histogram_error, seconds, refused)


def _detected(
    config: DatasetConfig,
    full: Transient,
    axis: TimeAxis,
    spad: Spad,
    exposure: Exposure,
    plan: EffectPlan,
    seconds: dict[str, float],
) -> tuple[float, str]:
    """Relative difference of the expected histograms, and why counts could not be drawn with everything on."""
    tolerance = config.detector.tolerance
    used = plan.apply_detector(spad, exposure, tolerance)

    def counted(detector: tuple[Spad, Exposure, float]) -> NDArray[np.integer]:
        return detect(full.total, axis, *detector[:2], tolerance=detector[2], approximate=True)

    def planned() -> NDArray[np.integer]:
        settings = (config.effects, tolerance)
        again = plan_detector_effects(full.total, axis, spad, exposure, *settings)
        return counted(again.apply_detector(spad, exposure, tolerance))

    refused = ""
    try:
        _, (seconds["detector full"], seconds["detector planned"]) = _in_turn(
            lambda: counted((spad, exposure, 0.0)), planned
        )
    except InputError as error:
        refused = str(error)
    mean, reference = (
        expected_histogram(full.total, axis, *pair, approximate=True) for pair in (used[:2], (spad, exposure))
    )
    norm = float(np.linalg.norm(reference))
    return (float(np.linalg.norm(mean - reference)) / norm if norm > 0 else float(np.linalg.norm(mean))), refused


def whole(transient: Transient) -> NDArray[np.float64]:
    """(channel, bin) all light."""
    return transient.total.reshape(-1, transient.time.bins)


def indirect(transient: Transient) -> NDArray[np.float64]:
    """(channel, bin) light of three bounces and more."""
    return (transient.total - transient.components.get("direct", 0.0)).reshape(-1, transient.time.bins)


def difference(
    planned: tuple[Transient, Transient],
    full: tuple[Transient, Transient],
    part: Callable[[Transient], NDArray[np.float64]],
) -> tuple[float, float]:
    """Relative L2 difference of two pairs of independent transients, and the same less two standard errors."""
    reference = [part(f) for f in full]
    apart = [part(p) - f for p, f in zip(planned, reference, strict=True)]
    above, below = (apart[0] * apart[1]).sum(axis=1), (reference[0] * reference[1]).sum(axis=1)
    if not any(a.any() for a in apart):
        return 0.0, 0.0
    if below.sum() <= 0:
        return np.inf, np.inf
    square = float(above.sum() / below.sum())
    n = len(above)
    without = (above.sum() - above) / np.maximum(below.sum() - below, 1e-300)
    spread = float(np.sqrt((n - 1) / n * np.square(without - without.mean()).sum()))
    return float(np.sqrt(max(square, 0.0))), float(np.sqrt(max(square - 2 * spread, 0.0)))


def _in_turn(*calls: Callable[[], T]) -> tuple[list[T], list[float]]:
    """What some calls return, and the least processor seconds that each took of several times, one after the other in
    turn: on a machine that others use, and where a first call may compile, single short ones tell little."""
    results: list[T] = []
    least = [np.inf] * len(calls)
    for done in range(MOST_TIMES):
        began = time.process_time()
        results = []
        for k, call in enumerate(calls):
            before = time.process_time()
            results.append(call())
            least[k] = min(least[k], time.process_time() - before)
        if done >= 1 and time.process_time() - began > SECONDS_KNOWN_WELL:
            break
    return results, least


def main(scenes: int) -> int:
    """Print what was saved and what it cost in error, by stage; 1 if a scene differs by more than the tolerance."""
    ends = [nearly_everything_skipped(), nearly_nothing_skipped()]
    outcomes = [run_case(config) for config in (*ends, *(random_case(index) for index in range(scenes)))]
    print(f"{len(outcomes)} scenes; {processor()}, {cores()} cores, processor seconds\n")
    for stage, error in (("transport", "transient_error"), ("detector", "histogram_error")):
        ratios = [ratio for o in outcomes if (ratio := getattr(o, f"{stage}_ratio")) is not None]
        worst = max(getattr(outcome, error) for outcome in outcomes)
        print(
            f"{stage}: seconds, decided over everything on, {statistics.median(ratios):.2f} in the median "
            f"({min(ratios):.2f} … {max(ratios):.2f}); largest difference {worst:.2g}"
        )
    for row in EFFECTS:
        states = [outcome.states[row.name] for outcome in outcomes]
        print(f"{row.title}: left out {states.count('off')} of {len(states) - states.count('absent')} times")
    broken = [problem for outcome in outcomes for problem in outcome.broken(ends[0].effects.tolerance)]
    print(*broken, sep="\n")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 100))
