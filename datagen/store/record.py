"""The commit record of a shard, `build/shard-000123.json`: its files' hashes, and of every scene the digests of the
decoded values, the parameters and the seconds. Its presence is what says that the shard is there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from datagen.errors import InputError
from datagen.records import Scalar
from datagen.store.files import json_bytes, read_json, sha256_of

BUILD = "build"


@dataclass(frozen=True)
class SceneRecord:
    """One scene of a shard. `failure` is None, or why the scene could not be made (its values are fill values)."""

    index: int
    failure: str | None = None
    digests: Mapping[str, str] = field(default_factory=dict)
    """Field → hex SHA-256 of the scene's values, little-endian, C order."""
    parameters: Mapping[str, Scalar] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class FileRecord:
    """Hex SHA-256 and size of a file."""

    sha256: str
    bytes: int


@dataclass(frozen=True)
class ShardRecord:
    """What is known of a committed shard.

    Attributes
    ----------
    first_scene, last_scene : the scenes it holds, both included.
    fingerprint : of the configuration it was made with.
    files : path relative to the dataset → hash and size.
    seconds : wall-clock seconds of the whole shard: "store" is encoding, writing and syncing.
    started, finished : Unix times.
    environment : versions and machine of the worker.
    """

    shard: int
    first_scene: int
    last_scene: int
    fingerprint: str
    files: Mapping[str, FileRecord]
    scenes: tuple[SceneRecord, ...]
    seconds: Mapping[str, float]
    started: float
    finished: float
    environment: Mapping[str, str]

    @property
    def failures(self) -> dict[int, str]:
        """Scene index → why it could not be made."""
        return {scene.index: scene.failure for scene in self.scenes if scene.failure is not None}

    def to_bytes(self) -> bytes:
        """The record's file."""
        return json_bytes(asdict(self))

    def problem(self, root: Path, hashes: bool = True) -> str | None:
        """What is wrong with the shard's files, or None. Without `hashes` only presence and size are looked at."""
        for name, known in self.files.items():
            path = root / name
            if not path.is_file():
                return f"{name}: missing"
            if path.stat().st_size != known.bytes:
                return f"{name}: {path.stat().st_size} bytes, {known.bytes} were written"
            if hashes and sha256_of(path) != known.sha256:
                return f"{name}: its bytes have changed since they were written (SHA-256 differs)"
        return None


def record_path(root: Path, shard: int) -> Path:
    """The commit record's file."""
    return root / BUILD / f"shard-{shard:06d}.json"


def running_path(root: Path, shard: int) -> Path:
    """Locked by the worker that writes the shard; holds the scene it is at."""
    return root / BUILD / f"shard-{shard:06d}.running"


def read_record(root: Path, shard: int) -> ShardRecord | None:
    """The record of a shard, or None when the shard is not committed. Raises `InputError` for a damaged record."""
    path = record_path(root, shard)
    if not path.is_file():
        return None
    values = read_json(path)
    try:
        files = {name: FileRecord(**known) for name, known in values["files"].items()}
        scenes = tuple(SceneRecord(**scene) for scene in values["scenes"])
        return ShardRecord(**{**values, "files": files, "scenes": scenes})
    except (TypeError, KeyError, AttributeError) as error:
        raise InputError(f"{path}: is not a commit record ({error}); delete it and build again") from None


def recorded_shards(root: Path) -> list[int]:
    """Numbers of the shards that have a record, ascending."""
    matches = (re.fullmatch(r"shard-(\d+)\.json", path.name) for path in (root / BUILD).glob("shard-*.json"))
    return sorted(int(match[1]) for match in matches if match)
