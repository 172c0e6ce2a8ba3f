"""`samples.parquet`: one row a scene, written from the commit records when all shards are there."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from datagen.config import SplitsConfig
from datagen.errors import CheckError, InputError
from datagen.records import Scalar
from datagen.store.files import read_json, replacing
from datagen.store.location import Location, opened
from datagen.store.record import GROWTH, SceneRecord, ShardRecord
from datagen.store.splits import splits_of
from datagen.store.stats import QUANTITIES, pooled_stats

TABLE = "samples.parquet"
CROISSANT = "croissant.json"
"""The card for machines, which has the table's SHA-256."""
COLUMNS = {
    "scene": "number of the scene; rows are in its order",
    "failure": "why the scene could not be made; null where it could",
    "split": "train, val, test or a split held out by the configuration",
    "transient.relative_error": "relative L2 error of the sample's transient: an estimate, no bound; docs/physics.md",
    "evidence.PART.detections, .brightest_bin, .significance": "of an object's own light; docs/physics.md",
    "evidence.PART.presence, .presence_detections, .presence_floor": "of the scene with against without it",
    "evidence.PART.change, .change_floor": "of the change from frame to frame by an object that moves",
    "evidence.weakest": "the least significance of any object of the scene; null where there is none",
    "evidence.placed_anew": "how often objects were placed anew until they had the evidence asked for; else absent",
    "stats.FIELD.mean, .std, .nonzero": "of the sample's values of a field; of a histogram's log(1 + counts)",
    "sha256.FIELD": "digest of the sample's decoded values",
    "others": "what was drawn for the sample and decided about it; docs/configuration.md of datagen lists them",
}
"""Column → meaning, for the cards."""
BATCH = 1024
"""Scenes whose records are held at a time."""
GROUP_BATCHES = 16
"""Batches of a row group of the file, which is made in memory: 2 kB a scene."""
_OWN = ("scene", "shard", "failure", "split")


@dataclass(frozen=True)
class Rows:
    """The rows of the table in batches of `BATCH` scenes, made from the records in each iteration. It raises
    `ValueError` or `TypeError` if the records are no longer those of which parameters and splits were taken.

    The table has no timings, so that it depends on the configuration alone. Its columns are `scene`, `shard`,
    `failure` (null without one), `split` (null after a failure), each parameter by its dotted name (null in scenes
    without it), `stats.FIELD.QUANTITY` and `sha256.FIELD`.

    records : returns the records of all shards in their order, read anew.
    parameters : parameter → the types of its values over all scenes.
    splits : of each scene.
    with_stats, fields : names of the fields with statistics, and of all fields.
    """

    records: Callable[[], Iterable[ShardRecord]]
    parameters: Mapping[str, Set[type]]
    splits: Sequence[str | None]
    with_stats: Sequence[str]
    fields: Sequence[str]

    def __iter__(self) -> Iterator[pa.RecordBatch]:
        scenes = ((record.shard, scene) for record in self.records() for scene in record.scenes)
        rows = zip(scenes, self.splits, strict=True)
        while (batch := self._next(rows)) is not None:
            yield batch

    def _next(self, rows: Iterator[tuple[tuple[int, SceneRecord], str | None]]) -> pa.RecordBatch | None:
        """The next batch, or None. Its records are gone when it is returned."""
        some = [*itertools.islice(rows, BATCH)]
        if not some:
            return None
        scenes, splits = [scene for (_, scene), _ in some], [split for _, split in some]
        columns: dict[str, pa.Array] = {
            "scene": pa.array([scene.index for scene in scenes], pa.int64()),
            "shard": pa.array([shard for (shard, _), _ in some], pa.int32()),
            "failure": pa.array([scene.failure for scene in scenes], pa.string()),
            "split": pa.array(splits, pa.string()),
        }
        for name, kinds in self.parameters.items():
            values = [scene.parameters.get(name) for scene in scenes]
            columns[name if name not in _OWN else f"parameter.{name}"] = _column(values, kinds)
        for name in self.with_stats:
            for quantity in QUANTITIES:
                values = [getattr(scene.stats[name], quantity) if name in scene.stats else None for scene in scenes]
                columns[f"stats.{name}.{quantity}"] = pa.array(values, pa.float64())
        for field in self.fields:
            columns[f"sha256.{field}"] = pa.array([scene.digests.get(field) for scene in scenes], pa.string())
        return pa.RecordBatch.from_pydict(columns)


def write_table(path: Path, rows: Iterable[pa.RecordBatch]) -> None:
    """Write the table. The same rows give the same bytes."""
    batches = iter(rows)
    with replacing(path) as file, contextlib.ExitStack() as stack:
        writer: pq.ParquetWriter | None = None
        while some := [*itertools.islice(batches, GROUP_BATCHES)]:
            # One piece, since the bytes depend on where pieces end.
            group = pa.Table.from_batches(some).combine_chunks()
            writer = writer or stack.enter_context(pq.ParquetWriter(file, group.schema, compression="zstd"))
            writer.write_table(group)


def has_rows(path: Location, rows: Iterable[pa.RecordBatch]) -> bool:
    """Whether a table has these rows and no others. Other versions of Arrow write them with other bytes."""
    try:
        with opened(path) as (_, stored):
            batches = parquet_file(stored).iter_batches(BATCH, use_threads=False)
            pairs = itertools.zip_longest(batches, rows)
            return all(None not in pair and _equal(*pair) for pair in pairs)
    except (pa.ArrowException, OSError, ValueError):
        return False


def _equal(one: pa.RecordBatch, other: pa.RecordBatch) -> bool:
    """Whether two batches have the same values; NaN equals NaN."""
    return one.equals(other) or (one.schema.equals(other.schema) and repr(one.to_pydict()) == repr(other.to_pydict()))


def stats_by_split(table: pa.Table) -> dict[str, dict[str, dict[str, float]]]:
    """Split → field → `mean`, `std`, `nonzero` over the values of all its scenes."""
    splits = table["split"].to_pylist()
    rows = {name: [row for row, split in enumerate(splits) if split == name] for name in {*splits} if name}
    of_fields = table.select([name for name in table.column_names if name.startswith("stats.")])
    return {name: stats_of_rows(of_fields.take(here)) for name, here in sorted(rows.items())}


def stats_of_rows(table: pa.Table) -> dict[str, dict[str, float]]:
    """Field → `mean`, `std`, `nonzero` over the values of all scenes of a table without failures."""
    fields = [name.split(".")[1] for name in table.column_names if re.fullmatch(r"stats\.\w+\.mean", name)]
    columns = {name: [f"stats.{name}.{quantity}" for quantity in QUANTITIES] for name in fields}
    found = {name: table.select(names).drop_null() for name, names in columns.items()}
    return {
        name: pooled_stats(*(np.asarray(column, np.float64) for column in rows.columns))
        for name, rows in found.items()
        if rows.num_rows
    }


def table_of(rows: Iterable[pa.RecordBatch]) -> pa.Table:
    """The table with these rows, in memory."""
    return pa.Table.from_batches([*rows])


def splits_of_table(table: pa.Table, splits: SplitsConfig) -> list[str | None]:
    """The split of every scene for other `splits` than the stored ones, from the parameters in the table."""
    names = [name for name in table.column_names if name not in _OWN and not name.startswith(("sha256.", "stats."))]
    failed = table["failure"].is_valid().to_pylist()
    rows = table.select(names).to_pylist() if names else [{}] * table.num_rows
    kept = [{name: value for name, value in row.items() if value is not None} for row in rows]
    return splits_of([None if no else row for no, row in zip(failed, kept, strict=True)], splits)


def parquet_file(stored: IO[bytes]) -> pq.ParquetFile:
    """A Parquet file to be read. Raises `pa.ArrowException` for a damaged file."""
    # Without `pre_buffer=False` here and `use_threads=False` in `rows_of`, two threads of Arrow stay behind. At the
    # end of the process one of them may free a buffer, for which it needs Python's lock: the process aborts.
    return pq.ParquetFile(stored, pre_buffer=False)


def rows_of(file: pq.ParquetFile, columns: Sequence[str] | None = None) -> pa.Table:
    """All rows of some columns (None: of all). Raises `pa.ArrowException` for a damaged file."""
    return file.read(columns, use_threads=False)


def read_table(root: Location, columns: Sequence[str] | None, scenes: int) -> pa.Table:
    """Columns of the table of a dataset (None: all columns).

    scenes : the number of rows, the first of the table: it has more if the dataset has grown since it was opened.

    Raises `CheckError` if the file has another hash than `croissant.json` states, `InputError` for an unknown column.
    """
    path, remedy = root / TABLE, "run the same `datagen build` again to write it anew"
    due = _stated_hash(root)
    if due is None:
        raise CheckError(f"{root / CROISSANT}: missing or damaged, and it holds the hash of {TABLE}; {remedy}")
    try:
        with opened(path) as (_, stored):
            found = hashlib.file_digest(stored, "sha256").hexdigest()
            # The table of a larger dataset takes its place before the card that has its hash, which waits meanwhile.
            if found != due and found not in (_stated_hash(root / GROWTH), _stated_hash(root)):
                raise CheckError(
                    f"{path}: has changed since it was written (SHA-256 differs from {CROISSANT}'s); {remedy}"
                )
            file = parquet_file(stored)
            if file.metadata.num_rows < scenes:
                raise CheckError(f"{path}: {file.metadata.num_rows} rows for {scenes} scenes; {remedy}")
            check_columns(path, columns, file.schema_arrow.names)
            return rows_of(file, columns).slice(0, scenes)
    except (pa.ArrowException, OSError) as error:
        raise CheckError(f"{path}: cannot be read ({' '.join(str(error).split())}); {remedy}") from None


def check_columns(path: Location, columns: Sequence[str] | None, known: Sequence[str]) -> None:
    """Raise `InputError` for a name that is no column of the table."""
    for name in columns or ():
        if name not in known:
            raise InputError(f"parameters: {name!r} is no column of {path}; it has {', '.join(known)}")


def _stated_hash(root: Location) -> str | None:
    """The hash of the table that `croissant.json` in a folder states; None if it is missing or damaged."""
    try:
        described = read_json(root / CROISSANT)
        (due,) = (file["sha256"] for file in described["distribution"] if file["@id"] == TABLE)
        return str(due)
    except (InputError, KeyError, TypeError, ValueError):
        return None


def _column(values: Sequence[Scalar | None], kinds: Set[type]) -> pa.Array:
    """Some values of a parameter as a column: of booleans, integers, floats, or else texts.

    kinds : the types of its values in all scenes.
    """
    if kinds == {bool}:
        return pa.array(values, pa.bool_())
    if kinds == {int}:
        return pa.array(values, pa.int64())
    if kinds <= {int, float}:
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    return pa.array([None if value is None else str(value) for value in values], pa.string())
