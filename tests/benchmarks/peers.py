"""Error against processor seconds, ours beside what a user would otherwise pick.

    python tests/benchmarks/peers.py OUT

- *Bare plate*: 0.5 m, nothing in the way, 16 × 16 confocal points, 300 bins of 3 mm, three bounces; relative L1 error
  against quadrature. Ours, mitransient at its best there (hidden-geometry sampling), and plain quadrature, which
  knows that there is nothing else in the scene.
- *Scans* of a closed room with a box and a pillar, and of the same with meshes in it; relative L2 error of the whole,
  of the worst object, and of light after 10 ns, against ours to a much smaller error.

Ours is timed as a user calls it, `simulate` with all its preparation; the others after their preparation
(mitransient's scene and kernels are built before the clock starts). Runs take turns, so that a busy machine disturbs
all alike, and ratios are formed turn by turn. mitransient runs when it is installed (`other_renderers.py`).
"""

from __future__ import annotations

import itertools
import math
import re
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import click
from benchmarks.other_renderers import missing_for_mitransient
from benchmarks.peer_cases import CASES, DEAR, Case, Contender
from matplotlib.ticker import LogLocator, NullFormatter

from datagen.bench.measuring import machine, markdown, percent, processor_seconds
from datagen.errors import InputError
from datagen.exit_status import exit_with, guarded
from datagen.report.style import INK, house_style, new_figure, save_png
from datagen.store.files import check_writable


@dataclass(frozen=True)
class Run:
    """One run: processor seconds (all threads), and relative errors by name, that of the whole first."""

    seconds: float
    errors: dict[str, float]

    @property
    def error(self) -> float:
        """Relative error of the whole."""
        return next(iter(self.errors.values()))


LOOKS = (("#D55E00", "o"), ("#000000", "s"), ("#0072B2", "^"), ("#CC79A7", "v"))
"""Colour and marker of each contender, ours first."""
RESTING_S = 0.2
"""Pause before each run: threads of the run before spin idly for a while, and would cost processor time."""
Turn = dict[str, list[Run]]
"""Contender → a run for each of its numbers of samples."""


def measured(case: Case, repeats: int) -> list[Turn]:
    """The runs of every contender at each of its numbers of samples, turn after turn with other seeds."""

    def once(contender: Contender, samples: int, seed: int) -> Run:
        time.sleep(RESTING_S)
        result, seconds = processor_seconds(lambda: contender.run(samples, seed))
        return Run(seconds, case.errors(result, contender.truth))

    if case.most > 1:
        # Once before the clock starts: shapes that depend on the number of samples compile anew in mitransient.
        for contender in case.contenders:
            for samples in contender.samples:
                contender.run(samples, 0)
    seeds = range(1, min(repeats, case.most) + 1)
    return [{one.name: [once(one, n, seed) for n in one.samples] for one in case.contenders} for seed in seeds]


def seconds_at(rows: Sequence[tuple[float, float]], target: float) -> tuple[float, bool]:
    """Processor seconds to reach an error, and whether rows enclose it (else it is extrapolated beyond the last one).

    rows : (seconds, error). Between two rows their logarithms are joined by a straight line; beyond the last one the
    error falls as 1/√seconds, as with independent paths, so an error that no longer falls is overlooked.
    """
    if rows[0][1] <= target:
        return rows[0][0], True
    for (less_s, worse), (more_s, better) in itertools.pairwise(rows):
        if better <= target:
            return less_s * (more_s / less_s) ** (math.log(worse / target) / math.log(worse / better)), True
    return rows[-1][0] * (rows[-1][1] / target) ** 2, False


def seconds_to_target(contender: Contender, runs: Sequence[Run], target: float) -> tuple[float, bool]:
    """`seconds_at` of a contender in one turn; one that takes an error is judged by its run to the target."""
    rows = [(run.seconds, run.error) for run in runs]
    if contender.takes_error:
        rows = [row for row, one_in in zip(rows, contender.samples, strict=True) if one_in * target >= 1] or rows
    return seconds_at(rows, target)


def lines_of(case: Case, turns: Sequence[Turn]) -> dict[str, list[tuple[float, float]]]:
    """Contender → (processor seconds, error) at each of its numbers of samples, medians over the turns."""

    def medians(name: str, k: int) -> tuple[float, float]:
        runs = [turn[name][k] for turn in turns]
        return statistics.median(run.seconds for run in runs), statistics.median(run.error for run in runs)

    return {one.name: [medians(one.name, k) for k in range(len(one.samples))] for one in case.contenders}


def report(case: Case, turns: Sequence[Turn]) -> str:
    """Markdown: error and seconds of every contender, and its seconds to the target error over ours."""
    first, lines = case.contenders[0], lines_of(case, turns)
    names = list(turns[0][first.name][0].errors)
    cells, ends = list[list[str]](), list[str]()
    for contender in case.contenders:
        for k, samples in enumerate(contender.samples):
            runs = [turn[contender.name][k] for turn in turns]
            errors = [
                percent(statistics.median(run.errors[name] for run in runs)) if name in runs[0].errors else "–"
                for name in names
            ]
            cells.append([contender.name, contender.effort(samples), f"{lines[contender.name][k][0]:.3f}", *errors])
        taken = [seconds_to_target(contender, turn[contender.name], case.target) for turn in turns]
        against = [seconds_to_target(first, turn[first.name], case.target)[0] for turn in turns]
        ratio = statistics.median(s / ours for (s, _), ours in zip(taken, against, strict=True))
        how = "" if all(reached for _, reached in taken) else ", extrapolated as 1/√seconds"
        median = statistics.median(s for s, _ in taken)
        took = f"{percent(case.target)} in {median:.3g} processor s{how}"
        ends.append(f"- {contender.name}: {took} ({ratio:.3g} × ours)")
    head = ["", "samples", "processor s", *names]
    return "\n".join([f"### {case.title}", "", markdown(head, cells), "", *ends, ""])


def picture(
    title: str, norm: int, target: float, lines: Mapping[str, Sequence[tuple[float, float]]],
    efforts: Mapping[str, Sequence[str]], path: Path,
) -> Path:  # fmt: skip
    """Error against processor seconds, a line for each contender, and at each of its points what was asked of it."""
    with house_style():
        figure = new_figure(4.4)
        axes = figure.subplots()
        for k, ((name, line), (color, marker)) in enumerate(zip(lines.items(), LOOKS, strict=False)):
            # Lines of two that lie side by side have their words on either side.
            beside: dict[str, Any] = {"xytext": (8, 4)} if k < 2 else {"xytext": (-8, -12), "ha": "right"}
            axes.plot(*zip(*line, strict=True), color=color, marker=marker, ms=7, lw=1.8, label=name)
            for effort, point in zip(efforts[name], line, strict=True):
                axes.annotate(effort, point, textcoords="offset points", color=color, fontsize=8, **beside)
        axes.axhline(target, color="#BBBBBB", lw=0.8, zorder=0, label=f"{percent(target)}, where times are compared")
        axes.legend(loc="lower left")
        axes.set(xscale="log", yscale="log", xlabel="processor seconds a scan", ylabel=f"relative L{norm} error")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=30))
            axis.set_minor_formatter(NullFormatter())
        axes.xaxis.set_major_formatter(lambda value, _: f"{value:g} s")
        axes.yaxis.set_major_formatter(lambda value, _: percent(value))
        # Room for words beside the last point, and for the legend below.
        axes.margins(0.2, 0.25)
        axes.set_title(title, fontsize=10, color=INK)
        return save_png(figure, path)


@click.command()
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--repeats", default=5, show_default=True, type=click.IntRange(1), help="Runs behind each median.")
@click.option("--only", default="", help=f"Only the cases whose name contains this; they are {'; '.join(CASES)}.")
@click.option("--dear", is_flag=True, help=f"Also the cases that take minutes: {'; '.join(DEAR)}.")
def main(out: Path, repeats: int, only: str, dear: bool) -> None:
    """Error against processor seconds for a bare plate and furnished rooms, ours beside others; a table and a
    picture of each case go to the folder OUT."""
    check_writable(out)
    chosen = {name: case for name, case in (CASES | DEAR if dear else CASES).items() if only in name}
    if not chosen:
        raise InputError(f"--only {only}: the cases are {'; '.join(CASES)}; and with --dear {'; '.join(DEAR)}")
    out.mkdir(parents=True, exist_ok=True)
    missing = missing_for_mitransient()
    pages = [f"Medians of {repeats}; processor seconds, {machine()}\n"]
    pages += [f"Without mitransient: {missing}\n"] if missing else []
    click.echo("\n".join(pages))
    for name, make in chosen.items():
        case = make()
        turns = measured(case, repeats)
        pages.append(report(case, turns))
        click.echo(pages[-1])
        file = out / f"peers_{'_'.join(re.findall('[a-z0-9]+', name))}.png"
        efforts = {one.name: [one.effort(samples) for samples in one.samples] for one in case.contenders}
        picture(case.title, case.norm, case.target, lines_of(case, turns), efforts, file)
    (out / "peers.md").write_text("\n".join(pages), encoding="utf-8")
    click.echo(f"{out / 'peers.md'}, a picture of each case beside it")


if __name__ == "__main__":
    exit_with(lambda: guarded(main))
