"""Single scenes of a dataset with all their fields and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import CheckError, InputError, shown
from datagen.records import Scalar, TimeAxis
from datagen.store.location import Location, location_of
from datagen.store.manifest import Manifest, read_manifest
from datagen.store.reader import DatasetReader
from datagen.store.record import SceneRecord, ShardRecord, read_record, scenes_made
from datagen.store.verify import each_committed


@dataclass(frozen=True)
class SceneContent:
    """One scene: field → its value (`arrays`), and its parameters as in `samples.parquet`; or one `frame` of it."""

    root: Location
    manifest: Manifest
    index: int
    arrays: Mapping[str, NDArray[Any]]
    parameters: Mapping[str, Scalar]
    frame: int | None = None

    def at_frame(self, frame: int) -> SceneContent:
        """A frame of a sequence, as the content of a scene that is measured once."""
        fields = self.manifest.schema.by_name
        arrays = {
            name: value if fields[name].frame_bytes is None else value[frame] for name, value in self.arrays.items()
        }
        return replace(self, arrays=arrays, frame=frame)

    @property
    def time(self) -> TimeAxis:
        """The bins of the histogram (also those of the transient unless the sensor merges bins)."""
        return self.manifest.time


class Scenes:
    """Reads single scenes of a dataset, in a folder or at an address such as `s3://bucket/name`. The mesh files that
    it was made from are not needed.

    Raises `InputError` if the folder is no dataset, `CheckError` for missing or damaged values.
    """

    def __init__(self, dataset: str | Location) -> None:
        self.root = location_of(dataset)
        self.manifest = read_manifest(self.root)
        self._reader = DatasetReader(self.root, self.manifest, self.manifest.schema.by_name)

    def made(self) -> list[int]:
        """The indices of the scenes of committed shards that could be made, ascending."""
        return [scene.index for scene in scenes_made(each_committed(self.root, self.manifest))]

    def record(self, index: int, called: str = "scene") -> tuple[ShardRecord, SceneRecord]:
        """The record of the shard of scene `index`, and the scene's own, also of a scene that could not be made.

        Raises `InputError`, which calls the scene `called`, if the dataset has no such scene, or not yet, and
        `CheckError` for a record that is damaged, or of another dataset.
        """
        schema = self.manifest.schema
        if isinstance(index, bool) or not isinstance(index, int | np.integer) or not 0 <= index < schema.scenes:
            raise InputError(
                f"{called} {shown(index)}: {self.root} has the scenes 0 … {schema.scenes - 1}; name one of them"
            )
        shard = int(index) // schema.scenes_per_shard
        record = read_record(self.root, shard)
        if record is not None:
            wrong = record.mismatch(schema, self.manifest.fingerprint, "any")
            if wrong is not None:
                raise CheckError(f"{self.root}: shard {shard} {wrong}; run the same `datagen build` again")
        if record is None or index > record.last_scene:
            raise InputError(
                f"{called} {index}: shard {shard} of {self.root} is not there yet; run `datagen build` again, or "
                "name a scene that is"
            )
        return record, record.scenes[int(index) - record.first_scene]

    def read(self, index: int, called: str = "scene") -> SceneContent:
        """The scene of an index. Raises as `record` does, and `InputError` for a scene that could not be made."""
        _, scene = self.record(index, called)
        if scene.failure is not None:
            raise InputError(
                f"{called} {index}: this scene of {self.root} could not be made ({scene.failure}); name another one"
            )
        arrays = {name: self._reader.read(name, [index])[0] for name in self.manifest.schema.by_name}
        return SceneContent(self.root, self.manifest, index, arrays, scene.parameters)
