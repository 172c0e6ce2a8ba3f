"""The description of a dataset that `info`, the cards and the preview print, each in its own form."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from datagen.records import Scalar
from datagen.store.environment import mixed
from datagen.store.manifest import Manifest
from datagen.store.record import ShardRecord, scenes_made
from datagen.store.schema import Field
from datagen.store.splits import splits_of
from datagen.store.summaries import evidence_by_kind, evidence_lines, label_place_line, placed_anew_lines

_SIMULATED = (
    "Simulated: rooms are drawn at random as the configuration in dataset.json declares, light is followed from a "
    "laser around a corner and back, and a model of a single-photon detector counts it. Nothing was measured."
)
_IMPORTED = (
    "Imported: captures as files of other programs or of a laboratory hold them, of which dataset.json has names and "
    "SHA-256; nothing was simulated. How they were made, and what is hidden, is not known to datagen."
)


@dataclass(frozen=True)
class Description:
    """A dataset as its manifest and the records of its committed shards describe it."""

    manifest: Manifest
    records: Sequence[ShardRecord]

    @property
    def origin(self) -> str:
        """Sentences that say whether the dataset was simulated or imported."""
        return _IMPORTED if self.manifest.imported else _SIMULATED

    @property
    def is_whole(self) -> bool:
        """Whether all shards are there."""
        return len(self.records) == self.manifest.schema.shards

    @property
    def scenes(self) -> int:
        """The number of scenes in committed shards."""
        return sum(len(record.scenes) for record in self.records)

    @property
    def shapes(self) -> dict[Field, tuple[str, ...]]:
        """Field → its shape over all scenes, as text."""
        schema = self.manifest.schema
        return {field: tuple(map(str, (schema.scenes, *field.shape))) for field in schema.fields}

    @cached_property
    def stored_bytes(self) -> Counter[str]:
        """Field → bytes of its files."""
        stored = Counter[str]()
        for record in self.records:
            for name, file in record.files.items():
                stored[name.split("/")[1]] += file.bytes
        return stored

    @cached_property
    def made(self) -> list[Mapping[str, Scalar]]:
        """The parameters of each scene that could be made."""
        return [scene.parameters for scene in scenes_made(self.records)]

    @cached_property
    def failures(self) -> dict[int, str]:
        """Scene → why it could not be made."""
        return dict(sorted(failure for record in self.records for failure in record.failures.items()))

    def failure_lines(self, most: int) -> list[str]:
        """A line for each of the first `most` scenes that could not be made."""
        return [f"scene {scene}: {reason}" for scene, reason in list(self.failures.items())[:most]]

    def differences(self) -> list[str]:
        """Sentences on how the environments differ in which the shards were made."""
        return [f"shards differ in {name}" for name in mixed([record.made_by for record in self.records])]

    def label_place(self) -> str:
        """A sentence on where label images lie beside the scan; "" if no scene says so."""
        return label_place_line(self.made)

    def evidence(self) -> list[str]:
        """Lines on the significance of the objects of each kind, and on objects that were placed anew."""
        return [*evidence_lines(evidence_by_kind(self.made)), *placed_anew_lines(self.made)]

    def scenes_by_split(self) -> Counter[str]:
        """Split → its number of scenes."""
        scenes = [scene for record in self.records for scene in record.scenes]
        parameters = [scene.parameters if scene.failure is None else None for scene in scenes]
        return Counter(name for name in splits_of(parameters, self.manifest.splits()) if name is not None)

    def ranges(self) -> list[tuple[str, str, str, str]]:
        """(name, least, median, most) of every numeric parameter that varies from scene to scene."""
        rows = []
        for name in dict.fromkeys(name for scene in self.made for name in scene):
            stated = [scene[name] for scene in self.made if name in scene]
            values = np.array([value for value in stated if not isinstance(value, str)], np.float64)
            if len(values) == len(stated) and values.min() < values.max():
                rows.append((name, f"{values.min():.4g}", f"{np.median(values):.4g}", f"{values.max():.4g}"))
        return rows
