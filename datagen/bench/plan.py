"""Does a plan come true? `datagen bench plan [CONFIG …]`.

Runs the pilots of each configuration, makes its first scenes as a worker does, and prints predicted beside actual:
seconds, error and bytes of a scene. The pilots are spread over the whole dataset, so they are other scenes, but one.
The clock of a busy machine says little, so times are processor seconds, of the pilots and of the scenes alike; what a
worker's start takes is left out. Exits with 1 when a number is off by more than a factor of `WITHIN`.
"""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import click

from datagen.config import DatasetConfig, load_config
from datagen.config.transport import TransportConfig
from datagen.errors import CheckError, InputError
from datagen.exit_status import guarded
from datagen.forecast.forecast import Outcome, against, forecast
from datagen.forecast.pilots import run_pilots
from datagen.forecast.probe import Workers
from datagen.forecast.text import BUDGET_S
from datagen.pipeline import simulate_sample
from datagen.records import Sample
from datagen.store import committed, finish, prepare, schema_of, write_shard
from datagen.store.environment import cores, processor

WITHIN = 1.5


@dataclass(frozen=True)
class Held:
    """One configuration: predicted beside what came, from pilots with `effort` and one of them with `reached`."""

    name: str
    scenes: int
    effort: float
    reached: float
    outcomes: tuple[Outcome, ...]

    @property
    def worst(self) -> float:
        """The largest factor by which a known number was off."""
        known = [row.ratio for row in self.outcomes if not math.isnan(row.ratio)]
        return max((max(ratio, 1 / ratio) for ratio in known), default=1.0)


def hold(config: DatasetConfig, scenes: int, budget_s: float) -> Held:
    """Forecast a configuration by pilots from all over it, then make its first scenes in this process."""
    few = config.with_scenes(min(scenes, config.scenes))
    pilots = run_pilots(config, budget_s, partial(_in_processor_seconds, config.transport), time.process_time)
    expected = forecast(few, schema_of(few), pilots, Workers(0.0, 0.0), 1, cores())
    with tempfile.TemporaryDirectory(prefix="datagen-bench-") as folder:
        root = Path(folder) / "set"
        manifest = prepare(root, few)
        began = time.process_time()
        for shard in range(manifest.schema.shards):
            made = ((index, simulate_sample(few, index)) for index in manifest.schema.scenes_of(shard))
            write_shard(root, manifest.schema, shard, manifest.fingerprint, made)
        taken_s = time.process_time() - began
        finish(root, manifest, committed(root, manifest))
        clock, *others = against(expected, few, root)
    seconds = Outcome(clock.name, "s", expected.worker_s / few.scenes, taken_s / few.scenes)
    return Held(few.name, few.scenes, expected.effort, expected.reached, (seconds, *others))


def _in_processor_seconds(planned: TransportConfig, config: DatasetConfig, index: int) -> Sample:
    """A sample as an idle machine would have timed it, and so would have counted it against the budget."""
    began = time.process_time()
    sample = simulate_sample(config, index, planned)
    share = min(1.0, (time.process_time() - began) / max(sum(sample.seconds.values()), 1e-9))
    return replace(sample, seconds={stage: taken * share for stage, taken in sample.seconds.items()})


def head(held: Held) -> str:
    """Markdown: the head of the table."""
    columns = " | ".join(
        ("configuration", "scenes", "effort of the pilots", "of one", *(r.name for r in held.outcomes))
    )
    return f"| {columns} |\n|---|---:|---:|---:|{'---|' * len(held.outcomes)}"


def line(held: Held) -> str:
    """Markdown: predicted → actual, and the ratio."""
    cells = [
        f"{_number(row.predicted, row.unit)} → {_number(row.actual, row.unit)} ({row.ratio:.2f})"
        for row in held.outcomes
    ]
    return f"| {held.name} | {held.scenes} | {held.effort:.2g} | {held.reached:.2g} | {' | '.join(cells)} |"


def _number(value: float, unit: str) -> str:
    if math.isnan(value):
        return "unknown"
    if unit == "bytes":
        return f"{value / 1000:.3g} kB"
    return f"{value:.3g} s" if unit == "s" else f"{100 * value:.2g} %"


@click.command()
@click.argument("configs", nargs=-1, required=True)
@click.option("--scenes", default=10, show_default=True, type=click.IntRange(1), help="Scenes built of each.")
@click.option("--seconds", default=BUDGET_S, show_default=True, type=float, help="Budget of the pilots of each.")
def main(configs: tuple[str, ...], scenes: int, seconds: float) -> None:
    """Forecast and build a few scenes of every CONFIG, and print predicted beside actual."""
    if not 0 < seconds < math.inf:
        raise InputError(f"--seconds {seconds:g}: must be > 0, such as 6")
    loaded = [load_config(config) for config in configs]
    click.echo(f"Processor seconds; {processor()}, {cores()} cores\n")
    held = list[Held]()
    for config in loaded:
        held.append(hold(config, scenes, seconds))
        if len(held) == 1:
            click.echo(head(held[0]))
        click.echo(line(held[-1]))
    far = [one.name for one in held if one.worst > WITHIN]
    if far:
        raise CheckError(f"off by more than a factor of {WITHIN}: {', '.join(far)}")


if __name__ == "__main__":
    raise SystemExit(guarded(main))
