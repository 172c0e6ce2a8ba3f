"""Pilot scenes: a few of a dataset's scenes, simulated and written as a build would, to forecast the whole of it.

Pilots have the configured accuracy, so their seconds and bytes need no model. Where the budget has room for one such
scene only, a few scenes are compared by trials with 1/16 of the paths, and the one of median cost is simulated in
full: it says how many times as long as its trial a scene takes. Only where one scene could take far more than the
budget, two trials with 1/16 and 1/256 of the paths are run, and the scene is extrapolated on the line through both.
Effects are decided with the configured accuracy, so that trials simulate the same effects.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from numba.core.event import install_timer

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
FAR = 80.0
"""A scene that could take more than so many times the budget, in proportion to the paths of its trial, is
extrapolated. Half would do so with scenes of 20 s: light to a target takes an eighth to once its proportion, and the
line through trials was up to 9 times too low."""
LOADING = 0.1
"""A pilot of which more than this share went into compiling or loading kernels is run again: a build does so once.
Half as many would run long pilots twice for little."""
COMPARED = 4
"""Scenes compared by trials; half as many may both be unlike the others."""

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

    def scaled(self, trial: Pilot, full: Pilot) -> Pilot:
        """This trial at full effort, if it takes as many times longer then as another scene's trial did. Its error
        stays unknown."""
        grown = {of: full.seconds[of] / trial.seconds[of] for of in LIGHT_STAGES if trial.seconds.get(of, 0.0) > 0}
        seconds = {stage: taken * grown.get(stage, 1.0) for stage, taken in self.seconds.items()}
        processor_s = self.processor_s * full.processor_s / trial.processor_s
        return replace(self, effort=1.0, seconds=seconds, processor_s=processor_s, error=math.nan)

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
    failed = dict[int, str]()

    def attempt(index: int, reduction: float = 1.0) -> tuple[Pilot, Sample] | None:
        tried, effort = with_less_effort(config, reduction)
        for _ in range(2):
            loading = list[float]()
            began, began_processor = time.perf_counter(), clock()
            try:
                with install_timer("numba:compiler_lock", loading.append):
                    sample = simulate(tried, index)
            except InputError as refusal:
                failed[index] = str(refusal)
                return None
            processor_s = clock() - began_processor
            if sum(loading) <= LOADING * (time.perf_counter() - began):
                break
        error = float(sample.parameters.get("transient.relative_error", math.nan))
        return Pilot(index, effort, dict(sample.seconds), processor_s, error, config.transport.target), sample

    indices = spread_indices(config.scenes, MOST)
    first = next(filter(None, (attempt(index, REDUCTION) for index in indices)), None)
    if first is None:
        return _written(config, [], failed, clock)
    trial, sample = first
    compiled(trial.index)
    if trial.processor_s / trial.effort > FAR * budget_s:
        second = attempt(trial.index, REDUCTION**2)
        return _written(config, [(replace(trial, smaller=second and second[0]), sample)], failed, clock)
    if trial.processor_s > budget_s / COMPARED:
        others = [
            attempt(index, REDUCTION) for index in spread_indices(config.scenes, COMPARED) if index != trial.index
        ]
        trials = sorted([first, *filter(None, others)], key=lambda made: made[0].processor_s)
        typical, _ = trials.pop((len(trials) - 1) // 2)
        if full := attempt(typical.index):
            scaled = [(other.scaled(typical, full[0]), sample) for other, sample in trials]
            return _written(config, [full, *scaled], failed, clock)
    pilots, spent_s = list[tuple[Pilot, Sample]](), 0.0
    for index in indices:
        if index not in failed and spent_s < budget_s and (made := attempt(index)):
            pilots.append(made)
            spent_s += made[0].processor_s
    return _written(config, pilots, failed, clock)


def _written(
    config: DatasetConfig, made: Sequence[tuple[Pilot, Sample]], failed: dict[int, str], clock: Callable[[], float]
) -> Pilots:
    """The pilots with the seconds and bytes of writing them, in shards as large as those of the build."""
    pilots, samples = [pilot for pilot, _ in made], [sample for _, sample in made]
    with tempfile.TemporaryDirectory(prefix="datagen-plan-") as folder:
        root, count = Path(folder), max(len(made), 1)
        store = config.store.model_copy(update={"scenes_per_shard": min(schema_of(config).scenes_per_shard, count)})
        manifest = prepare(root, config.with_scenes(count).model_copy(update={"store": store}))
        schema = manifest.schema
        shards = [
            [(k, samples[k]) for k in schema.scenes_of(shard)] for shard in range(schema.shards if pilots else 0)
        ]
        # Twice, because the first time loads what writing needs.
        for _ in range(2):
            began, began_processor = time.perf_counter(), clock()
            records = [write_shard(root, schema, k, manifest.fingerprint, of) for k, of in enumerate(shards)]
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
