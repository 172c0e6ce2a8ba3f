"""Builds: the same bytes whatever happens on the way, and nothing touched that is not the build's own."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import re
import resource
import socket
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from fake_samples import (
    always_fails,
    build_fakes,
    dies_at_5,
    dies_once_at_5,
    fake_sample,
    large_config,
    small_config,
    waits_for_another,
)
from here_and_now import one_worker_here
from limits import limited

from datagen.building import shard_job
from datagen.building.build import parse_shards
from datagen.config import DatasetConfig
from datagen.errors import CheckError, InputError
from datagen.records import Sample
from datagen.store import committed_records, prepare, running_path, verify
from datagen.store.files import PARTIAL, clear_partials, write_atomically


def content(root: Path) -> dict[str, bytes]:
    """Every file's bytes, but for times: those of commit records, and the day in croissant.json."""
    files = {}
    for path in sorted(root.rglob("*")):
        if path.is_file():
            data = path.read_bytes()
            if path.parent.name == "build":
                record = json.loads(data)
                for key in ("seconds", "started", "finished", "checksum"):
                    del record[key]
                data = json.dumps(record).encode()
            data = re.sub(rb'"datePublished": "[0-9-]{10}"', b"", data)
            # The code may be committed while its tests run.
            files[str(path.relative_to(root))] = re.sub(rb"\b[0-9a-f]{40}(\+changes)?(?![0-9a-f])", b"COMMIT", data)
    return files


@pytest.fixture(scope="module")
def whole(pristine: Path) -> dict[str, bytes]:
    return content(pristine)


def test_more_workers_write_the_same_bytes(whole: dict[str, bytes], tmp_path: Path) -> None:
    """Four workers share all scenes of the three shards."""
    build_fakes(small_config(), tmp_path / "set", 4)
    assert content(tmp_path / "set") == whole


def test_scenes_of_one_shard_come_from_several_workers(tmp_path: Path) -> None:
    """Each waits until the other is at a scene, too."""
    config = small_config(scenes=4, description=str(tmp_path))
    build_fakes(config, tmp_path / "set", 2, sample_function=waits_for_another)
    assert len(list(tmp_path.glob("*.pid"))) == 2 and verify(tmp_path / "set").problems == ()


@one_worker_here()
def test_shards_built_one_by_one_make_the_same_dataset(whole: dict[str, bytes], tmp_path: Path) -> None:
    """And building again changes no file."""
    root = tmp_path / "set"
    result = build_fakes(small_config(), root, shards="2")
    assert not result.complete and not (root / "samples.parquet").exists()
    assert "Incomplete" in (root / "README.md").read_text()
    build_fakes(small_config(), root, shards="0-1")
    assert content(root) == whole
    times = {path: path.stat().st_mtime_ns for path in root.rglob("*") if path.is_file()}
    result = build_fakes(small_config(), root)
    assert (result.built, result.kept) == (0, 3)
    assert {path: path.stat().st_mtime_ns for path in root.rglob("*") if path.is_file()} == times
    assert parse_shards(None, 3) == [0, 1, 2] and parse_shards("7-9,3,8", 10) == [3, 7, 8, 9]
    for bad in ("", "a", "3-1", "-1", "0-10", "1,,2"):
        with pytest.raises(InputError, match=r"^shards = "):
            parse_shards(bad, 10)


@one_worker_here()
def test_a_dataset_grows_and_keeps_its_scenes(whole: dict[str, bytes], tmp_path: Path) -> None:
    root = tmp_path / "set"
    build_fakes(small_config(scenes=6), root)
    before = content(root)
    result = build_fakes(small_config(), root)
    assert (result.built, result.kept) == (2, 1)
    grown = content(root)
    assert grown == whole and all(grown[name] == data for name, data in before.items() if "/c/0/" in name)
    with pytest.raises(InputError, match=r"12 scenes, scenes = 6 is fewer"):
        build_fakes(small_config(scenes=6), root)


def test_another_configuration_and_other_files_are_refused_and_stay_as_they_are(
    whole: dict[str, bytes], dataset: Path, tmp_path: Path
) -> None:
    other_time = {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 17}}
    other_field = {"fields": ["histogram", "albedo", "depth"], "scenes_per_shard": 4}
    for changes, message in (
        ({"capture": other_time}, r"capture\.time\.bins = 16, this configuration has 17"),
        ({"store": other_field}, r"store\.fields\[1\] = 'transient', this configuration has 'albedo'"),
    ):
        with pytest.raises(InputError, match=message):
            build_fakes(small_config(**changes), dataset)
    assert content(dataset) == whole
    other = tmp_path / "other"
    other.mkdir()
    for name, message in (
        ("thesis.tex", r"thesis\.tex.*no dataset\.json"),
        ("dataset.json", "not the manifest of a"),
    ):
        (other / name).write_text('{"format": "another tool"}')
        with pytest.raises(InputError, match=message):
            build_fakes(small_config(), other)
    assert sorted(path.name for path in other.rglob("*")) == ["dataset.json", "thesis.tex"]


def test_a_build_where_every_scene_fails_stops_early(tmp_path: Path) -> None:
    with pytest.raises(CheckError, match=r"all of the first 8 scenes failed.*scene 4: impossible"):
        build_fakes(small_config(scenes=400), tmp_path / "set", sample_function=always_fails)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_worker_that_dies_is_replaced_and_costs_one_scene(
    whole: dict[str, bytes], tmp_path: Path, workers: int
) -> None:
    """One worker makes a shard of four scenes and dies over the second: the first is not made again."""
    begun = tmp_path / "begun"
    build_fakes(small_config(description=str(begun)), tmp_path / "set", workers, sample_function=dies_once_at_5)
    assert workers > 1 or [int(line) for line in begun.read_text().split()] == [*range(6), *range(5, 12)]
    described, found = ("dataset.json", "README.md", "croissant.json"), content(tmp_path / "set")
    assert {**whole, **{name: found[name] for name in described}} == found


@pytest.mark.parametrize("workers", [1, 2])
def test_a_scene_that_kills_its_workers_is_given_up(tmp_path: Path, workers: int) -> None:
    with pytest.raises(CheckError, match=r"1 of 8 scenes.*scene 5: 2 worker processes died over it"):
        build_fakes(small_config(scenes=8), tmp_path / "set", workers, sample_function=dies_at_5)
    assert len(verify(tmp_path / "set").problems) == 1


def test_workers_begin_with_their_modules_imported_and_one_thread() -> None:
    code = (
        "from datagen.building.engines import start_imports, running_engine\n"
        "start_imports('colorsys')\n"
        "with running_engine('local', 2, None) as running:\n"
        '    asked = \'("colorsys" in __import__("sys").modules, __import__("os").environ["OMP_NUM_THREADS"])\'\n'
        "    assert [running.submit(eval, asked).result() for _ in range(2)] == [(True, '1')] * 2\n"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300, env=environment)


def test_two_writers_never_meet_in_one_shard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shard_job, "LOCK_PATIENCE_S", 0.1)
    root, config = tmp_path / "set", small_config()
    manifest = prepare(root, config)
    job = shard_job.Recipe(root, config, manifest, fake_sample), 0, time.time()
    with running_path(root, 0).open("w") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(CheckError, match="another build is writing this shard"):
            shard_job.run_shard(*job)
    assert shard_job.run_shard(*job) == {}
    made = (root / "build/shard-000000.json").read_bytes()
    assert shard_job.run_shard(*job) == {}
    assert (root / "build/shard-000000.json").read_bytes() == made, "a shard made meanwhile is not made again"


def test_half_written_files_go_unless_their_writer_is_at_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A killed build's file has no lock any more. Where a file system has no locks nobody can tell, and all stay."""
    left, at_work, kept = (tmp_path / name for name in (f"left{PARTIAL}", f"at_work{PARTIAL}", "shard"))
    for path in (left, at_work, kept):
        path.write_bytes(b"half")
    with at_work.open("rb") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        clear_partials(tmp_path)
        assert sorted(path.name for path in tmp_path.iterdir()) == [at_work.name, kept.name]
    clear_partials(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [kept.name]

    def no_locks(handle: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, "no locks available")

    left.write_bytes(b"half")
    monkeypatch.setattr("datagen.locks.fcntl.flock", no_locks)
    clear_partials(tmp_path)
    assert left.exists()
    write_atomically(tmp_path / "whole", b"all of it")
    assert (tmp_path / "whole").read_bytes() == b"all of it"


def test_a_failed_scene_whose_result_was_lost_is_not_made_again(tmp_path: Path) -> None:
    """The job that committed it is handed out anew, because its result got lost: it returns what the record says. A
    job of a later build tries the failed scene again, and makes no other."""
    made: list[int] = []

    def third_fails(config: DatasetConfig, index: int) -> Sample:
        made.append(index)
        if index == 2 and len(made) < 8:
            raise InputError("no room for it")
        return fake_sample(config, index)

    config = small_config()
    manifest = prepare(tmp_path / "set", config)
    recipe = shard_job.Recipe(tmp_path / "set", config, manifest, third_fails)
    before = time.time()
    failures = shard_job.run_shard(recipe, 0, before)
    assert failures == {2: "no room for it"} and made == [0, 1, 2, 3]
    assert shard_job.run_shard(recipe, 0, before) == failures
    assert made == [0, 1, 2, 3]
    assert shard_job.run_shard(recipe, 0, before + 3600) == failures
    assert made == [0, 1, 2, 3, 2]
    made.extend([9, 9, 9])
    assert shard_job.run_shard(recipe, 0, before + 3600) == {}
    assert made[-1] == 2
    whole = prepare(tmp_path / "whole", config)
    shard_job.run_shard(
        replace(recipe, root=tmp_path / "whole", manifest=whole, sample_function=fake_sample), 0, before
    )
    digests = [[scene.digests for scene in next(iter(committed_records(tmp_path / name, whole, [0]))).scenes]
               for name in ("set", "whole")]  # fmt: skip
    assert digests[0] == digests[1]


@one_worker_here()
def test_files_are_on_the_disk_before_their_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Power may fail at any moment: before a shard's record has its name, it and the shard's files are synced."""
    synced: set[int] = set()
    committed = []
    whole = os.replace

    def replaced(source: Path, target: Path) -> None:
        if found := re.fullmatch(r"shard-0*(\d+)\.json", Path(target).name):
            files = [path for path in (tmp_path / "set/data.zarr").glob(f"*/c/{found[1]}/**/*") if path.is_file()]
            assert len(files) > len(small_config().store.fields)
            assert [path for path in (Path(source), *files) if path.stat().st_ino not in synced] == []
            committed.append(found[1])
        whole(source, target)

    monkeypatch.setattr(os, "fsync", lambda handle: synced.add(os.fstat(handle).st_ino))
    monkeypatch.setattr(os, "replace", replaced)
    build_fakes(small_config(), tmp_path / "set")
    assert committed == ["0", "1", "2"]


@one_worker_here()
def test_a_full_disk_ends_the_build_in_one_line_and_can_be_resumed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """Files may not grow beyond a limit: below the manifest's size, and below that of a shard."""
    for size in (900, 20_000):
        full = limited(resource.RLIMIT_FSIZE, size)
        with full, pytest.raises(CheckError, match=r"File too large.*resume") as ended:
            build_fakes(large_config(), tmp_path / "set")
        assert "\n" not in str(ended.value) and capfd.readouterr() == ("", "")
    build_fakes(large_config(), tmp_path / "set")
    assert verify(tmp_path / "set").problems == ()


def test_dask_writes_the_same_bytes(whole: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Workers fork from the server of the other builds, which has imported what they need.
    monkeypatch.setenv("DASK_DISTRIBUTED__WORKER__MULTIPROCESSING_METHOD", "forkserver")
    with socket.socket() as other:
        # Another cluster of this machine has the port that Dask would take.
        with suppress(OSError):
            other.bind(("0.0.0.0", 8787))
            other.listen()
        build_fakes(small_config(), tmp_path / "set", 2, engine="dask")
    assert content(tmp_path / "set") == whole
