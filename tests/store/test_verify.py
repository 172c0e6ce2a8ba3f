"""`verify` finds every kind of damage, and says where."""

from __future__ import annotations

import shutil
from pathlib import Path

import google_crc32c
import numpy as np
import pyarrow.parquet as pq
import pytest
import zarr
from damage import reseal

from datagen.errors import CheckError
from datagen.store import DatasetReader, committed, read_manifest, verify
from datagen.store.croissant import croissant

SHARD = "data.zarr/histogram/c/1/0/0/0"


def test_a_flip_that_hashes_do_not_guard_is_found_by_the_checksum(dataset: Path) -> None:
    """Any Zarr reader finds it, without commit records, because the codec chain ends with a CRC-32C."""
    manifest = read_manifest(dataset)
    sound = (dataset / SHARD).read_bytes()
    values = zarr.open_array(dataset / "data.zarr/histogram", mode="r")[4:8]
    for place in range(0, len(sound), 11):
        data = bytearray(sound)
        data[place] ^= 0x10
        (dataset / SHARD).write_bytes(data)
        for read in (
            lambda: zarr.open_array(dataset / "data.zarr/histogram", mode="r")[4:8],
            lambda: DatasetReader(dataset, manifest, ["histogram"], check=False).read("histogram", range(4, 8)),
        ):
            try:
                unnoticed = np.array_equal(read(), values)
            except Exception:
                continue
            assert unnoticed, f"byte {place}: another value was read without an error"


def test_damage_is_named(dataset: Path, pristine: Path) -> None:
    def the_problem() -> str:
        (problem,) = verify(dataset).problems
        return problem

    for name in ("data.zarr/zarr.json", "samples.parquet", "croissant.json", "README.md"):
        (dataset / name).write_bytes((dataset / name).read_bytes().replace(b"e", b"a", 1) + b" ")
        assert the_problem().startswith(name)
        (dataset / name).unlink()
        assert the_problem().startswith(f"{name}: missing")
        shutil.copy(pristine / name, dataset / name)
    (dataset / SHARD).write_bytes((dataset / SHARD).read_bytes()[:-9])
    assert the_problem().startswith(f"shard 1: {SHARD}:") and "were written" in the_problem()
    (dataset / SHARD).unlink()
    assert the_problem() == f"shard 1: {SHARD}: missing"
    (dataset / "build/shard-000001.json").unlink()
    assert the_problem().startswith("shard 1: not there (no commit record)")


def test_exchanged_shards_are_found_by_the_hash_of_a_file(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is decoded for it. Checksums of chunks cannot tell: those of other values are as sound, and the CRC-32C
    of a file whose pieces end in their CRC-32C depends on their lengths alone."""
    one, other = (dataset / f"data.zarr/laser_position/c/{shard}/0" for shard in (0, 1))
    contents = one.read_bytes(), other.read_bytes()
    assert contents[0] != contents[1] and len({(len(c), google_crc32c.value(c)) for c in contents}) == 1
    one.write_bytes(contents[1])
    other.write_bytes(contents[0])
    manifest = read_manifest(dataset)
    DatasetReader(dataset, manifest, ["laser_position"], check=False).read("laser_position", range(12))
    with pytest.raises(CheckError, match="decodes to other values"):
        DatasetReader(dataset, manifest, ["laser_position"]).read("laser_position", range(12))
    monkeypatch.setattr(DatasetReader, "read", None)
    assert [problem.split(":")[0] for problem in verify(dataset).problems] == ["shard 0", "shard 1"]


def test_a_changed_configuration_is_found(dataset: Path) -> None:
    reseal(dataset / "dataset.json", lambda values: values["config"].update(seed=values["config"]["seed"] + 1))
    assert any("fingerprint" in problem for problem in verify(dataset).problems)


def test_table_and_cards_agree_with_the_dataset(dataset: Path) -> None:
    table = pq.read_table(dataset / "samples.parquet")
    assert table["scene"].to_pylist() == list(range(12))
    assert table["index"].to_pylist() == list(range(12))
    assert table["kind"].to_pylist() == ["mesh", "box"] * 6
    assert table["failure"].null_count == 12
    # Bytes of the table are those of any build; times are not.
    assert not any("second" in name for name in table.column_names)
    card = (dataset / "README.md").read_text()
    assert "Complete: 12 scenes in 3 shards" in card and "| `depth` | scene, row, column | 12, 4, 5 |" in card
    described = croissant(dataset, read_manifest(dataset), committed(dataset, read_manifest(dataset)))
    columns = [field["source"]["extract"]["column"] for field in described["recordSet"][0]["field"]]
    assert columns == table.column_names
