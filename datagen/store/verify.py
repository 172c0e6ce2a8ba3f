"""Is a dataset what its records say? Files by hash, values by the digests of what they decode to."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from datagen.config import fingerprint_of
from datagen.errors import InputError
from datagen.store.arrays import GROUP, open_array
from datagen.store.card import CARD, CROISSANT, card, croissant, write_card, write_croissant
from datagen.store.environment import environment
from datagen.store.files import json_bytes, sha256_of
from datagen.store.manifest import Manifest, read_manifest
from datagen.store.record import ShardRecord, read_record, recorded_shards
from datagen.store.shard import digest
from datagen.store.table import TABLE, table_bytes, table_of, write_table


def committed(
    root: Path, manifest: Manifest, shards: Iterable[int] | None = None, hashes: bool = False
) -> list[ShardRecord]:
    """The records of the shards that are there: of this configuration, of all their scenes, their files in place.

    With `hashes` the files' bytes must also be those that were written.
    """
    records = []
    for shard in range(manifest.schema.shards) if shards is None else shards:
        try:
            record = read_record(root, shard)
        except InputError:
            continue
        if record and _mismatch(record, manifest) is None and record.problem(root, hashes) is None:
            records.append(record)
    return records


def finish(root: Path, manifest: Manifest, records: Sequence[ShardRecord]) -> None:
    """Write what a complete dataset has beside its arrays: the table, the cards."""
    write_table(root, records, [field.name for field in manifest.schema.fields])
    write_croissant(root, manifest)
    write_card(root, manifest, records)


@dataclass(frozen=True)
class Verification:
    """The outcome of `verify`: what was looked at, and every problem in a line of its own."""

    scenes: int
    shards: int
    bytes: int
    problems: tuple[str, ...]


def verify(path: str | Path) -> Verification:
    """Check all of a dataset: metadata, every file's SHA-256, every scene's decoded values, table and cards.

    Raises `InputError` when the folder is no dataset; everything that is wrong with one that is stands in `problems`.
    """
    root = Path(path)
    manifest = read_manifest(root)
    problems = list(_metadata_problems(root, manifest))
    scenes = shards = size = 0
    records = []
    for shard in range(manifest.schema.shards):
        try:
            record = read_record(root, shard)
        except InputError as error:
            problems.append(str(error))
            continue
        if record is None:
            problems.append(f"shard {shard}: not there (no commit record); build again to make it")
            continue
        records.append(record)
        problems += _shard_problems(root, manifest, record)
        scenes, shards = scenes + len(record.scenes), shards + 1
        size += sum(file.bytes for file in record.files.values())
    problems += [
        f"shard {shard}: has a commit record, but the dataset has only {manifest.schema.shards} shards"
        for shard in recorded_shards(root)
        if shard >= manifest.schema.shards
    ]
    if len(records) == manifest.schema.shards:
        problems += _summary_problems(root, manifest, records)
    return Verification(scenes, shards, size, tuple(problems))


def _metadata_problems(root: Path, manifest: Manifest) -> Iterator[str]:
    yield from filter(None, (_metadata_problem(root, manifest, name) for name in manifest.metadata))
    if fingerprint_of(manifest.config, manifest.meshes) != manifest.fingerprint:
        yield "dataset.json: its configuration is not the one its fingerprint was taken of"


def _metadata_problem(root: Path, manifest: Manifest, name: str) -> str | None:
    if not (root / name).is_file():
        return f"{name}: missing"
    if sha256_of(root / name) != manifest.metadata.get(name):
        return f"{name}: its bytes have changed since they were written (SHA-256 differs)"
    return None


def _mismatch(record: ShardRecord, manifest: Manifest) -> str | None:
    scenes = manifest.schema.scenes_of(record.shard)
    if record.fingerprint != manifest.fingerprint:
        return f"was made with another configuration (fingerprint {record.fingerprint[:12]})"
    if (record.first_scene, record.last_scene) != (scenes.start, scenes.stop - 1):
        return f"holds scenes {record.first_scene}-{record.last_scene}, {scenes.start}-{scenes.stop - 1} belong there"
    if [scene.index for scene in record.scenes] != list(scenes):
        return "its record does not list its scenes one by one"
    return None


def _shard_problems(root: Path, manifest: Manifest, record: ShardRecord) -> Iterator[str]:
    wrong = _mismatch(record, manifest) or record.problem(root)
    if wrong is not None:
        yield f"shard {record.shard}: {wrong}"
        return
    for scene in record.scenes:
        if scene.failure is not None:
            yield f"scene {scene.index}: could not be made: {scene.failure}"
    start = record.first_scene
    for field in manifest.schema.fields:
        if _metadata_problem(root, manifest, f"{GROUP}/{field.name}/zarr.json"):
            continue
        try:
            values = np.asarray(open_array(root, field.name)[start : record.last_scene + 1])
        except Exception as error:
            # Whatever a decoder raises over damaged bytes is a finding here, not an accident.
            what = " ".join(f"{type(error).__name__}: {error}".split())
            yield f"shard {record.shard}: field {field.name} cannot be decoded ({what})"
            continue
        for scene in record.scenes:
            if scene.failure is None and digest(field, values[scene.index - start]) != scene.digests[field.name]:
                yield f"scene {scene.index}: field {field.name} decodes to other values than were written"


def _summary_problems(root: Path, manifest: Manifest, records: Sequence[ShardRecord]) -> Iterator[str]:
    if not (root / TABLE).is_file():
        yield f"{TABLE}: missing; build again to write it"
        return
    table, now = table_of(records, [field.name for field in manifest.schema.fields]), environment()
    # Another pyarrow writes the same table in other bytes.
    same_writer = manifest.versions["pyarrow"] == now["pyarrow"]
    if (root / TABLE).read_bytes() != table_bytes(table) and (same_writer or not _holds(root / TABLE, table)):
        yield f"{TABLE}: differs from what the commit records say"
        return
    for name, text in ((CROISSANT, json_bytes(croissant(root, manifest))), (CARD, card(manifest, records).encode())):
        # Another datagen may word the same facts otherwise.
        if not (root / name).is_file() or (
            (root / name).read_bytes() != text and manifest.versions["datagen"] == now["datagen"]
        ):
            yield f"{name}: missing, or differs from what the dataset holds"


def _holds(path: Path, table: pa.Table) -> bool:
    try:
        return table_bytes(pq.read_table(path).replace_schema_metadata(table.schema.metadata)) == table_bytes(table)
    except (pa.ArrowException, OSError):
        return False
