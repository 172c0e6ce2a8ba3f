"""The description of a dataset that `info`, the cards and the preview print, each in its own form."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cached_property

import numpy as np
import pyarrow as pa

from datagen.store.arrays import GROUP
from datagen.store.columns import Columns
from datagen.store.environment import environment_differences
from datagen.store.manifest import Manifest
from datagen.store.record import SceneRecord, ShardRecord, scenes_made
from datagen.store.schema import Field
from datagen.store.splits import Dealing
from datagen.store.stats import QUANTITIES
from datagen.store.summaries import (
    change_lines,
    effects_of,
    evidence_by_kind,
    evidence_lines,
    label_place_line,
    placed_anew_lines,
)
from datagen.store.table import Rows, stats_by_split

_SIMULATED = (
    "Simulated: rooms are drawn at random as the configuration in dataset.json declares, light is followed from a "
    "laser around a corner and back, and a model of a single-photon detector counts it. Nothing was measured."
)
_IMPORTED = (
    "Imported: captures as files of other programs or of a laboratory hold them, of which dataset.json has names and "
    "SHA-256; nothing was simulated. How they were made, and what is hidden, is not known to datagen."
)


def seconds_of(record: ShardRecord) -> Iterator[dict[str, float]]:
    """Stage → seconds, of each scene that could be made; and "store", the shard's seconds divided by its scenes."""
    for scene in scenes_made([record]):
        yield {stage: taken_s for stage, taken_s in scene.seconds.items() if stage != "store"}
    if record.scenes:
        yield {"store": record.seconds["store"] / len(record.scenes)}


class Description:
    """A dataset as its manifest and the records of its committed shards describe it.

    The records are read one after the other. What stays of a scene is what differs from scene to scene, some 8 bytes
    a number: a record itself takes 9 kB.

    Attributes
    ----------
    shards, scenes, made : number of committed shards, of their scenes, and of those that could be made.
    stored_bytes : field → bytes of its files.
    failures : scene → why it could not be made.
    parameters : of the scenes that could be made.
    effects : of each scene that could be made `effects_of` it.
    seconds : of all shards `seconds_of` them.
    times : when each shard was begun and finished.
    """

    def __init__(self, manifest: Manifest, records: Iterable[ShardRecord] = ()) -> None:
        self.manifest = manifest
        self.shards = self.scenes = self.made = 0
        self.stored_bytes = Counter[str]()
        self.failures = dict[int, str]()
        self.parameters, self.effects, self.seconds = Columns(), Columns(), Columns()
        self.times = list[tuple[float, float]]()
        self._environments = list[Mapping[str, str]]()
        self._dealing = Dealing(manifest.splits())
        self._stats: dict[str, array[float]] = {}
        for record in records:
            self.add(record)

    def add(self, record: ShardRecord) -> None:
        """Take in the record of another shard."""
        self.shards += 1
        self.times.append((record.started, record.finished))
        if record.made_by not in self._environments:
            self._environments.append(record.made_by)
        for name, file in record.files.items():
            self.stored_bytes[name.removeprefix(f"{GROUP}/").partition("/")[0]] += file.bytes
        for seconds in seconds_of(record):
            self.seconds.add(seconds)
        for scene in record.scenes:
            self._add_scene(scene)

    def _add_scene(self, scene: SceneRecord) -> None:
        """Take in a scene of a shard."""
        self._dealing.add(scene.parameters if scene.failure is None else None)
        for name, of in scene.stats.items():
            for quantity in QUANTITIES:
                column = self._stats.setdefault(f"stats.{name}.{quantity}", array("d"))
                column.extend([math.nan] * (self.scenes - len(column)))
                column.append(getattr(of, quantity))
        self.scenes += 1
        if scene.failure is not None:
            self.failures[scene.index] = scene.failure
            return
        self.made += 1
        self.parameters.add(scene.parameters)
        self.effects.add(effects_of(scene.parameters))

    @property
    def origin(self) -> str:
        """Sentences that say whether the dataset was simulated or imported."""
        return _IMPORTED if self.manifest.imported else _SIMULATED

    @property
    def is_whole(self) -> bool:
        """Whether all shards are there."""
        return self.shards == self.manifest.schema.shards

    @property
    def shapes(self) -> dict[Field, tuple[str, ...]]:
        """Field → its shape over all scenes, as text."""
        schema = self.manifest.schema
        return {field: tuple(map(str, (schema.scenes, *field.shape))) for field in schema.fields}

    def failure_lines(self, most: int) -> list[str]:
        """A line for each of the first `most` scenes that could not be made."""
        return [f"scene {scene}: {reason}" for scene, reason in sorted(self.failures.items())[:most]]

    def differences(self) -> list[str]:
        """Sentences on how the environments differ in which the shards were made."""
        return [f"shards differ in {name}" for name in environment_differences(self._environments)]

    def label_place(self) -> str:
        """A sentence on where label images lie beside the scan; "" if no scene says so."""
        return label_place_line(self.parameters)

    def evidence(self) -> list[str]:
        """Lines on the significance of the objects of each kind, on the changes by those that move, and on objects
        that were placed anew."""
        lines = [*evidence_lines(evidence_by_kind(self.parameters)), *change_lines(self.parameters)]
        return [*lines, *placed_anew_lines(self.parameters)]

    @cached_property
    def splits(self) -> list[str | None]:
        """The split of each scene; None where it could not be made."""
        return self._dealing.splits()

    def scenes_by_split(self) -> Counter[str]:
        """Split → its number of scenes."""
        return Counter(name for name in self.splits if name is not None)

    def stats(self) -> dict[str, dict[str, dict[str, float]]]:
        """Split → field → `mean`, `std` and `nonzero` of its values."""
        columns = {"split": pa.array(self.splits, pa.string())}
        for name, values in self._stats.items():
            padded = np.append(values, np.full(self.scenes - len(values), np.nan))
            columns[name] = pa.array(padded, mask=np.isnan(padded))
        return stats_by_split(pa.table(columns))

    def rows(self, records: Callable[[], Iterable[ShardRecord]]) -> Rows:
        """The rows of the table; `records` returns the same records once more."""
        kinds = {name: column.kinds for name, column in self.parameters.items()}
        with_stats = dict.fromkeys(name.split(".")[1] for name in self._stats)
        return Rows(records, kinds, self.splits, [*with_stats], [field.name for field in self.manifest.schema.fields])

    def ranges(self) -> list[tuple[str, str, str, str]]:
        """(name, least, median, most) of every numeric parameter that varies from scene to scene."""
        rows = []
        for name, column in self.parameters.items():
            if column.is_text:
                continue
            values = column.numbers
            if values.min() < values.max():
                rows.append((name, f"{values.min():.4g}", f"{np.median(values):.4g}", f"{values.max():.4g}"))
        return rows
