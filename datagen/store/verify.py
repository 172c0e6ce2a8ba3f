"""Verification of a dataset against its commit records: files by their hash, values by their digests."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from datagen.config import fingerprint_of
from datagen.errors import CheckError, InputError, as_line
from datagen.store.card import CARD, card, write_card
from datagen.store.croissant import croissant
from datagen.store.description import Description
from datagen.store.environment import made_with
from datagen.store.files import difference, holds, json_bytes, write_if_changed
from datagen.store.growth import (
    damaged_growth,
    growing_alone,
    growth_of,
    standing_shards,
    take_places,
    waiting_record,
)
from datagen.store.location import Location, location_of
from datagen.store.manifest import MANIFEST, Manifest, read_manifest
from datagen.store.reader import DatasetReader
from datagen.store.record import GROWTH, ShardRecord, read_record, record_name, recorded_shards, sound_records
from datagen.store.shard import digest
from datagen.store.table import CROISSANT, TABLE, has_rows, read_table, write_table


def committed_records(
    root: Location, manifest: Manifest, shards: Iterable[int] | None = None, hashes: bool = False
) -> list[ShardRecord]:
    """The records of committed shards: undamaged, of this configuration, with all their files at the right size. With
    `hashes` the files' bytes must also be those that were written.

    shards : look at these shards only; None: at all.
    """
    return list(each_committed(root, manifest, shards, hashes))


def each_committed(
    root: Location, manifest: Manifest, shards: Iterable[int] | None = None, hashes: bool | Container[int] = False,
    partly: bool = False,
) -> Iterator[ShardRecord]:  # fmt: skip
    """The records of `committed_records`, one after the other: all of a large dataset take 9 kB of memory for a
    scene.

    hashes : for all shards, or for these.
    partly : also shards of which the first scenes alone are there, because the dataset had fewer scenes.
    """
    schema, fingerprint = manifest.schema, manifest.fingerprint
    waiting = recorded_shards(root / GROWTH)
    # Files that wait belong to the larger dataset; the smaller one has them only after they have taken their places.
    waiting_first = bool(waiting) and standing_shards(root, manifest) > 0
    # The loop is over records in the folder, since a hostile `dataset.json` may claim any number of scenes.
    for shard in sorted({*recorded_shards(root), *waiting}) if shards is None else shards:
        compared = hashes if isinstance(hashes, bool) else shard in hashes
        instead = waiting_record(root, manifest, shard) if shard in waiting else None
        # Record, places of its files, and the record that may have begun to take its place.
        known: list[tuple[ShardRecord | None, tuple[Location, ...], ShardRecord | None]] = [
            (next(sound_records(root, [shard]), None), (root,), instead)
        ]
        if waiting_first:
            known.insert(0, (instead, (root / GROWTH, root), None))
        for record, places, other in known:
            if record is None or record.mismatch(schema, fingerprint, "any" if partly else "at least"):
                continue
            if shard < schema.shards and record.problem(*places, hashes=compared, instead=other) is None:
                yield record.cut(schema)
                break


def finish(root: Path, manifest: Manifest) -> Description:
    """Write the card of a dataset, and of a complete one the other files beside its arrays: table, `croissant.json`,
    and `stats` in `dataset.json`. Returns the description of what is there. A smaller dataset that grows into it
    becomes the larger one when that is complete, and stays as it is until then.

    Raises `CheckError` if another build changes shards in the meantime.
    """
    with growing_alone(root):
        dataset = Description(manifest, each_committed(root, manifest))
        if _has_grown(root, manifest):
            return dataset
        is_growing = standing_shards(root, manifest) > 0
        if is_growing and not dataset.is_whole:
            return dataset
        home = root / GROWTH if is_growing else root
        if dataset.is_whole:
            dataset.manifest = replace(manifest, stats=dataset.stats())
            if not is_growing:
                write_if_changed(root / MANIFEST, dataset.manifest.to_bytes())
            rows = dataset.rows(lambda: each_committed(root, manifest))
            if not has_rows(home / TABLE, rows):
                try:
                    write_table(home / TABLE, rows)
                except (TypeError, ValueError):
                    raise CheckError(
                        f"{root}: shards have changed while {TABLE} was made; run the same `datagen build` again"
                    ) from None
            write_if_changed(home / CROISSANT, json_bytes(croissant(home, dataset)))
        write_card(home, dataset)
        if is_growing:
            # With its stats the manifest says that everything waits that the larger dataset needs.
            write_if_changed(home / MANIFEST, dataset.manifest.to_bytes())
            take_places(root)
    return dataset


def _has_grown(root: Path, manifest: Manifest) -> bool:
    """Whether another build has made the dataset larger than in `manifest`: what describes it is that build's."""
    try:
        there = read_manifest(root)
    except InputError:
        return False
    return there.fingerprint == manifest.fingerprint and there.schema.scenes > manifest.schema.scenes


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
    larger, problems = growth_of(root, manifest), list[str]()
    problems += _metadata_problems(root, manifest, larger)
    size = 0
    dataset, there = Description(manifest), recorded_shards(root)
    for shard in there:
        if shard >= manifest.schema.shards:
            # A dataset that grows has shards beyond its end.
            if larger is None or shard >= larger.schema.shards:
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
            # It was listed: a link that leads nowhere, or an object that the store does not find now.
            problems.append(
                f"shard {shard}: its commit record {root / record_name(shard)} is listed and cannot be opened; build "
                "again to make the shard anew"
            )
            continue
        wrong = _readable(f"shard {shard}: ", partial(_shard_problems, root, manifest, record, larger))
        dataset.add(record.cut(manifest.schema))
        problems += wrong or _scene_problems(root, manifest, record.cut(manifest.schema), deep)
        size += sum(file.bytes for file in record.files.values())
    problems += [
        f"{name}: not there (no commit record); build again to make what is missing"
        for name in _missing(there, manifest.schema.shards)
    ]
    if dataset.is_whole:
        problems += _readable("", lambda: _summary_problems(root, dataset, larger))
    elif not problems:
        problems.append(f"{dataset.shards} of {manifest.schema.shards} shards are there; build again to go on")
    return Verification(dataset.scenes, dataset.shards, size, tuple(map(as_line, problems)))


def _missing(there: Sequence[int], shards: int) -> Iterator[str]:
    """`shard 3` or `shards 3-90` for every gap between the shards that are there."""
    ends = [-1, *(shard for shard in there if shard < shards), shards]
    for before, after in itertools.pairwise(ends):
        if after - before == 2:
            yield f"shard {before + 1}"
        elif after - before > 2:
            yield f"shards {before + 1}-{after - 1}"


def _readable(where: str, found: Callable[[], Iterable[str]]) -> list[str]:
    """The problems that are found, or as the one problem that a file cannot be read, such as without permission."""
    try:
        return [*found()]
    except OSError as error:
        return [
            f"{where}{error.filename}: cannot be read ({error.strerror or error}); see that it can, or build again"
        ]


def _metadata_problems(root: Location, manifest: Manifest, larger: Manifest | None) -> Iterator[str]:
    for name in manifest.metadata:
        yield from _readable("", partial(_of_metadata, root, name, manifest, larger))
    if larger is None and (why := damaged_growth(root)) is not None:
        yield f"{why}, and grow the dataset again to make it go on"
    if fingerprint_of(manifest.config, manifest.meshes) != manifest.fingerprint:
        yield "dataset.json: its configuration is not the one its fingerprint was taken of"


def _of_metadata(root: Location, name: str, manifest: Manifest, larger: Manifest | None) -> Iterator[str]:
    wrong = difference(root / name, manifest.metadata[name])
    if wrong is not None and (larger is None or difference(root / name, larger.metadata.get(name))):
        yield f"{name}: {wrong}"


def _shard_problems(root: Location, manifest: Manifest, record: ShardRecord, larger: Manifest | None) -> list[str]:
    """The first problem of the record and the files of a committed shard."""
    wrong = record.mismatch(manifest.schema, manifest.fingerprint, "all" if larger is None else "at least")
    # In the last step of a growth files take their places one by one, and a record when all of its files have.
    instead = None if larger is None or larger.stats is None else waiting_record(root, manifest, record.shard)
    wrong = wrong or record.problem(root, instead=instead)
    return [] if wrong is None else [f"shard {record.shard}: {wrong}"]


def _scene_problems(root: Location, manifest: Manifest, record: ShardRecord, deep: bool) -> Iterator[str]:
    """Problems of the scenes of a shard whose files are as written."""
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


def _summary_problems(root: Location, dataset: Description, larger: Manifest | None) -> Iterator[str]:
    """Problems of the files that a complete dataset has beside its arrays."""
    if not (root / TABLE).is_file():
        yield f"{TABLE}: missing; build again to write it"
        return
    manifest, now = dataset.manifest, made_with()
    if larger is not None and larger.stats is not None:
        # Table and cards are those of the smaller dataset or already of the larger one, which begins with its rows.
        try:
            read_table(root, None, manifest.schema.scenes)
        except CheckError as error:
            yield str(error)
        return
    if manifest.stats != dataset.stats():
        yield "dataset.json: its stats differ from what the commit records say"
    if not has_rows(root / TABLE, dataset.rows(lambda: sound_records(root, range(manifest.schema.shards)))):
        yield f"{TABLE}: differs from what the commit records say"
        return
    # Another version of datagen may describe the same dataset in other words; then the cards must only exist.
    same_words = manifest.made_by["datagen"] == now["datagen"]
    texts = {CROISSANT: b"", CARD: b""}
    if same_words:
        texts[CROISSANT] = json_bytes(croissant(root, dataset))
        texts[CARD] = card(dataset).encode()
    for name, text in texts.items():
        if not (holds(root / name, text) if same_words else (root / name).is_file()):
            yield f"{name}: missing, or differs from what the dataset holds"


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
    schema, shards, made = manifest.schema, 0, list[bool]()
    for record in each_committed(root, manifest):
        shards += 1
        made += [scene.failure is None for scene in record.scenes]
    if shards < schema.shards:
        raise CheckError(
            f"{root}: {schema.shards - shards} of {schema.shards} shards are missing or damaged; run the same "
            "`datagen build` again to make them"
        )
    reader, whole = DatasetReader(root, manifest, schema.by_name), hashlib.sha256()
    for name, field in sorted(schema.by_name.items()):
        whole.update(f"{name} {field.dtype} {' '.join(map(str, field.shape))}\n".encode())
        for index, is_made in enumerate(made):
            value = reader.read(name, [index])[0] if is_made else None
            whole.update(bytes(32) if value is None else bytes.fromhex(digest(field, value)))
    return whole.hexdigest()
