"""From pilot scenes to the whole build: arithmetic only, so that the same pilots always give the same forecast."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from datagen.building.engines import SHARDS_PER_PROCESS
from datagen.config import DatasetConfig
from datagen.errors import InputError
from datagen.forecast.ladder import Pilot
from datagen.forecast.pilots import Pilots
from datagen.forecast.probe import Workers
from datagen.store import Schema, ShardRecord, committed, read_manifest
from datagen.store.arrays import metadata_files

NOISY_FIELDS = ("transient", "transient_stderr")
"""Fields whose compressed size depends on effort: with more lookins more bins hold something."""


@dataclass(frozen=True)
class Forecast:
    """What building a dataset is expected to take and to give.

    Attributes
    ----------
    pilots, effort : how many pilot scenes, with which share of the configured effort.
    reached : the share that one of them was run with besides, by which the others are scaled.
    seconds : stage → seconds of one scene, mean over the pilots, at full effort; "store" with its share of the shard.
    scene_s : least, median and greatest total of a pilot scene, seconds.
    error : least, median and greatest estimated relative L2 error of a transient; NaN when nothing estimates it.
    stored : field → bytes on disk of one scene, mean; "records": its share of the commit record.
    workers, working : processes asked for, and those that have a shard to work on.
    startup_s : of each worker process.
    worker_s : seconds that all workers together work. build_s : the whole build, wall clock.
    build_bytes : the whole dataset on disk. shard_memory_bytes : what a worker holds of the shard it fills.
    processor_share : processor time of the pilots over their wall-clock time; far below 1 on a busy machine.
    """

    scenes: int
    shards: int
    scenes_per_shard: int
    pilots: int
    effort: float
    reached: float
    seconds: Mapping[str, float]
    scene_s: tuple[float, float, float]
    error: tuple[float, float, float]
    stored: Mapping[str, float]
    workers: int
    working: int
    startup_s: float
    worker_s: float
    build_s: float
    build_bytes: float
    shard_memory_bytes: int
    processor_share: float

    @property
    def bytes_per_scene(self) -> float:
        return sum(self.stored.values())

    def as_json(self) -> dict[str, Any]:
        """Plain values; NaN, which JSON has not, becomes None."""
        values = {**asdict(self), "bytes_per_scene": self.bytes_per_scene}
        return {key: _without_nan(value) for key, value in values.items()}


def forecast(
    config: DatasetConfig, schema: Schema, pilots: Pilots, running: Workers, workers: int, cores: int
) -> Forecast:
    """The forecast of a build with `workers` processes on a machine with `cores` cores.

    What was measured with full effort is left as it is; seconds of the transport, errors and bytes of pilots with
    less are scaled as `ladder.py` says.
    """
    rate = pilots.ladder.slower(pilots.effort)
    working = min(workers, schema.shards)
    sharing = max(1.0, working / cores)
    each = [_stages(pilot, rate) for pilot in pilots.scenes]
    seconds = {stage: statistics.fmean(one[stage] for one in each) for stage in each[0]}
    slower, scene_s = running.slowdown * sharing, sum(seconds.values()) + pilots.store_scene_s
    first_s, last_s = (
        (len(schema.scenes_of(shard)) * scene_s + pilots.store_shard_s) * slower for shard in (0, schema.shards - 1)
    )
    startup_s = running.startup_s * sharing
    starts = working * math.ceil(math.ceil(schema.shards / working) / SHARDS_PER_PROCESS)
    seconds["store"] = pilots.store_scene_s + pilots.store_shard_s / schema.scenes_per_shard
    totals = sorted(sum(one.values()) + seconds["store"] for one in each)
    stored = _stored(pilots, schema)
    fixed = sum(map(len, metadata_files(schema).values())) + pilots.about_bytes
    table = pilots.table_bytes[0] + pilots.table_bytes[1] * (schema.scenes - 1)
    return Forecast(
        scenes=schema.scenes,
        shards=schema.shards,
        scenes_per_shard=schema.scenes_per_shard,
        pilots=len(pilots.scenes),
        effort=pilots.effort,
        reached=pilots.ladder.top.effort,
        seconds=seconds,
        scene_s=(totals[0], statistics.median(totals), totals[-1]),
        error=_errors(config, pilots),
        stored=stored,
        workers=workers,
        working=working,
        startup_s=running.startup_s,
        worker_s=(schema.shards - 1) * first_s + last_s + starts * startup_s,
        build_s=wall_seconds(schema.shards, working, first_s, last_s, startup_s),
        build_bytes=schema.scenes * sum(stored.values()) + table + fixed,
        shard_memory_bytes=schema.scenes_per_shard * schema.bytes_per_scene,
        processor_share=min(1.0, _share(pilots.scenes)),
    )


def wall_seconds(shards: int, workers: int, shard_s: float, last_s: float, startup_s: float) -> float:
    """How long `workers` processes take over `shards` equal shards, of which the last may be smaller.

    Each takes the next shard when it is done with one, and is replaced after `SHARDS_PER_PROCESS` of them.
    """
    rounds = math.ceil(shards / workers)
    alone_last = (shards - 1) % workers == 0
    busy = (rounds - 1) * shard_s + (last_s if alone_last else shard_s)
    return busy + math.ceil(rounds / SHARDS_PER_PROCESS) * startup_s


def _stages(pilot: Pilot, rate: float) -> dict[str, float]:
    return {stage: taken * (rate if stage == "transport" else 1.0) for stage, taken in pilot.seconds.items()}


def _errors(config: DatasetConfig, pilots: Pilots) -> tuple[float, float, float]:
    found = sorted(pilot.error for pilot in pilots.scenes if math.isfinite(pilot.error))
    if not found:
        return math.nan, math.nan, math.nan
    if pilots.effort < 1.0:
        targeted = config.transport.target is not None
        found = [pilots.ladder.at_full(error, pilots.effort, targeted) for error in found]
    return found[0], statistics.median(found), found[-1]


def _stored(pilots: Pilots, schema: Schema) -> dict[str, float]:
    """Field → bytes of a scene at full effort."""
    stored = {
        name: statistics.fmean(pilot.stored[name] for pilot in pilots.scenes) for name in pilots.scenes[0].stored
    }
    for name in NOISY_FIELDS:
        if name in stored:
            most = float(schema.by_name[name].bytes_per_scene)
            stored[name] = min(stored[name] * pilots.ladder.larger(name, pilots.effort), most)
    stored["records"] += pilots.shard_bytes / schema.scenes_per_shard
    return stored


def _share(scenes: Sequence[Pilot]) -> float:
    wall = sum(pilot.total_s for pilot in scenes)
    return sum(pilot.processor_s for pilot in scenes) / wall if wall > 0 else 1.0


def _without_nan(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value


@dataclass(frozen=True)
class Outcome:
    """One number of a build (medians over scenes for seconds and error): what was expected, and what it came to.

    unit : "s", "bytes" or "" for a share.
    """

    name: str
    unit: str
    predicted: float
    actual: float

    @property
    def ratio(self) -> float:
        """Actual over predicted; NaN when either is unknown or nothing."""
        return self.actual / self.predicted if self.predicted > 0 and self.actual > 0 else math.nan

    def as_json(self) -> dict[str, Any]:
        return {key: _without_nan(value) for key, value in asdict(self).items()}


def check_same(config: DatasetConfig, dataset: str | Path) -> list[ShardRecord]:
    """The records of a dataset's shards; raises `InputError` as `against` does."""
    root = Path(dataset)
    manifest = read_manifest(root)
    if manifest.fingerprint != config.fingerprint():
        raise InputError(
            f"--against {root}: was built from another configuration (fingerprint {manifest.fingerprint[:12]}, "
            f"not {config.fingerprint()[:12]}); name a dataset of this one"
        )
    records = committed(root, manifest)
    if all(scene.failure for record in records for scene in record.scenes):
        raise InputError(f"--against {root}: holds no finished scene yet; build it first")
    return records


def against(expected: Forecast, config: DatasetConfig, dataset: str | Path) -> list[Outcome]:
    """Hold a forecast against a dataset that was built from the same configuration.

    Raises
    ------
    InputError : the folder is no dataset, was made from another configuration, or holds no scene yet.
    """
    records = check_same(config, dataset)
    made = [scene for record in records for scene in record.scenes if scene.failure is None]
    scenes = sum(len(record.scenes) for record in records)
    staged_s = sum(sum(scene.seconds.values()) for record in records for scene in record.scenes)
    store_s = (sum(record.seconds["total"] for record in records) - staged_s) / scenes
    scene_s = statistics.median(sum(scene.seconds.values()) for scene in made) + store_s
    errors = [float(scene.parameters.get("transient.relative_error", math.nan)) for scene in made]
    files = sum(path.stat().st_size for path in Path(dataset).rglob("*") if path.is_file())
    return [
        Outcome("seconds per scene", "s", expected.scene_s[1], scene_s),
        Outcome("relative error", "", expected.error[1], statistics.median(errors)),
        Outcome("bytes per scene", "bytes", expected.build_bytes / expected.scenes, files / scenes),
    ]
