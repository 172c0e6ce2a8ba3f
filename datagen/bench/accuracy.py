"""What accuracy costs in time: the true relative L2 error of one scene's transient against processor seconds.

One quantity is swept at a time about a base setting: hidden vertices (`lookins`), FoV points, bounce orders, target,
second hidden vertices (`observed`), k strongest secondary paths. The truth is a long run with other seeds, in two
halves; half of their difference is its own error, which is subtracted. The truth has all paths of as many bounces as
the configuration (at least four, so that there is a secondary); for the sweep of bounce orders it has all paths, so
that those left out show as a bias.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter

from datagen.bench.measuring import machine, markdown, percent, processor_seconds
from datagen.capture import capture_for
from datagen.config import DatasetConfig, load_config
from datagen.design.scene_for import scene_for
from datagen.errors import InputError
from datagen.records import Accuracy, Capture
from datagen.records.arrays import Floats
from datagen.report.style import INK, house_style, new_figure, save_png
from datagen.store.files import check_writable
from datagen.transport import simulate

Run = Callable[[Accuracy, int], tuple[Floats, float]]
"""Accuracy and seed → (laser, pixel, bin) transient, and processor seconds."""

GOALS = (0.10, 0.05, 0.02, 0.01)
"""Errors for which the report recommends settings."""
RUNS_IN_BUDGET = 250
"""How many runs of the base setting fit into the budget; its lookins are halved until they do."""
SHARE_OF_REFERENCE = 0.25
"""Share of the budget for each of the two truths, whose own errors fall with its root."""
SLOWEST_SHARE = 0.04
"""Share of the budget above which one run of a setting ends its sweep."""
REFERENCE_SEED = 1 << 40
FEWEST_LOOKINS, SMALLEST_SWEPT = 64, 16
OBSERVED = 1024
"""Second hidden vertices of the factorised secondary in the other sweeps."""
ALL_LOOKINS = "lookins, all bounces"
_LOOKS = {
    "lookins": ("#000000", "o"), "FoV points": ("#009E73", "^"), "observed points": ("#0072B2", "s"),
    "k strongest paths": ("#CC79A7", "P"), "target": ("#D55E00", "v"), ALL_LOOKINS: ("#000000", "o"),
    "bounce orders": ("#E69F00", "X"),
}  # fmt: skip
"""Colour and marker of each swept quantity."""


class Setting(NamedTuple):
    """One point of a sweep: the swept quantity, its value, and whether its truth has all bounce orders."""

    quantity: str
    value: str
    accuracy: Accuracy
    complete: bool = False

    @property
    def configured(self) -> str:
        """The setting as keys of a configuration's section `transport`."""
        accuracy = self.accuracy
        orders = f"max_bounces: {'null' if accuracy.max_bounces is None else accuracy.max_bounces}"
        if accuracy.target is not None:
            return f"target: {accuracy.target:g}, {orders}"
        text = f"lookins: {accuracy.lookins}, fov_samples: {accuracy.fov_samples}, {orders}"
        if accuracy.observed is not None:
            text += f", observed: {accuracy.observed}"
        return text if accuracy.secondary == "all" else f"{text}, secondary: {accuracy.secondary}"


@dataclass(frozen=True)
class Row:
    """One setting, measured: medians over `runs` runs with different seeds.

    seconds : processor seconds of a run.
    error : relative L2 error against the truth.
    noise : its random part, relative to the mean of the runs.
    bias : its systematic part, which more samples do not reduce; 0 where it is within the noise.
    complete : whether the truth has all bounce orders, or those of the base setting.
    front : on the Pareto front of its truth: no quicker setting has less error.
    """

    quantity: str
    value: str
    configured: str
    runs: int
    seconds: float
    error: float
    noise: float
    bias: float
    complete: bool
    front: bool = False


def sweeps(base: Accuracy) -> list[list[Setting]]:
    """All sweeps about a base setting, each from its cheapest setting on. What most users change comes first, since
    the last sweeps are left out when the budget is spent."""
    lookins = [n for n in (base.lookins * 4**k // 64 for k in range(6)) if n >= SMALLEST_SWEPT]
    factorised, everything = replace(base, observed=OBSERVED), replace(base, max_bounces=None)
    target = Accuracy(max_bounces=base.max_bounces, direct=base.direct, target=1.0)
    orders = (3, 4, 5, 6, 8, 12, None)
    return [
        [Setting("lookins", str(n), replace(base, lookins=n)) for n in lookins],
        [Setting("FoV points", str(n), replace(base, fov_samples=n)) for n in (1, 4, 16, 64)],
        [Setting(ALL_LOOKINS, str(n), replace(everything, lookins=n), complete=True) for n in lookins],
        [Setting("bounce orders", f"≤ {b}" if b else "all", replace(base, max_bounces=b), True) for b in orders],
        [Setting("target", f"{t:g}", replace(target, target=t)) for t in (0.2, 0.1, 0.05, 0.02, 0.01)],
        [Setting("observed points", str(n), replace(base, observed=n)) for n in (64, 256, OBSERVED, 4 * OBSERVED)],
        [Setting("k strongest paths", str(k), replace(factorised, secondary=k)) for k in (1, 8, 64, 512)],
    ]


def fewer_laser_points(capture: Capture, most: int | None) -> Capture:
    """At most `most` of the laser points (confocal: with their pixels), spread evenly over the scan."""
    count = len(capture.laser.targets)
    if most is None or count <= most:
        return capture
    return capture.excerpt(np.unique(np.round((np.arange(most) + 0.5) * count / most - 0.5).astype(int)))


@dataclass(frozen=True)
class Truth:
    """The converged transient.

    value : mean of two halves. square_error : its squared error ‖half₁ − half₂‖²/4. square : ‖truth‖² without noise.
    """

    value: Floats
    square_error: float
    square: float
    lookins: int = 0

    @classmethod
    def of(cls, one: Floats, two: Floats, lookins: int = 0) -> Truth:
        """The truth from two independent halves of the same shape."""
        mean, error = (one + two) / 2, float(np.sum((one - two) ** 2)) / 4
        return cls(mean, error, max(float(np.sum(mean**2)) - error, 0.0), lookins)

    @property
    def relative_error(self) -> float:
        """The truth's own relative L2 error; 0 without light."""
        return math.sqrt(self.square_error / self.square) if self.square > 0 else 0.0

    def error_of(self, transient: Floats) -> float:
        """Relative L2 error of a transient, the truth's own error subtracted."""
        apart = float(np.sum((transient - self.value) ** 2)) - self.square_error
        return math.sqrt(max(apart, 0.0) / self.square)


def measured(
    config: DatasetConfig, scene: int, laser_points: int | None, seconds: float, repeats: int
) -> tuple[str, list[Row]]:
    """The report of a scene in Markdown, and the rows of its sweeps, made in about `seconds` processor seconds.

    Raises
    ------
    InputError : the scene cannot be made, or sends no light into the window.
    """
    room = scene_for(config, scene)
    whole = capture_for(config, room, config.seed, scene)
    capture = fewer_laser_points(whole, laser_points)

    def run(accuracy: Accuracy, seed: int) -> tuple[Floats, float]:
        return processor_seconds(lambda: simulate(room, capture, accuracy, seed, split_parts=False).total)

    configured = config.transport.accuracy()
    orders = None if configured.max_bounces is None else max(configured.max_bounces, 4)
    lookins = 1 << round(math.log2(max(configured.lookins, FEWEST_LOOKINS)))
    wanted = Accuracy(lookins, configured.fov_samples, orders, replicates=4, direct=configured.direct)
    base = _affordable(wanted, run, seconds / RUNS_IN_BUDGET)
    own = converge(run, base, SHARE_OF_REFERENCE * seconds)
    every = own if orders is None else converge(run, replace(base, max_bounces=None), SHARE_OF_REFERENCE * seconds)
    rows, left_out, spent = list[Row](), list[str](), 0.0
    for sweep in sweeps(base):
        # Once, so that no compilation is timed; a setting that cannot be run is reported below.
        with suppress(InputError):
            run(sweep[0].accuracy, 0)
        for k, setting in enumerate(sweep):
            if spent > seconds:
                left_out.append(f"{setting.quantity} {setting.value}: the budget was spent")
                continue
            try:
                row = measure(setting, run, every if setting.complete else own, repeats, SLOWEST_SHARE * seconds)
            except InputError as error:
                left_out.append(f"{setting.quantity} {setting.value}: {error}")
                continue
            rows.append(row)
            spent += row.seconds * row.runs
            if row.seconds > SLOWEST_SHARE * seconds:
                left_out += [f"{later.quantity} {later.value}: too slow" for later in sweep[k + 1 :]]
                break
    used, there = len(capture.laser.targets), len(whole.laser.targets)
    points = f"{used} of its {there} laser points" if used < there else f"laser points: {there}"
    rows = with_front(rows)
    followed = "all bounces" if orders is None else f"up to {orders} bounces"
    lines = [
        f"### {config.name}, scene {scene}, {points}",
        "",
        f"Base: {base.lookins} lookins, {base.fov_samples} FoV points, {followed}, by the walk. Truth: {own.lookins} "
        f"lookins with other seeds, its own error of {percent(own.relative_error)} subtracted; for bounce orders all "
        f"of them, {every.lookins} lookins, {percent(every.relative_error)}. Medians; {machine()}.",
        "",
        table(rows),
        "",
        *(f"Not run: {'; '.join(left_out)}.\n" for _ in left_out[:1]),
        *advice(rows),
    ]
    return "\n".join(lines) + "\n", rows


def _affordable(base: Accuracy, run: Run, seconds: float) -> Accuracy:
    """The base setting with fewer lookins, if need be, so that a run takes at most `seconds` processor seconds."""
    tried = replace(base, lookins=FEWEST_LOOKINS)
    run(tried, 2)
    while 2 * tried.lookins <= base.lookins and run(tried, 2)[1] < seconds / 2:
        tried = replace(tried, lookins=2 * tried.lookins)
    return tried


def converge(run: Run, accuracy: Accuracy, budget_s: float) -> Truth:
    """The truth, in two halves whose lookins are doubled until a longer run would not fit into the budget.

    Raises
    ------
    InputError : no light arrives within the window, so that there is nothing to be wrong about.
    """
    count, spent = accuracy.lookins, 0.0
    while True:
        long = replace(accuracy, lookins=count, replicates=1)
        (one, first_s), (two, second_s) = (run(long, REFERENCE_SEED + half) for half in range(2))
        if not (one.any() and two.any()):
            raise InputError(
                "the scene sends no light into the window, so there is no error to measure; try another --scene"
            )
        taken = max(first_s + second_s, 1e-6)
        spent += taken
        if budget_s - spent < 2 * taken:
            return Truth.of(one, two, 2 * count)
        count <<= int(math.log2((budget_s - spent) / taken))


def measure(setting: Setting, run: Run, truth: Truth, repeats: int, slowest_s: float) -> Row:
    """The row of a setting: `repeats` runs with different seeds, or two if one takes longer than `slowest_s`."""
    runs = list[tuple[Floats, float]]()
    while len(runs) < repeats and (len(runs) < 2 or runs[0][1] <= slowest_s):
        runs.append(run(setting.accuracy, 1 + len(runs)))
    found = np.array([transient for transient, _ in runs])
    noise, bias = noise_and_bias(found, truth)
    seconds = statistics.median(taken for _, taken in runs)
    error = statistics.median(truth.error_of(transient) for transient in found)
    what = setting.quantity, setting.value, setting.configured
    return Row(*what, len(runs), seconds, error, noise, bias, setting.complete)


def noise_and_bias(runs: Floats, truth: Truth) -> tuple[float, float]:
    """Random part of the error of (run, …) transients, relative to their mean; and systematic part, relative to the
    truth, 0 where it is within the noise."""
    mean, count = runs.mean(axis=0), len(runs)
    variance = float(np.sum((runs - mean) ** 2)) / (count - 1)
    uncertain = variance / count + truth.square_error
    apart = float(np.sum((mean - truth.value) ** 2)) - uncertain
    noise = math.sqrt(variance / max(float(np.sum(mean**2)) - variance / count, 1e-300))
    # A few bright bins dominate, so by chance alone the squared distance fluctuates by about its own mean.
    return noise, math.sqrt(apart / truth.square) if apart > uncertain else 0.0


def with_front(rows: Sequence[Row]) -> list[Row]:
    """The rows, with those marked that are on the Pareto front of their truth: no quicker one has as little error."""

    def is_front(row: Row) -> bool:
        quicker = (other for other in rows if other.complete == row.complete and other.seconds < row.seconds)
        return all(other.error > row.error for other in quicker)

    return [replace(row, front=is_front(row)) for row in rows]


def table(rows: Sequence[Row]) -> str:
    """Markdown, a row for each setting; the Pareto front is marked by ●."""
    head = ["swept", "value", "processor s", "error", "of it noise", "of it bias", "front"]
    cells = []
    for row in rows:
        # Errors at the level of rounding are no noise, or no bias.
        parts = [percent(error) if error > 1e-9 else "–" for error in (row.noise, row.bias)]
        cells.append(
            [row.quantity, row.value, f"{row.seconds:.3g}", percent(row.error), *parts, "●" if row.front else ""]
        )
    return markdown(head, cells, words=2)


def advice(rows: Sequence[Row]) -> list[str]:
    """Recommendations: the cheapest setting for each goal, and the biases that samples do not reduce."""
    title = f"What to choose for {_light_of(rows)} (processor seconds a scene, error found):"
    return [title, "", *(_for_goal(rows, goal) for goal in GOALS), *_floors(rows)]


def _light_of(rows: Sequence[Row]) -> str:
    """The light in the truth of most sweeps, in words."""
    orders = {row.configured.rpartition("max_bounces: ")[2] for row in rows if row.quantity == "lookins"}
    return "light of all bounces" if orders in (set(), {"null"}) else f"light of up to {orders.pop()} bounces"


def _for_goal(rows: Sequence[Row], goal: float) -> str:
    enough = [row for row in rows if row.error <= goal and not row.complete]
    fixed = [row for row in enough if row.quantity != "target"]
    targeted = [row for row in enough if row.quantity == "target" and row.value == f"{goal:g}"]
    best = [min(some, key=lambda row: row.seconds) for some in (fixed, targeted) if some]
    choices = [f"`{row.configured}`, {row.seconds:.2g} s ({percent(row.error)})" for row in best]
    if not fixed:
        choices.insert(0, f"no fixed setting of these; {_by_the_trend(rows, goal)}")
    return f"- {percent(goal)}: {'; or leave the choice to it, '.join(choices)}"


def _by_the_trend(rows: Sequence[Row], goal: float) -> str:
    sweep = [row for row in rows if row.quantity == "lookins" and row.error > 0]
    if len(sweep) < 2 or sweep[-1].error >= sweep[-2].error:
        return "more lookins do not lead there"
    low, high = sweep[-2:]
    power = math.log(low.error / high.error) / math.log(float(high.value) / float(low.value))
    times = (high.error / goal) ** (1 / power)
    return f"by the trend about {float(high.value) * times:.2g} lookins, {high.seconds * times:.2g} s"


def _floors(rows: Sequence[Row]) -> Iterator[str]:
    """Sentences about errors that no number of samples reduces."""
    for quantity, what, label in (
        ("bounce orders", "Of the light of all bounces is left out, however many samples are taken", "{} bounces"),
        ("k strongest paths", "Keeping the k strongest secondary paths of each lookin loses", "k = {}"),
    ):
        biased = [row for row in rows if row.quantity == quantity and row.bias > 0 and row.value != "all"]
        if biased:
            yield f"- {what}: {', '.join(f'{label.format(row.value)} {percent(row.bias)}' for row in biased)}."
    own = {row.value: row.seconds for row in rows if row.quantity == "lookins"}
    ratios = [row.seconds / own[row.value] for row in rows if row.quantity == ALL_LOOKINS and row.value in own]
    if ratios:
        yield f"- All bounces cost {statistics.median(ratios):.2g} times as much time as {_light_of(rows)}."


def picture(rows: Sequence[Row], title: str, path: Path) -> Path:
    """Error against seconds, one colour for each swept quantity, the Pareto front as a line."""
    with house_style():
        figure = new_figure(11.0, 5.6)
        left, right = figure.subplots(1, 2, width_ratios=(2.2, 1.3), sharey=True)
        _draw(left, [row for row in rows if not row.complete], f"Error against cost: {_light_of(rows)}")
        _draw(right, [row for row in rows if row.complete], "… of all bounces")
        figure.suptitle(title, fontsize=10, color=INK)
        return save_png(figure, path)


def _draw(axes: Axes, rows: Sequence[Row], title: str) -> None:
    shown = [row for row in rows if row.error > 0]
    if not shown:
        # Logarithmic axes cannot be empty.
        axes.set_axis_off()
        axes.set_title(f"{title}: the time left room for no run")
        return

    def places(some: Sequence[Row]) -> tuple[list[float], list[float]]:
        return [row.seconds for row in some], [row.error for row in some]

    front = sorted((row for row in shown if row.front), key=lambda row: row.seconds)
    broad: dict[str, Any] = {"color": "#F0C000", "lw": 7, "alpha": 0.45, "zorder": 0, "solid_capstyle": "round"}
    axes.plot(*places(front), label="Pareto front", **broad)
    for quantity in dict.fromkeys(row.quantity for row in shown):
        color, marker = _LOOKS[quantity]
        points = [row for row in shown if row.quantity == quantity]
        axes.plot(*places(points), color=color, marker=marker, ms=5.5, lw=1.0, alpha=0.9, label=quantity)
        style: dict[str, Any] = {"xytext": (5, 4), "textcoords": "offset points", "fontsize": 6.5, "color": color}
        for row in points[:: max(len(points) - 1, 1)]:
            axes.annotate(row.value, (row.seconds, row.error), **style)
    for goal in GOALS:
        axes.axhline(goal, color="#BBBBBB", lw=0.6, zorder=0)
    axes.set(xscale="log", yscale="log", xlabel="processor seconds a scene", ylabel="relative L2 error", title=title)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=30))
    axes.yaxis.set_major_formatter(lambda value, _: percent(value))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.margins(0.12)
    axes.legend(loc="lower left", fontsize=7)


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
    text, rows = measured(loaded, scene, laser_points, seconds, repeats)
    out.mkdir(parents=True, exist_ok=True)
    (out / "accuracy.md").write_text(text, encoding="utf-8")
    title = text.splitlines()[0].removeprefix("### ")
    picture(rows, f"{title} ({machine()})", out / "accuracy.png")
    click.echo(text)
    click.echo(f"{out / 'accuracy.md'}, accuracy.png beside it")
