"""Pilot scenes: a few of a dataset's scenes, simulated and written as by a build, from which the build is forecast.

Pilots have the configured accuracy, so their seconds and bytes need no model. If the budget has room for only one
such scene, a few scenes are compared by trials with 1/16 of the paths, and the one of median cost is simulated in
full: it says how many times as long as its trial a scene takes. If a single scene could take far more than the
budget, it is not simulated in full: its cost is extrapolated on the line through two trials with 1/16 and 1/256 of
the paths. Effects are decided with the configured accuracy, so that trials simulate the same effects.
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
"""Most pilot scenes. With half as many, less of the spread from scene to scene is seen."""
REDUCTION = 16
"""Factor by which the first trial has fewer paths than configured, and the second fewer than the first. Halved,
trials of large scenes take twice as long."""
LOOSEST_TARGET = 0.5
"""Loosest target of a trial. Halved, trials of loose targets take longer."""
FAR = 80.0
"""Number of budgets beyond which a scene is extrapolated, if it took its trial's time in proportion to the paths.
Halved, scenes of 20 s would be extrapolated, too: light to a target takes between an eighth and the whole of that
proportion, and the line through two trials was up to 9 times too low."""
LOADING = 0.1
"""Share of a pilot's time for compiling or loading kernels, beyond which the pilot is run again, since a build loads
them once. Halved, long pilots are run twice for little."""
COMPARED = 4
"""Number of scenes that are compared by trials. With half as many, both may be unlike the others."""

LIGHT_STAGES = ("transport", "background", "presence")
"""Stages whose time grows with the number of paths."""

SampleFunction = Callable[[DatasetConfig, int], Sample]


@dataclass(frozen=True)
class Pilot:
    """One pilot scene.

    effort : fraction of the configured paths (or of those that the configured target needs) that were simulated.
    seconds : stage → wall-clock seconds. processor_s : of all stages together.
    error : estimated relative L2 error of its transient; NaN when nothing estimates it.
    target : the configured error, if there is one. smaller : the second trial, which has fewer paths than this one.
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
        """The pilot at the configured effort, extrapolated if it is a trial.

        The stages of light are extrapolated on the line through both trials, or in proportion to effort without a
        second trial. The error follows from noise² / signal² ∝ 1 / effort, or is the configured target.
        """
        if self.effort >= 1.0:
            return self
        light = {stage: self._light_s(stage) for stage in LIGHT_STAGES if stage in self.seconds}
        seconds = {**self.seconds, **light}
        slower = sum(seconds.values()) / self.total_s if self.total_s > 0 else 1.0
        noise = self.effort * self.error**2 / max(1.0 - self.error**2, 1e-6)
        error = math.sqrt(noise / (1.0 + noise)) if self.target is None else min(self.error, self.target)
        return replace(self, effort=1.0, seconds=seconds, processor_s=self.processor_s * slower, error=error)

    def scaled(self, trial: Pilot, full: Pilot) -> Pilot:
        """This trial at full effort if it grows as that of another scene does; its error is unknown."""
        grown = {of: full.seconds[of] / trial.seconds[of] for of in LIGHT_STAGES if trial.seconds.get(of, 0.0) > 0}
        seconds = {stage: taken * grown.get(stage, 1.0) for stage, taken in self.seconds.items()}
        processor_s = self.processor_s * full.processor_s / trial.processor_s
        return replace(self, effort=1.0, seconds=seconds, processor_s=processor_s, error=math.nan)

    def _light_s(self, stage: str) -> float:
        """Seconds of a stage at full effort: at least the trial's own, at most these in proportion to effort."""
        now = self.seconds[stage]
        if self.smaller is None or self.smaller.effort >= self.effort:
            return now / self.effort
        slope = (now - self.smaller.seconds.get(stage, 0.0)) / (self.effort - self.smaller.effort)
        return min(now + max(slope, 0.0) * (1.0 - self.effort), now / self.effort)


@dataclass(frozen=True)
class Pilots:
    """The measurements of all pilots.

    scenes : the pilot scenes, or the single trial; their seconds contain the stage "store".
    failed : scene → reason why it could not be made.
    stored : field → bytes on disk of one scene, mean; "records": its commit record and its row of the table.
    fixed_bytes : bytes that a dataset has whatever the number of its scenes.
    evidence : significance of the objects of the pilot scenes, by kind.
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
    """The measurements of pilot scenes, which are spread over the dataset, simulated and written.

    Scenes are simulated until `budget_s` processor seconds are spent or there are `MOST`, but at least one.

    simulate : sample function; left out, the whole simulation. clock : processor seconds. compiled : called with the
    first scene that can be made, as soon as its kernels are on disk.

    Raises
    ------
    InputError : none of the scenes can be made.
    """
    if simulate is None:
        from datagen.pipeline import simulate_sample

        simulate = partial(simulate_sample, planned=config.transport)
    failed = dict[int, str]()

    def attempt(index: int, reduction: float = 1.0) -> tuple[Pilot, Sample] | None:
        """A scene with `reduction` times fewer paths; None if it cannot be made."""
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
    """The pilots with the seconds and bytes that it takes to write them, in shards as large as those of the build."""
    pilots, samples = [pilot for pilot, _ in made], [sample for _, sample in made]
    with tempfile.TemporaryDirectory(prefix="datagen-plan-") as folder:
        root, count = Path(folder), max(len(made), 1)
        store = config.store.model_copy(update={"scenes_per_shard": min(schema_of(config).scenes_per_shard, count)})
        manifest = prepare(root, config.with_scenes(count).model_copy(update={"store": store}))
        schema = manifest.schema
        shards = [
            [(k, samples[k]) for k in schema.scenes_of(shard)] for shard in range(schema.shards if pilots else 0)
        ]
        # The first of two times loads the modules that writing needs, and is not measured.
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
    """The parameters of a sample, and `PART.away_m` of each object: its distance in plan from the relay wall."""
    named, middle = dict(sample.parameters), sample.arrays["relay_wall"][0]
    for name in [key.removesuffix(".x_m") for key in named if key.endswith(".x_m")]:
        x_m, y_m = float(named[f"{name}.x_m"]), float(named[f"{name}.y_m"])
        named[f"{name}.away_m"] = math.hypot(x_m - float(middle[0]), y_m - float(middle[1]))
    return named


def spread_indices(scenes: int, count: int) -> list[int]:
    """At most `count` different scene indices, evenly spread over the dataset, ascending from 0."""
    count = min(count, scenes)
    return sorted({round(k * (scenes - 1) / max(count - 1, 1)) for k in range(count)})


def with_less_effort(config: DatasetConfig, reduction: float) -> tuple[DatasetConfig, float]:
    """The configuration with about `reduction` times fewer paths, and the remaining fraction of paths. The number of
    paths for a target is ∝ target⁻²."""
    transport = config.transport
    if transport.target is not None:
        target = max(transport.target, min(LOOSEST_TARGET, transport.target * reduction**0.5))
        looser = transport.model_copy(update={"target": target})
        return config.model_copy(update={"transport": looser}), (transport.target / target) ** 2
    lookins = min(transport.lookins, max(transport.replicates, round(transport.lookins / reduction)))
    fewer = transport.model_copy(update={"lookins": lookins})
    return config.model_copy(update={"transport": fewer}), lookins / transport.lookins


def startup_seconds(config: DatasetConfig, index: int, requested: float) -> float:
    """Seconds until a worker process has imported its modules and loaded its kernels.

    The worker itself runs this function, and simulates scene `index` twice with few paths. requested : Unix time at
    which the worker was started.
    """
    from datagen.pipeline import simulate_sample

    reduced, _ = with_less_effort(config, REDUCTION)
    simulate_sample(reduced, index, config.transport)
    warm_at = time.time()
    again_s = sum(simulate_sample(reduced, index, config.transport).seconds.values())
    return max(0.0, warm_at - requested - again_s)
