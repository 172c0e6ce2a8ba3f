"""Whether `Accuracy(target=…)` keeps its promise: `datagen bench target OUT`.

For random scenes and captures: the true relative L2 error, against a long run of another seed, of runs with targets
of 0.10, 0.05, 0.02 and 0.01; how often it is within the target; and what it cost beside hindsight.

*Truth*: a run of another seed with `TRUTH` of the smallest target, whose own expected squared error is subtracted.
*Hindsight*: the cheapest fixed sample counts that keep the same promise, an error within the target in 95 % of runs;
and, cheaper, those that meet it on average only (`hindsight.py`).
*Cost*: in connections with their shadow rays (`transport/cost.py`), the same units for both.

A scene is taken to the smaller targets for as long as its cost allows, so that the bench ends; how many scenes each
target had is part of the table.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from datagen.bench.hindsight import hindsight
from datagen.bench.target_cases import random_case, room_of
from datagen.errors import InputError
from datagen.exit_status import guarded
from datagen.records import Accuracy, Capture, Scene, Transient
from datagen.transport import simulate

TARGETS = (0.10, 0.05, 0.02, 0.01)
TRUTH, TRUTH_IF_DEAR = 0.5, 0.8
"""Error of the truth, in units of the smallest target that a scene was taken to; the second where a run cost more
than `COST_AT_MOST`. Its expected square is known and subtracted, so it need not be much smaller."""
FAIR = 4.0
"""Largest cost, in units of hindsight, that is promised."""
COST_AT_MOST = 2e6
"""Largest cost of a run, in connections, that the next smaller target may be expected to have."""


@dataclass(frozen=True)
class Outcome:
    """One scene and target. error : true relative L2 error; bound : what was claimed; promised, on_average : the
    cost of hindsight with the same promise, and without."""

    case: int
    capture: str
    bounces: int | None
    bins: int
    target: float
    error: float
    truth_error: float
    bound: float
    met: bool
    rounds: int
    cost: float
    promised: float
    on_average: float
    seconds: float

    @property
    def within(self) -> bool:
        return self.error <= self.target


def outcomes(
    cases: Sequence[int], targets: Sequence[float] = TARGETS, cost: float = COST_AT_MOST
) -> Iterator[Outcome]:
    """Run every case, one after the other. Cases whose configuration cannot be furnished are left out."""
    for case in cases:
        config = random_case(case)
        try:
            scene, capture = room_of(config)
        except InputError:
            continue
        base = Accuracy(max_bounces=config.transport.max_bounces, direct=config.transport.direct)
        yield from outcomes_of(case, scene, capture, base, targets, cost)


def outcomes_of(
    case: int, scene: Scene, capture: Capture, base: Accuracy, targets: Sequence[float], cost: float
) -> list[Outcome]:
    """The targets in falling order, for as long as the next would not cost more than `cost`."""
    runs: list[tuple[float, Transient, float]] = []
    for target in sorted(targets, reverse=True):
        if runs:
            last, before, _ = runs[-1]
            assert before.spend is not None
            if before.spend.cost * (last / target) ** 2 > cost:
                break
        began = time.process_time()
        run = _run(scene, capture, replace(base, target=target), 1000 * case + len(runs))
        runs.append((target, run, time.process_time() - began))
    smallest, dearest, _ = runs[-1]
    assert dearest.spend is not None
    truth_target = (TRUTH if dearest.spend.cost <= cost else TRUTH_IF_DEAR) * smallest
    truth = _run(scene, capture, replace(base, target=max(truth_target, 1e-4)), 1000 * case + 999)
    norm = float(np.linalg.norm(truth.total))
    noise = float(np.linalg.norm(truth.stderr)) / norm if norm > 0 else 0.0
    known = hindsight(scene, capture, base, [target for target, _, _ in runs], 1000 * case + 500, norm)
    found = []
    for (target, run, seconds), fixed in zip(runs, known, strict=True):
        assert run.spend is not None and run.error_bound is not None and run.met_target is not None
        found.append(
            Outcome(
                case, f"{capture.pairing} {capture.shape[0]}x{capture.shape[1]}", base.max_bounces, capture.time.bins,
                target, _error(run.total, truth.total, norm, noise), noise, run.error_bound, run.met_target,
                run.spend.rounds, run.spend.cost, fixed.promised, fixed.on_average, seconds,
            )
        )  # fmt: skip
    return found


def _run(scene: Scene, capture: Capture, accuracy: Accuracy, seed: int) -> Transient:
    return simulate(scene, capture, accuracy, seed, split_parts=False)


def _error(run: NDArray[np.float64], truth: NDArray[np.float64], norm: float, noise: float) -> float:
    """‖run − truth‖ / ‖truth‖ without the truth's own expected part."""
    if norm == 0:
        return 0.0 if not run.any() else math.inf
    return math.sqrt(max((float(np.linalg.norm(run - truth)) / norm) ** 2 - noise**2, 0.0))


def table(found: Sequence[Outcome]) -> str:
    """Markdown, a line for each target; in brackets hindsight that is within the target on average only."""
    lines = [
        "| target | scenes | within | exact 95 % interval | true / target: median | 95th | worst "
        "| cost / hindsight: median | 95th | over 4 | CPU s: median |",
        "|---:|---:|---:|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for target in sorted({one.target for one in found}, reverse=True):
        some = [one for one in found if one.target == target]
        good = sum(one.within for one in some)
        interval = stats.binomtest(good, len(some)).proportion_ci(0.95, "exact")
        share = np.array([one.error for one in some]) / target
        ratio = np.array([one.cost / one.promised for one in some if one.promised > 0])
        lenient = np.array([one.cost / one.on_average for one in some if one.on_average > 0])
        lines.append(
            f"| {target:g} | {len(some)} | {good / len(some):.1%} | {interval.low:.1%} … {interval.high:.1%} "
            f"| {np.median(share):.2f} | {np.quantile(share, 0.95):.2f} | {share.max():.2f} "
            f"| {np.median(ratio):.2f} ({np.median(lenient):.2f}) "
            f"| {np.quantile(ratio, 0.95):.2f} ({np.quantile(lenient, 0.95):.2f}) "
            f"| {(ratio > FAIR).mean():.1%} ({(lenient > FAIR).mean():.1%}) "
            f"| {np.median([one.seconds for one in some]):.2f} |"
        )
    return "\n".join(lines)


@click.command()
@click.argument("out")
@click.option("--scenes", type=int, default=200, show_default=True, help="How many random scenes.")
@click.option("--first", type=int, default=0, show_default=True, help="Number of the first.")
@click.option("--cost", type=float, default=COST_AT_MOST, show_default=True, help="Largest cost of a run.")
def main(out: str, scenes: int, first: int, cost: float) -> None:
    """Hold accuracy targets against the true error on random scenes; table and JSON in the folder OUT.

    Running it again goes on with the scenes that OUT does not have yet.
    """
    if scenes < 1:
        raise InputError(f"--scenes {scenes}: must be ≥ 1")
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / "target.json"
    found = [Outcome(**one) for one in json.loads(kept.read_text())] if kept.exists() else []
    done = {one.case for one in found}
    for case in range(first, first + scenes):
        if case not in done:
            found += outcomes([case], cost=cost)
            kept.write_text(json.dumps([asdict(one) for one in found], indent=1))
    text = table(found)
    (folder / "target.md").write_text(text + "\n")
    click.echo(text)
    missed = [one for one in found if not one.within]
    for one in missed:
        click.echo(
            f"beyond its target: case {one.case} ({one.capture}, {one.bins} bins, bounces {one.bounces}) "
            f"target {one.target:g}, true {one.error:.4f}, claimed {one.bound:.4f}"
        )


if __name__ == "__main__":
    raise SystemExit(guarded(main))
