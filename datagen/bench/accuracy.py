"""What accuracy costs in time: the true relative L2 error of one scene's transient against processor seconds.

One quantity is swept at a time about a base setting: lookins, FoV points, bounce orders, target, observed points, k
strongest secondary paths. The truth is a long run with other seeds, in two halves, whose difference is its own error;
that is subtracted. It holds all paths of as many bounces as the configuration asks for (four at least, so that there
is a secondary); for the sweep of bounce orders it holds all orders, so that what leaving out costs is seen as a bias.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from datagen.bench.accuracy_report import advice, picture, table
from datagen.bench.accuracy_settings import Row, Setting, fewer_laser_points, sweeps
from datagen.bench.measuring import machine, percent, processor_seconds
from datagen.capture import capture_for
from datagen.config import DatasetConfig, load_config
from datagen.design.scene_for import scene_for
from datagen.errors import InputError
from datagen.records import Accuracy, Capture, Scene
from datagen.store.files import check_writable
from datagen.transport import simulate

RUNS_IN_BUDGET = 250
"""So many runs of the base setting should fit into the budget; its lookins are halved until they do."""
REFERENCE_SEED = 1 << 40
SHARE_OF_REFERENCE = 0.25
"""Of the budget, for each of the two truths."""
FEWEST_LOOKINS = 64
SLOWEST_SHARE = 0.04
"""A setting of which one run takes more than this share of the budget ends its sweep."""


@dataclass(frozen=True)
class Problem:
    """A scene and how it is looked at."""

    scene: Scene
    capture: Capture

    def run(self, accuracy: Accuracy, seed: int) -> tuple[NDArray[np.float64], float]:
        """(laser, pixel, bin) transient, and processor seconds."""
        return processor_seconds(lambda: simulate(self.scene, self.capture, accuracy, seed, split_parts=False).total)


@dataclass(frozen=True)
class Truth:
    """The converged transient.

    value : mean of two halves. square_error : of it, ‖half₁ − half₂‖²/4. square : ‖truth‖², freed of that.
    """

    value: NDArray[np.float64]
    square_error: float
    square: float
    lookins: int = 0

    @classmethod
    def of(cls, one: NDArray[np.float64], two: NDArray[np.float64], lookins: int = 0) -> Truth:
        """The truth from two independent halves of the same shape."""
        mean, error = (one + two) / 2, float(np.sum((one - two) ** 2)) / 4
        return cls(mean, error, max(float(np.sum(mean**2)) - error, 0.0), lookins)

    @property
    def relative_error(self) -> float:
        """The truth's own relative L2 error; 0 without light."""
        return math.sqrt(self.square_error / self.square) if self.square > 0 else 0.0

    def error_of(self, transient: NDArray[np.float64]) -> float:
        """Relative L2 error of a transient, the truth's own error subtracted."""
        apart = float(np.sum((transient - self.value) ** 2)) - self.square_error
        return math.sqrt(max(apart, 0.0) / self.square)


@dataclass(frozen=True)
class Outcome:
    """title : of the report. base : what the sweeps start from. truths : of the base's bounce orders, and of all.
    left_out : settings not run, and why."""

    title: str
    base: Accuracy
    truths: tuple[Truth, Truth]
    rows: list[Row]
    left_out: list[str]


def run(
    config: DatasetConfig, scene: int = 0, laser_points: int | None = None, seconds: float = 240.0, repeats: int = 3
) -> Outcome:
    """Measure every sweep for one scene, within about `seconds` processor seconds.

    Raises
    ------
    InputError : the scene cannot be made, or sends no light into the window.
    """
    room = scene_for(config, scene)
    whole = capture_for(config, room, config.seed, scene)
    problem = Problem(room, fewer_laser_points(whole, laser_points))
    configured = config.transport.accuracy()
    orders = None if configured.max_bounces is None else max(configured.max_bounces, 4)
    lookins = 1 << round(math.log2(max(configured.lookins, FEWEST_LOOKINS)))
    wanted = Accuracy(lookins, configured.fov_samples, orders, replicates=4, direct=configured.direct)
    base = _base_lookins(wanted, problem, seconds / RUNS_IN_BUDGET)
    own = converge(problem, base, SHARE_OF_REFERENCE * seconds)
    every = replace(base, max_bounces=None)
    truths = own, own if orders is None else converge(problem, every, SHARE_OF_REFERENCE * seconds)
    rows, left_out, spent = list[Row](), list[str](), 0.0
    for sweep in sweeps(base):
        # Once, so that no compilation is timed; that it cannot be run is found again below.
        with suppress(InputError):
            problem.run(sweep[0].accuracy, 0)
        for k, setting in enumerate(sweep):
            if spent > seconds:
                left_out.append(f"{setting.quantity} {setting.value}: the budget was spent")
                continue
            try:
                row = measure(setting, problem, truths[setting.complete], repeats, SLOWEST_SHARE * seconds)
            except InputError as error:
                left_out.append(f"{setting.quantity} {setting.value}: {error}")
                continue
            rows.append(row)
            spent += row.seconds * row.runs
            if row.seconds > SLOWEST_SHARE * seconds:
                left_out += [f"{later.quantity} {later.value}: too slow" for later in sweep[k + 1 :]]
                break
    used, there = len(problem.capture.laser.targets), len(whole.laser.targets)
    points = f"{used} of its {there} laser points" if used < there else f"laser points: {there}"
    return Outcome(f"{config.name}, scene {scene}, {points}", base, truths, with_front(rows), left_out)


def _base_lookins(base: Accuracy, problem: Problem, seconds: float) -> Accuracy:
    """The base setting with as many lookins, up to its own, as take at most `seconds` processor seconds."""
    tried = replace(base, lookins=FEWEST_LOOKINS)
    problem.run(tried, 2)
    while 2 * tried.lookins <= base.lookins and problem.run(tried, 2)[1] < seconds / 2:
        tried = replace(tried, lookins=2 * tried.lookins)
    return tried


def converge(problem: Problem, accuracy: Accuracy, budget_s: float) -> Truth:
    """A long run in two halves, its lookins doubled until a further run would not fit into the budget.

    Raises
    ------
    InputError : no light arrives within the window, so that there is nothing to be wrong about.
    """
    count, spent = accuracy.lookins, 0.0
    while True:
        long = replace(accuracy, lookins=count, replicates=1)
        (one, first_s), (two, second_s) = (problem.run(long, REFERENCE_SEED + half) for half in range(2))
        if not (one.any() and two.any()):
            raise InputError(
                "the scene sends no light into the window, so there is no error to measure; try another --scene"
            )
        taken = max(first_s + second_s, 1e-6)
        spent += taken
        if budget_s - spent < 2 * taken:
            return Truth.of(one, two, 2 * count)
        count <<= int(math.log2((budget_s - spent) / taken))


def measure(setting: Setting, problem: Problem, truth: Truth, repeats: int, slowest_s: float) -> Row:
    """Run a setting `repeats` times with different seeds; twice only if a run takes longer than `slowest_s`."""
    runs = list[tuple[NDArray[np.float64], float]]()
    while len(runs) < repeats and (len(runs) < 2 or runs[0][1] <= slowest_s):
        runs.append(problem.run(setting.accuracy, 1 + len(runs)))
    found = np.array([transient for transient, _ in runs])
    noise, bias = noise_and_bias(found, truth)
    seconds = statistics.median(taken for _, taken in runs)
    error = statistics.median(truth.error_of(transient) for transient in found)
    what = setting.quantity, setting.value, setting.configured
    return Row(*what, len(runs), seconds, error, noise, bias, setting.complete)


def noise_and_bias(runs: NDArray[np.float64], truth: Truth) -> tuple[float, float]:
    """Random part of the error of (run, …) transients, relative to their mean; and systematic part, relative to the
    truth, 0 where it is not above what the noise leaves uncertain."""
    mean, count = runs.mean(axis=0), len(runs)
    variance = float(np.sum((runs - mean) ** 2)) / (count - 1)
    uncertain = variance / count + truth.square_error
    apart = float(np.sum((mean - truth.value) ** 2)) - uncertain
    noise = math.sqrt(variance / max(float(np.sum(mean**2)) - variance / count, 1e-300))
    # Few bright bins decide, so the squared distance fluctuates by about as much as chance alone makes it.
    return noise, math.sqrt(apart / truth.square) if apart > uncertain else 0.0


def with_front(rows: Sequence[Row]) -> list[Row]:
    """The rows with the Pareto front of each truth marked: nothing quicker has as little error."""

    def is_front(row: Row) -> bool:
        quicker = (other for other in rows if other.complete == row.complete and other.seconds < row.seconds)
        return all(other.error > row.error for other in quicker)

    return [replace(row, front=is_front(row)) for row in rows]


def report(outcome: Outcome) -> str:
    """Markdown: what was measured, the table, what to choose."""
    base, (own, every) = outcome.base, outcome.truths
    orders = "all bounces" if base.max_bounces is None else f"up to {base.max_bounces} bounces"
    lines = [
        f"### {outcome.title}",
        "",
        f"Base: {base.lookins} lookins, {base.fov_samples} FoV points, {orders}, by the walk. Truth: {own.lookins} "
        f"lookins with other seeds, its own error of {percent(own.relative_error)} subtracted; for bounce orders all "
        f"of them, {every.lookins} lookins, {percent(every.relative_error)}. Medians; {machine()}.",
        "",
        table(outcome.rows),
        "",
        *(f"Not run: {'; '.join(outcome.left_out)}.\n" for _ in outcome.left_out[:1]),
        *advice(outcome.rows),
    ]
    return "\n".join(lines) + "\n"


@click.command()
@click.argument("config")
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--scene", default=0, show_default=True, type=click.IntRange(0), help="Which scene of the dataset.")
@click.option(
    "--laser-points", type=click.IntRange(1), help="Only so many of the laser points, spread over the scan."
)
@click.option("--seconds", default=240.0, show_default=True, type=float, help="Budget, processor seconds.")
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(2), help="Runs behind each median.")
def main(config: str, out: Path, scene: int, laser_points: int | None, seconds: float, repeats: int) -> None:
    """Measure what accuracy costs for one scene of CONFIG; table and picture go to the folder OUT."""
    loaded = load_config(config)
    if not 1 <= seconds < math.inf:
        raise InputError(f"--seconds {seconds:g}: must be ≥ 1, such as 240")
    if scene >= loaded.scenes:
        raise InputError(f"--scene {scene}: {loaded.name} has the scenes 0 … {loaded.scenes - 1}")
    check_writable(out)
    outcome = run(loaded, scene, laser_points, seconds, repeats)
    out.mkdir(parents=True, exist_ok=True)
    (out / "accuracy.md").write_text(report(outcome), encoding="utf-8")
    picture(outcome.rows, f"{outcome.title} ({machine()})", out / "accuracy.png")
    click.echo(report(outcome))
    click.echo(f"{out / 'accuracy.md'}, accuracy.png beside it")
