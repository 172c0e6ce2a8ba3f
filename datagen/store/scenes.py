"""Single scenes of a dataset with all their fields and parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.records import Scalar, TimeAxis
from datagen.store.manifest import Manifest, read_manifest
from datagen.store.reader import DatasetReader
from datagen.store.record import read_record
from datagen.store.verify import committed


@dataclass(frozen=True)
class SceneContent:
    """The arrays and parameters of one scene.

    arrays : field → the scene's value. parameters : as in `samples.parquet`.
    """

    root: Path
    manifest: Manifest
    index: int
    arrays: Mapping[str, NDArray[Any]]
    parameters: Mapping[str, Scalar]

    @property
    def time(self) -> TimeAxis:
        """The bins of histogram and transient."""
        return self.manifest.time


class Scenes:
    """The scenes of a dataset, one after the other. Needs none of the mesh files that it was made from.

    Raises `InputError` when the folder is no dataset, `CheckError` for what is missing or damaged.
    """

    def __init__(self, dataset: str | Path) -> None:
        self.root = Path(dataset)
        self.manifest = read_manifest(dataset)
        self._reader = DatasetReader(self.root, self.manifest, self.manifest.schema.by_name)

    def made(self) -> list[int]:
        """The numbers of the scenes that are there and could be made."""
        records = committed(self.root, self.manifest)
        return sorted(scene.index for record in records for scene in record.scenes if scene.failure is None)

    def read(self, index: int, called: str = "scene") -> SceneContent:
        """One scene; `called` is what a refusal calls its number. Raises `InputError` for one that is not there, or
        could not be made."""
        schema = self.manifest.schema
        shard = index // schema.scenes_per_shard
        record = read_record(self.root, shard, self.manifest.must_be_sealed)
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
