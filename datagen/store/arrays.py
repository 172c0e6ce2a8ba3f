"""The Zarr v3 group of a dataset: its metadata, made by the parent alone, and the codec chain of every array."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec
from zarr.storage import MemoryStore

from datagen.store.schema import Field, Schema

GROUP = "data.zarr"


def shard_file(field: Field, shard: int) -> str:
    """The one file that holds shard `shard` of a field, relative to the dataset: one writer, one file, one field."""
    return "/".join([GROUP, field.name, "c", str(shard), *["0"] * len(field.shape)])


def metadata_files(schema: Schema) -> dict[str, bytes]:
    """Every `zarr.json` of the group, path relative to the dataset → content, made in memory."""
    store = MemoryStore()
    group = zarr.create_group(store)
    for field in schema.fields:
        _create(group, field, schema)
    return {f"{GROUP}/{key}": store._store_dict[key].to_bytes() for key in sorted(store._store_dict)}


def array_to_write(root: Path, name: str) -> zarr.Array[Any]:
    """One array of a dataset. It keeps empty chunks: a chunk left out would read as zeros when it is lost, with
    other readers than ours.
    """
    array = zarr.open_array(root / GROUP / name, mode="r+")
    return array.with_config({"write_empty_chunks": True})


def shard_shape(field: Field, scenes_per_shard: int) -> tuple[int, ...]:
    """The shard of a sharded field: K scenes, every other axis whole (rounded up to whole chunks)."""
    return scenes_per_shard, *(c * math.ceil(s / c) for c, s in zip(field.chunk, field.shape, strict=True))


def _create(group: zarr.Group, field: Field, schema: Schema) -> None:
    k, dtype = schema.scenes_per_shard, np.dtype(field.dtype)
    blosc = BloscCodec(cname="zstd", clevel=5, shuffle="bitshuffle", typesize=dtype.itemsize)
    group.create_array(
        field.name,
        shape=(schema.scenes, *field.shape),
        dtype=dtype,
        chunks=(1, *field.chunk) if field.sharded else (k, *field.shape),
        shards=shard_shape(field, k) if field.sharded else None,
        # crc32c comes last, over the compressed bytes: without it most flipped bits go unnoticed.
        compressors=[blosc, Crc32cCodec()],
        fill_value=float("nan") if dtype.kind == "f" else 0,
        dimension_names=field.dims,
        attributes={"unit": field.unit, "meaning": field.meaning}
        | ({"classes": list(field.classes)} if field.classes else {}),
    )
