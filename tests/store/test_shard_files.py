"""A shard's file, made in memory, is what zarr writes into the group on the disk, and leaves no scene out."""

from __future__ import annotations

from pathlib import Path

import google_crc32c
import numpy as np
import pytest
import zarr

from datagen.config.capture import TimeConfig
from datagen.store import schema
from datagen.store.arrays import chunk_grid, metadata_files, shard_content, shard_file
from datagen.store.schema import Field, Schema

SCENES, A_SHARD = 10, 4
FIELDS = {
    "counts": Field("counts", ("scene", "laser", "pixel", "bin"), (3, 2, 50), "uint16", "counts", ""),
    "wide counts": Field("wide", ("scene", "laser", "pixel", "bin"), (2, 1, 9), "uint32", "counts", ""),
    "light": Field("light", ("scene", "laser", "pixel", "bin"), (5, 3, 17), "float32", "photons", ""),
    "several blocks": Field("blocks", ("scene", "laser", "bin"), (300, 1000), "float32", "photons", ""),
    "voxels": Field("voxels", ("scene", "a", "b", "c"), (3, 4, 5), "uint8", "1", ""),
    "table": Field("table", ("scene", "object", "axis"), (2, 3), "float64", "m", "", sharded=False),
    "classes": Field("classes", ("scene", "object"), (3,), "int16", "1", "", sharded=False),
    "number": Field("number", ("scene",), (), "int32", "1", "", sharded=False),
}


def values_of(field: Field) -> np.ndarray:
    random = np.random.default_rng(1)
    values = random.poisson(0.3, (SCENES, *field.shape)) * random.uniform(0, 100, (SCENES, *field.shape))
    return values.astype(field.dtype)


def group(root: Path, field: Field) -> Schema:
    made = Schema((field,), SCENES, A_SHARD)
    for name, content in metadata_files(made, TimeConfig(bins=1, bin_width_ps=1.0)).items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(content)
    return made


def shards(field: Field, values: np.ndarray) -> list[bytes]:
    made = Schema((field,), SCENES, A_SHARD)
    every = [values[made.scenes_of(shard).start : made.scenes_of(shard).stop] for shard in range(made.shards)]
    return [shard_content(field, some, A_SHARD) for some in every]


def by_zarr(root: Path, field: Field, values: np.ndarray) -> zarr.Array:
    made = group(root, field)
    array = zarr.open_array(root / "data.zarr" / field.name, mode="r+").with_config({"write_empty_chunks": True})
    for shard in range(made.shards):
        scenes = made.scenes_of(shard)
        array[scenes.start : scenes.stop] = values[scenes.start : scenes.stop]
    return array


@pytest.mark.parametrize("name", FIELDS)
def test_bytes_are_those_of_zarr(tmp_path: Path, name: str) -> None:
    """Whole shards, and the last one, which has fewer scenes."""
    field, values = FIELDS[name], values_of(FIELDS[name])
    by_zarr(tmp_path, field, values)
    for shard, content in enumerate(shards(field, values)):
        assert content == (tmp_path / shard_file(field, shard)).read_bytes()


@pytest.mark.parametrize("chunk_bytes", [2**22, 700, 90])
def test_every_scene_is_there_and_no_other(monkeypatch: pytest.MonkeyPatch, chunk_bytes: int) -> None:
    """Also those of fill values: a chunk that zarr leaves out reads as fill values when it is lost."""
    monkeypatch.setattr(schema, "CHUNK_BYTES", chunk_bytes)
    for fill in (0.0, np.nan):
        values = np.full((SCENES, *FIELDS["light"].shape), fill, "f4")
        for shard, content in enumerate(shards(FIELDS["light"], values)):
            listed = chunks(content, FIELDS["light"])
            assert [chunk is None for chunk in listed] == [
                shard == 2 and row >= 2 for row in range(A_SHARD) for _ in range(len(listed) // A_SHARD)
            ]


def chunks(whole: bytes, field: Field) -> list[bytes | None]:
    """As the shard's index lists them."""
    count = A_SHARD * int(np.prod(chunk_grid(field)))
    table = whole[-16 * count - 4 : -4]
    assert google_crc32c.value(table) == int.from_bytes(whole[-4:], "little")
    index = np.frombuffer(table, "<u8").reshape(-1, 2).tolist()
    return [None if size == 2**64 - 1 else whole[start : start + size] for start, size in index]
