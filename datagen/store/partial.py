"""The shards of a dataset that are there while it is built, or while it grows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import pyarrow as pa

from datagen.store.description import Description
from datagen.store.growth import growth_of, waiting_record
from datagen.store.location import Location
from datagen.store.manifest import Manifest, read_manifest
from datagen.store.record import GROWTH, SceneRecord, ShardRecord, recorded_shards, sound_records
from datagen.store.table import CROISSANT, TABLE, table_of

NOT_THERE = "is not there yet"


def largest(root: Location, manifest: Manifest) -> Manifest:
    """The manifest of the dataset that is being made: of the larger one if this one grows."""
    return growth_of(root, manifest) or manifest


def is_complete(root: Location, manifest: Manifest) -> bool:
    """Whether the dataset of a manifest is complete at a location."""
    there = {shard for shard in recorded_shards(root) if shard < manifest.schema.shards}
    is_described = read_manifest(root).schema.scenes == manifest.schema.scenes
    # A first build writes the table before the file that has its hash.
    has_table = (root / TABLE).is_file() and (root / CROISSANT).is_file()
    return is_described and has_table and len(there) == manifest.schema.shards


def shards_there(root: Location, manifest: Manifest, shards: Iterable[int] | None = None) -> Iterator[ShardRecord]:
    """The records of the shards that have their place, one after the other. The last shard of a dataset that grows
    has the scenes that it had.

    shards : look at these shards only; None: at all.
    """
    waiting = recorded_shards(root / GROWTH)
    for record in sound_records(root, shards):
        if record.mismatch(manifest.schema, manifest.fingerprint, "any") or record.shard >= manifest.schema.shards:
            continue
        # While a growth takes its last step, files of the shard are replaced before its record is.
        instead = waiting_record(root, manifest, record.shard) if record.shard in waiting else None
        if record.problem(root, hashes=False, instead=instead) is None:
            yield record.cut(manifest.schema)


def table_there(root: Location, manifest: Manifest) -> pa.Table:
    """The table of a dataset as if it were complete: a scene that is not there is one that could not be made."""
    dataset = Description(manifest, _records_with_failures(root, manifest))
    return table_of(dataset.rows(lambda: _records_with_failures(root, manifest)))


def _records_with_failures(root: Location, manifest: Manifest) -> Iterator[ShardRecord]:
    """A record for each shard, with a failure for each scene that is not there."""
    schema, there = manifest.schema, {*recorded_shards(root)}
    for shard in range(schema.shards):
        due = schema.scenes_of(shard)
        record = next(shards_there(root, manifest, [shard]), None) if shard in there else None
        known = record.scenes if record else ()
        missing = tuple(SceneRecord(scene, NOT_THERE) for scene in due[len(known) :])
        seconds, made_by = {"store": 0.0, "total": 0.0}, record.made_by if record else {}
        yield ShardRecord(
            shard, due.start, due.stop - 1, manifest.fingerprint, {}, (*known, *missing), seconds, 0.0, 0.0, made_by
        )
