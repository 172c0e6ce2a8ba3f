"""The forecast of a whole build from its pilot scenes, by arithmetic only: the same pilots give the same forecast."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from datagen.config import DatasetConfig
from datagen.errors import InputError
from datagen.forecast.pilots import Pilots
from datagen.store import Schema, ShardRecord, committed, read_manifest
from datagen.store.files import bytes_below, finite
from datagen.store.record import scenes_made
from datagen.store.summaries import KindEvidence


@dataclass(frozen=True)
class Forecast:
    """The expected time, size and error of a dataset.

    pilots, effort : number of pilot scenes, and the share of the configured paths that they had (1, or a trial's).
    failed : pilot scene → reason why it could not be made.
    seconds : stage → seconds of one scene, mean over the pilots.
    processor_s : processor seconds of one scene, mean; far below the sum of `seconds` on a busy machine.
    scene_s : least, median and greatest total of a pilot scene, seconds.
    error : least, median and greatest estimated relative L2 error of a transient; NaN when nothing estimates it.
    stored : field → bytes on disk of one scene, mean; "records": its commit record and its row of the table.
    workers, working : number of worker processes, and of those that have a scene to work on.
    startup_s : seconds until a worker process is warm.
    build_s : wall-clock seconds of the whole build.
    build_bytes : bytes of the whole dataset on disk. shard_memory_bytes : memory of the shard that a worker fills.
    evidence : significance of the objects of the pilot scenes, by kind.
    """

    scenes: int
    shards: int
    scenes_per_shard: int
    pilots: int
    effort: float
    failed: Mapping[int, str]
    seconds: Mapping[str, float]
    processor_s: float
    scene_s: tuple[float, float, float]
    error: tuple[float, float, float]
    stored: Mapping[str, float]
    workers: int
    working: int
    startup_s: float
    build_s: float
    build_bytes: float
    shard_memory_bytes: int
    evidence: tuple[KindEvidence, ...] = ()

    @property
    def bytes_per_scene(self) -> float:
        """Bytes on disk of one scene: all fields, its commit record and its row of the table."""
        return sum(self.stored.values())

    @property
    def processor_share(self) -> float:
        """Processor time of the pilots over their wall-clock time, at most 1."""
        total = sum(self.seconds.values())
        return min(1.0, self.processor_s / total) if total > 0 else 1.0

    def as_json(self) -> dict[str, Any]:
        """The forecast as plain values for JSON, with None in place of NaN."""
        values = {**asdict(self), "bytes_per_scene": self.bytes_per_scene, "processor_share": self.processor_share}
        return dict(finite(values))


def forecast(schema: Schema, pilots: Pilots, startup_s: float, workers: int, cores: int) -> Forecast:
    """The forecast of a build with `workers` processes on a machine with `cores` cores, from the means of its pilots.

    The wall-clock time is that of the busiest worker, which makes every `workers`-th scene; if there are more workers
    than cores, they share these.
    """
    scenes = [pilot.at_full_effort() for pilot in pilots.scenes]
    seconds = {stage: statistics.fmean(one.seconds[stage] for one in scenes) for stage in scenes[0].seconds}
    working = min(workers, schema.scenes)
    busiest = math.ceil(schema.scenes / working)
    sharing = max(1.0, working / cores)
    return Forecast(
        scenes=schema.scenes,
        shards=schema.shards,
        scenes_per_shard=schema.scenes_per_shard,
        pilots=len(scenes),
        effort=pilots.scenes[0].effort,
        failed=pilots.failed,
        seconds=seconds,
        processor_s=statistics.fmean(one.processor_s for one in scenes),
        scene_s=_spread([one.total_s for one in scenes]),
        error=_spread([one.error for one in scenes if math.isfinite(one.error)]),
        stored=pilots.stored,
        workers=workers,
        working=working,
        startup_s=startup_s,
        build_s=sharing * (busiest * sum(seconds.values()) + startup_s),
        build_bytes=schema.scenes * sum(pilots.stored.values()) + pilots.fixed_bytes,
        shard_memory_bytes=schema.scenes_per_shard * schema.bytes_per_scene,
        evidence=pilots.evidence,
    )


def _spread(values: Sequence[float]) -> tuple[float, float, float]:
    """Least, median and greatest value; NaN if there are none."""
    return (min(values), statistics.median(values), max(values)) if values else (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class Outcome:
    """One number of a build, predicted and actual. unit : "s", "bytes" or "" for a fraction."""

    name: str
    unit: str
    predicted: float
    actual: float

    @property
    def ratio(self) -> float:
        """Actual over predicted; NaN if either is unknown or 0."""
        return self.actual / self.predicted if self.predicted > 0 and self.actual > 0 else math.nan


def records_of(config: DatasetConfig, dataset: str | Path) -> list[ShardRecord]:
    """The records of a dataset's shards.

    Raises
    ------
    InputError : the folder is no dataset, was built from another configuration, or holds no scene yet.
    """
    root = Path(dataset)
    manifest = read_manifest(root)
    if manifest.fingerprint != config.fingerprint():
        raise InputError(
            f"--against {root}: was built from another configuration (fingerprint {manifest.fingerprint[:12]}, "
            f"not {config.fingerprint()[:12]}); name a dataset of this one"
        )
    records = committed(root, manifest)
    if not scenes_made(records):
        raise InputError(f"--against {root}: holds no finished scene yet; build it first")
    return records


def outcomes(expected: Forecast, records: Sequence[ShardRecord], dataset: str | Path) -> list[Outcome]:
    """The forecast's numbers beside those of the dataset: medians over scenes of seconds and error, and bytes."""
    made = scenes_made(records)
    scenes = sum(len(record.scenes) for record in records)
    store_s = sum(record.seconds["store"] for record in records) / scenes
    scene_s = statistics.median(sum(scene.seconds.values()) for scene in made) + store_s
    errors = [float(scene.parameters.get("transient.relative_error", math.nan)) for scene in made]
    files = bytes_below(Path(dataset))
    return [
        Outcome("seconds per scene", "s", expected.scene_s[1], scene_s),
        Outcome("relative error", "", expected.error[1], statistics.median(errors)),
        Outcome("bytes per scene", "bytes", expected.build_bytes / expected.scenes, files / scenes),
    ]
