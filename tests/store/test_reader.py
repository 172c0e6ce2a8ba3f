"""The fast reader equals zarr's own, whole scenes and cut ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import zarr
from fake_samples import fake_sample

from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import CheckError
from datagen.store import prepare, schema, write_shard
from datagen.store.reader import ShardReader


def made(root: Path, config: DatasetConfig) -> None:
    manifest = prepare(root, config)
    for shard in range(manifest.schema.shards):
        scenes = manifest.schema.scenes_of(shard)
        write_shard(root, manifest.schema, shard, manifest.fingerprint, ((i, fake_sample(config, i)) for i in scenes))


def config_of(rows: int, columns: int, pixels: int, bins: int) -> DatasetConfig:
    capture = {
        "pairing": "exhaustive",
        "scan": {"rows": rows, "columns": columns},
        "field_of_view": {"rows": 1, "columns": pixels},
        "time": {"bins": bins},
    }
    fields = ["histogram", "transient", "depth", "normal", "part_id"]
    store = {"fields": fields, "scenes_per_shard": 4}
    return config_from_mapping(
        {"scenes": 10, "capture": capture, "store": store, "labels": {"rows": 5, "columns": 3}}
    )


@pytest.mark.parametrize("chunk_bytes", [2**22, 700, 90], ids=["whole", "cut on laser", "cut on laser and pixel"])
def test_reads_what_zarr_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunk_bytes: int) -> None:
    monkeypatch.setattr(schema, "CHUNK_BYTES", chunk_bytes)
    config = config_of(rows=1, columns=5, pixels=3, bins=17)
    made(tmp_path, config)
    described = schema.schema_of(config)
    order = [7, 0, 9, 9, 3, 4, 8]
    for field in described.fields:
        if field.sharded:
            array = zarr.open_array(tmp_path / "data.zarr" / field.name, mode="r")
            reader = ShardReader(tmp_path, field, described)
            plain = np.stack([np.asarray(array[scene]) for scene in order])
            fast = reader.read(order)
            assert fast.dtype == plain.dtype and np.array_equal(fast, plain)
            assert (field.chunk != field.shape) == (chunk_bytes < field.bytes_per_scene)
            reader.close()


def test_few_files_stay_open(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from datagen.store import reader as module

    monkeypatch.setattr(module, "MOST_OPEN", 1)
    config = config_of(1, 2, 1, 8)
    made(tmp_path, config)
    described = schema.schema_of(config)
    reader = ShardReader(tmp_path, described.by_name["depth"], described)
    array = zarr.open_array(tmp_path / "data.zarr/depth", mode="r")
    for scene in (0, 9, 1, 5, 0):
        assert np.array_equal(reader.read([scene])[0], np.asarray(array[scene]))
    assert len(reader._open) == 1


def test_damage_is_an_error(tmp_path: Path) -> None:
    config = config_of(1, 2, 1, 8)
    made(tmp_path, config)
    described = schema.schema_of(config)
    field = described.by_name["histogram"]
    path = tmp_path / "data.zarr/histogram/c/0/0/0/0"
    sound = path.read_bytes()
    for data, message in (
        (bytes([sound[0] ^ 1]) + sound[1:], "checksum does not match"),
        (sound[:-1] + bytes([sound[-1] ^ 1]), "index is damaged"),
        (b"", "index is damaged"),
    ):
        path.write_bytes(data)
        with pytest.raises(CheckError, match=message):
            ShardReader(tmp_path, field, described).read([0, 1, 2, 3])
    path.unlink()
    with pytest.raises(CheckError, match="cannot be opened"):
        ShardReader(tmp_path, field, described).read([0])
