"""Pilot scenes: a few of a dataset's scenes, simulated and encoded as a build would, to forecast the whole of it.

What a scene costs and how it compresses is measured, not modelled. Only where full accuracy would take too long are
the pilots run with less *effort* (fewer lookins, or a looser target); a first scene is run with several efforts in
turn, so that `forecast.py` knows how seconds, error and bytes go on from there.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datagen.config import DatasetConfig
from datagen.engines import started
from datagen.errors import InputError
from datagen.records import Sample
from datagen.store import Schema, ShardRecord, schema_of, write_shard
from datagen.store.arrays import metadata_files, write_metadata
from datagen.store.card import card, croissant
from datagen.store.files import json_bytes
from datagen.store.manifest import describe
from datagen.store.schema import SHARD_BYTES
from datagen.store.table import table_bytes, table_of, write_table

MOST, FEWEST = 8, 3
"""Pilot scenes: as many as the budget allows, up to `MOST`; at least `FEWEST`, with less effort where need be."""
REDUCTIONS = (64, 16, 4, 1)
"""How many times less effort than configured the first scene is tried with, in turn."""
LOOSEST_TARGET = 0.5
SURPRISING = 1.5
"""A pilot that takes so many times longer than the one before it lets expect is run again: something was loaded or
compiled for it that earlier ones had not needed."""
WRITTEN_AT_ONCE = 4
"""Scenes in the larger of the two shards from whose times the cost of a scene and of a shard are told apart."""

SampleFunction = Callable[[DatasetConfig, int], Sample]


@dataclass(frozen=True)
class Pilot:
    """One scene, simulated and encoded once.

    Attributes
    ----------
    effort : share of the configured lookins (or of the paths that the configured target takes: effort ∝ target⁻²).
    seconds : stage → wall-clock seconds. processor_s : of all stages together.
    error : estimated relative L2 error of its transient.
    stored : field → bytes on disk, and "records" → its share of the commit record.
    """

    index: int
    effort: float
    seconds: Mapping[str, float]
    processor_s: float
    error: float
    stored: Mapping[str, int]

    @property
    def total_s(self) -> float:
        return sum(self.seconds.values())


@dataclass(frozen=True)
class Pilots:
    """What the pilots measured.

    Attributes
    ----------
    scenes : the pilot scenes, all with the same effort.
    lower : unless that is full, the same scenes with a rung less effort (none where there is no rung below).
    ladder : the first of them with rising effort; the last rung is `scenes[0]`.
    failed : scene → why it could not be made.
    store_scene_s, store_shard_s : a shard is encoded and written in `store_shard_s` + scenes × `store_scene_s`.
    shard_bytes : of a commit record beside its scenes.
    table_bytes : of the table `samples.parquet` with one row, and for each further row.
    about_bytes : of manifest and cards.
    """

    scenes: tuple[Pilot, ...]
    lower: tuple[Pilot, ...]
    ladder: tuple[Pilot, ...]
    failed: Mapping[int, str]
    store_scene_s: float
    store_shard_s: float
    shard_bytes: int
    table_bytes: tuple[int, float]
    about_bytes: int

    @property
    def effort(self) -> float:
        return self.scenes[0].effort


def effort_reduced(config: DatasetConfig, reduction: float) -> tuple[DatasetConfig, float]:
    """The configuration with (about) so many times less effort, and the share of the effort that is left."""
    transport = config.transport
    if transport.target is not None:
        target = max(transport.target, min(LOOSEST_TARGET, transport.target * reduction**0.5))
        looser = transport.model_copy(update={"target": target})
        return config.model_copy(update={"transport": looser}), (transport.target / target) ** 2
    lookins = min(transport.lookins, max(transport.scramblings, round(transport.lookins / reduction)))
    fewer = transport.model_copy(update={"lookins": lookins})
    return config.model_copy(update={"transport": fewer}), lookins / transport.lookins


def spread_indices(scenes: int, count: int) -> list[int]:
    """At most `count` different scene indices, spread evenly over the dataset, ascending from 0."""
    count = min(count, scenes)
    return sorted({round(k * (scenes - 1) / max(count - 1, 1)) for k in range(count)})


def run_pilots(config: DatasetConfig, budget_s: float, simulate: SampleFunction | None = None) -> Pilots:
    """Simulate and encode pilot scenes within about `budget_s` seconds, kernels loaded (or compiled) beforehand.

    simulate : what makes a sample; left out, the whole simulation.

    Raises
    ------
    InputError : none of the scenes can be made.
    """
    if simulate is None:
        from datagen.pipeline import simulate_sample

        simulate = simulate_sample
    with tempfile.TemporaryDirectory(prefix="datagen-plan-") as folder:
        trial = _Trial(config, simulate, Path(folder))
        indices = spread_indices(config.scenes, MOST)
        first = indices.pop(0)
        while trial.attempt(first, REDUCTIONS[0]) is None:
            if not indices:
                scene, reason = next(iter(trial.failed.items()))
                raise InputError(f"none of the pilot scenes can be made; scene {scene}: {reason}")
            first = indices.pop(0)
        ladder = _ladder(trial, first, budget_s, min(FEWEST, 1 + len(indices)))
        efforts = [pilot.effort for pilot in (ladder[-1:] if ladder[-1].effort == 1.0 else ladder[-2:])]
        runs = [ladder[-len(efforts) :]]
        spent_s = sum(pilot.total_s for pilot in ladder)
        for index in indices:
            mean_s = sum(pilot.total_s for run in runs for pilot in run) / len(runs)
            if spent_s + mean_s > (budget_s if len(runs) >= FEWEST else 2 * budget_s):
                break
            expected_s = [pilot.total_s for pilot in runs[-1]]
            tried = [
                trial.attempt(index, 1 / effort, SURPRISING * s)
                for effort, s in zip(efforts, expected_s, strict=True)
            ]
            run = [pilot for pilot in tried if pilot is not None]
            spent_s += sum(pilot.total_s for pilot in run)
            if len(run) == len(efforts):
                runs.append(run)
        return trial.result(runs, ladder)


def _ladder(trial: _Trial, index: int, budget_s: float, wanted: int) -> list[Pilot]:
    """One scene with rising effort, up to where `wanted` scenes with more would not fit into the budget."""
    ladder: list[Pilot] = []
    spent_s = 0.0
    for reduction, following in zip(REDUCTIONS, (*REDUCTIONS[1:], 0), strict=True):
        expected_s = ladder[-1].total_s * ladder[-1].effort ** -1 / reduction if ladder else math.inf
        pilot = trial.attempt(index, reduction, SURPRISING * expected_s)
        if pilot is None:
            # It could be made with the least effort: with more, a count no longer fits its type.
            break
        if ladder and pilot.effort == ladder[-1].effort:
            ladder.pop()
        ladder.append(pilot)
        spent_s += pilot.total_s
        if not following or pilot.effort == 1.0:
            break
        next_s = pilot.total_s + pilot.seconds.get("transport", 0.0) * (reduction / following - 1)
        # From two rungs the others can be told, so the second is only left out when it alone is too much; and two
        # scenes with full effort tell more than several without.
        least = 1 if len(ladder) == 1 else min(wanted, 2) if following == 1 else wanted
        if least * next_s > budget_s - spent_s:
            break
    return ladder


class _Trial:
    """Simulates scenes of a configuration and writes each as a shard of its own."""

    def __init__(self, config: DatasetConfig, simulate: SampleFunction, folder: Path) -> None:
        self.config, self.simulate, self.folder = config, simulate, folder
        self.fields = schema_of(config).fields
        self.failed: dict[int, str] = {}
        self._records: dict[tuple[int, float], ShardRecord] = {}
        self._write_s: list[float] = []
        self._last: Sample | None = None
        write_metadata(folder / "one", metadata_files(Schema(self.fields, 1, 1)))

    def attempt(self, index: int, reduction: float, surprising_s: float = math.inf) -> Pilot | None:
        """Simulate and encode one scene, again if that takes more than `surprising_s`; None when it cannot be made,
        which `failed` then explains.
        """
        pilot = self._once(index, reduction)
        if pilot is None or pilot.total_s <= surprising_s:
            return pilot
        again = self._once(index, reduction)
        return pilot if again is None or pilot.total_s < again.total_s else again

    def _once(self, index: int, reduction: float) -> Pilot | None:
        config, effort = effort_reduced(self.config, reduction)
        began = time.process_time()
        try:
            sample = self.simulate(config, index)
        except InputError as refusal:
            self.failed[index] = str(refusal)
            return None
        processor_s = time.process_time() - began
        record = self._write("one", 1, sample)
        if record.failures:
            self.failed[index] = record.failures[0]
            return None
        self._records[index, effort], self._last = record, sample
        stored = {name.split("/")[1]: file.bytes for name, file in record.files.items()}
        stored["records"] = len(record.to_bytes()) - len(replace(record, scenes=()).to_bytes())
        error = float(sample.parameters.get("transient.relative_error", np.nan))
        return Pilot(index, effort, dict(sample.seconds), processor_s, error, stored)

    def _write(self, name: str, scenes: int, sample: Sample) -> ShardRecord:
        began = time.perf_counter()
        schema = Schema(self.fields, scenes, scenes)
        record = write_shard(self.folder / name, schema, 0, "pilot", [(k, sample) for k in range(scenes)])
        if scenes == 1:
            self._write_s.append(time.perf_counter() - began)
        return record

    def result(self, runs: Sequence[Sequence[Pilot]], ladder: Sequence[Pilot]) -> Pilots:
        """runs : each scene's pilots, with less effort first where there are two."""
        scenes = [run[-1] for run in runs]
        lower = [run[0] for run in runs if len(run) > 1]
        records = [self._records[pilot.index, pilot.effort] for pilot in scenes]
        scene_s, shard_s = self._writing_times()
        names = [field.name for field in self.fields]
        sizes = [len(table_bytes(table_of(some, names))) for some in (records[:1], records)]
        return Pilots(
            tuple(scenes), tuple(lower), tuple(ladder), self.failed, scene_s, shard_s,
            len(replace(records[0], scenes=()).to_bytes()),
            (sizes[0], (sizes[1] - sizes[0]) / max(len(records) - 1, 1)), self._about(records, names),
        )  # fmt: skip

    def _about(self, records: Sequence[ShardRecord], names: Sequence[str]) -> int:
        manifest = describe(self.config, schema_of(self.config))
        write_table(self.folder, records, names)
        cards = len(card(manifest, records).encode()) + len(json_bytes(croissant(self.folder, manifest)))
        return cards + len(manifest.to_bytes())

    def _writing_times(self) -> tuple[float, float]:
        """Seconds of a scene and of a shard, from shards of one scene and a shard of a few."""
        alone = float(np.median(self._write_s))
        assert self._last is not None
        if WRITTEN_AT_ONCE * sum(field.bytes_per_scene for field in self.fields) > SHARD_BYTES:
            return alone, 0.0
        write_metadata(self.folder / "few", metadata_files(Schema(self.fields, WRITTEN_AT_ONCE, WRITTEN_AT_ONCE)))
        began = time.perf_counter()
        self._write("few", WRITTEN_AT_ONCE, self._last)
        each = max((time.perf_counter() - began - alone) / (WRITTEN_AT_ONCE - 1), 0.0)
        return min(each, alone), max(alone - each, 0.0)


@dataclass(frozen=True)
class Workers:
    """What worker processes cost beside their scenes.

    Attributes
    ----------
    startup_s : from asking for a process until its scenes go as quickly as ever: imports, compiled kernels loaded.
    startup_processor_s : processor seconds of that.
    slowdown : how many times longer a scene takes when the workers asked for are at it together; ≥ 1.
    """

    startup_s: float
    startup_processor_s: float
    slowdown: float = 1.0


def probe_workers(config: DatasetConfig, pilots: Pilots, processes: int) -> Workers:
    """Start `processes` workers as a build does, and let all of them simulate the first pilot scene twice."""
    rung = max((p for p in pilots.ladder if p.total_s <= 1.0), key=lambda p: p.effort, default=pilots.ladder[0])
    reduced, _ = effort_reduced(config, 1 / rung.effort)
    with started("local", processes, None) as engine:
        asked = time.time()
        futures = [engine.submit(_twice, reduced, rung.index) for _ in range(processes)]
        outcomes = [future.result() for future in futures]
    again_s = float(np.mean([outcome.again_s for outcome in outcomes]))
    return Workers(
        max(0.0, float(np.median([outcome.warm_at - asked - outcome.again_s for outcome in outcomes]))),
        max(0.0, float(np.median([outcome.processor_s - outcome.again_processor_s for outcome in outcomes]))),
        max(1.0, again_s / rung.total_s) if processes > 1 else 1.0,
    )


@dataclass(frozen=True)
class _Outcome:
    """warm_at : Unix time when the first run was through; processor_s : of the process until then; again_s,
    again_processor_s : of the second run."""

    warm_at: float
    processor_s: float
    again_s: float
    again_processor_s: float


def _twice(config: DatasetConfig, index: int) -> _Outcome:
    from datagen.pipeline import simulate_sample

    simulate_sample(config, index)
    warm_at, processor_s = time.time(), time.process_time()
    again_s = sum(simulate_sample(config, index).seconds.values())
    return _Outcome(warm_at, processor_s, again_s, time.process_time() - processor_s)
