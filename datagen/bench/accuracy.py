"""What accuracy costs in time: the error of one scene's light, claimed and true, against processor seconds.

Targets are swept, and beside them numbers of plain paths. The true error is that against long runs of other plain
paths (`plain_check.py`). What the orders of light beyond each bring is listed, too: that much is left out with a
smaller `max_bounces`, whatever the target.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from matplotlib.ticker import LogLocator, NullFormatter

from datagen.bench.measuring import machine, markdown, percent, processor_seconds
from datagen.bench.plain_check import Checked, PlainPaths
from datagen.capture import capture_for
from datagen.config import DatasetConfig, load_config
from datagen.design.scene_for import scene_for
from datagen.errors import InputError
from datagen.records import Accuracy, Capture
from datagen.report.style import INK, house_style, new_figure, save_png
from datagen.store.files import check_writable, write_atomically
from datagen.transport import simulate
from datagen.transport.problem import components_asked

TARGETS, SAMPLES = (0.1, 0.05, 0.02, 0.01, 0.005), (16, 128, 1024)
SHARE_OF_TRUTH = 0.6
"""Share of the budget for the paths that tell the true error."""
TRUTH_SEED = 1 << 40


class Row(NamedTuple):
    """A setting, measured. seconds, claimed : medians of processor seconds and of the claimed relative errors.
    found : the mean of the squared true errors."""

    quantity: str
    value: str
    seconds: float
    claimed: float
    found: Checked


def settings(base: Accuracy) -> list[tuple[str, str, Accuracy]]:
    """Quantity, value and accuracy of each setting, from the cheapest on."""
    return [
        *(("target", f"{t:g}", replace(base, target=t, samples=None, part_target=None)) for t in TARGETS),
        *(("samples", str(n), replace(base, target=None, samples=n, part_target=None)) for n in SAMPLES),
    ]


def fewer_laser_points(capture: Capture, most: int | None) -> Capture:
    """At most `most` of the laser points (confocal: with their pixels), spread evenly over the scan."""
    count = len(capture.laser.targets)
    if most is None or count <= most:
        return capture
    return capture.excerpt(np.unique(np.round((np.arange(most) + 0.5) * count / most - 0.5).astype(int)))


def accuracy_report(
    config: DatasetConfig, scene: int, laser_points: int | None, seconds: float, repeats: int
) -> tuple[str, list[Row]]:
    """The report of a scene in Markdown, and its rows, made in about `seconds` processor seconds.

    Raises
    ------
    InputError : the scene cannot be made, or sends no light into the window.
    """
    room = scene_for(config, scene)
    whole = capture_for(config, room, config.seed, scene)
    capture = fewer_laser_points(whole, laser_points)
    base = replace(config.transport.accuracy(), faint_part=0.0)
    if capture.illumination == "flood":
        raise InputError(f"{config.name}: a flood has no plain check; take a configuration that scans")
    every = replace(base, max_bounces=None, target=None, part_target=None, samples=1)
    samples = _affordable(lambda n: PlainPaths.of(room, capture, every, n, TRUTH_SEED), SHARE_OF_TRUTH * seconds)
    truth = PlainPaths.of(room, capture, every, samples, TRUTH_SEED + 1)
    if not any(of.any() for of in truth.runs.values()):
        raise InputError("the scene sends no light into the window; try another --scene")
    names = [name for name in truth.runs if name in ("direct", "primary", "secondary", "higher")]
    asked = [name for name in names if name in components_asked(base)]
    rows, left_out, spent = list[Row](), list[str](), 0.0
    for quantity, value, accuracy in settings(base):
        if spent > (1 - SHARE_OF_TRUTH) * seconds:
            left_out.append(f"{quantity} {value}")
            continue
        runs = list[tuple[float, float, Checked]]()
        # The first run of a scene may compile.
        for seed in range(repeats + (not rows)):
            light, taken = processor_seconds(lambda a=accuracy, s=seed: simulate(room, capture, a, s))  # type: ignore[misc]
            runs.append((taken, light.relative_error, truth.check(light.total, *asked)))
            spent += taken if rows or seed else 0.0
        runs = runs[not rows :]
        found = [run[2] for run in runs]
        mean = Checked(statistics.mean(c.square for c in found), statistics.mean(c.noise for c in found))
        taken, claimed = statistics.median(run[0] for run in runs), statistics.median(run[1] for run in runs)
        rows.append(Row(quantity, value, taken, claimed, mean))
    used, there = len(capture.laser.targets), len(whole.laser.targets)
    points = f"{used} of its {there} laser points" if used < there else f"laser points: {there}"
    lines = [
        f"### {config.name}, scene {scene}, {points}",
        "",
        f"Light of {' and '.join(asked)}; medians of {repeats} runs. True errors against {8 * samples} plain paths a "
        f"pair with other seeds; {machine()}.",
        "",
        table(rows),
        "",
        *_beyond(truth, names),
        *(f"Not run, as the budget was spent: {', '.join(left_out)}.\n" for _ in left_out[:1]),
    ]
    return "\n".join(lines) + "\n", rows


def _affordable(run: Callable[[int], object], seconds: float) -> int:
    """Samples that paths may have in `seconds` processor seconds."""
    # The first run of a scene may compile.
    run(1)
    samples, spent = 4, 0.0
    while True:
        _, taken = processor_seconds(lambda n=samples: run(n))  # type: ignore[misc]
        spent += taken
        if taken > 0.1 * (seconds - spent) or samples >= 1 << 20:
            grown = (seconds - spent) / max(taken, 1e-6)
            return int(samples * min(max(grown, 1.0), 8.0))
        samples *= 4


def _beyond(truth: PlainPaths, names: Sequence[str]) -> list[str]:
    """A line on what orders of light beyond each bring, relative to all light."""
    mean = {name: truth.runs[name].mean(axis=0) for name in names}
    total = np.linalg.norm(sum(mean.values()))
    shares = []
    for bounces, left in ((3, ("secondary", "higher")), (4, ("higher",))):
        share = np.linalg.norm(sum(mean[name] for name in left if name in mean)) / total
        shares.append(f"max_bounces: {bounces} leaves out {percent(float(share))}")
    return [f"Of the light of all bounces {', '.join(shares)} (relative L2).", ""]


def table(rows: Sequence[Row]) -> str:
    """Markdown, a row for each setting."""
    head = ["asked", "value", "processor s", "error claimed", "error found"]
    return markdown(
        head, [[r.quantity, r.value, f"{r.seconds:.3g}", percent(r.claimed), str(r.found)] for r in rows], words=2
    )


def picture(rows: Sequence[Row], title: str, path: Path) -> Path:
    """Error against seconds: claimed and found, by target and by plain paths."""
    with house_style():
        figure = new_figure(5.2)
        axes = figure.subplots()
        axes.set_title(title, fontsize=10, color=INK)
        if not rows:
            # Logarithmic axes cannot be empty.
            axes.set_axis_off()
            return save_png(figure, path)
        for quantity, color, name in (("target", "#D55E00", "to a target"), ("samples", "#0072B2", "plain paths")):
            own = [row for row in rows if row.quantity == quantity]
            seen = [row for row in own if row.found.error**2 > 2 * row.found.noise]
            places = [row.seconds for row in seen], [row.found.error for row in seen]
            axes.plot(*places, color=color, marker="o", label=f"{name}: error found")
            claimed = [row.seconds for row in own], [row.claimed for row in own]
            axes.plot(*claimed, color=color, ls=":", marker="_", ms=9, label=f"{name}: error claimed")
            for row in own:
                asked = f"{row.value} paths a pair" if quantity == "samples" else f"{percent(float(row.value))} asked"
                # Below the line that falls from left to right there is room at the left.
                there: dict[str, Any] = {"xytext": (8, 5)}
                if quantity == "samples":
                    there = {"xytext": (-4, -14), "ha": "right"}
                axes.annotate(
                    asked, (row.seconds, row.claimed), textcoords="offset points", fontsize=8, color=color, **there
                )
        axes.set(xscale="log", yscale="log", xlabel="processor seconds a scene", ylabel="relative L2 error")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=30))
            axis.set_minor_formatter(NullFormatter())
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.yaxis.set_major_formatter(lambda value, _: percent(value))
        axes.margins(0.2, 0.12)
        axes.legend(fontsize=8)
        return save_png(figure, path)


@click.command()
@click.argument("config")
@click.argument("out", type=click.Path(path_type=Path), required=False)
@click.option("--scene", default=0, show_default=True, type=click.IntRange(0), help="Which scene of the dataset.")
@click.option(
    "--laser-points", type=click.IntRange(1), help="Only so many of the laser points, spread over the scan."
)
@click.option("--seconds", default=60.0, show_default=True, type=float, help="Budget, processor seconds.")
@click.option("--repeats", default=3, show_default=True, type=click.IntRange(1), help="Runs behind each median.")
def main(config: str, out: Path | None, scene: int, laser_points: int | None, seconds: float, repeats: int) -> None:
    """Measure what accuracy costs for one scene of CONFIG; table and picture go to the folder OUT, if given."""
    loaded = load_config(config)
    if not 1 <= seconds < math.inf:
        raise InputError(f"--seconds {seconds:g}: must be ≥ 1, such as 60")
    if scene >= loaded.scenes:
        raise InputError(f"--scene {scene}: {loaded.name} has the scenes 0 … {loaded.scenes - 1}")
    if out is not None:
        check_writable(out)
    text, rows = accuracy_report(loaded, scene, laser_points, seconds, repeats)
    click.echo(text)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_atomically(out / "accuracy.md", text.encode())
        title = text.splitlines()[0].removeprefix("### ")
        picture(rows, f"What accuracy costs: {title}\n{machine()}", out / "accuracy.png")
        click.echo(f"{out / 'accuracy.md'}, accuracy.png beside it")
