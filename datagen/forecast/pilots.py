"""Pilot scenes: a few of a dataset's scenes, simulated and written as a build would, to forecast the whole of it.

They have the configured accuracy, so what they take and give needs no model. Only where a single such scene would be
far beyond the budget do two trials stand for it, with 1/16 and 1/256 of the paths, on whose line the scene is taken
to lie: what grows more slowly with the paths takes less. Effects are decided with the configured accuracy, so that
trials and scene simulate the same.
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
"""Pilot scenes, at most."""
REDUCTION = 16
"""How many times fewer paths than configured the trial has, and the second trial than that."""
LOOSEST_TARGET = 0.5
FAR = 4.0
"""A scene expected to take more than this many times the budget is not run."""
SURPRISING = 1.5
"""A pilot that takes so many times longer than the trial lets expect is run again: a kernel was compiled for it."""

LIGHT_STAGES = ("transport", "background", "presence")
"""Stages that take as long as the light they follow."""

SampleFunction = Callable[[DatasetConfig, int], Sample]


@dataclass(frozen=True)
class Pilot:
    """One pilot scene.

    Attributes
    ----------
    effort : share of the configured lookins (or of the paths that the configured target takes) it was run with.
    seconds : stage → wall-clock seconds. processor_s : of all stages together.
    error : estimated relative L2 error of its transient; NaN when nothing estimates it.
    target : the error that is asked of the scene, if one is. less : the same with less effort still.
    """

    index: int
    effort: float
    seconds: Mapping[str, float]
    processor_s: float
    error: float
    target: float | None = None
    less: Pilot | None = None

    @property
    def total_s(self) -> float:
        """Wall-clock seconds of all stages."""
        return sum(self.seconds.values())

    def at_full_effort(self) -> Pilot:
        """Light along the line through both trials, or in proportion to effort where there is one; noise over signal
        (both squared) in proportion to 1 / effort, or the error that is asked for."""
        if self.effort >= 1.0:
            return self
        light = {stage: self._light_s(stage) for stage in LIGHT_STAGES if stage in self.seconds}
        seconds = {**self.seconds, **light}
        slower = sum(seconds.values()) / self.total_s if self.total_s > 0 else 1.0
        noise = self.effort * self.error**2 / max(1.0 - self.error**2, 1e-6)
        error = math.sqrt(noise / (1.0 + noise)) if self.target is None else min(self.error, self.target)
        return replace(self, effort=1.0, seconds=seconds, processor_s=self.processor_s * slower, error=error)

    def _light_s(self, stage: str) -> float:
        """Seconds of a stage at full effort: no less than now, and no more than in proportion."""
        now = self.seconds[stage]
        if self.less is None or self.less.effort >= self.effort:
            return now / self.effort
        slope = (now - self.less.seconds.get(stage, 0.0)) / (self.effort - self.less.effort)
        return min(now + max(slope, 0.0) * (1.0 - self.effort), now / self.effort)


@dataclass(frozen=True)
class Pilots:
    """What the pilots measured.

    Attributes
    ----------
    scenes : the pilot scenes, or the trial alone; their seconds hold the stage "store".
    failed : scene → why it could not be made.
    stored : field → bytes on disk of one scene, mean; "records": its commit record and its row of the table.
    fixed_bytes : of all that a dataset holds once.
    evidence : how far the objects of the pilot scenes stand out of the noise, kind by kind.
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

    simulate : what makes a sample; left out, the whole simulation. clock : processor seconds. compiled : is told the
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
                if made[0].at_full_effort().processor_s > FAR * budget_s and (less := attempt(index, REDUCTION**2)):
                    made = replace(made[0], less=less[0]), made[1]
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
    """The pilots written as a dataset of their own, in shards as large as the build's."""
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
    """A sample's parameters, and of each object `PART.away_m`: in plan, from the middle of the visible relay wall."""
    told, middle = dict(sample.parameters), sample.arrays["relay_wall"][0]
    for name in [key.removesuffix(".x_m") for key in told if key.endswith(".x_m")]:
        x_m, y_m = float(told[f"{name}.x_m"]), float(told[f"{name}.y_m"])
        told[f"{name}.away_m"] = math.hypot(x_m - float(middle[0]), y_m - float(middle[1]))
    return told


def spread_indices(scenes: int, count: int) -> list[int]:
    """At most `count` different scene indices, spread evenly over the dataset, ascending from 0."""
    count = min(count, scenes)
    return sorted({round(k * (scenes - 1) / max(count - 1, 1)) for k in range(count)})


def with_less_effort(config: DatasetConfig, reduction: float) -> tuple[DatasetConfig, float]:
    """The configuration with (about) so many times fewer paths, and the share of them that is left; the number of
    paths that a target takes is ∝ target⁻²."""
    transport = config.transport
    if transport.target is not None:
        target = max(transport.target, min(LOOSEST_TARGET, transport.target * reduction**0.5))
        looser = transport.model_copy(update={"target": target})
        return config.model_copy(update={"transport": looser}), (transport.target / target) ** 2
    lookins = min(transport.lookins, max(transport.replicates, round(transport.lookins / reduction)))
    fewer = transport.model_copy(update={"lookins": lookins})
    return config.model_copy(update={"transport": fewer}), lookins / transport.lookins


def startup_seconds(config: DatasetConfig, index: int, asked: float) -> float:
    """Seconds from asking for a worker process until its scenes go as quickly as ever: imports, kernels loaded. Run
    by that worker, which simulates scene `index` twice with little effort.

    asked : Unix time when it was asked for.
    """
    from datagen.pipeline import simulate_sample

    reduced, _ = with_less_effort(config, REDUCTION)
    simulate_sample(reduced, index, config.transport)
    warm_at = time.time()
    again_s = sum(simulate_sample(reduced, index, config.transport).seconds.values())
    return max(0.0, warm_at - asked - again_s)
