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
from datagen.config import DatasetConfig
from datagen.design.exposure import with_exposure_found
from datagen.errors import InputError
from datagen.pipeline import check_inputs, simulate_sample
from datagen.records import Sample, Scalar
from datagen.store import Manifest, prepare, schema_of, write_shard
from datagen.store.environment import cores
from datagen.store.files import finite
from datagen.store.summaries import KindEvidence, evidence_by_kind

SECONDS = 5.0
"""After how many seconds no further scene is begun: some ten scenes of an ordinary scan."""
FEWEST = 3
"""Fewest scenes that are simulated, however long they take: the seconds of the first do not count, as it also loads
compiled code, and two show how different scenes are."""

Range = tuple[float, float, float]
"""Least value, mean and greatest value."""


@dataclass(frozen=True)
class SceneCost:
    """What one scene took and made.

    seconds : stage → processor seconds. stored : field → bytes on disk, and those of its commit record as "record".
    parameters : those of its sample: its error, the evidence of its objects, the decisions on effects.
    """

    seconds: Mapping[str, float]
    stored: Mapping[str, int]
    parameters: Mapping[str, Scalar]


@dataclass(frozen=True)
class Plan:
    """What a build would take and make.

    simulated : number of scenes that were simulated. failed : scene → reason why it could not be made.
    seconds : stage → processor seconds of a scene, mean over the scenes after the first, which also loads compiled
        code. scene_s : of all stages together.
    error : relative L2 error of a transient that the simulation claims; NaN if nothing estimates it.
    stored : field → bytes on disk of a scene, mean. scene_bytes : of all fields and the commit record together.
    evidence : significance of the objects, by kind. parameters : of the samples that were simulated.
    build_s : wall-clock seconds of the whole build on idle cores, without the start of the workers.
    build_bytes : bytes of all scenes on disk. shard_memory_bytes : memory of the shard that a worker fills.
    """

    scenes: int
    shards: int
    scenes_per_shard: int
    simulated: int
    failed: Mapping[int, str]
    seconds: Mapping[str, float]
    scene_s: Range
    error: Range
    stored: Mapping[str, float]
    scene_bytes: Range
    evidence: tuple[KindEvidence, ...]
    parameters: tuple[Mapping[str, Scalar], ...]
    workers: int
    build_s: float
    build_bytes: float
    shard_memory_bytes: int

    def as_json(self) -> dict[str, Any]:
        """The plan as plain values for JSON, with None in place of NaN."""
        return dict(finite({name: value for name, value in asdict(self).items() if name != "parameters"}))


def plan_build(config: DatasetConfig, workers: int = 1, seconds: float = SECONDS) -> Plan:
    """The plan of a build with `workers` processes on this machine.

    Whole scenes are simulated, the first ones of the dataset, until `seconds` have passed, but at least `FEWEST`.

    Raises
    ------
    InputError : whatever a build would refuse; `workers` under 1; `seconds` that are no positive number; none of the
        scenes can be made.
    """
    check_workers(workers)
    if not 0 < seconds < math.inf:
        raise InputError(f"--seconds {seconds:g}: must be > 0, such as {SECONDS:g}")
    config = with_exposure_found(config)
    check_inputs(config)
    return planned(config, *simulated_scenes(config, seconds), workers, cores())


def simulated_scenes(config: DatasetConfig, seconds: float) -> tuple[list[SceneCost], dict[int, str]]:
    """The costs of the first scenes of a dataset, and scene → reason of those that could not be made."""
    costs, failed = list[SceneCost](), dict[int, str]()
    # With one scene in each shard a scene's bytes are those of its files.
    alone = config.model_copy(update={"store": config.store.model_copy(update={"scenes_per_shard": 1})})
    with tempfile.TemporaryDirectory(prefix="datagen-plan-") as folder:
        manifest = prepare(Path(folder), alone)
        began = time.perf_counter()
        for index in range(config.scenes):
            if index >= FEWEST and time.perf_counter() - began > seconds:
                break
            begun, begun_s = time.perf_counter(), time.process_time()
            try:
                sample = simulate_sample(config, index)
            except InputError as refusal:
                failed[index] = str(refusal)
                continue
            # Of a machine that others use, too, a scene has a share only: its processor seconds are those of a core.
            busy = (time.process_time() - begun_s) / (time.perf_counter() - begun)
            made = {stage: busy * taken for stage, taken in sample.seconds.items()}
            try:
                costs.append(_written(Path(folder), manifest, index, sample, made))
            except InputError as refusal:
                failed[index] = str(refusal)
    if not costs:
        scene, reason = next(iter(failed.items()))
        raise InputError(f"none of the first {len(failed)} scenes can be made; scene {scene}: {reason}")
    return costs, failed


def _written(root: Path, manifest: Manifest, index: int, sample: Sample, seconds: Mapping[str, float]) -> SceneCost:
    """The cost of a sample that took `seconds`, with that of writing it. Raises `InputError` if it cannot be."""
    begun_s = time.process_time()
    record = write_shard(root, manifest.schema, index, manifest.fingerprint, [(index, sample)])
    if index in record.failures:
        raise InputError(record.failures[index])
    store_s = time.process_time() - begun_s
    stored = {
        field.name: sum(file.bytes for path, file in record.files.items() if f"/{field.name}/" in path)
        for field in manifest.schema.fields
    }
    return SceneCost({**seconds, "store": store_s}, stored | {"record": len(record.to_bytes())}, sample.parameters)


def planned(
    config: DatasetConfig, costs: Sequence[SceneCost], failed: Mapping[int, str], workers: int, machine_cores: int
) -> Plan:
    """The plan that follows from the costs of a few scenes: each worker makes its share of the scenes one after
    another, and workers beyond the number of cores share these."""
    schema = schema_of(config)
    timed = [cost.seconds for cost in (costs[1:] or costs)]
    seconds = {stage: statistics.fmean(of.get(stage, 0.0) for of in timed) for stage in timed[0]}
    errors = [float(cost.parameters.get("transient.relative_error", math.nan)) for cost in costs]
    scene_s, scene_bytes = _range([sum(of.values()) for of in timed]), _range([sum(c.stored.values()) for c in costs])
    working = min(workers, config.scenes)
    return Plan(
        scenes=config.scenes,
        shards=schema.shards,
        scenes_per_shard=schema.scenes_per_shard,
        simulated=len(costs),
        failed=failed,
        seconds=seconds,
        scene_s=scene_s,
        error=_range([error for error in errors if math.isfinite(error)]),
        stored={name: statistics.fmean(cost.stored[name] for cost in costs) for name in costs[0].stored},
        scene_bytes=scene_bytes,
        evidence=tuple(evidence_by_kind(cost.parameters for cost in costs)),
        parameters=tuple(cost.parameters for cost in costs),
        workers=workers,
        build_s=max(1.0, working / machine_cores) * math.ceil(config.scenes / working) * scene_s[1],
        build_bytes=config.scenes * scene_bytes[1],
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
        raise InputError(f"--scene-seconds {text}: must be a number of seconds, or forecast") from None
