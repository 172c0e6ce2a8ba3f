"""Single scenes of a dataset with all their fields and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.records import Scalar, TimeAxis
from datagen.store.location import Location, location_of
from datagen.store.manifest import Manifest, read_manifest
from datagen.store.reader import DatasetReader
from datagen.store.record import read_record, scenes_made
from datagen.store.verify import each_committed


@dataclass(frozen=True)
class SceneContent:
    """One scene: field → its value (`arrays`), and its parameters as in `samples.parquet`."""

    root: Location
    manifest: Manifest
    index: int
    arrays: Mapping[str, NDArray[Any]]
    parameters: Mapping[str, Scalar]

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

    def read(self, index: int, called: str = "scene") -> SceneContent:
        """The scene of an index. Raises `InputError`, which calls it `called`, if it is not there or was not made."""
        schema = self.manifest.schema
        shard = index // schema.scenes_per_shard
        record = read_record(self.root, shard)
        if record is None:
            raise InputError(
                f"{called} {index}: shard {shard} of {self.root} is not there yet; run `datagen build` again, or "
                "name a scene that is"
            )
        failure = record.failures.get(index)
        if failure is not None:
            raise InputError(
                f"{called} {index}: this scene of {self.root} could not be made ({failure}); name another one"
            )
        arrays = {name: self._reader.read(name, [index])[0] for name in schema.by_name}
        parameters = next(scene.parameters for scene in record.scenes if scene.index == index)
        return SceneContent(self.root, self.manifest, index, arrays, parameters)
