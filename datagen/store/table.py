"""`samples.parquet`: one row a scene, written from the commit records when all shards are there."""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Sequence
from typing import IO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from datagen.config import SplitsConfig
from datagen.errors import CheckError, InputError
from datagen.records import Scalar
from datagen.store.files import read_json
from datagen.store.location import Location
from datagen.store.record import SceneRecord, ShardRecord
from datagen.store.splits import splits_of
from datagen.store.stats import QUANTITIES, pooled

TABLE = "samples.parquet"
CROISSANT = "croissant.json"
"""The card for machines, which has the table's SHA-256."""
COLUMNS = {
    "scene": "number of the scene; rows are in its order",
    "failure": "why the scene could not be made; null where it could",
    "split": "train, val, test or a split held out by the configuration",
    "transient.relative_error": "relative L2 error of the sample's transient; with a target its upper bound (95 %)",
    "evidence.PART.detections, .brightest_bin, .significance": "of an object's own light; docs/physics.md",
    "evidence.PART.presence, .presence_detections, .presence_floor": "of the scene with against without it",
    "evidence.weakest": "the least significance of any object of the scene; null where there is none",
    "evidence.placed_anew": "how often objects were placed anew until they had the evidence asked for; else absent",
    "stats.FIELD.mean, .std, .nonzero": "of the sample's values of a field; of a histogram's log(1 + counts)",
    "sha256.FIELD": "digest of the sample's decoded values",
    "others": "what was drawn for the sample and decided about it; docs/configuration.md of datagen lists them",
}
"""Column → meaning, for the cards."""
_OWN = ("scene", "shard", "failure", "split")


def table_of(records: Sequence[ShardRecord], fields: Sequence[str], splits: SplitsConfig | None = None) -> pa.Table:
    """The table, with a row for each scene. It has no timings, so that it depends on the configuration alone.

    Its columns are `scene`, `shard`, `failure` (null without one), `split` (only if `splits` is given; null after a
    failure), each parameter by its dotted name (null in scenes without it), `stats.FIELD.QUANTITY` and
    `sha256.FIELD`.
    """
    rows = [(record.shard, scene) for record in records for scene in record.scenes]
    rows.sort(key=lambda row: row[1].index)
    scenes = [scene for _, scene in rows]
    columns: dict[str, pa.Array] = {
        "scene": pa.array([scene.index for scene in scenes], pa.int64()),
        "shard": pa.array([shard for shard, _ in rows], pa.int32()),
        "failure": pa.array([scene.failure for scene in scenes], pa.string()),
    }
    if splits is not None:
        shown = [scene.parameters if scene.failure is None else None for scene in scenes]
        columns["split"] = pa.array(splits_of(shown, splits), pa.string())
    names = dict.fromkeys(name for scene in scenes for name in scene.parameters)
    for name in names:
        columns[name if name not in _OWN else f"parameter.{name}"] = _column(scenes, name)
    for name in dict.fromkeys(name for scene in scenes for name in scene.stats):
        for quantity in QUANTITIES:
            values = [getattr(scene.stats[name], quantity) if name in scene.stats else None for scene in scenes]
            columns[f"stats.{name}.{quantity}"] = pa.array(values, pa.float64())
    for field in fields:
        columns[f"sha256.{field}"] = pa.array([scene.digests.get(field) for scene in scenes], pa.string())
    return pa.table(columns)


def table_bytes(table: pa.Table) -> bytes:
    """The table as a Parquet file. The same table gives the same bytes."""
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue()


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
        name: pooled(*(np.asarray(column, np.float64) for column in rows.columns))
        for name, rows in found.items()
        if rows.num_rows
    }


def read_splits(root: Location, scenes: int, splits: SplitsConfig) -> list[str | None]:
    """The split of every scene for other `splits` than the stored ones, from the parameters in the table."""
    table = read_table(root, None, scenes)
    names = [name for name in table.column_names if name not in _OWN and not name.startswith(("sha256.", "stats."))]
    failed = table["failure"].is_valid().to_pylist()
    rows = table.select(names).to_pylist() if names else [{}] * scenes
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
    try:
        described = read_json(root / CROISSANT)
        due = [file["sha256"] for file in described["distribution"] if file["@id"] == TABLE]
    except (InputError, KeyError, TypeError):
        raise CheckError(
            f"{root / CROISSANT}: missing or damaged, and it holds the hash of {TABLE}; {remedy}"
        ) from None
    try:
        with path.open("rb") as stored:
            if due != [hashlib.file_digest(stored, "sha256").hexdigest()]:
                raise CheckError(
                    f"{path}: has changed since it was written (SHA-256 differs from {CROISSANT}'s); {remedy}"
                )
            file = parquet_file(stored)
            if file.metadata.num_rows < scenes:
                raise CheckError(f"{path}: {file.metadata.num_rows} rows for {scenes} scenes; {remedy}")
            known = file.schema_arrow.names
            for name in columns or ():
                if name not in known:
                    raise InputError(f"parameters: {name!r} is no column of {path}; it has {', '.join(known)}")
            return rows_of(file, columns).slice(0, scenes)
    except (pa.ArrowException, OSError) as error:
        raise CheckError(f"{path}: cannot be read ({' '.join(str(error).split())}); {remedy}") from None


def _column(scenes: Sequence[SceneRecord], name: str) -> pa.Array:
    """A parameter of all scenes as a column: of booleans, integers, floats, or else texts."""
    values: list[Scalar | None] = [scene.parameters.get(name) for scene in scenes]
    present = [value for value in values if value is not None]
    kinds = {bool if isinstance(value, bool) else type(value) for value in present}
    if kinds == {bool}:
        return pa.array(values, pa.bool_())
    if kinds == {int}:
        return pa.array(values, pa.int64())
    if kinds <= {int, float}:
        return pa.array([None if value is None else float(value) for value in values], pa.float64())
    return pa.array([None if value is None else str(value) for value in values], pa.string())
