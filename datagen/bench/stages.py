"""Where a build's time goes: seconds per scene by stage, and scenes per second, from the records of small builds.

A worker's first scenes include loading and compiling the kernels: a first build, which is not counted, leaves
compiled kernels on disk, and each worker's first shard is left out of the rates. The time of a million scenes is
extrapolated from the processor seconds of a few, made one after the other, which depend little on other work of the
machine.
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Sequence
from pathlib import Path

import click

from datagen.bench.measuring import machine, markdown, processor_seconds
from datagen.building.build import build
from datagen.config import DatasetConfig, load_config
from datagen.config.scans import GridScan
from datagen.errors import InputError
from datagen.pipeline import simulate_sample
from datagen.store import ShardRecord, committed_records, prepare, read_manifest, schema_of, write_shard
from datagen.store.columns import Columns
from datagen.store.description import seconds_of
from datagen.store.info import STAGES, seconds_by_stage

LEAST_SHARDS = 4
"""Fewest shards of a build: two workers' first ones, which are left out of the rates, and as many after them."""
SIMULATION = ("scene", "transport", "detector")
"""Stages that make a sample; all others count as overhead."""
CORES = 16
"""Cores of the machine for which a million scenes are extrapolated."""


def shard_size(config: DatasetConfig, scenes: int) -> int:
    """Scenes in a shard: as many as a dataset of `scenes` scenes has, or fewer for at least `LEAST_SHARDS` shards."""
    return min(
        schema_of(config.with_scenes(scenes)).scenes_per_shard, 1 << ((scenes // LEAST_SHARDS).bit_length() - 1)
    )


def records_of_build(config: DatasetConfig, workers: int, scenes: int) -> list[ShardRecord]:
    """Build `scenes` scenes with `workers` workers; the records in the order in which they were finished."""
    store = config.store.model_copy(update={"scenes_per_shard": shard_size(config, scenes)})
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "set"
        build(config.with_scenes(scenes).model_copy(update={"store": store}), root, workers, progress=False)
        return sorted(committed_records(root, read_manifest(root)), key=lambda record: record.finished)


def scenes_per_second(records: Sequence[ShardRecord], workers: int) -> float:
    """Scenes per second, from the end of the last worker's first shard to the end of all."""
    warm = records[workers - 1].finished
    after = [record for record in records if record.finished > warm]
    return sum(len(record.scenes) for record in after) / (after[-1].finished - warm)


def with_scan(config: DatasetConfig, scan: str) -> DatasetConfig:
    """The configuration with another number of laser points and bins.

    scan : rows, columns and bins, such as 64x64x512.

    Raises
    ------
    InputError : for a text that is no such numbers, or a configuration without a grid of laser points.
    """
    counts = scan.split("x")
    if len(counts) != 3 or not all(count.isdigit() and int(count) > 0 for count in counts):
        raise InputError(f"--scan {scan}: must be rows, columns and bins, such as 64x64x512")
    rows, columns, bins = (int(count) for count in counts)
    grid, time = config.capture.scan, config.capture.time
    if config.capture.device is not None:
        raise InputError(f"--scan {scan}: {config.name} has a device, from which its scan follows; leave --scan out")
    if not isinstance(grid, GridScan):
        raise InputError(f"--scan {scan}: {config.name} has no grid of laser points")
    changed = {"scan": grid.model_copy(update={"rows": rows, "columns": columns}),
               "time": time.model_copy(update={"bins": bins})}  # fmt: skip
    return config.model_copy(update={"capture": config.capture.model_copy(update=changed)})


def processor_seconds_of_scenes(config: DatasetConfig, scenes: int) -> list[float]:
    """Processor seconds of each of `scenes` scenes, from seed to shard, after a first one that compiles kernels."""
    alone = config.store.model_copy(update={"scenes_per_shard": 1})
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "set"
        manifest = prepare(root, config.with_scenes(scenes + 1).model_copy(update={"store": alone}))

        def made(shard: int) -> ShardRecord:
            samples = ((index, simulate_sample(config, index)) for index in manifest.schema.scenes_of(shard))
            return write_shard(root, manifest.schema, shard, manifest.fingerprint, samples)

        return [processor_seconds(lambda shard=shard: made(shard))[1] for shard in range(scenes + 1)][1:]  # type: ignore[misc]


def a_million(config: DatasetConfig, seconds: Sequence[float]) -> str:
    """One line: the time of 10⁶ scenes on `CORES` cores."""
    mean = statistics.mean(seconds)
    spread = f"{min(seconds):.2g} … {max(seconds):.2g}"
    days = 1e6 * mean / CORES / 86400
    return (
        f"{config.name}: {mean:.3g} processor s a scene (mean of {len(seconds)}, {spread}): a million of them would "
        f"take {days:.2g} days on {CORES} cores"
    )


@click.command()
@click.argument("config")
@click.option("--scenes", default=64, show_default=True, type=click.IntRange(8), help="Scenes of each build.")
@click.option("--workers", default="1,2", show_default=True, help="Numbers of workers, one row each.")
@click.option("--scan", help="Rows, columns and bins instead of CONFIG's, such as 64x64x512.")
@click.option("--million", is_flag=True, help="Say instead what a million scenes would take, by --scenes of them.")
def main(config: str, scenes: int, workers: str, scan: str | None, million: bool) -> None:
    """Print seconds per scene by stage, and scenes per second, for CONFIG; or what a million scenes would take."""
    loaded = load_config(config) if scan is None else with_scan(load_config(config), scan)
    if million:
        what = f"{scan}, " if scan else ""
        click.echo(f"{what}{a_million(loaded, processor_seconds_of_scenes(loaded, scenes))}; {machine()}")
        return
    shards = scenes // shard_size(loaded, scenes)
    if not all(count.isdigit() and 0 < int(count) < shards for count in workers.split(",")):
        raise InputError(
            f"--workers {workers}: must be numbers such as 1,2, less than the {shards} shards of --scenes"
        )
    counts = [int(count) for count in workers.split(",")]
    records_of_build(loaded, max(counts), 8)
    rows = []
    for count in counts:
        records = records_of_build(loaded, count, scenes)
        medians = seconds_by_stage(Columns(seconds for record in records for seconds in seconds_of(record)))
        stages = [stage for stage in STAGES if stage in medians]
        taken = [medians[stage] for stage in stages]
        rate = scenes_per_second(records, count)
        added = 1 - sum(medians.get(stage, 0.0) for stage in SIMULATION) / sum(taken)
        rows.append([str(count), *(f"{cell:.4f}" for cell in [*taken, sum(taken)]), f"{added:.1%}", f"{rate:.2f}"])
    size = shard_size(loaded, scenes)
    click.echo(f"{loaded.name}, medians over {scenes} scenes in shards of {size}; {machine()}\n")
    heading = ["workers", *(f"{stage} (s)" for stage in stages), "sum (s)", "overhead", "scenes/s"]
    click.echo(markdown(heading, rows))
    click.echo(f"\noverhead: the share of all stages but {', '.join(SIMULATION)}")
