"""What is read is what zarr reads; damage and loss are errors, and `verify` finds each and says where."""

from __future__ import annotations

import os
import pickle
import resource
import shutil
from contextlib import suppress
from pathlib import Path

import google_crc32c
import numpy as np
import pyarrow.parquet as pq
import pytest
import zarr
from damage import reseal
from datasets import write_dataset
from fake_samples import EITHER, fake_sample, file_of

from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import CheckError
from datagen.loader import TransientDataset
from datagen.store import DatasetReader, Description, each_committed, read_manifest, schema, verify
from datagen.store.croissant import croissant


def config_of(rows: int, columns: int, pixels: int, bins: int, scenes: int = 10) -> DatasetConfig:
    capture = {
        "pairing": "exhaustive",
        "scan": {"rows": rows, "columns": columns},
        "field_of_view": {"rows": 1, "columns": pixels},
        "time": {"bins": bins},
    }
    fields = ["histogram", "transient", "depth", "normal"]
    store = {"fields": fields, "scenes_per_shard": 1 if scenes > 10 else 4}
    return config_from_mapping(
        {"scenes": scenes, "capture": capture, "store": store, "labels": {"rows": 5, "columns": 3}}
    )


@EITHER
def test_damage_is_an_error(dataset: Path) -> None:
    manifest, path = read_manifest(dataset), file_of(dataset, "histogram", 0)
    sound = path.read_bytes()
    for data, check, message in (
        (bytes([sound[0] ^ 1]) + sound[1:], True, "scene 0: the checksum does not match"),
        (sound[:-1] + bytes([sound[-1] ^ 1]), True, "scenes 0-3: the shard's index is damaged"),
        (sound[:-1], True, f"{len(sound) - 1} bytes, {len(sound)} were written"),
        (sound[:-1], False, "the shard's index is damaged"),
        (b"", True, "0 bytes"),
        (b"", False, "the shard's index is damaged"),
    ):
        path.write_bytes(data)
        with pytest.raises(CheckError, match=message) as refused:
            DatasetReader(dataset, manifest, ["histogram"], check).read("histogram", [0, 1, 2, 3])
        assert str(path) in str(refused.value) and "build` again" in str(refused.value)


@EITHER
@pytest.mark.parametrize("name", ["histogram", "laser_points"])
def test_a_missing_chunk_is_an_error_and_no_fill_value(dataset: Path, name: str) -> None:
    """A chunk that is missing would be filled by zarr; two shards exchanged would be read as they are."""
    manifest = read_manifest(dataset)
    one, other = (file_of(dataset, name, shard) for shard in (0, 1))
    one.rename(dataset / "aside")
    with pytest.raises(CheckError, match="scenes 0-3: cannot be opened"):
        DatasetReader(dataset, manifest, [name], check=False).read(name, [0])
    # Whoever opens a pipe waits for its writer.
    os.mkfifo(one)
    with pytest.raises(CheckError, match="no plain file"):
        DatasetReader(dataset, manifest, [name]).read(name, [0])
    one.unlink()
    other.rename(one)
    (dataset / "aside").rename(other)
    with pytest.raises(CheckError, match=r"decodes to other values than were written|bytes, \d+ were written"):
        DatasetReader(dataset, manifest, [name]).read(name, [0])


@pytest.mark.parametrize(
    ("shards", "allowed"), [(20, 40), pytest.param(300, 256, marks=pytest.mark.nightly)], ids=["few", "many"]
)
def test_five_fields_of_more_shards_than_files_are_allowed(tmp_path: Path, shards: int, allowed: int) -> None:
    """Also if the rest of the process has nearly all files that are allowed open; if all, the error says so."""
    write_dataset(config_of(1, 1, 1, 2, shards), tmp_path / "set", fake_sample)
    data = TransientDataset(tmp_path / "set", ("histogram", "transient", "depth", "normal", "laser_points"))
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    held: list[int] = []
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(map(int, os.listdir("/proc/self/fd"))) + allowed, before[1]))
        assert len([data[item] for item in [*range(len(data)), 0]]) == shards + 1
        data = pickle.loads(pickle.dumps(data))
        with suppress(OSError):
            while True:
                held.append(os.open("/dev/null", os.O_RDONLY))
        with pytest.raises(CheckError, match=r"too many files open; .*ulimit -n"):
            data[5]
        # One for a file, one for its record.
        for _ in range(2):
            os.close(held.pop())
        assert [int(data[item]["scene"]) for item in (3, 1, 3)] == [3, 1, 3]
    finally:
        for handle in held:
            os.close(handle)
        resource.setrlimit(resource.RLIMIT_NOFILE, before)


@pytest.mark.parametrize("chunk_bytes", [2**22, 700])
def test_threads_read_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, chunk_bytes: int) -> None:
    """Several scenes side by side, whole and cast, and the first error of them is raised."""
    monkeypatch.setattr(schema, "CHUNK_BYTES", chunk_bytes)
    monkeypatch.setattr("datagen.store.reader.MEMORY_BYTES", 0)
    manifest = read_manifest(write_dataset(config_of(rows=1, columns=5, pixels=3, bins=17), tmp_path, fake_sample))
    order = [7, 0, 9, 9, 3, 4, 8]

    def read(threads: int) -> list[np.ndarray]:
        monkeypatch.setattr("datagen.store.reader.WORTH_BYTES", 0 if threads else 2**60)
        monkeypatch.setattr("datagen.store.reader.cores", lambda: threads)
        reader = DatasetReader(tmp_path, manifest, ["histogram", "transient"])
        shape = len(order), *manifest.schema.by_name["histogram"].shape
        return [
            reader.read(name, order, out=out)
            for name in ("histogram", "transient")
            for out in (None, np.empty(shape, "f8"))
        ]

    assert all(np.array_equal(a, b) for a, b in zip(read(0), read(3), strict=True))
    path = tmp_path / "data.zarr/histogram/c/2/0/0/0"
    path.write_bytes(path.read_bytes()[:-1] + b"\0")
    with pytest.raises(CheckError, match=r"c/2/0/0/0, scenes 8-9: the shard's index is damaged"):
        read(3)


@EITHER
def test_a_flip_that_hashes_do_not_guard_is_found_by_the_checksum(dataset: Path) -> None:
    """Any Zarr reader finds it, without commit records, because the codec chain ends with a CRC-32C."""
    manifest, file = read_manifest(dataset), file_of(dataset, "histogram", 1)
    sound = file.read_bytes()
    values = zarr.open_array(dataset / "data.zarr/histogram", mode="r")[4:8]
    for place in range(0, len(sound), 11):
        data = bytearray(sound)
        data[place] ^= 0x10
        file.write_bytes(data)
        for read in (
            lambda: zarr.open_array(dataset / "data.zarr/histogram", mode="r")[4:8],
            lambda: DatasetReader(dataset, manifest, ["histogram"], check=False).read("histogram", range(4, 8)),
        ):
            try:
                unnoticed = np.array_equal(read(), values)
            except Exception:
                continue
            assert unnoticed, f"byte {place}: another value was read without an error"


@EITHER
def test_damage_is_named(dataset: Path, pristine: Path) -> None:
    file = file_of(dataset, "histogram", 1)
    name_of_file = file.relative_to(dataset).as_posix()

    def the_problem() -> str:
        (problem,) = verify(dataset).problems
        return problem

    for name in ("data.zarr/zarr.json", "samples.parquet", "croissant.json", "README.md"):
        (dataset / name).write_bytes((dataset / name).read_bytes().replace(b"e", b"a", 1) + b" ")
        assert the_problem().startswith(name)
        (dataset / name).unlink()
        assert the_problem().startswith(f"{name}: missing")
        shutil.copy(pristine / name, dataset / name)
    file.write_bytes(file.read_bytes()[:-9])
    assert the_problem().startswith(f"shard 1: {name_of_file}:") and "were written" in the_problem()
    file.unlink()
    assert the_problem() == f"shard 1: {name_of_file}: missing"
    (dataset / "build/shard-000001.json").unlink()
    assert the_problem().startswith("shard 1: not there (no commit record)")


def test_files_that_cannot_be_read_are_named_with_all_other_problems(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One has no permission, folders stand in the places of others; none of them ends the verification."""
    names = ("data.zarr/bin/c/0", "data.zarr/zarr.json", "README.md", "build/shard-000002.json")
    locked, opens, handles = file_of(dataset, "histogram", 1), os.open, len(os.listdir("/proc/self/fd"))

    def refuse(path: object, *more: object) -> int:
        if path == locked:
            raise PermissionError(13, "Permission denied", str(path))
        return opens(path, *more)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "open", refuse)
    for name in names[:3]:
        (dataset / name).unlink()
        (dataset / name).mkdir()
    problems = verify(dataset).problems
    assert [line.partition(": ")[0] for line in problems] == [*names[:2], "shard 1", "README.md"]
    assert f"{locked}: cannot be read (Permission denied)" in problems[2]
    (dataset / names[3]).unlink()
    (dataset / names[3]).mkdir()
    assert any(
        line.startswith(f"{dataset / names[3]}: missing, or not a plain file") for line in verify(dataset).problems
    )
    assert len(os.listdir("/proc/self/fd")) == handles


@EITHER
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


@EITHER
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
    manifest = read_manifest(dataset)
    described = croissant(dataset, Description(manifest, each_committed(dataset, manifest)))
    columns = [field["source"]["extract"]["column"] for field in described["recordSet"][0]["field"]]
    assert columns == table.column_names
