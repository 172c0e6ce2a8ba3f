"""The commit record of a shard, `build/shard-000123.json`: hashes of its files, and for each scene the digests of the
decoded values, the parameters and the seconds. A shard is committed when its record exists. The record ends with a
checksum of its own; a record that does not match it is not used.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import pydantic

from datagen.errors import CheckError, InputError
from datagen.store.arrays import shard_file
from datagen.store.environment import STATED
from datagen.store.files import difference, is_intact, parsed_json, read_if_there, sealed_bytes
from datagen.store.location import AnyLocation, Location
from datagen.store.schema import Schema
from datagen.store.stats import FieldStats

BUILD = "build"
GROWTH = f"{BUILD}/growth"
"""Folder of what waits to take the place of files of a dataset that grows (`store/growth.py`); it is laid out as the
dataset itself."""

Parameter = Annotated[int, pydantic.Field(ge=-(2**63), lt=2**63)] | float | str | bool
Finite = Annotated[float, pydantic.Field(allow_inf_nan=False)]
Digest = Annotated[str, pydantic.Field(pattern=r"^[0-9a-f]{64}$")]


@dataclass(frozen=True)
class SceneRecord:
    """One scene of a shard; `failure` says why it could not be made (its values are fill values), or is None."""

    index: int
    failure: str | None = None
    digests: Mapping[str, Digest] = field(default_factory=dict)
    """Field → hex SHA-256 of the scene's values, little-endian, C order."""
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    seconds: Mapping[str, Finite] = field(default_factory=dict)
    stats: Mapping[str, FieldStats] = field(default_factory=dict)
    """Field → statistics of its values."""


@dataclass(frozen=True)
class FileRecord:
    """Hex SHA-256 and size of a file."""

    sha256: Digest
    bytes: Annotated[int, pydantic.Field(ge=0)]


@dataclass(frozen=True)
class ShardRecord:
    """A committed shard: its files, its scenes, and the environment in which it was made.

    first_scene, last_scene : its first scene and its last one.
    fingerprint : of the configuration that it was made with.
    files : path relative to the dataset → hash and size.
    seconds : wall-clock seconds of the whole shard: "store" for encoding, writing and syncing; "total".
    started, finished : Unix times.
    made_by : versions and machine of the worker (`made_with`).
    """

    shard: int
    first_scene: int
    last_scene: int
    fingerprint: str
    files: Mapping[str, FileRecord]
    scenes: tuple[SceneRecord, ...]
    seconds: Mapping[str, Finite]
    started: Finite
    finished: Finite
    made_by: Mapping[str, str]

    @property
    def failures(self) -> dict[int, str]:
        """Scene index → why it could not be made."""
        return {scene.index: scene.failure for scene in self.scenes if scene.failure is not None}

    def to_bytes(self) -> bytes:
        """The record's file."""
        return sealed_bytes(vars(self))

    def mismatch(
        self, schema: Schema, fingerprint: str, extent: Literal["all", "at least", "any"] = "all"
    ) -> str | None:
        """A sentence on why this record does not belong to a dataset of this schema and fingerprint, or None.

        extent : the scenes that the record must hold: those that the schema gives the shard; these and perhaps more,
            because the dataset may have grown, or grow, beyond the schema; or any number of the shard's scenes, from
            the first one on.
        """
        scenes = schema.scenes_of(self.shard)
        first = self.shard * schema.scenes_per_shard
        least = scenes.stop if extent == "at least" else first + 1
        if extent != "all" and least <= self.last_scene + 1 <= first + schema.scenes_per_shard:
            scenes = range(first, self.last_scene + 1)
        if self.fingerprint != fingerprint:
            return f"was made with another configuration (fingerprint {self.fingerprint[:12]})"
        if (self.first_scene, self.last_scene) != (scenes.start, scenes.stop - 1):
            return f"holds scenes {self.first_scene}-{self.last_scene}, {scenes.start}-{scenes.stop - 1} belong there"
        if [scene.index for scene in self.scenes] != list(scenes):
            return "its record does not list its scenes one by one"
        if set(self.files) != {shard_file(field, self.shard) for field in schema.fields}:
            return "its record lists other files than the shard has"
        if any(scene.failure is None and set(scene.digests) != set(schema.by_name) for scene in self.scenes):
            return "its record lacks digests"
        return None

    def cut(self, schema: Schema) -> ShardRecord:
        """This record with those of its scenes alone that the schema has."""
        here = len(schema.scenes_of(self.shard))
        if len(self.scenes) <= here:
            return self
        return replace(self, last_scene=self.first_scene + here - 1, scenes=self.scenes[:here])

    def problem(self, *places: Location, hashes: bool = True, instead: ShardRecord | None = None) -> str | None:
        """A sentence on the first file of the shard that is as written in none of the `places`, or None if there is
        no such file.

        hashes : compare the bytes; without it, only sizes.
        instead : a record whose files may have taken the places of some of these.
        """
        for name, known in self.files.items():
            due = [known] if instead is None else [known, instead.files[name]]
            found = [
                difference(place / name, of.sha256 if hashes else None, of.bytes) for of in due for place in places
            ]
            if None not in found:
                return f"{name}: {next((what for what in found if what != 'missing'), 'missing')}"
        return None


def record_path(root: AnyLocation, shard: int) -> AnyLocation:
    """Path of a shard's commit record."""
    return root / record_name(shard)


def record_name(shard: int) -> str:
    """Path of a shard's commit record, relative to the dataset."""
    return f"{BUILD}/shard-{shard:06d}.json"


def running_path(root: Path, shard: int) -> Path:
    """Path of the file that is locked by whoever makes a shard, from its first scene until it is committed."""
    return root / BUILD / f"shard-{shard:06d}.running"


def writing_path(root: Path, shard: int) -> Path:
    """Path of the file that is locked by the process that writes a shard, as long as it writes."""
    return root / BUILD / f"shard-{shard:06d}.writing"


def read_record(root: Location, shard: int) -> ShardRecord | None:
    """The record of a shard, or None if the shard is not committed. Raises `CheckError` for a damaged record."""
    path = root / record_name(shard)
    try:
        content = read_if_there(path)
        if content is None:
            return None
        if not is_intact(content):
            raise InputError(f"{path}: has changed since it was written (its checksum differs)")
        record = parsed_json(path, content, ShardRecord)
        is_whole = {"store", "total"} <= set(record.seconds) and set(record.made_by) >= STATED
        if record.shard != shard or not is_whole:
            raise InputError(f"{path}: is not the record of shard {shard}")
    except InputError as error:
        raise CheckError(f"{error}; run the same `datagen build` again to make shard {shard} anew") from None
    return record


def recorded_shards(root: Location) -> list[int]:
    """Numbers of the shards that have a record, ascending."""
    matches = (re.fullmatch(r"shard-([0-9]{6,12})\.json", path.name) for path in (root / BUILD).glob("shard-*.json"))
    # Of two names of one number, such as with more zeros, only the one counts that is opened.
    return sorted({int(match[1]) for match in matches if match and match[0] == Path(record_name(int(match[1]))).name})


def sound_records(root: Location, shards: Iterable[int] | None = None) -> Iterator[ShardRecord]:
    """The undamaged records of `shards` (None: of all shards). They may belong to another dataset."""
    for shard in recorded_shards(root) if shards is None else shards:
        try:
            record = read_record(root, shard)
        except CheckError:
            continue
        if record is not None:
            yield record


def scenes_made(records: Iterable[ShardRecord]) -> Iterator[SceneRecord]:
    """The scenes of the shards that could be made, one after the other."""
    return (scene for record in records for scene in record.scenes if scene.failure is None)
