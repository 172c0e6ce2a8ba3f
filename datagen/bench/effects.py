"""The switchboard's promise: `datagen bench effects OUT`.

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

import json
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

import click
import numpy as np
from numpy.typing import NDArray

from datagen.bench.effects_cases import LOOKINS, nearly_everything_skipped, nearly_nothing_skipped, random_case
from datagen.capture import capture_for
from datagen.config import DatasetConfig, EffectsConfig
from datagen.detector import Exposure, Spad, detect, detector_for, expected_histogram
from datagen.effects import EFFECTS, EffectDecisions, decide_detector_effects, decide_transport_effects
from datagen.errors import CheckError, InputError
from datagen.exit_status import guarded
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

    def plan_of(settings: EffectsConfig) -> EffectDecisions:
        return decide_transport_effects(scene, capture, accuracy, settings, seed=config.seed)

    def lit(plan: EffectDecisions, seed: int) -> Transient:
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
    plan += decide_detector_effects(
        full.total, capture.time, spad, exposure, config.effects, config.detector.tolerance
    )
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
    plan: EffectDecisions,
    seconds: dict[str, float],
) -> tuple[float, str]:
    """Relative difference of the expected histograms, and why counts could not be drawn with everything on."""
    tolerance = config.detector.tolerance
    used = plan.apply_detector(spad, exposure, tolerance)

    def counted(detector: tuple[Spad, Exposure, float]) -> NDArray[np.integer]:
        return detect(full.total, axis, *detector[:2], tolerance=detector[2], approximate=True)

    def planned() -> NDArray[np.integer]:
        settings = (config.effects, tolerance)
        again = decide_detector_effects(full.total, axis, spad, exposure, *settings)
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


def effects_table(outcomes: Sequence[Outcome]) -> str:
    """Markdown: how often each effect was there, and how often it was left out."""
    lines = ["| effect | there | left out | |", "|---|---:|---:|---:|"]
    for row in EFFECTS:
        states = [outcome.states[row.name] for outcome in outcomes]
        there, gone = len(states) - states.count("absent"), states.count("off")
        lines.append(f"| {row.title} | {there} | {gone} | {f'{gone / there:.0%}' if there else ''} |")
    return "\n".join(lines)


def savings_table(outcomes: Sequence[Outcome], tolerance: float) -> str:
    """Markdown: what was saved, and what it cost in error, by stage."""
    lines = [
        "| stage | seconds, planned / everything on: median | range | largest difference | tolerance |",
        "|---|---:|---:|---:|---:|",
    ]
    stages = (
        ("transport", [o.transport_ratio for o in outcomes], max(o.transient_error for o in outcomes)),
        (
            "detector",
            [o.detector_ratio for o in outcomes if o.detector_ratio is not None],
            max(o.histogram_error for o in outcomes),
        ),
    )
    for stage, ratios, error in stages:
        spread = f"{min(ratios):.2f} … {max(ratios):.2f}"
        lines.append(f"| {stage} | {statistics.median(ratios):.2f} | {spread} | {error:.2g} | {tolerance:g} |")
    return "\n".join(lines)


def named_table(outcomes: Sequence[Outcome]) -> str:
    """Markdown: single scenes, the ends of the range."""
    lines = ["| scene | left out | simulated | transport | detector |", "|---|---:|---:|---:|---:|"]
    for outcome in outcomes:
        states = list(outcome.states.values())
        ratio = "refused" if outcome.detector_ratio is None else f"{outcome.detector_ratio:.2f}"
        lines.append(
            f"| {outcome.name} | {states.count('off')} | {states.count('on')} | {outcome.transport_ratio:.2f} | "
            f"{ratio} |"
        )
    return "\n".join(lines)


@click.command()
@click.argument("out", type=click.Path(file_okay=False, path_type=Path))
@click.option("--scenes", default=100, show_default=True, type=click.IntRange(1), help="Random scenes.")
@click.option("--seed", default=0, show_default=True, help="Of the scenes drawn.")
@click.option("--lookins", default=LOOKINS, show_default=True, type=click.IntRange(1), help="Of each laser point.")
def main(out: Path, scenes: int, seed: int, lookins: int) -> None:
    """Compare what is planned with everything on; tables to the screen and OUT/effects.md, cases to OUT/effects.json.

    Exits with status 1 if any scene differs by more than the tolerance.
    """
    ends = [nearly_everything_skipped(lookins), nearly_nothing_skipped(lookins)]
    named = [run_case(config) for config in ends]
    outcomes = [run_case(random_case(index, seed, lookins)) for index in range(scenes)]
    tolerance = ends[0].effects.tolerance
    refused = sum(1 for outcome in outcomes if outcome.refused)
    text = (
        f"{scenes} random scenes, seed {seed}, {lookins} lookins; {processor()}, {cores()} cores, processor seconds"
        "\n\n"
        f"{savings_table(outcomes, tolerance)}\n\n{named_table(named)}\n\n{effects_table(outcomes)}\n"
    )
    if refused:
        text += f"\nIn {refused} scenes counts with everything on could not be drawn (too many events).\n"
    out.mkdir(parents=True, exist_ok=True)
    (out / "effects.md").write_text(text)
    (out / "effects.json").write_text(json.dumps([asdict(o) for o in named + outcomes], indent=1))
    click.echo(text)
    broken = [problem for outcome in named + outcomes for problem in outcome.broken(tolerance)]
    if broken:
        raise CheckError(f"{len(broken)} promises not kept: {'; '.join(broken[:5])}")


if __name__ == "__main__":
    raise SystemExit(guarded(main))
