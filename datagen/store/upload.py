"""The output of a build, a local folder that may be copied to an object store shard by shard.

The commit record of a shard is uploaded after its files, and the table after all records: readers use no shard
without its record, and take no dataset for complete without its table. A build that was interrupted can be resumed on
another machine: it fetches the shards whose records are in the object store, instead of making them again. Object
stores have no locks, so only one build at a time may write to an address.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from datagen.errors import InputError
from datagen.store.card import CARD
from datagen.store.files import check_writable, holds, read_whole, write_atomically
from datagen.store.location import Bucket, location_of
from datagen.store.manifest import MANIFEST, DamagedManifest, Manifest, read_manifest
from datagen.store.prepare import WHEN_COMPLETE, forget_complete, is_fresh
from datagen.store.record import ShardRecord, record_path, recorded_shards, sound_records


@dataclass(frozen=True)
class Output:
    """The folder that a build writes, and the prefix of an object store that it is copied to (None: no copy)."""

    folder: Path
    bucket: Bucket | None

    @classmethod
    def at(cls, path: str | Path) -> Output:
        """The output that a path or an address names. The folder of an address lies below DATAGEN_STAGING, or in the
        user's cache; it may be deleted when the build is done. Raises `InputError` if that cannot be written."""
        target = location_of(path)
        if isinstance(target, Path):
            return cls(target, None)
        cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
        below = Path(os.environ.get("DATAGEN_STAGING") or Path(cache, "datagen", "staging"))
        remedy = "let the environment variable DATAGEN_STAGING name a folder that has room for the shards"
        if below.parts[:1] == ("~",):
            raise InputError(
                f"output {target}: shards are made in a local folder, and this user has no home; {remedy}"
            )
        try:
            check_writable(below)
        except InputError as error:
            raise InputError(f"output {target}: shards are made in a local folder; {error}; {remedy}") from None
        return cls(Path(below, target.bucket, *target.key.parts), target)

    @property
    def shown(self) -> Path | str:
        """The folder, or the address of its copy."""
        return self.folder if self.bucket is None else str(self.bucket)

    def fetch(self) -> None:
        """Copy the shards of an earlier build from the object store to the folder, where that lacks them.

        Raises `InputError` if what lies there is no dataset, or another one than that of the folder.
        """
        root, bucket = self.folder, self.bucket
        if bucket is None:
            return
        try:
            manifest = read_manifest(bucket)
        except DamagedManifest:
            # The build restores the manifest from the folder, and makes shards that do not belong to it anew.
            return
        except InputError:
            if bucket.is_dir():
                raise InputError(f"output {bucket}: holds objects and no dataset; name another prefix") from None
            return
        if is_fresh(root):
            root.mkdir(parents=True, exist_ok=True)
            write_atomically(root / MANIFEST, read_whole(bucket / MANIFEST))
        own = read_manifest(root)
        if own.fingerprint != manifest.fingerprint:
            raise InputError(
                f"output {bucket}: holds another dataset than {root}, made for it; delete one of the two"
            )
        missing = sorted({*recorded_shards(bucket)} - {*recorded_shards(root)})
        for record in sound_records(bucket, missing):
            # A file that differs from its record is found by the build, which makes the shard again.
            if record.mismatch(manifest.schema, manifest.fingerprint) or record.problem(bucket, hashes=False):
                continue
            for name in record.files:
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                write_atomically(root / name, (bucket / name).read_bytes())
            kept = record_path(root, record.shard)
            kept.parent.mkdir(exist_ok=True)
            write_atomically(kept, record.to_bytes())

    def begin(self, manifest: Manifest) -> None:
        """Upload the manifest and the metadata of the arrays, if they are not there."""
        if self.bucket is None:
            return
        if not holds(self.bucket / MANIFEST, (self.folder / MANIFEST).read_bytes()):
            # The dataset grows, or is repaired: files that say it is complete go before anything else changes.
            forget_complete(self.bucket)
        for name in (MANIFEST, *manifest.metadata):
            self._put(self.bucket, name)

    def put_shard(self, record: ShardRecord) -> None:
        """Upload a committed shard, its record last, unless the same bytes are there."""
        if self.bucket is None:
            return
        kept, there = record_path(self.folder, record.shard), record_path(self.bucket, record.shard)
        if holds(there, kept.read_bytes()) and record.problem(self.bucket) is None:
            return
        forget_complete(self.bucket)
        there.unlink(missing_ok=True)
        for name in record.files:
            (self.bucket / name).put(self.folder / name)
        there.put(kept)

    def finish(self, records: Iterable[ShardRecord], complete: bool) -> None:
        """Upload what is missing or differs; the files of a complete dataset come last."""
        if self.bucket is None:
            return
        for record in records:
            self.put_shard(record)
        # The table comes before croissant.json, which holds the table's hash.
        for name in (CARD, MANIFEST, *(WHEN_COMPLETE if complete else ())):
            self._put(self.bucket, name)

    def _put(self, bucket: Bucket, name: str) -> None:
        if not holds(bucket / name, (self.folder / name).read_bytes()):
            (bucket / name).put(self.folder / name)
