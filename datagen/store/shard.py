"""Writing one shard: old files are removed, each field's file is written and synced, and the record comes last."""

from __future__ import annotations

import hashlib
import math
import os
import time
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError, printable
from datagen.records import Sample, Scalar
from datagen.store.arrays import fill_of, shard_content, shard_file
from datagen.store.environment import made_with
from datagen.store.files import PARTIAL, own_path, write_atomically
from datagen.store.record import BUILD, FileRecord, SceneRecord, ShardRecord, record_path
from datagen.store.schema import Field, Schema
from datagen.store.stats import COUNTS, LABELS, WITH_STATS, stats_of

FINITE = ("transient", "moving_transient", "background_transient", *LABELS)
"""Fields whose values must be finite."""


def discard_shard(root: Path, schema: Schema, shard: int) -> None:
    """Remove the record and every file of a shard, finished or partial. The record goes first, so that no
    record lists files that are gone.

    Raises `InputError` if one of them is reached through a symbolic link; nothing is removed then.
    """
    record = own_path(root, record_path(root, shard).relative_to(root).as_posix())
    paths = [own_path(root, shard_file(field, shard)) for field in schema.fields]
    for partial in [*record.parent.glob(f"{record.name}.*{PARTIAL}"), record]:
        partial.unlink(missing_ok=True)
    for path in paths:
        for partial in path.parent.glob(f"*{PARTIAL}"):
            partial.unlink(missing_ok=True)
        path.unlink(missing_ok=True)


def encoded_value(field: Field, value: NDArray[np.generic]) -> NDArray[np.generic]:
    """One scene's value in the dtype of its field.

    Raises `InputError` for another shape than the configuration gives, counts beyond the dtype's range (they never
    wrap around), and values that are not finite in a field of `FINITE`.
    """
    value = np.asarray(value)
    if value.shape != field.shape:
        due = f"{field.shape} follows from the configuration"
        raise InputError(f"field {field.name!r}: shape {value.shape} made, {due}")
    target = np.dtype(field.dtype)
    if target.kind in "ui":
        _check_range(field, value, np.iinfo(target))
        return value.astype(target)
    with np.errstate(over="ignore"):
        stored = value.astype(target)
    if field.name in FINITE and not np.isfinite(stored).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(stored))[0])
        raise InputError(f"field {field.name!r}: {value[where]} at {where} is not a finite {field.dtype}")
    return stored


def _check_range(field: Field, value: NDArray[np.generic], limits: np.iinfo) -> None:
    if value.dtype.kind not in "uib":
        raise InputError(f"field {field.name!r}: {value.dtype} made where whole numbers are stored")
    if value.size and (int(value.min()) < limits.min or int(value.max()) > limits.max):
        worst = int(value.max()) if int(value.max()) > limits.max else int(value.min())
        wider = "; set store.histogram_dtype to a wider type or shorten the exposure"
        raise InputError(
            f"field {field.name!r}: {worst} lies outside {limits.min} … {limits.max} of {field.dtype}"
            f"{wider if field.name in COUNTS else ''}"
        )


def digest(field: Field, value: NDArray[np.generic]) -> str:
    """Hex SHA-256 of decoded values: little-endian, C order."""
    plain = np.ascontiguousarray(value, np.dtype(field.dtype).newbyteorder("<"))
    return hashlib.sha256(plain.data).hexdigest()


def write_shard(
    root: Path, schema: Schema, shard: int, fingerprint: str, samples: Iterable[tuple[int, Sample | str]],
    made_by: Mapping[str, str] | None = None, started: float | None = None,
) -> ShardRecord:  # fmt: skip
    """Write one shard and commit it; returns its record.

    samples : (index, sample) for each scene of the shard in order, or (index, reason) if it could not be made.
    made_by : the environment that made the samples; left out: that of this process.
    started : Unix time at which the first sample was begun; left out: now.
    """
    started, scenes = time.time() if started is None else started, schema.scenes_of(shard)
    discard_shard(root, schema, shard)
    # Scenes that cannot be made keep the fill value.
    made: dict[Field, NDArray[np.generic]] = {
        field: np.full((len(scenes), *field.shape), fill_of(field), np.dtype(field.dtype).newbyteorder("<"))
        for field in schema.fields
    }
    records, store_s = list[SceneRecord](), 0.0
    for index, sample in samples:
        begun = time.perf_counter()
        record, values = record_of(made, index, sample)
        records.append(record)
        for field, value in values.items():
            made[field][index - scenes.start] = value
        store_s += time.perf_counter() - begun
    begun = time.perf_counter()
    # Folders are not synced: if a power cut loses the name of a file, the next build makes the shard again.
    files = dict[str, FileRecord]()
    for field in schema.fields:
        name, content = shard_file(field, shard), shard_content(field, made.pop(field), schema.scenes_per_shard)
        files[name] = _write_new(root / name, content)
    now = time.time()
    seconds = {"store": store_s + time.perf_counter() - begun, "total": now - started}
    whole = ShardRecord(
        shard, scenes.start, scenes.stop - 1, fingerprint, files, tuple(records), seconds, started, now,
        dict(made_by or made_with()),
    )  # fmt: skip
    (root / BUILD).mkdir(exist_ok=True)
    write_atomically(record_path(root, shard), whole.to_bytes())
    return whole


def _write_new(path: Path, content: bytes) -> FileRecord:
    """Write a new file and sync it; returns its hash and size."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("xb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    return FileRecord(hashlib.sha256(content).hexdigest(), len(content))


def record_of(
    fields: Iterable[Field], index: int, sample: Sample | str
) -> tuple[SceneRecord, dict[Field, NDArray[np.generic]]]:
    """The record of a scene, and the values of its fields as they are stored. These are empty for a scene that cannot
    be stored, or of which there is only a reason why it could not be made."""
    if isinstance(sample, str):
        return SceneRecord(index, failure=printable(sample)), {}
    try:
        values = {field: _value(field, sample) for field in fields}
        parameters = {name: _plain(name, value) for name, value in sample.parameters.items()}
        seconds = {name: _finite(name, value) for name, value in sample.seconds.items()}
    except Exception as error:
        # A sample function of the user may return anything; its scene then fails, not the build.
        reason = str(error) if isinstance(error, InputError) else f"not a sample: {type(error).__name__}: {error}"
        return SceneRecord(index, failure=printable(" ".join(reason.split()))), {}
    digests = {field.name: digest(field, value) for field, value in values.items()}
    stats = {field.name: stats_of(field.name, value) for field, value in values.items() if field.name in WITH_STATS}
    return SceneRecord(index, None, digests, parameters, seconds, stats), values


def _value(field: Field, sample: Sample) -> NDArray[np.generic]:
    if field.name not in sample.arrays:
        raise InputError(f"field {field.name!r}: missing, the sample has {', '.join(sample.arrays) or 'no arrays'}")
    return encoded_value(field, sample.arrays[field.name])


def _plain(name: str, value: Scalar | np.generic) -> Scalar:
    plain: Scalar = value.item() if isinstance(value, np.generic) else value
    if not isinstance(plain, bool | int | float | str):
        raise InputError(f"parameter {name}: {type(plain).__name__} made, must be a number, a text, true or false")
    if isinstance(plain, int) and not -(2**63) <= plain < 2**63:
        raise InputError(f"parameter {name}: a whole number of more than 64 bits made")
    # Raises UnicodeEncodeError for text that JSON cannot hold.
    f"{name}{plain}".encode()
    return plain


def _finite(name: str, value: float) -> float:
    if not math.isfinite(value):
        raise InputError(f"seconds of {name}: {value} made")
    return float(value)
