"""Whether `Accuracy(target=…)` keeps its promise, and at what cost, on random scenes and captures.

*Error*: relative L2 of a run with a target, against a long run of another seed (the truth) with `TRUTH` of the
smallest target, whose own expected squared error is subtracted.
*Cost*: in connections with their shadow rays (`transport/cost.py`), beside that of the cheapest fixed counts
`Accuracy(lookins=N, fov_samples=M)` whose error is the target on average (root mean square), which half of their runs
miss: what somebody would pay who knew N and M beforehand.

A scene is taken to the smaller targets for as long as its cost allows, so that the bench ends; how many scenes each
target had is part of the table.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from datagen.bench.measuring import machine, markdown, processor_seconds
from datagen.bench.target_cases import random_case
from datagen.capture import capture_for
from datagen.design.scene_for import scene_for
from datagen.errors import InputError
from datagen.records import Accuracy, Capture, Scene, Transient
from datagen.records.arrays import l2_norm
from datagen.transport import simulate

TARGETS = (0.10, 0.05, 0.02, 0.01)
TRUTH, TRUTH_IF_DEAR = 0.5, 0.8
"""Error of the truth, in units of the smallest target that a scene was taken to; the second where a run cost more
than `COST_AT_MOST`. Its expected square is known and subtracted, so it need not be much smaller."""
FAIR = 4.0
"""Largest cost, in units of the fixed counts', that should occur."""
COST_AT_MOST = 2e6
"""Largest cost of a run, in connections, that the next smaller target may be expected to have."""
REPLICATES, USUAL_REPLICATES = 16, 8
"""Of the runs with fixed counts by which their error is measured; and the default, for which it is stated."""
FOV_SAMPLES = (1, 4, 16, 64)
CONNECTIONS_AT_MOST = 256
"""Connections of a vertex beyond which more FoV points are not tried."""


@dataclass(frozen=True)
class Outcome:
    """One scene and target.

    Attributes
    ----------
    error : true relative L2 error. truth_error : the truth's own. bound : the error that was claimed.
    cost, fixed_cost : of the run, and of the cheapest fixed counts, in connections; NaN where there is no light.
    seconds : processor seconds of the run.
    """

    case: int
    capture: str
    bounces: int | None
    bins: int
    target: float
    error: float
    truth_error: float
    bound: float
    met: bool
    cost: float
    fixed_cost: float
    seconds: float

    @property
    def within(self) -> bool:
        """Whether the true error is at most the target."""
        return self.error <= self.target


def outcomes(
    cases: Sequence[int], targets: Sequence[float] = TARGETS, cost: float = COST_AT_MOST
) -> Iterator[Outcome]:
    """Run every case, one after the other. Cases whose configuration cannot be furnished are left out."""
    for case in cases:
        config = random_case(case)
        try:
            scene = scene_for(config, 0)
            capture = capture_for(config, scene, config.seed, 0)
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
        asked, seed = replace(base, target=target), 1000 * case + len(runs)
        runs.append((target, *processor_seconds(partial(_run, scene, capture, asked, seed))))
    smallest, dearest, _ = runs[-1]
    assert dearest.spend is not None
    truth_target = (TRUTH if dearest.spend.cost <= cost else TRUTH_IF_DEAR) * smallest
    truth = _run(scene, capture, replace(base, target=max(truth_target, 1e-4)), 1000 * case + 999)
    norm = l2_norm(truth.total)
    noise = l2_norm(truth.stderr) / norm if norm > 0 else 0.0
    fixed = fixed_counts_costs(scene, capture, base, [target for target, _, _ in runs], norm, 1000 * case + 500)
    found = []
    for (target, run, seconds), fixed_cost in zip(runs, fixed, strict=True):
        assert run.spend is not None and run.error_bound is not None and run.met_target is not None
        what = case, "{} {}x{}".format(capture.pairing, *capture.shape), base.max_bounces, capture.time.bins, target
        claimed = noise, run.error_bound, run.met_target
        error = _error(run.total, truth.total, norm, noise)
        found.append(Outcome(*what, error, *claimed, run.spend.cost, fixed_cost, seconds))
    return found


def fixed_counts_costs(
    scene: Scene, capture: Capture, base: Accuracy, targets: Sequence[float], norm: float, seed: int
) -> list[float]:
    """For each target the cost of the cheapest fixed counts with that root mean square error; norm : ‖truth‖.

    For each number of FoV points lookins are quadrupled until the smallest target is met, or others met it for less;
    between two of them cost is read off the straight line of the logarithms.
    """
    cheapest = np.full(len(targets), np.inf)
    for samples in FOV_SAMPLES if norm > 0 else ():
        if samples > 1 and samples * capture.shape[1] > CONNECTIONS_AT_MOST:
            break
        lookins, errors, costs = REPLICATES * 4, list[float](), list[float]()
        while not errors or (errors[-1] > min(targets) and costs[-1] < cheapest[-1]):
            counts = replace(base, lookins=lookins, fov_samples=samples, replicates=REPLICATES)
            run = _run(scene, capture, counts, seed)
            assert run.spend is not None
            errors.append(math.sqrt(REPLICATES / USUAL_REPLICATES) * l2_norm(run.stderr) / norm)
            costs.append(run.spend.cost * USUAL_REPLICATES / REPLICATES)
            lookins *= 4
        if all(errors):
            found = np.interp(np.log(targets), np.log(errors[::-1]), np.log(costs[::-1]), left=np.inf)
            cheapest = np.minimum(cheapest, np.exp(found))
    return [float(cost) if np.isfinite(cost) else math.nan for cost in cheapest]


def _run(scene: Scene, capture: Capture, accuracy: Accuracy, seed: int) -> Transient:
    return simulate(scene, capture, accuracy, seed, split_parts=False)


def _error(run: NDArray[np.float64], truth: NDArray[np.float64], norm: float, noise: float) -> float:
    """‖run − truth‖ / ‖truth‖ without the truth's own expected part."""
    if norm == 0:
        return 0.0 if not run.any() else math.inf
    return math.sqrt(max((l2_norm(run - truth) / norm) ** 2 - noise**2, 0.0))


def table(found: Sequence[Outcome]) -> str:
    """Markdown, a line for each target."""
    head = ["target", "scenes", "within", "exact 95 % interval", "true / target: median", "95th", "worst",
            "cost / fixed counts: median", "95th", f"over {FAIR:g}", "CPU s: median"]  # fmt: skip
    rows = []
    for target in sorted({one.target for one in found}, reverse=True):
        some = [one for one in found if one.target == target]
        good = sum(one.within for one in some)
        interval = stats.binomtest(good, len(some)).proportion_ci(0.95, "exact")
        share = np.array([one.error for one in some]) / target
        ratio = np.array([one.cost / one.fixed_cost for one in some if one.fixed_cost > 0] or [math.nan])
        within = f"{good / len(some):.1%}", f"{interval.low:.1%} … {interval.high:.1%}"
        errors = [f"{x:.2f}" for x in (np.median(share), np.quantile(share, 0.95), share.max())]
        costs = f"{np.median(ratio):.2f}", f"{np.quantile(ratio, 0.95):.2f}", f"{(ratio > FAIR).mean():.1%}"
        seconds = f"{np.median([one.seconds for one in some]):.2f}"
        rows.append([f"{target:g}", str(len(some)), *within, *errors, *costs, seconds])
    return markdown(head, rows, words=0)


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
    if not found:
        raise InputError(f"--first {first} --scenes {scenes}: none of these scenes can be made; try others")
    text = f"{len(done | {one.case for one in found})} scenes; {machine()}\n\n{table(found)}\n"
    (folder / "target.md").write_text(text, encoding="utf-8")
    click.echo(text)
    for one in (one for one in found if not one.within):
        click.echo(
            f"beyond its target: case {one.case} ({one.capture}, {one.bins} bins, bounces {one.bounces}) "
            f"target {one.target:g}, true {one.error:.4f}, claimed {one.bound:.4f}"
        )
