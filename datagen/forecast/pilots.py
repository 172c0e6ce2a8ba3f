"""Pilot scenes: a few of a dataset's scenes, simulated and encoded as a build would, to forecast the whole of it.

What a scene costs and how it compresses is measured, not modelled. Only where full accuracy would take too long are
the pilots run with less *effort* (fewer lookins, or a looser target); a first scene is run with rising effort, with
all of it if that can be had at all, so that `ladder.py` knows how seconds, error and bytes go on from there. Effects
are decided as for full effort: a pilot must not follow light, or save itself a look at it, that the scene would not.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from datagen.config import DatasetConfig
from datagen.errors import InputError
from datagen.forecast.ladder import Ladder, Pilot
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
class Pilots:
    """What the pilots measured.

    Attributes
    ----------
    scenes : the pilot scenes, all with the same effort.
    ladder : the first of them with rising effort; one rung is `scenes[0]`.
    failed : scene → why it could not be made.
    store_scene_s, store_shard_s : a shard is encoded and written in `store_shard_s` + scenes × `store_scene_s`.
    shard_bytes : of a commit record beside its scenes.
    table_bytes : of the table `samples.parquet` with one row, and for each further row.
    about_bytes : of manifest and cards.
    """

    scenes: tuple[Pilot, ...]
    ladder: Ladder
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
    lookins = min(transport.lookins, max(transport.replicates, round(transport.lookins / reduction)))
    fewer = transport.model_copy(update={"lookins": lookins})
    return config.model_copy(update={"transport": fewer}), lookins / transport.lookins


def spread_indices(scenes: int, count: int) -> list[int]:
    """At most `count` different scene indices, spread evenly over the dataset, ascending from 0."""
    count = min(count, scenes)
    return sorted({round(k * (scenes - 1) / max(count - 1, 1)) for k in range(count)})


def run_pilots(
    config: DatasetConfig,
    budget_s: float,
    simulate: SampleFunction | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Pilots:
    """Simulate and encode pilot scenes within about `budget_s` seconds, or twice that where fewer than `FEWEST` would
    be left or full effort comes within reach for one of them; kernels are loaded (or compiled) beforehand.

    simulate : what makes a sample; left out, the whole simulation. clock : seconds, for what is written.

    Raises
    ------
    InputError : none of the scenes can be made.
    """
    if simulate is None:
        from datagen.pipeline import simulate_sample

        simulate = partial(simulate_sample, planned=config.transport)
    with tempfile.TemporaryDirectory(prefix="datagen-plan-") as folder:
        trial = _Trial(config, simulate, Path(folder), clock)
        indices = spread_indices(config.scenes, MOST)
        first = indices.pop(0)
        while trial.attempt(first, REDUCTIONS[0]) is None:
            if not indices:
                scene, reason = next(iter(trial.failed.items()))
                raise InputError(f"none of the pilot scenes can be made; scene {scene}: {reason}")
            first = indices.pop(0)
        others = min(FEWEST - 1, len(indices))
        ladder = _climbed(trial, first, budget_s, others)
        spent_s = sum(pilot.total_s for pilot in ladder.rungs)
        scenes = [_rung_for(ladder, others, budget_s, spent_s)]
        for index in indices:
            mean_s = sum(pilot.total_s for pilot in scenes) / len(scenes)
            if spent_s + mean_s > budget_s and len(scenes) > others:
                break
            pilot = trial.attempt(index, 1 / scenes[0].effort, SURPRISING * scenes[-1].total_s)
            if pilot is not None:
                spent_s += pilot.total_s
                scenes.append(pilot)
        return trial.result(scenes, ladder)


def _climbed(trial: _Trial, index: int, budget_s: float, others: int) -> Ladder:
    """One scene with rising effort, as far as twice the budget goes with `others` scenes on the lowest rung.

    From the second rung on it goes straight to full effort where twice the budget holds that, whatever the others
    then come to; from the first where as many scenes as are wanted can have full effort.
    """
    rungs: list[Pilot] = []
    reductions = list(REDUCTIONS)
    spent_s, expected_s = 0.0, math.inf
    while reductions:
        pilot = trial.attempt(index, reductions.pop(0), SURPRISING * expected_s)
        if pilot is None:
            # It could be made with the least effort: with more, a count no longer fits its type.
            break
        if rungs and pilot.effort == rungs[-1].effort:
            rungs.pop()
        rungs.append(pilot)
        spent_s += pilot.total_s
        if pilot.effort == 1.0:
            break
        ladder, left_s = Ladder(tuple(rungs)), 2 * budget_s - spent_s
        full_s = ladder.most_s(1.0)
        within_reach = (full_s <= left_s and len(rungs) > 1) or (1 + others) * full_s <= budget_s - spent_s
        reductions = [1] if within_reach else reductions
        expected_s = ladder.most_s(1 / reductions[0])
        left_s -= others * rungs[0].total_s
        # From two rungs others can be told, so the second is only left out when it alone is too much.
        if expected_s > (max(left_s, budget_s) if len(rungs) == 1 else left_s) and not within_reach:
            break
    return Ladder(tuple(rungs))


def _rung_for(ladder: Ladder, others: int, budget_s: float, spent_s: float) -> Pilot:
    """The highest rung that `others` scenes can be run on with what is left: of the budget, or of twice the budget if
    that is more than half of it spent."""
    left_s = min(max(budget_s - spent_s, budget_s / 2), 2 * budget_s - spent_s)
    return next((rung for rung in reversed(ladder.rungs) if others * rung.total_s <= left_s), ladder.rungs[0])


class _Trial:
    """Simulates scenes of a configuration and writes each as a shard of its own."""

    def __init__(
        self, config: DatasetConfig, simulate: SampleFunction, folder: Path, clock: Callable[[], float]
    ) -> None:
        self.config, self.simulate, self.folder, self.clock = config, simulate, folder, clock
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
        began = self.clock()
        schema = Schema(self.fields, scenes, scenes)
        record = write_shard(self.folder / name, schema, 0, "pilot", [(k, sample) for k in range(scenes)])
        if scenes == 1:
            self._write_s.append(self.clock() - began)
        return record

    def result(self, scenes: Sequence[Pilot], ladder: Ladder) -> Pilots:
        records = [self._records[pilot.index, pilot.effort] for pilot in scenes]
        scene_s, shard_s = self._writing_times()
        names = [field.name for field in self.fields]
        sizes = [len(table_bytes(table_of(some, names))) for some in (records[:1], records)]
        return Pilots(
            tuple(scenes), ladder, self.failed, scene_s, shard_s,
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
        began = self.clock()
        self._write("few", WRITTEN_AT_ONCE, self._last)
        each = max((self.clock() - began - alone) / (WRITTEN_AT_ONCE - 1), 0.0)
        return min(each, alone), max(alone - each, 0.0)
