"""The Zarr v3 group of a dataset: metadata, which only the parent process writes, and the codecs of each array."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any, Literal

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, Crc32cCodec
from zarr.storage import MemoryStore

from datagen.config.capture import TimeConfig
from datagen.config.sequence import SequenceConfig
from datagen.records import Clock
from datagen.store.schema import Field, Schema

GROUP = "data.zarr"
BLOCK_BYTES = 2**18
"""Decoded bytes of a block of blosc, the smallest piece that a reader can decode: a block fits into a core's cache,
and smaller ones compress less. Of a sequence a block is one frame, so that some frames can be decoded without the
others."""
LEVEL = 1
"""Compression level of zstd. With blocks of this size level 5 saves 3 % of the disk and takes five times as long."""


def shard_file(field: Field, shard: int) -> str:
    """Path, relative to the dataset, of the file of shard number `shard` of a field. A file has one writer."""
    return "/".join([GROUP, field.name, "c", str(shard), *["0"] * len(field.shape)])


Axis = TimeConfig | SequenceConfig
"""What says where the points of an axis lie: bins of arrival times, frames."""


def metadata_files(schema: Schema, axes: Mapping[str, Axis]) -> dict[str, bytes]:
    """Path relative to the dataset → content, of every `zarr.json` of the group and of the files of its
    coordinates.

    axes : name of an axis of time → its bins, or its frames."""
    store = MemoryStore()
    geometry = " ".join(name for name, field in schema.by_name.items() if field.dtype == "float64")
    group = zarr.create_group(store, attributes={"coordinates": geometry})
    for field in schema.fields:
        _create(group, field, schema)
    for name, axis in axes.items():
        if isinstance(axis, SequenceConfig):
            _create_frame_times(group, name, axis)
        else:
            _create_arrival_times(group, name, axis)
    files = {key: store._store_dict[key].to_bytes() for key in sorted(store._store_dict)}
    return {f"{GROUP}/{key}": content for key, content in (files | _group_metadata(files)).items()}


def _group_metadata(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """The group's `zarr.json` with the metadata of all arrays in it. Readers that know these open the group in one
    read, others ignore them.

    `zarr.consolidate_metadata` writes the same bytes and warns that they are no part of the standard yet; Python's
    filters of warnings belong to the whole process, so no thread can silence that for itself.
    """
    arrays = {key.removesuffix("/zarr.json"): json.loads(files[key]) for key in files if key.endswith("/zarr.json")}
    group = json.loads(files["zarr.json"])
    kind = group.pop("node_type")
    group["consolidated_metadata"] = {"kind": "inline", "must_understand": False, "metadata": arrays}
    group["node_type"] = kind
    return {"zarr.json": json.dumps(group, indent=zarr.config.get("json_indent")).encode()}


def coordinates(axes: Iterable[str]) -> tuple[str, ...]:
    """Files of the arrays of times, each named as its axis, which makes it a coordinate for xarray."""
    return tuple(f"{GROUP}/{axis}/{file}" for axis in axes for file in ("zarr.json", "c/0"))


def _create_arrival_times(group: zarr.Group, axis: str, time: TimeConfig) -> None:
    """Create the coordinate of an axis: the arrival time of the middle of each bin, ps."""
    origin = "laser emission" if time.origin == "source" else "the laser point, without the legs of the device"
    middles = 1000.0 * time.start_ns + time.bin_width_ps * (np.arange(time.bins) + 0.5)
    about = {"long_name": f"arrival time counted from {origin}: middle of the bin", "bin_width_ps": time.bin_width_ps}
    _create_coordinate(group, axis, middles, {"units": "ps"} | about)


def _create_frame_times(group: zarr.Group, axis: str, sequence: SequenceConfig) -> None:
    """Create the coordinate of the frames: when each begins."""
    starts = Clock(sequence.frames, sequence.rate_hz).starts_s
    about = {"long_name": "when the frame begins, counted from the first one", "rate_hz": sequence.rate_hz}
    _create_coordinate(group, axis, starts, {"units": "s"} | about)


def _create_coordinate(
    group: zarr.Group, axis: str, values: NDArray[np.floating[Any]], about: dict[str, Any]
) -> None:
    """Create an array named as its axis. Readers that turn units of time into dates do not know "ps" and "s" alone,
    so the numbers stay numbers."""
    array = group.create_array(
        axis, shape=values.shape, dtype=np.float64, chunks=values.shape, compressors=[Crc32cCodec()],
        dimension_names=(axis,), fill_value=float("nan"), attributes=about,
    )  # fmt: skip
    array[:] = values


def chunk_grid(field: Field) -> tuple[int, ...]:
    """The number of chunks along each axis of one scene's value of a sharded field."""
    return tuple(math.ceil(s / c) for c, s in zip(field.chunk, field.shape, strict=True))


def block_bytes(field: Field) -> int:
    """Decoded bytes of a block of a field: of one frame where chunks hold whole frames, else `BLOCK_BYTES`."""
    is_whole = field.sharded and field.frame_bytes is not None and field.chunk[1:] == field.shape[1:]
    return field.frame_bytes if is_whole and field.frame_bytes else BLOCK_BYTES


def fill_of(field: Field) -> float | int:
    """The value that a field has in scenes that could not be made: NaN, or 0 for whole numbers."""
    return float("nan") if np.dtype(field.dtype).kind == "f" else 0


def shard_shape(field: Field, scenes_per_shard: int) -> tuple[int, ...]:
    """The shape of a shard of a sharded field: K scenes, and all of every other axis, rounded up to whole chunks."""
    return scenes_per_shard, *(c * n for c, n in zip(field.chunk, chunk_grid(field), strict=True))


def shard_content(field: Field, values: NDArray[np.generic], scenes_per_shard: int) -> bytes:
    """The content of a field's `shard_file`, encoded by zarr in memory.

    values : (scenes, *field.shape). The last shard of a dataset may have fewer scenes than `scenes_per_shard`.
    """
    store = MemoryStore()
    array = _create(zarr.create_group(store), field, Schema((field,), len(values), scenes_per_shard))
    array[...] = values
    return store._store_dict[shard_file(field, 0).removeprefix(f"{GROUP}/")].to_bytes()


def _create(group: zarr.Group, field: Field, schema: Schema) -> zarr.Array[Any]:
    """Create the array of a field in a Zarr group, with its codecs and attributes."""
    k, dtype = schema.scenes_per_shard, np.dtype(field.dtype)
    # Low counts have mostly zero bits; bitshuffle puts these together. Floats have only their exponents in common,
    # and for those shuffling by bytes is enough.
    shuffle: Literal["shuffle", "bitshuffle"] = "shuffle" if dtype.kind == "f" else "bitshuffle"
    blosc = BloscCodec(
        cname="zstd", clevel=LEVEL, shuffle=shuffle, typesize=dtype.itemsize, blocksize=block_bytes(field)
    )
    return group.create_array(
        field.name,
        shape=(schema.scenes, *field.shape),
        dtype=dtype,
        chunks=(1, *field.chunk) if field.sharded else (k, *field.shape),
        shards=shard_shape(field, k) if field.sharded else None,
        # crc32c comes last, over the compressed bytes: without it most flipped bits would go unnoticed.
        compressors=[blosc, Crc32cCodec()],
        fill_value=fill_of(field),
        dimension_names=field.dims,
        attributes={"units": field.unit, "long_name": field.meaning}
        | ({"classes": list(field.classes)} if field.classes else {}),
        # A chunk of zeros is written, too: a missing chunk reads as the fill value, so its loss would go unnoticed.
        config={"write_empty_chunks": True},
    )
