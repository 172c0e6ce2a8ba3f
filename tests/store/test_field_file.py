"""What a worker writes is what zarr itself would write."""

from __future__ import annotations

from pathlib import Path

import google_crc32c
import numpy as np
import pytest
import zarr
from numcodecs import blosc

from datagen.config.capture import TimeConfig
from datagen.store import schema
from datagen.store.arrays import chunk_grid, metadata_files, shard_file
from datagen.store.field_file import FieldFile, write_new
from datagen.store.files import sha256_of
from datagen.store.schema import Field, Schema

SCENES, A_SHARD = 10, 4
LOST = 5
"""A scene that could not be made."""
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


def written(root: Path, field: Field, values: np.ndarray) -> None:
    made = group(root, field)
    for shard in range(made.shards):
        scenes = made.scenes_of(shard)
        file = FieldFile(field, len(scenes), A_SHARD)
        for row, scene in enumerate(scenes):
            if scene != LOST:
                file.add(row, values[scene])
        path = root / shard_file(field, shard)
        record = write_new(path, file.pieces())
        assert (sha256_of(path), path.stat().st_size) == (record.sha256, record.bytes)


def by_zarr(root: Path, field: Field, values: np.ndarray) -> zarr.Array:
    made = group(root, field)
    array = zarr.open_array(root / "data.zarr" / field.name, mode="r+").with_config({"write_empty_chunks": True})
    for shard in range(made.shards):
        scenes = made.scenes_of(shard)
        array[scenes.start : scenes.stop] = values[scenes.start : scenes.stop]
    return array


@pytest.mark.parametrize("name", FIELDS)
def test_bytes_are_those_of_zarr(tmp_path: Path, name: str) -> None:
    """Whole shards, the last one, and a scene that could not be made."""
    field, values = FIELDS[name], values_of(FIELDS[name])
    written(tmp_path / "ours", field, values)
    values[LOST] = np.nan if values.dtype.kind == "f" else 0
    by_zarr(tmp_path / "zarr", field, values)
    for shard in range(3):
        path = shard_file(field, shard)
        assert (tmp_path / "ours" / path).read_bytes() == (tmp_path / "zarr" / path).read_bytes()


@pytest.mark.parametrize("chunk_bytes", [700, 90])
def test_scenes_in_several_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunk_bytes: int) -> None:
    """Edges filled up; the chunks' order is the index's own, so each is looked up there."""
    monkeypatch.setattr(schema, "CHUNK_BYTES", chunk_bytes)
    field, values = FIELDS["light"], values_of(FIELDS["light"])
    assert field.chunk != field.shape
    written(tmp_path / "ours", field, values)
    values[LOST] = np.nan
    by_zarr(tmp_path / "zarr", field, values)
    read = zarr.open_array(tmp_path / "ours/data.zarr/light", mode="r")
    assert np.array_equal(np.asarray(read[:]), values, equal_nan=True)
    for shard in range(3):
        ours, theirs = (chunks(tmp_path / who / shard_file(field, shard), field) for who in ("ours", "zarr"))
        assert ours == theirs and sum(chunk is None for chunk in ours) == (2 if shard == 2 else 0) * len(ours) // 4


def chunks(path: Path, field: Field) -> list[bytes | None]:
    """As the shard's index lists them."""
    whole, places = path.read_bytes(), A_SHARD * int(np.prod(chunk_grid(field)))
    table = whole[-16 * places - 4 : -4]
    assert google_crc32c.value(table) == int.from_bytes(whole[-4:], "little")
    index = np.frombuffer(table, "<u8").reshape(-1, 2).tolist()
    return [None if size == 2**64 - 1 else whole[start : start + size] for start, size in index]


def test_threads_of_blosc_do_not_enter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a process that lets blosc have several, blocks would lie in the order in which these get ready."""
    field, values = FIELDS["several blocks"], values_of(FIELDS["several blocks"])
    monkeypatch.setattr(blosc, "use_threads", False)
    written(tmp_path / "one", field, values)
    monkeypatch.setattr(blosc, "use_threads", True)
    threads = blosc.set_nthreads(4)
    try:
        written(tmp_path / "four", field, values)
    finally:
        blosc.set_nthreads(threads)
    assert blosc.use_threads is True
    for shard in range(3):
        path = shard_file(field, shard)
        assert (tmp_path / "one" / path).read_bytes() == (tmp_path / "four" / path).read_bytes()


def test_nothing_is_written_over(tmp_path: Path) -> None:
    field = FIELDS["number"]
    values = values_of(field)
    written(tmp_path, field, values)
    with pytest.raises(FileExistsError):
        write_new(tmp_path / shard_file(field, 0), [b"other"])
    assert np.array_equal(np.asarray(zarr.open_array(tmp_path / "data.zarr/number", mode="r")[:4]), values[:4])
