"""The Zarr v3 group of a dataset: its metadata, made by the parent alone, and the codec chain of every array."""

from __future__ import annotations

import math
import warnings
from typing import Any, Literal

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec
from zarr.storage import MemoryStore

from datagen.config.capture import TimeConfig
from datagen.store.schema import Field, Schema

GROUP = "data.zarr"
BLOCK_BYTES = 2**18
"""Decoded bytes of a block of blosc, the least that a reader decodes. It fits into a core's cache; half as many cost
a few percent of the disk."""
WAITING_BYTES = 8 * 2**20
"""Raw bytes of a field that wait to be encoded together, since zarr copies the shard for every assignment. Half as
many double the copies; all scenes at once would keep a shard in memory as it is, not as it is compressed."""
LEVEL = 1
"""Level of zstd. Higher ones gain mostly by longer blocks: with these blocks level 5 saves 3 % of the disk for five
times the time."""


def shard_file(field: Field, shard: int) -> str:
    """The one file that holds shard `shard` of a field, relative to the dataset: one writer, one file, one field."""
    return "/".join([GROUP, field.name, "c", str(shard), *["0"] * len(field.shape)])


def metadata_files(schema: Schema, time: TimeConfig) -> dict[str, bytes]:
    """Every `zarr.json` of the group, and its coordinates, path relative to the dataset → content, made in memory."""
    store = MemoryStore()
    geometry = " ".join(name for name, field in schema.by_name.items() if field.dtype == "float64")
    group = zarr.create_group(store, attributes={"coordinates": geometry})
    for field in schema.fields:
        _create(group, field, schema)
    _create_arrival_times(group, time)
    with warnings.catch_warnings():
        # No part of the standard yet: readers that know it open the group in one read, others ignore it.
        warnings.filterwarnings("ignore", "Consolidated metadata", UserWarning)
        zarr.consolidate_metadata(store)
    return {f"{GROUP}/{key}": store._store_dict[key].to_bytes() for key in sorted(store._store_dict)}


COORDINATES = (f"{GROUP}/bin/zarr.json", f"{GROUP}/bin/c/0")
"""Files of arrays that are not of scenes but of an axis; named as it is, as xarray and others expect."""


def _create_arrival_times(group: zarr.Group, time: TimeConfig) -> None:
    origin = "laser emission" if time.origin == "source" else "the laser point, without the legs of the device"
    middles = 1000.0 * time.start_ns + time.bin_width_ps * (np.arange(time.bins) + 0.5)
    # "ps" is no unit of time to those who decode units of time by themselves: the numbers stay numbers.
    array = group.create_array(
        "bin", shape=middles.shape, dtype=np.float64, chunks=middles.shape, compressors=[Crc32cCodec()],
        dimension_names=("bin",), fill_value=float("nan"),
        attributes={"units": "ps", "long_name": f"arrival time counted from {origin}: middle of the bin"}
        | {"bin_width_ps": time.bin_width_ps},
    )  # fmt: skip
    array[:] = middles


def chunk_grid(field: Field) -> tuple[int, ...]:
    """The number of chunks along each axis of a scene of a sharded field."""
    return tuple(math.ceil(s / c) for c, s in zip(field.chunk, field.shape, strict=True))


def fill_of(field: Field) -> float | int:
    """The values of a scene that could not be made: NaN, or 0 for whole numbers."""
    return float("nan") if np.dtype(field.dtype).kind == "f" else 0


def shard_shape(field: Field, scenes_per_shard: int) -> tuple[int, ...]:
    """The shard of a sharded field: K scenes, every other axis whole (rounded up to whole chunks)."""
    return scenes_per_shard, *(c * n for c, n in zip(field.chunk, chunk_grid(field), strict=True))


class FieldOfShard:
    """The content of a field's `shard_file`, encoded by zarr in memory while the scenes are made.

    scenes : how many the shard holds; the last one of a dataset has fewer than `scenes_per_shard`.
    """

    def __init__(self, field: Field, scenes: int, scenes_per_shard: int) -> None:
        self._store, self._scenes, self._first = MemoryStore(), scenes, 0
        self._array = _create(zarr.create_group(self._store), field, Schema((field,), scenes, scenes_per_shard))
        # A field that is not sharded is one chunk: it is encoded once, when all of it is there.
        together = min(scenes, max(1, WAITING_BYTES // field.bytes_per_scene)) if field.sharded else scenes
        self._waiting = np.full((together, *field.shape), fill_of(field), np.dtype(field.dtype).newbyteorder("<"))
        self._fill, self._key = fill_of(field), shard_file(field, 0).removeprefix(f"{GROUP}/")

    def add(self, row: int, value: NDArray[np.generic]) -> None:
        """Scene `row` of the shard, in ascending order. A scene that is never given has the fill value."""
        while row >= self._first + len(self._waiting):
            self._encode()
        self._waiting[row - self._first] = value

    def content(self) -> bytes:
        """The file's content, when all scenes are given."""
        while self._first < self._scenes:
            self._encode()
        return self._store._store_dict[self._key].to_bytes()

    def _encode(self) -> None:
        stop = min(self._first + len(self._waiting), self._scenes)
        self._array[self._first : stop] = self._waiting[: stop - self._first]
        self._waiting[...] = self._fill
        self._first = stop


def _create(group: zarr.Group, field: Field, schema: Schema) -> zarr.Array[Any]:
    k, dtype = schema.scenes_per_shard, np.dtype(field.dtype)
    # Low counts leave most of their bits 0, which planes of bits gather; light leaves only its exponents alike.
    shuffle: Literal["shuffle", "bitshuffle"] = "shuffle" if dtype.kind == "f" else "bitshuffle"
    blosc = BloscCodec(cname="zstd", clevel=LEVEL, shuffle=shuffle, typesize=dtype.itemsize, blocksize=BLOCK_BYTES)
    return group.create_array(
        field.name,
        shape=(schema.scenes, *field.shape),
        dtype=dtype,
        chunks=(1, *field.chunk) if field.sharded else (k, *field.shape),
        shards=shard_shape(field, k) if field.sharded else None,
        # crc32c comes last, over the compressed bytes: without it most flipped bits go unnoticed.
        compressors=[blosc, Crc32cCodec()],
        fill_value=fill_of(field),
        dimension_names=field.dims,
        attributes={"units": field.unit, "long_name": field.meaning}
        | ({"classes": list(field.classes)} if field.classes else {}),
        # A scene of zeros must be there, or losing it would go unnoticed: what is missing reads as the fill value.
        config={"write_empty_chunks": True},
    )
