"""The growth of a complete dataset, which stays what it was, for every reader, until the larger one is complete.

New shards lie beyond the end of the arrays, where no reader looks. Whatever will take the place of a file of the
smaller dataset waits in `build/growth`, which is laid out as the dataset itself: the manifest of the larger dataset
and the metadata of its arrays; shards of the smaller dataset with scenes that these lacked; and when all shards are
there, table and cards. The last step moves these files to their places, in an order in which readers find, between
any two moves, the smaller dataset or the larger one:

1. shards, and then their records. The scenes that both datasets have are the same in both, so readers of the smaller
   dataset read on; they take the size of a file from either record.
2. metadata of the arrays, those of the whole group last: from here on readers of Zarr see the larger dataset.
3. the table, whose hash is in the `croissant.json` that waits or that has its place, and the cards.
4. `dataset.json`: from here on our own readers see the larger dataset.
"""

from __future__ import annotations

import os
import re
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from datagen.errors import CheckError, InputError
from datagen.locks import try_lock
from datagen.records.checks import as_given
from datagen.store.arrays import GROUP
from datagen.store.files import PARTIAL, move, own_path
from datagen.store.location import Location
from datagen.store.manifest import MANIFEST, DamagedManifest, Manifest, read_manifest
from datagen.store.record import BUILD, GROWTH, ShardRecord, recorded_shards, sound_records
from datagen.store.schema import Schema
from datagen.store.table import CROISSANT, TABLE

_TURNS = (
    rf"{GROUP}/\w+/c/.*", rf"{BUILD}/.*", rf"{GROUP}/\w+/zarr\.json", rf"{GROUP}/zarr\.json", re.escape(TABLE),
    re.escape(CROISSANT), r"README\.md", re.escape(MANIFEST),
)  # fmt: skip
"""Patterns of the names of files, in the order in which these take their places."""
_WAIT_S = 0.05
_PATIENCE_S = 600.0
"""Seconds that a build waits for another one which completes a growth: the table of a million scenes takes less."""


def growth_of(root: Location, manifest: Manifest) -> Manifest | None:
    """The manifest of the larger dataset that a dataset grows into; None if it does not grow. It has `stats` when
    everything waits that the larger dataset needs."""
    try:
        larger = read_manifest(root / GROWTH)
    except InputError:
        return None
    same = (larger.fingerprint, larger.schema.fields, larger.schema.scenes_per_shard) == (
        manifest.fingerprint, manifest.schema.fields, manifest.schema.scenes_per_shard,
    )  # fmt: skip
    return larger if same and larger.schema.scenes > manifest.schema.scenes else None


def growth_line(root: Location, manifest: Manifest) -> str:
    """Words on the growth of a dataset that is not complete; "" if it does not grow."""
    larger = growth_of(root, manifest)
    if larger is None:
        return ""
    schema, own = larger.schema, manifest.schema
    shards = {*range(own.scenes // own.scenes_per_shard, schema.shards)}
    there = {shard for shard in recorded_shards(root) if shard >= own.shards} | {*recorded_shards(root / GROWTH)}
    return (
        f"growth to {schema.scenes} scenes not complete ({len(there & shards)} of its {len(shards)} shards are there)"
        f"; build with {as_given('scenes', schema.scenes)} to go on"
    )


def damaged_growth(root: Location) -> str | None:
    """A sentence on the manifest of a growth that is not as it was written, or None."""
    try:
        read_manifest(root / GROWTH)
    except DamagedManifest as error:
        return str(error)
    except InputError:
        pass
    return None


def standing_shards(root: Location, manifest: Manifest) -> int:
    """The number of shards of the smaller dataset that grows into that of `manifest`; 0 if none does. These shards
    stay as they are until the larger dataset is complete."""
    try:
        smaller = read_manifest(root)
    except InputError:
        return 0
    return smaller.schema.shards if smaller.schema.scenes < manifest.schema.scenes else 0


def is_of_dataset(root: Path, path: Path, schema: Schema) -> bool:
    """Whether a file below a dataset's folder is one of its own, and not of a larger dataset that it grows into."""
    name = path.relative_to(root).as_posix()
    shard = re.match(rf"(?:{GROUP}/\w+/c|{BUILD}/shard)[/-](\d+)", name)
    is_beyond = shard is not None and int(shard[1]) >= schema.shards
    return not is_beyond and not name.startswith(f"{GROWTH}/")


def waiting_record(root: Location, manifest: Manifest, shard: int) -> ShardRecord | None:
    """The record of a shard that waits, if there is a sound one of the configuration of `manifest`."""
    record = next(sound_records(root / GROWTH, [shard]), None)
    return (
        record if record is not None and not record.mismatch(manifest.schema, manifest.fingerprint, "any") else None
    )


def turn(name: str) -> tuple[int, str]:
    """The place of a file in the order in which files take their places; a name relative to the dataset."""
    return next((turn for turn, pattern in enumerate(_TURNS) if re.fullmatch(pattern, name)), 0), name


def take_places(root: Path) -> None:
    """Move what waits to its place. If this is interrupted, the next call goes on."""
    waiting = root / GROWTH
    names = [path.relative_to(waiting).as_posix() for path in waiting.rglob("*") if path.is_file()]
    for name in sorted((name for name in names if not name.endswith(PARTIAL)), key=turn):
        move(waiting / name, own_path(root, name))
    remove_empty(root)


def remove_empty(root: Path) -> None:
    """Remove the folders in which nothing waits any more."""
    waiting = root / GROWTH
    if not any(path.is_file() for path in waiting.rglob("*")):
        shutil.rmtree(waiting, ignore_errors=True)


@contextmanager
def growing_alone(root: Path) -> Iterator[None]:
    """A context in which no other build completes the growth of this dataset. Without a growth nobody waits. Raises
    `CheckError` if another build is at it for longer than `_PATIENCE_S`, such as one that was stopped."""
    try:
        handle = os.open(root / GROWTH, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        yield
        return
    try:
        last = time.monotonic() + _PATIENCE_S
        while not try_lock(handle, otherwise=True):
            if time.monotonic() > last:
                raise CheckError(
                    f"{root}: another build has been completing it for {_PATIENCE_S:.0f} s, and does not go on; when "
                    "that process has gone on or ended, run the same command again"
                )
            time.sleep(_WAIT_S)
        yield
    finally:
        os.close(handle)
