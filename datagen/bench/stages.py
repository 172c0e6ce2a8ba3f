"""Where a build's time goes: seconds per scene by stage, and scenes per second, from the records of small builds.

A worker's first scenes pay for loading and compiling the kernels: a first build, not counted, leaves the compiled
kernels on disk, and each worker's first shard is left out of the rates.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import click

from datagen.bench.measuring import machine, markdown
from datagen.building.build import build
from datagen.config import DatasetConfig, load_config
from datagen.errors import InputError
from datagen.store import ShardRecord, committed, read_manifest
from datagen.store.info import STAGES, seconds_by_stage

SCENES_PER_SHARD = 2


def records_of_build(config: DatasetConfig, workers: int, scenes: int) -> list[ShardRecord]:
    """Build `scenes` scenes with `workers` workers; the records in the order in which they were finished."""
    store = config.store.model_copy(update={"scenes_per_shard": SCENES_PER_SHARD})
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "set"
        build(config.with_scenes(scenes).model_copy(update={"store": store}), root, workers, progress=False)
        return sorted(committed(root, read_manifest(root)), key=lambda record: record.finished)


def scenes_per_second(records: Sequence[ShardRecord], workers: int) -> float:
    """From the end of the last worker's first shard to the end of all."""
    warm = records[workers - 1].finished
    after = [record for record in records if record.finished > warm]
    return sum(len(record.scenes) for record in after) / (after[-1].finished - warm)


@click.command()
@click.argument("config")
@click.option("--scenes", default=16, show_default=True, type=click.IntRange(8), help="Scenes of each build.")
@click.option("--workers", default="1,2", show_default=True, help="Numbers of workers, one row each.")
def main(config: str, scenes: int, workers: str) -> None:
    """Print seconds per scene by stage, and scenes per second, for CONFIG."""
    loaded = load_config(config)
    if not all(count.isdigit() and 0 < int(count) < scenes // SCENES_PER_SHARD for count in workers.split(",")):
        raise InputError(f"--workers {workers}: must be numbers such as 1,2, less than half of --scenes {scenes}")
    counts = [int(count) for count in workers.split(",")]
    records_of_build(loaded, max(counts), SCENES_PER_SHARD * (max(counts) + 1))
    rows = []
    for count in counts:
        records = records_of_build(loaded, count, scenes)
        medians = seconds_by_stage(records)
        taken = [medians[stage] for stage in STAGES]
        rate = scenes_per_second(records, count)
        rows.append([str(count), *(f"{cell:.4f}" for cell in [*taken, sum(taken)]), f"{rate:.2f}"])
    click.echo(f"{loaded.name}, medians over {scenes} scenes; {machine()}\n")
    click.echo(markdown(["workers", *(f"{stage} (s)" for stage in STAGES), "sum (s)", "scenes/s"], rows))
