"""Verification of a dataset against its commit records: files by their hash, values by their digests."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow as pa

from datagen.config import fingerprint_of
from datagen.errors import CheckError, printable
from datagen.store.card import CARD, card, write_card
from datagen.store.croissant import croissant
from datagen.store.environment import made_with
from datagen.store.files import difference, holds, json_bytes, write_if_changed
from datagen.store.location import Location, location_of
from datagen.store.manifest import MANIFEST, Manifest, read_manifest
from datagen.store.reader import DatasetReader
from datagen.store.record import ShardRecord, read_record, recorded_shards, sound_records
from datagen.store.table import CROISSANT, TABLE, parquet_file, rows_of, stats_by_split, table_bytes, table_of


def committed(
    root: Location, manifest: Manifest, shards: Iterable[int] | None = None, hashes: bool = False
) -> list[ShardRecord]:
    """The records of committed shards: undamaged, of this configuration, with all their files at the right size. With
    `hashes` the files' bytes must also be those that were written.

    shards : look at these shards only; None: at all.
    """
    return list(each_committed(root, manifest, shards, hashes))


def each_committed(
    root: Location, manifest: Manifest, shards: Iterable[int] | None = None, hashes: bool = False
) -> Iterator[ShardRecord]:
    """The records of `committed`, one after the other: all of a large dataset take 9 kB of memory for a scene."""
    # The loop is over records in the folder, since a hostile `dataset.json` may claim any number of scenes.
    for record in sound_records(root, shards):
        is_own = record.shard < manifest.schema.shards and not record.mismatch(manifest.schema, manifest.fingerprint)
        if is_own and not record.problem(root, hashes):
            yield record


def finish(root: Path, manifest: Manifest, records: Sequence[ShardRecord]) -> None:
    """Write the files of a complete dataset beside its arrays: table, cards, and `stats` in `dataset.json`."""
    table = _table(manifest, records)
    manifest = replace(manifest, stats=stats_by_split(table))
    write_if_changed(root / MANIFEST, manifest.to_bytes())
    write_if_changed(root / TABLE, table_bytes(table))
    write_if_changed(root / CROISSANT, json_bytes(croissant(root, manifest, records)))
    write_card(root, manifest, records)


def _table(manifest: Manifest, records: Sequence[ShardRecord]) -> pa.Table:
    return table_of(records, [field.name for field in manifest.schema.fields], manifest.splits())


@dataclass(frozen=True)
class Verification:
    """The outcome of `verify`: the number of scenes, shards and bytes checked, and a line for each problem."""

    scenes: int
    shards: int
    bytes: int
    problems: tuple[str, ...]


def verify(path: str | Path, deep: bool = False) -> Verification:
    """The problems of a dataset: a check of its metadata, commit records, table, cards, and the SHA-256 of every
    file.

    deep : also decode every value and compare it with the digest that was taken before it was written.

    Raises `InputError` if the folder is no dataset; everything else that is wrong is in `problems`.
    """
    root = location_of(path)
    manifest = read_manifest(root)
    problems = list(_metadata_problems(root, manifest))
    scenes = size = 0
    records, there = [], recorded_shards(root)
    for shard in there:
        if shard >= manifest.schema.shards:
            problems.append(
                f"shard {shard}: has a commit record, but the dataset has only {manifest.schema.shards} shards"
            )
            continue
        try:
            record = read_record(root, shard)
        except CheckError as error:
            problems.append(str(error))
            continue
        if record is None:
            continue
        records.append(record)
        problems += _shard_problems(root, manifest, record, deep)
        scenes, size = scenes + len(record.scenes), size + sum(file.bytes for file in record.files.values())
    problems += [
        f"{name}: not there (no commit record); build again to make what is missing"
        for name in _missing(there, manifest.schema.shards)
    ]
    if len(records) == manifest.schema.shards:
        problems += _summary_problems(root, manifest, records)
    return Verification(scenes, len(records), size, tuple(printable(problem) for problem in problems))


def _missing(there: Sequence[int], shards: int) -> Iterator[str]:
    """`shard 3` or `shards 3-90` for every gap between the shards that are there."""
    ends = [-1, *(shard for shard in there if shard < shards), shards]
    for before, after in itertools.pairwise(ends):
        if after - before == 2:
            yield f"shard {before + 1}"
        elif after - before > 2:
            yield f"shards {before + 1}-{after - 1}"


def _metadata_problems(root: Location, manifest: Manifest) -> Iterator[str]:
    for name, sha256 in manifest.metadata.items():
        if (wrong := difference(root / name, sha256)) is not None:
            yield f"{name}: {wrong}"
    if fingerprint_of(manifest.config, manifest.meshes) != manifest.fingerprint:
        yield "dataset.json: its configuration is not the one its fingerprint was taken of"


def _shard_problems(root: Location, manifest: Manifest, record: ShardRecord, deep: bool) -> Iterator[str]:
    """Problems of the files and scenes of a committed shard."""
    wrong = record.mismatch(manifest.schema, manifest.fingerprint) or record.problem(root)
    if wrong is not None:
        yield f"shard {record.shard}: {wrong}"
        return
    for scene in record.scenes:
        if scene.failure is not None:
            yield f"scene {scene.index}: could not be made: {scene.failure}"
    if deep:
        reader = DatasetReader(root, manifest, manifest.schema.by_name)
        for scene, name in itertools.product(record.scenes, manifest.schema.by_name):
            try:
                reader.read(name, [scene.index])
            except CheckError as error:
                yield str(error)


def _summary_problems(root: Location, manifest: Manifest, records: Sequence[ShardRecord]) -> Iterator[str]:
    """Problems of the files that a complete dataset has beside its arrays."""
    if not (root / TABLE).is_file():
        yield f"{TABLE}: missing; build again to write it"
        return
    table, now = _table(manifest, records), made_with()
    if manifest.stats != stats_by_split(table):
        yield "dataset.json: its stats differ from what the commit records say"
    # Another version of pyarrow writes the same table with other bytes; then the rows are compared.
    same_writer = manifest.made_by["pyarrow"] == now["pyarrow"]
    if not holds(root / TABLE, table_bytes(table)) and (same_writer or not _has_rows_of(root / TABLE, table)):
        yield f"{TABLE}: differs from what the commit records say"
        return
    # Another version of datagen may describe the same dataset in other words; then the cards must only exist.
    same_words = manifest.made_by["datagen"] == now["datagen"]
    texts = {CROISSANT: b"", CARD: b""}
    if same_words:
        texts[CROISSANT] = json_bytes(croissant(root, manifest, records))
        texts[CARD] = card(manifest, records).encode()
    for name, text in texts.items():
        if not (holds(root / name, text) if same_words else (root / name).is_file()):
            yield f"{name}: missing, or differs from what the dataset holds"


def _has_rows_of(path: Location, table: pa.Table) -> bool:
    try:
        with path.open("rb") as file:
            stored = rows_of(parquet_file(file)).replace_schema_metadata(table.schema.metadata)
        return table_bytes(stored) == table_bytes(table)
    except (pa.ArrowException, OSError, ValueError):
        return False


def dataset_digest(path: str | Location) -> str:
    """Hex SHA-256 over all decoded values of a dataset. It does not depend on shards, compression, the order of
    building or interruptions.

    The hash takes, for each field in alphabetical order, a line `name dtype shape` (of one scene), and then for each
    scene the SHA-256 of its values, little-endian in C order, or 32 zero bytes if the scene could not be made. All
    values are read, and compared with the digests that were taken when they were written.

    Raises `InputError` if the folder is no dataset, `CheckError` if it is not complete or not as it was written.
    """
    root = location_of(path)
    manifest = read_manifest(root)
    schema, records = manifest.schema, committed(root, manifest)
    if len(records) < schema.shards:
        raise CheckError(
            f"{root}: {schema.shards - len(records)} of {schema.shards} shards are missing or damaged; run the same "
            "`datagen build` again to make them"
        )
    scenes = sorted((scene for record in records for scene in record.scenes), key=lambda scene: scene.index)
    reader, whole = DatasetReader(root, manifest, schema.by_name), hashlib.sha256()
    for name, field in sorted(schema.by_name.items()):
        whole.update(f"{name} {field.dtype} {' '.join(map(str, field.shape))}\n".encode())
        for scene in scenes:
            if scene.failure is None:
                # Reading compares the values with the record's digest, which can then stand for them.
                reader.read(name, [scene.index])
            whole.update(bytes.fromhex(scene.digests[name]) if scene.failure is None else bytes(32))
    return whole.hexdigest()
