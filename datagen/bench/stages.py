"""Where a dataset's time goes: `python -m datagen.bench.stages CONFIG`.

Builds a few scenes into a temporary folder with one worker and with two, and prints a Markdown table from the commit
records: seconds per scene by stage (median over scenes), and scenes per second. A worker's first scenes pay for
loading and compiling the kernels; a first build, not counted, leaves the compiled kernels on disk, and each worker's
first shard is left out of the rates.
"""

from __future__ import annotations

import statistics
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from datagen.building.build import build
from datagen.config import DatasetConfig, load_config
from datagen.exit_status import guarded
from datagen.store import ShardRecord, committed, read_manifest
from datagen.store.environment import cores, processor
from datagen.store.info import STAGES

SCENES_PER_SHARD = 2


@dataclass(frozen=True)
class Timing:
    """seconds : stage → median seconds per scene. scenes_per_s : of the whole build, workers started and warm."""

    workers: int
    scenes: int
    seconds: dict[str, float]
    scenes_per_s: float


def measure(config: DatasetConfig, workers: int, scenes: int) -> Timing:
    """Build `scenes` scenes with `workers` workers, and read the times from the commit records."""
    small = config.with_scenes(scenes)
    store = small.store.model_copy(update={"scenes_per_shard": SCENES_PER_SHARD})
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "set"
        build(small.model_copy(update={"store": store}), root, workers, progress=False)
        records = sorted(committed(root, read_manifest(root)), key=lambda record: record.finished)
    return Timing(workers, scenes, _stages(records), _rate(records, workers))


def _stages(records: Sequence[ShardRecord]) -> dict[str, float]:
    scenes = [scene for record in records for scene in record.scenes]
    seconds = {
        stage: statistics.median(scene.seconds[stage] for scene in scenes) for stage in STAGES if stage != "store"
    }
    seconds["store"] = statistics.median(record.seconds["store"] / len(record.scenes) for record in records)
    return seconds


def _rate(records: Sequence[ShardRecord], workers: int) -> float:
    """Scenes per second from the end of the last worker's first shard to the end of all."""
    warm = records[workers - 1].finished
    after = [record for record in records if record.finished > warm]
    return sum(len(record.scenes) for record in after) / (after[-1].finished - warm)


def table(timings: Sequence[Timing]) -> str:
    """Markdown: a row for each number of workers."""
    head = ["workers", *(f"{stage} (s)" for stage in STAGES), "sum (s)", "scenes/s"]
    lines = [f"| {' | '.join(head)} |", "|" + "---:|" * len(head)]
    for timing in timings:
        cells = [timing.seconds[stage] for stage in STAGES]
        numbers = " | ".join(f"{cell:.4f}" for cell in [*cells, sum(cells)])
        lines.append(f"| {timing.workers} | {numbers} | {timing.scenes_per_s:.2f} |")
    return "\n".join(lines)


@click.command()
@click.argument("config")
@click.option("--scenes", default=16, show_default=True, type=click.IntRange(8), help="Scenes of each build.")
@click.option("--workers", default="1,2", show_default=True, help="Numbers of workers, one row each.")
def main(config: str, scenes: int, workers: str) -> None:
    """Print seconds per scene by stage, and scenes per second, for CONFIG."""
    loaded = load_config(config)
    counts = [int(count) for count in workers.split(",")]
    measure(loaded, max(counts), SCENES_PER_SHARD * (max(counts) + 1))
    timings = [measure(loaded, count, scenes) for count in counts]
    click.echo(f"{loaded.name}, medians over {scenes} scenes; {processor()}, {cores()} cores\n")
    click.echo(table(timings))


if __name__ == "__main__":
    raise SystemExit(guarded(main))
