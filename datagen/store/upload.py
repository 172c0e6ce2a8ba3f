"""A build into an object store: shards are made in a local folder and put there one by one, each record last.

A build that was interrupted is taken up, also on another machine: shards whose records are there are fetched, not
made again. Readers use no shard without its record, and no dataset is complete without its table, which comes after
all records. One build at a time may write there: object stores have no locks.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from datagen.errors import InputError
from datagen.store.card import CARD
from datagen.store.files import read_whole, write_atomically
from datagen.store.location import Bucket
from datagen.store.manifest import MANIFEST, DamagedManifest, Manifest, read_manifest
from datagen.store.prepare import WHEN_COMPLETE, is_fresh
from datagen.store.record import ShardRecord, record_path, recorded_shards, sound_records


def staging_of(bucket: Bucket) -> Path:
    """The local folder of a build into an object store: below DATAGEN_STAGING, or the user's cache. It may be deleted
    when the build is done."""
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    below = os.environ.get("DATAGEN_STAGING") or Path(cache, "datagen", "staging")
    return Path(below, bucket.bucket, *bucket.key.parts)


def fetch(root: Path, bucket: Bucket) -> None:
    """Copy the shards of an earlier build from the object store to the local folder, where that lacks them.

    Raises `InputError` when what lies there is no dataset, or another one than that of the folder.
    """
    try:
        manifest = read_manifest(bucket)
    except DamagedManifest:
        # Restored from here, as a build restores a folder's; shards that are no part of it are made new.
        return
    except InputError:
        if bucket.is_dir():
            raise InputError(f"output {bucket}: holds objects and no dataset; name another prefix") from None
        return
    if is_fresh(root):
        root.mkdir(parents=True, exist_ok=True)
        write_atomically(root / MANIFEST, read_whole(bucket / MANIFEST))
    own = read_manifest(root)
    if (own.fingerprint, own.schema_version) != (manifest.fingerprint, manifest.schema_version):
        raise InputError(f"output {bucket}: holds another dataset than {root}, made for it; delete one of the two")
    missing = sorted({*recorded_shards(bucket)} - {*recorded_shards(root)})
    for record in sound_records(bucket, manifest.must_be_sealed, missing):
        if record.mismatch(manifest.schema, manifest.fingerprint) is None:
            _fetch_shard(root, bucket, record)


def _fetch_shard(root: Path, bucket: Bucket, record: ShardRecord) -> None:
    """Copy one shard, its record last. A file that differs from the record is found by the build, and made again."""
    if record.problem(bucket, hashes=False) is not None:
        return
    for name in record.files:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(root / name, (bucket / name).read_bytes())
    kept = record_path(root, record.shard)
    kept.parent.mkdir(exist_ok=True)
    write_atomically(kept, record.to_bytes())


def begin(root: Path, bucket: Bucket, manifest: Manifest) -> None:
    """Upload the manifest and the metadata of the arrays, if they are not there."""
    if not _holds(bucket / MANIFEST, root / MANIFEST):
        # It grows, or is mended: what described it as complete goes before anything else changes.
        for name in WHEN_COMPLETE:
            (bucket / name).unlink()
    for name in (MANIFEST, *manifest.metadata):
        _put(root, bucket, name)


def put_shard(root: Path, bucket: Bucket, record: ShardRecord) -> None:
    """Upload a committed shard, its record last, unless the same bytes are there."""
    kept, there = record_path(root, record.shard), record_path(bucket, record.shard)
    if _holds(there, kept) and record.problem(bucket) is None:
        return
    for name in WHEN_COMPLETE:
        (bucket / name).unlink()
    there.unlink()
    for name in record.files:
        (bucket / name).put(root / name)
    there.put(kept)


def finish_upload(root: Path, bucket: Bucket, records: Iterable[ShardRecord], complete: bool) -> None:
    """Upload what is missing or differs; the files of a complete dataset come last."""
    for record in records:
        put_shard(root, bucket, record)
    # The table before what vouches for it.
    for name in (CARD, MANIFEST, *(WHEN_COMPLETE if complete else ())):
        _put(root, bucket, name)


def _put(root: Path, bucket: Bucket, name: str) -> None:
    if not _holds(bucket / name, root / name):
        (bucket / name).put(root / name)


def _holds(there: Bucket, kept: Path) -> bool:
    try:
        return there.read_bytes() == kept.read_bytes()
    except FileNotFoundError:
        return False
