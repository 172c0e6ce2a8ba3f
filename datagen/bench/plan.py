"""Whether a plan comes true: pilots of each configuration, then its first scenes made as a worker does.

Only one of the pilots, which are spread over the dataset, is among those. Processor seconds of pilots and scenes
alike, because the clock of a busy machine says little; what a worker's start takes is left out.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import click

from datagen.bench.measuring import machine, markdown, processor_seconds
from datagen.config import DatasetConfig, load_config
from datagen.errors import CheckError, InputError
from datagen.forecast.forecast import Forecast, Outcome, forecast, outcomes
from datagen.forecast.pilots import run_pilots
from datagen.forecast.text import BUDGET_S, quantity
from datagen.pipeline import simulate_sample
from datagen.store import ShardRecord, committed, finish, prepare, schema_of, write_shard

WITHIN = 1.5
"""Largest factor by which a forecast may be off."""


def predicted_and_actual(config: DatasetConfig, scenes: int, budget_s: float) -> tuple[Forecast, list[Outcome]]:
    """Forecast a configuration by pilots from all over it, then make its first scenes in this process."""
    few = config.with_scenes(min(scenes, config.scenes))
    expected = forecast(schema_of(few), run_pilots(config, budget_s), startup_s=0.0, workers=1, cores=1)
    with tempfile.TemporaryDirectory(prefix="datagen-bench-") as folder:
        root = Path(folder) / "set"
        records, taken_s = processor_seconds(lambda: _built(few, root))
        _, *others = outcomes(expected, records, root)
    return expected, [Outcome("seconds per scene", "s", expected.processor_s, taken_s / few.scenes), *others]


def _built(config: DatasetConfig, root: Path) -> list[ShardRecord]:
    manifest = prepare(root, config)
    for shard in range(manifest.schema.shards):
        made = ((index, simulate_sample(config, index)) for index in manifest.schema.scenes_of(shard))
        write_shard(root, manifest.schema, shard, manifest.fingerprint, made)
    records = committed(root, manifest)
    finish(root, manifest, records)
    return records


def furthest_off(held: list[Outcome]) -> float:
    """The largest factor by which a known number was off."""
    known = [row.ratio for row in held if not math.isnan(row.ratio)]
    return max((max(ratio, 1 / ratio) for ratio in known), default=1.0)


@click.command()
@click.argument("configs", nargs=-1, required=True)
@click.option("--scenes", default=10, show_default=True, type=click.IntRange(1), help="Scenes built of each.")
@click.option("--seconds", default=BUDGET_S, show_default=True, type=float, help="Budget of the pilots of each.")
def main(configs: tuple[str, ...], scenes: int, seconds: float) -> None:
    """Forecast and build a few scenes of every CONFIG: predicted → actual (ratio). Status 1 when one is far off."""
    if not 0 < seconds < math.inf:
        raise InputError(f"--seconds {seconds:g}: must be > 0, such as {BUDGET_S:g}")
    far, rows = list[str](), list[list[str]]()
    for config in [load_config(config) for config in configs]:
        expected, held = predicted_and_actual(config, scenes, seconds)
        cells = [
            f"{quantity(row.predicted, row.unit)} → {quantity(row.actual, row.unit)} ({row.ratio:.2f})"
            for row in held
        ]
        pilots = str(expected.pilots) if expected.effort == 1.0 else f"1 of {expected.effort:.2g} effort"
        rows.append([config.name, str(min(scenes, config.scenes)), pilots, *cells])
        far += [config.name] if furthest_off(held) > WITHIN else []
    click.echo(f"Processor seconds; {machine()}\n")
    click.echo(markdown(["configuration", "scenes", "pilots", *(row.name for row in held)], rows))
    if far:
        raise CheckError(f"off by more than a factor of {WITHIN}: {', '.join(far)}")
