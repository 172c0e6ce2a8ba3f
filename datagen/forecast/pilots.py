"""Pilot scenes: a few of a dataset's scenes, simulated and written as a build would, to forecast the whole of it.

Pilots have the configured accuracy, so their seconds and bytes need no model. Only where a single scene would take
far more than the budget, two trials with 1/16 and 1/256 of the paths are run, and the scene is extrapolated on the
line through both. Effects are decided with the configured accuracy, so that trials simulate the same effects.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from datagen.config import DatasetConfig
from datagen.errors import InputError
from datagen.records import Sample, Scalar
from datagen.store import finish, prepare, schema_of, write_shard
from datagen.store.files import bytes_below
from datagen.store.summaries import KindEvidence, evidence_by_kind
from datagen.store.table import table_bytes, table_of

MOST = 8
"""The most pilot scenes; half as many show less of the spread from scene to scene."""
REDUCTION = 16
"""The first trial has so many times fewer paths than configured, the second so many fewer than the first. With half,
trials of large scenes take twice as long."""
LOOSEST_TARGET = 0.5
"""The loosest target of a trial; half of it makes the trials of loose targets slower."""
FAR = 4.0
"""A scene that is expected to take more than so many times the budget is extrapolated; half would do so more
often."""
SURPRISING = 1.5
"""A pilot that takes so many times longer than its trial predicts is run again, as a kernel was compiled for it. Half
would run most pilots twice."""

LIGHT_STAGES = ("transport", "background", "presence")
"""Stages whose time grows with the number of paths."""

SampleFunction = Callable[[DatasetConfig, int], Sample]


@dataclass(frozen=True)
class Pilot:
    """One pilot scene.

    Attributes
    ----------
    effort : fraction of the configured paths (or of those that the configured target takes) that were followed.
    seconds : stage → wall-clock seconds. processor_s : of all stages together.
    error : estimated relative L2 error of its transient; NaN when nothing estimates it.
    target : the configured error, if there is one. smaller : the second trial, with still fewer paths.
    """

    index: int
    effort: float
    seconds: Mapping[str, float]
    processor_s: float
    error: float
    target: float | None = None
    smaller: Pilot | None = None

    @property
    def total_s(self) -> float:
        """Wall-clock seconds of all stages."""
        return sum(self.seconds.values())

    def at_full_effort(self) -> Pilot:
        """The pilot extrapolated to the configured effort: stages of light on the line through both trials (in
        proportion to effort without a second one), noise² / signal² in proportion to 1 / effort, or the configured
        target."""
        if self.effort >= 1.0:
            return self
        light = {stage: self._light_s(stage) for stage in LIGHT_STAGES if stage in self.seconds}
        seconds = {**self.seconds, **light}
        slower = sum(seconds.values()) / self.total_s if self.total_s > 0 else 1.0
        noise = self.effort * self.error**2 / max(1.0 - self.error**2, 1e-6)
        error = math.sqrt(noise / (1.0 + noise)) if self.target is None else min(self.error, self.target)
        return replace(self, effort=1.0, seconds=seconds, processor_s=self.processor_s * slower, error=error)

    def _light_s(self, stage: str) -> float:
        """Seconds of a stage at full effort: at least those now, and at most in proportion to effort."""
        now = self.seconds[stage]
        if self.smaller is None or self.smaller.effort >= self.effort:
            return now / self.effort
        slope = (now - self.smaller.seconds.get(stage, 0.0)) / (self.effort - self.smaller.effort)
        return min(now + max(slope, 0.0) * (1.0 - self.effort), now / self.effort)


@dataclass(frozen=True)
class Pilots:
    """The measurements of all pilots.

    Attributes
    ----------
    scenes : the pilot scenes, or the trial alone; their seconds hold the stage "store".
    failed : scene → why it could not be made.
    stored : field → bytes on disk of one scene, mean; "records": its commit record and its row of the table.
    fixed_bytes : of all that a dataset holds once.
    evidence : significance of the objects of the pilot scenes against the noise, by kind.
    """

    scenes: tuple[Pilot, ...]
    failed: Mapping[int, str]
    stored: Mapping[str, float]
    fixed_bytes: float
    evidence: tuple[KindEvidence, ...] = ()


def run_pilots(
    config: DatasetConfig,
    budget_s: float,
    simulate: SampleFunction | None = None,
    clock: Callable[[], float] = time.process_time,
    compiled: Callable[[int], None] = lambda index: None,
) -> Pilots:
    """Simulate and write pilot scenes, spread over the dataset, until `budget_s` processor seconds are spent or there
    are `MOST`; one at least.

    simulate : sample function; left out, the whole simulation. clock : processor seconds. compiled : called with the
    first scene that could be made, as soon as its kernels are on disk.

    Raises
    ------
    InputError : none of the scenes can be made.
    """
    if simulate is None:
        from datagen.pipeline import simulate_sample

        simulate = partial(simulate_sample, planned=config.transport)
    pilots, samples, failed = list[Pilot](), list[Sample](), dict[int, str]()

    def attempt(index: int, reduction: float = 1.0) -> tuple[Pilot, Sample] | None:
        tried, effort = with_less_effort(config, reduction)
        began = clock()
        try:
            sample = simulate(tried, index)
        except InputError as refusal:
            failed[index] = str(refusal)
            return None
        error = float(sample.parameters.get("transient.relative_error", math.nan))
        return Pilot(index, effort, dict(sample.seconds), clock() - began, error, config.transport.target), sample

    expected_s, spent_s = math.nan, 0.0
    for index in spread_indices(config.scenes, MOST):
        if math.isnan(expected_s):
            # The first run of all loads (or compiles) the kernels.
            made = attempt(index, REDUCTION) and attempt(index, REDUCTION)
            if made is not None:
                compiled(index)
                if made[0].at_full_effort().processor_s > FAR * budget_s and (second := attempt(index, REDUCTION**2)):
                    made = replace(made[0], smaller=second[0]), made[1]
                expected_s = made[0].at_full_effort().processor_s
        if expected_s <= FAR * budget_s:
            made = attempt(index)
            if made is not None and made[0].processor_s > SURPRISING * expected_s:
                made = min(made, attempt(index) or made, key=lambda one: one[0].processor_s)
        if made is not None:
            pilots.append(made[0])
            samples.append(made[1])
            spent_s += made[0].processor_s
        if spent_s >= budget_s or expected_s > FAR * budget_s:
            break
    return _written(config, pilots, samples, failed, clock)


def _written(
    config: DatasetConfig,
    pilots: Sequence[Pilot],
    samples: Sequence[Sample],
    failed: dict[int, str],
    clock: Callable[[], float],
) -> Pilots:
    """The pilots with the seconds and bytes of writing them, in shards as large as those of the build."""
    with tempfile.TemporaryDirectory(prefix="datagen-plan-") as folder:
        root, count = Path(folder), max(len(pilots), 1)
        store = config.store.model_copy(update={"scenes_per_shard": min(schema_of(config).scenes_per_shard, count)})
        manifest = prepare(root, config.with_scenes(count).model_copy(update={"store": store}))
        schema = manifest.schema
        shards = [
            [(k, samples[k]) for k in schema.scenes_of(shard)] for shard in range(schema.shards if pilots else 0)
        ]
        # Twice, because the first time loads what writing needs.
        for _ in range(2):
            began, began_processor = time.perf_counter(), clock()
            records = [write_shard(root, schema, k, manifest.fingerprint, made) for k, made in enumerate(shards)]
            store_s, processor_s = (time.perf_counter() - began) / count, (clock() - began_processor) / count
        failed |= {pilots[k].index: reason for record in records for k, reason in record.failures.items()}
        scenes = tuple(
            replace(pilot, seconds={**pilot.seconds, "store": store_s}, processor_s=pilot.processor_s + processor_s)
            for pilot in pilots
            if pilot.index not in failed
        )
        if not scenes:
            scene, reason = next(iter(failed.items()))
            raise InputError(f"none of the pilot scenes can be made; scene {scene}: {reason}")
        names = [field.name for field in schema.fields]
        finish(root, manifest, records)
        table = table_of(records, names)
        row = (len(table_bytes(table)) - len(table_bytes(table.slice(0, 1)))) / max(count - 1, 1)
        stored = {
            name: sum(file.bytes for record in records for path, file in record.files.items() if f"/{name}/" in path)
            / len(scenes)
            for name in names
        }
        stored["records"] = sum(len(record.to_bytes()) for record in records) / count + row
        everything = bytes_below(root)
        evidence = tuple(evidence_by_kind(_with_distances(sample) for sample in samples))
        return Pilots(scenes, failed, stored, everything - len(scenes) * sum(stored.values()), evidence)


def _with_distances(sample: Sample) -> dict[str, Scalar]:
    """The parameters of a sample, with `PART.away_m` of each object: its distance in plan from the middle of the
    relay wall."""
    named, middle = dict(sample.parameters), sample.arrays["relay_wall"][0]
    for name in [key.removesuffix(".x_m") for key in named if key.endswith(".x_m")]:
        x_m, y_m = float(named[f"{name}.x_m"]), float(named[f"{name}.y_m"])
        named[f"{name}.away_m"] = math.hypot(x_m - float(middle[0]), y_m - float(middle[1]))
    return named


def spread_indices(scenes: int, count: int) -> list[int]:
    """At most `count` different scene indices, spread evenly over the dataset, ascending from 0."""
    count = min(count, scenes)
    return sorted({round(k * (scenes - 1) / max(count - 1, 1)) for k in range(count)})


def with_less_effort(config: DatasetConfig, reduction: float) -> tuple[DatasetConfig, float]:
    """The configuration with about `reduction` times fewer paths, and the fraction of paths that is left. A target
    takes a number of paths ∝ target⁻²."""
    transport = config.transport
    if transport.target is not None:
        target = max(transport.target, min(LOOSEST_TARGET, transport.target * reduction**0.5))
        looser = transport.model_copy(update={"target": target})
        return config.model_copy(update={"transport": looser}), (transport.target / target) ** 2
    lookins = min(transport.lookins, max(transport.replicates, round(transport.lookins / reduction)))
    fewer = transport.model_copy(update={"lookins": lookins})
    return config.model_copy(update={"transport": fewer}), lookins / transport.lookins


def startup_seconds(config: DatasetConfig, index: int, asked: float) -> float:
    """Seconds from asking for a worker process until imports are done and kernels loaded. It is run by that worker,
    which simulates scene `index` twice with few paths.

    asked : Unix time at which the worker was asked for.
    """
    from datagen.pipeline import simulate_sample

    reduced, _ = with_less_effort(config, REDUCTION)
    simulate_sample(reduced, index, config.transport)
    warm_at = time.time()
    again_s = sum(simulate_sample(reduced, index, config.transport).seconds.values())
    return max(0.0, warm_at - asked - again_s)
