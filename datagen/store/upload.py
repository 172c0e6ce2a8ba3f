"""The output of a build, a local folder that may be copied to an object store shard by shard.

The commit record of a shard is uploaded after its files, and the table after all records: readers use no shard
without its record, and take no dataset for complete without its table. A build that was interrupted can be resumed on
another machine: it fetches the shards whose records are in the object store, instead of making them again. Object
stores have no locks, so only one build at a time may write to an address.

A complete dataset that grows stays as it is, as in a folder (`store/growth.py`). Its new shards are uploaded one by
one; what takes the place of other objects is uploaded at the end, in the same order in which files take their places.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from datagen.errors import CheckError, InputError
from datagen.store.card import CARD
from datagen.store.files import check_writable, holds, read_whole, write_atomically, write_first
from datagen.store.growth import growth_of, standing_shards, turn
from datagen.store.location import Bucket, location_of
from datagen.store.manifest import MANIFEST, DamagedManifest, Manifest, read_manifest
from datagen.store.prepare import WHEN_COMPLETE, forget_complete, is_fresh
from datagen.store.record import GROWTH, ShardRecord, record_path, recorded_shards, sound_records
from datagen.store.table import CROISSANT, TABLE


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
            write_first(root / MANIFEST, read_whole(bucket / MANIFEST))
        own = read_manifest(root)
        if own.fingerprint != manifest.fingerprint:
            raise InputError(
                f"output {bucket}: holds another dataset than {root}, made for it; delete one of the two"
            )
        missing = sorted({*recorded_shards(bucket)} - {*recorded_shards(root)})
        schema = (growth_of(bucket, manifest) or manifest).schema
        for record in sound_records(bucket, missing):
            # A file that differs from its record is found by the build, which makes the shard again.
            if record.mismatch(schema, manifest.fingerprint, "any") or record.problem(bucket, hashes=False):
                continue
            for name in record.files:
                (root / name).parent.mkdir(parents=True, exist_ok=True)
                write_atomically(root / name, (bucket / name).read_bytes())
            kept = record_path(root, record.shard)
            kept.parent.mkdir(exist_ok=True)
            write_atomically(kept, record.to_bytes())

    def begin(self, manifest: Manifest) -> None:
        """Upload the manifest and the metadata of the arrays, if they are not there. Raises `CheckError` if another
        build has begun another dataset there since this one looked."""
        if self.bucket is None:
            return
        if self._standing(manifest):
            content = manifest.to_bytes()
            if not holds(self.bucket / GROWTH / MANIFEST, content):
                (self.bucket / GROWTH / MANIFEST).put(content)
            return
        first = self.bucket / MANIFEST
        if first.is_file() or not first.put_first(self.folder / MANIFEST):
            try:
                there = read_manifest(self.bucket).fingerprint
            except DamagedManifest:
                there = manifest.fingerprint
            if there != manifest.fingerprint:
                raise CheckError(
                    f"output {self.bucket}: another build began another dataset there first, and this one wrote "
                    f"nothing there; name another address, and delete {self.folder}"
                )
        if not holds(self.bucket / MANIFEST, (self.folder / MANIFEST).read_bytes()):
            # The dataset is repaired, or grows before it is complete: files that say it is complete go before
            # anything else changes.
            forget_complete(self.bucket)
        for name in (MANIFEST, *manifest.metadata):
            self._put(self.bucket, name)

    def _standing(self, manifest: Manifest) -> int:
        """The number of shards in the object store that stay as they are until the dataset of `manifest` is complete:
        those of a complete smaller one; 0 without one."""
        assert self.bucket is not None
        if not standing_shards(self.bucket, manifest) or read_manifest(self.bucket).stats is None:
            return 0
        is_described = all((self.bucket / name).is_file() for name in WHEN_COMPLETE)
        return standing_shards(self.bucket, manifest) if is_described else 0

    def put_shard(self, record: ShardRecord, manifest: Manifest) -> None:
        """Upload a committed shard of the dataset of `manifest`, its record last, unless the same bytes are there.
        One that takes the place of another when a growth is complete is left to `finish`."""
        if self.bucket is None:
            return
        standing = self._standing(manifest)
        if record.shard >= standing and not record_path(self.folder / GROWTH, record.shard).is_file():
            self._put_shard(self.bucket, record, standing)

    def _put_shard(self, bucket: Bucket, record: ShardRecord, standing: int) -> None:
        kept, there = record_path(self.folder, record.shard), record_path(bucket, record.shard)
        if holds(there, kept.read_bytes()) and record.problem(bucket) is None:
            return
        if record.shard < standing:
            # Readers of the smaller dataset take the size of a file from this record, too.
            record_path(bucket / GROWTH, record.shard).put(kept)
        else:
            if not standing:
                forget_complete(bucket)
            there.unlink(missing_ok=True)
        for name in record.files:
            (bucket / name).put(self.folder / name)
        there.put(kept)

    def finish(self, records: Iterable[ShardRecord], manifest: Manifest, complete: bool) -> None:
        """Upload what is missing or differs; the files of a complete dataset come last."""
        if self.bucket is None:
            return
        standing = self._standing(manifest)
        grows = standing > 0
        if grows and not complete:
            return
        if grows:
            for name in (CROISSANT, MANIFEST):
                (self.bucket / GROWTH / name).put(self.folder / name)
        for record in records:
            self._put_shard(self.bucket, record, standing)
        names = (
            [*sorted(manifest.metadata, key=turn), TABLE, CROISSANT, CARD, MANIFEST] if grows else [CARD, MANIFEST]
        )
        if complete and not grows:
            # The table comes before croissant.json, which holds the table's hash.
            names += WHEN_COMPLETE
        for name in names:
            self._put(self.bucket, name)
        if complete and growth_of(self.bucket, manifest) is None:
            (self.bucket / GROWTH).unlink_below()

    def _put(self, bucket: Bucket, name: str) -> None:
        if not holds(bucket / name, (self.folder / name).read_bytes()):
            (bucket / name).put(self.folder / name)
