"""The plan of a build: a few of its scenes are simulated and written as a build does, and what the build would take
and make is their mean times the number of scenes."""

from __future__ import annotations

import math
import statistics
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from datagen.building.engines import check_workers
from datagen.building.input_check import check_inputs
from datagen.config import DatasetConfig
from datagen.design.exposure import with_exposure_found
from datagen.errors import InputError
from datagen.pipeline import simulate_sample
from datagen.records import Sample, Scalar
from datagen.records.checks import as_given
from datagen.store import prepare, schema_of, write_shard
from datagen.store.columns import Columns
from datagen.store.environment import cores
from datagen.store.files import finite
from datagen.store.summaries import KindEvidence, evidence_by_kind

SECONDS = 5.0
"""After how many seconds no further scene is begun: some ten scenes of an ordinary scan."""
FEWEST = 3
"""Fewest scenes that are simulated, however long they take: the seconds of the first do not count, as it also loads
compiled code, and two show how different scenes are."""

MOST = 32
"""Most scenes that are simulated, whose samples are kept until they are written: their objects show enough."""

Range = tuple[float, float, float]
"""Least value, mean and greatest value."""


@dataclass(frozen=True)
class Pilots:
    """A few scenes of a dataset, simulated and written as by a build.

    seconds : stage → processor seconds, for each scene. parameters : those of the samples: errors, evidence, effects.
    stored : field → bytes on disk of a scene, mean, and those of its commit record as "record".
    failed : scene → reason why it could not be made.
    """

    seconds: tuple[Mapping[str, float], ...]
    parameters: tuple[Mapping[str, Scalar], ...]
    stored: Mapping[str, float]
    failed: Mapping[int, str]


@dataclass(frozen=True)
class Plan:
    """What a build would take and make.

    seconds : stage → processor seconds of a scene, mean over the scenes after the first, which also loads compiled
        code. scene_s : of all stages together.
    scene_bytes : bytes on disk of all fields of a scene and of its commit record, mean.
    error : relative L2 error of a transient that the simulation claims; NaN if nothing estimates it.
    evidence : significance of the objects, by kind.
    build_s : wall-clock seconds of the whole build on idle cores, without the start of the workers.
    build_bytes : bytes of all scenes on disk. shard_memory_bytes : memory of a shard, which the worker that
        writes it needs.
    """

    pilots: Pilots
    scenes: int
    shards: int
    scenes_per_shard: int
    seconds: Mapping[str, float]
    scene_s: Range
    scene_bytes: float
    error: Range
    evidence: tuple[KindEvidence, ...]
    workers: int
    build_s: float
    build_bytes: float
    shard_memory_bytes: int

    def as_json(self) -> dict[str, Any]:
        """The plan as plain values for JSON, with None in place of NaN."""
        values = {name: value for name, value in asdict(self).items() if name != "pilots"}
        of = self.pilots
        return dict(finite({**values, "simulated": len(of.parameters), "stored": of.stored, "failed": of.failed}))


def plan_build(config: DatasetConfig, workers: int = 1, seconds: float = SECONDS) -> Plan:
    """The plan of a build with `workers` processes on this machine.

    Whole scenes are simulated, the first ones of the dataset, until `seconds` have passed, but at least `FEWEST` and
    at most `MOST`.

    Raises
    ------
    InputError : whatever a build would refuse; `workers` under 1; `seconds` that are no positive number; none of the
        scenes can be made.
    """
    check_workers(workers)
    if not 0 < seconds < math.inf:
        raise InputError(f"{as_given('seconds', seconds)}: must be > 0, such as {SECONDS:g}")
    config = with_exposure_found(config)
    check_inputs(config)
    return plan_of(config, simulated_scenes(config, seconds), workers, cores())


def simulated_scenes(config: DatasetConfig, seconds: float) -> Pilots:
    """The first scenes of a dataset, simulated until `seconds` have passed."""
    made, taken = list[tuple[int, Sample | str]](), list[Mapping[str, float]]()
    began = time.perf_counter()
    for index in range(min(config.scenes, MOST)):
        if index >= FEWEST and time.perf_counter() - began > seconds:
            break
        begun, begun_s = time.perf_counter(), time.process_time()
        try:
            sample = simulate_sample(config, index)
        except InputError as refusal:
            made.append((index, str(refusal)))
            continue
        # Of a machine that others use, too, a scene has a share only: its processor seconds are those of a core.
        busy = (time.process_time() - begun_s) / (time.perf_counter() - begun)
        taken.append({stage: busy * stage_s for stage, stage_s in sample.seconds.items()})
        made.append((index, sample))
    return _pilots_written(config, made, taken)


def _pilots_written(
    config: DatasetConfig, made: Sequence[tuple[int, Sample | str]], taken: Sequence[Mapping[str, float]]
) -> Pilots:
    """The pilots whose samples or reasons for failures are given, written in shards as by the build."""
    per_shard = min(schema_of(config).scenes_per_shard, len(made))
    store = config.store.model_copy(update={"scenes_per_shard": per_shard})
    with tempfile.TemporaryDirectory(prefix="datagen-plan-") as folder:
        manifest = prepare(Path(folder), config.with_scenes(len(made)).model_copy(update={"store": store}))
        schema = manifest.schema
        shards = [[made[k] for k in schema.scenes_of(shard)] for shard in range(schema.shards)]
        # The first of two times loads what writing needs, as the first scene does.
        for _ in range(2):
            begun_s = time.process_time()
            records = [
                write_shard(Path(folder), schema, k, manifest.fingerprint, shard) for k, shard in enumerate(shards)
            ]
            store_s = (time.process_time() - begun_s) / len(made)
    failed = {index: reason for record in records for index, reason in record.failures.items()}
    if len(failed) == len(made):
        raise InputError(f"none of the first {len(made)} scenes can be made; scene 0: {failed[0]}")
    files = [(path, file.bytes) for record in records for path, file in record.files.items()]
    number = len(made) - len(failed)
    stored = {of.name: sum(size for path, size in files if f"/{of.name}/" in path) / number for of in schema.fields}
    stored["record"] = sum(len(record.to_bytes()) for record in records) / number
    parameters = tuple(scene.parameters for record in records for scene in record.scenes if scene.failure is None)
    return Pilots(tuple({**stages, "store": store_s} for stages in taken), parameters, stored, failed)


def plan_of(config: DatasetConfig, pilots: Pilots, workers: int, machine_cores: int) -> Plan:
    """The plan that follows from pilots: each worker makes its share of the scenes one after another, and workers
    beyond the number of cores share these."""
    schema = schema_of(config)
    timed = pilots.seconds[1:] or pilots.seconds
    errors = [float(of.get("transient.relative_error", math.nan)) for of in pilots.parameters]
    scene_s, scene_bytes = _range([sum(stages.values()) for stages in timed]), sum(pilots.stored.values())
    working = min(workers, config.scenes)
    return Plan(
        pilots=pilots,
        scenes=config.scenes,
        shards=schema.shards,
        scenes_per_shard=schema.scenes_per_shard,
        seconds={stage: statistics.fmean(of.get(stage, 0.0) for of in timed) for stage in timed[0]},
        scene_s=scene_s,
        scene_bytes=scene_bytes,
        error=_range([error for error in errors if math.isfinite(error)]),
        evidence=tuple(evidence_by_kind(Columns(pilots.parameters))),
        workers=workers,
        build_s=max(1.0, working / machine_cores) * math.ceil(config.scenes / working) * scene_s[1],
        build_bytes=config.scenes * scene_bytes,
        shard_memory_bytes=schema.scenes_per_shard * schema.bytes_per_scene,
    )


def _range(values: Sequence[float]) -> Range:
    """Least value, mean and greatest value; NaN if there are none."""
    return (min(values), statistics.fmean(values), max(values)) if values else (math.nan, math.nan, math.nan)


WORTH = 20.0
"""Time limit of a scene over the longest one that was simulated: rooms differ, and machines are busy."""
AT_LEAST_S = 60.0
"""Least time limit of a scene: a worker's first one loads compiled code, perhaps from a busy disk."""


def scene_limit(text: str, config: DatasetConfig) -> float:
    """Seconds that `--scene-seconds` means: a number, or `forecast` for `WORTH` times the longest scene of a plan.

    Raises `InputError` for any other text, and as `plan_build` does.
    """
    if text == "forecast":
        return max(AT_LEAST_S, WORTH * plan_build(config).scene_s[2])
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{as_given('scene_seconds', text)}: must be a number of seconds, or forecast") from None
