"""Does a plan come true? `datagen bench plan [CONFIG …]`.

Forecasts a few scenes of each configuration, builds them, and prints predicted beside actual: seconds, error and
bytes of a scene, and the time of the whole build. The clock of a busy machine says little, so times are processor
seconds: of the pilots and the worker's start, and of the worker that then builds. Exits with 1 when a number is off
by more than a factor of `WITHIN`.
"""

from __future__ import annotations

import math
import resource
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import click

from datagen.builder import build
from datagen.cli import guarded
from datagen.config import DatasetConfig, load_config
from datagen.errors import CheckError, InputError
from datagen.forecast import Outcome, against, forecast
from datagen.pilots import Pilot, Pilots, probe_workers, run_pilots
from datagen.store import schema_of
from datagen.store.environment import cores, processor

WITHIN = 1.5


@dataclass(frozen=True)
class Held:
    """One configuration: effort of its pilots, and what was predicted beside what came."""

    name: str
    scenes: int
    effort: float
    outcomes: tuple[Outcome, ...]

    @property
    def worst(self) -> float:
        """The largest factor by which a known number was off."""
        known = [row.ratio for row in self.outcomes if not math.isnan(row.ratio)]
        return max((max(ratio, 1 / ratio) for ratio in known), default=1.0)


def hold(config: DatasetConfig, scenes: int, budget_s: float) -> Held:
    """Forecast and build `scenes` scenes of a configuration with one worker."""
    few = config.with_scenes(min(scenes, config.scenes))
    schema = schema_of(few)
    pilots = run_pilots(few, budget_s)
    running = probe_workers(few, pilots, 1)
    warm = replace(running, startup_s=running.startup_processor_s)
    expected = forecast(few, schema, _in_processor_seconds(pilots), warm, 1, cores())
    with tempfile.TemporaryDirectory(prefix="datagen-bench-") as folder:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        build(few, Path(folder) / "set", progress=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        clock, *others = against(expected, few, Path(folder) / "set")
    alone_s = spent_s - running.startup_processor_s
    mean_s = (expected.worker_s - warm.startup_s) / few.scenes
    return Held(
        few.name,
        few.scenes,
        expected.effort,
        (Outcome(clock.name, "s", mean_s, alone_s / few.scenes), *others,
         Outcome("whole build", "s", expected.build_s, spent_s)),
    )  # fmt: skip


def _in_processor_seconds(pilots: Pilots) -> Pilots:
    """The pilots as an idle machine would have timed them."""

    def idle(pilot: Pilot) -> Pilot:
        share = min(1.0, pilot.processor_s / max(pilot.total_s, 1e-9))
        return replace(pilot, seconds={stage: taken * share for stage, taken in pilot.seconds.items()})

    scenes, lower, ladder = (tuple(map(idle, some)) for some in (pilots.scenes, pilots.lower, pilots.ladder))
    return replace(pilots, scenes=scenes, lower=lower, ladder=ladder)


def table(held: Sequence[Held]) -> str:
    """Markdown: predicted → actual, and the ratio."""
    if not held:
        return ""
    names = [row.name for row in held[0].outcomes]
    lines = [
        f"| configuration | scenes | pilots' effort | {' | '.join(names)} |",
        "|---|---:|---:|" + "---|" * len(names),
    ]
    for one in held:
        cells = [
            f"{_number(row.predicted, row.unit)} → {_number(row.actual, row.unit)} ({row.ratio:.2f})"
            for row in one.outcomes
        ]
        lines.append(f"| {one.name} | {one.scenes} | {one.effort:.2g} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _number(value: float, unit: str) -> str:
    if math.isnan(value):
        return "unknown"
    if unit == "bytes":
        return f"{value / 1000:.3g} kB"
    return f"{value:.3g} s" if unit == "s" else f"{100 * value:.2g} %"


@click.command()
@click.argument("configs", nargs=-1, required=True)
@click.option("--scenes", default=10, show_default=True, type=click.IntRange(1), help="Scenes built of each.")
@click.option("--seconds", default=6.0, show_default=True, type=float, help="Budget of the pilots of each.")
def main(configs: tuple[str, ...], scenes: int, seconds: float) -> None:
    """Forecast and build a few scenes of every CONFIG, and print predicted beside actual."""
    if not 0 < seconds < math.inf:
        raise InputError(f"--seconds {seconds:g}: must be > 0, such as 6")
    loaded = [load_config(config) for config in configs]
    click.echo(f"Processor seconds; {processor()}, {cores()} cores\n")
    held = []
    for config in loaded:
        held.append(hold(config, scenes, seconds))
        click.echo(f"{config.name}: off by a factor of {held[-1].worst:.2f} at most", err=True)
    click.echo(table(held))
    far = [one.name for one in held if one.worst > WITHIN]
    if far:
        raise CheckError(f"off by more than a factor of {WITHIN}: {', '.join(far)}")


if __name__ == "__main__":
    raise SystemExit(guarded(main))
