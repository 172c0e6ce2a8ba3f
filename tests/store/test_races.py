"""Builds that meet in one folder: one begins the dataset, others of the same configuration share its work, and those
of another one say that they lost. What comes in between two steps is put there by the test, not by chance."""

from __future__ import annotations

import importlib
import math
import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from fake_samples import build_fakes, fails_at_5, fake_sample, small_config
from here_and_now import HereAndNow, jobs_go_to, one_worker_here

from datagen import locks, store
from datagen.building import build as building
from datagen.building import jobs, shard_job
from datagen.config import DatasetConfig
from datagen.errors import CheckError, InputError
from datagen.locks import lock_file
from datagen.store import running_path, verify, writing_path
from datagen.store.files import write_first
from datagen.store.verify import dataset_digest

preparation = importlib.import_module("datagen.store.prepare")


def files_of(root: Path) -> set[str]:
    return {path.name for path in root.rglob("*") if path.suffix in (".partial", ".running", ".writing")}


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for long, and no process is taken for dead because the machine is slow."""
    for module, name, seconds in (
        (jobs, "TICK_S", 0.01), (jobs, "LOOK_S", 0.02), (shard_job, "LOCK_PATIENCE_S", 0.0),
    ):  # fmt: skip
        monkeypatch.setattr(module, name, seconds)


class Clock:
    """The time of a build that waits: it goes on when the build sleeps, and `meanwhile` is what others do then."""

    def __init__(self, meanwhile: Callable[[float], object] = lambda now: None) -> None:
        self.now, self.meanwhile, self.time = 0.0, meanwhile, time.time

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds
        self.meanwhile(self.now)


def before(monkeypatch: pytest.MonkeyPatch, module: Any, name: str, do: Callable[[], object]) -> None:
    """Let `do` be called once, before the first call of a function."""
    whole, due = getattr(module, name), [do]

    def changed(*arguments: Any, **options: Any) -> Any:
        if due:
            due.pop()()
        return whole(*arguments, **options)

    monkeypatch.setattr(module, name, changed)


@one_worker_here()
@pytest.mark.parametrize(
    ("module", "step"),
    [
        ((building, "with_exposure_found"), "looks"), ((building.store, "check_writable"), "has planned"),
        ((building.store, "prepare"), "prepares"), ((preparation, "write_first"), "writes the first file"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)  # fmt: skip
def test_of_two_new_datasets_in_one_folder_one_is_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: tuple[Any, str], step: str
) -> None:
    """Whatever step of the first build the second one comes before; without locks of the file system, too. The loser
    says so with status 1, and the dataset is that of the winner alone."""
    root, alone = tmp_path / "set", tmp_path / "alone"
    build_fakes(small_config(seed=4), alone)
    monkeypatch.setattr(locks, "try_lock", lambda handle, otherwise: otherwise)
    before(monkeypatch, *module, lambda: build_fakes(small_config(seed=4), root))
    with pytest.raises(CheckError, match=r"seed = 4, this configuration has 3.*another build began there first"):
        build_fakes(small_config(seed=3), root)
    assert verify(root, deep=True).problems == () and dataset_digest(root) == dataset_digest(alone)
    assert not files_of(root)
    # Later it is a wrong call.
    with pytest.raises(InputError, match="seed = 4, this configuration has 3"):
        build_fakes(small_config(seed=3), root)


@one_worker_here()
def test_a_dataset_grows_to_one_size_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A build that has found room to grow waits while another one prepares to grow further, and then refuses."""
    root = tmp_path / "set"
    build_fakes(small_config(), root)
    monkeypatch.setattr(preparation, "alone_in", partial(locks.alone_in, patience_s=math.inf))
    refused = list[str]()

    def grow() -> None:
        try:
            store.prepare(root, small_config(scenes=16))
        except InputError as error:
            refused.append(str(error))

    other = threading.Thread(target=grow)

    def meanwhile() -> None:
        other.start()
        other.join(0.5)

    before(monkeypatch, preparation, "clear_partials", meanwhile)
    store.prepare(root, small_config(scenes=20))
    other.join()
    assert len(refused) == 1 and "scenes = 16" in refused[0]


def test_a_file_is_written_first_by_one_of_many(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With two names for a file, and where a file has one name only."""

    def refused(*_: object) -> None:
        raise PermissionError("no links here")

    for name in ("linked", "claimed"):
        written = list[int]()

        def write(number: int, path: Path = tmp_path / name, to: list[int] = written) -> None:
            to.extend([number] if write_first(path, b"%d" % number) else [])

        threads = [threading.Thread(target=write, args=(number,)) for number in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert [int((tmp_path / name).read_text())] == written
        monkeypatch.setattr("os.link", refused)
    assert {path.name for path in tmp_path.iterdir()} == {"linked", "claimed"}


class Whole(HereAndNow):
    """Workers that make whole shards, as those of a cluster."""

    shares_shards = False


@pytest.mark.parametrize("locked", [running_path, writing_path])
@pytest.mark.parametrize("engine", [HereAndNow, Whole])
def test_a_shard_that_another_process_has_locked_is_left_for_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, engine: type[HereAndNow], locked: Callable[[Path, int], Path]
) -> None:
    """All others are made; then the build waits as long as the other process gives signs of life, and ends with a
    line that names it. When the lock is gone the build goes on."""
    root, config = tmp_path / "set", small_config()
    monkeypatch.setattr(shard_job, "LOCK_PATIENCE_S", 0.0)
    store.prepare(root, config)
    path = locked(root, 1)
    handle = lock_file(path)
    assert handle is not None

    monkeypatch.setattr(jobs, "time", clock := Clock())
    with jobs_go_to(engine()), pytest.raises(CheckError, match=r"shard 1 \(.*, process \d+\).*has not stirred for"):
        build_fakes(config, root)
    assert jobs.SILENCE_S < clock.now < 1.2 * jobs.SILENCE_S
    assert [record.shard for record in store.each_committed(root, store.read_manifest(root))] == [0, 2]

    def stir(now: float) -> None:
        """A sign now and then, until the lock is gone."""
        if now == 3 * jobs.SILENCE_S:
            os.close(handle)
        elif now < 3 * jobs.SILENCE_S and now % locks.PULSE_S == 0:
            os.utime(path, ns=(0, int(now)))

    monkeypatch.setattr(jobs, "time", clock := Clock(stir))
    with jobs_go_to(engine()):
        result = build_fakes(config, root)
    assert result.complete and (result.built, result.kept) == (1, 2) and not files_of(root)
    assert clock.now >= 3 * jobs.SILENCE_S


@pytest.mark.usefixtures("at_once")
def test_a_worker_that_meets_a_locked_shard_takes_another_one(tmp_path: Path) -> None:
    """A worker of a cluster that has stalled for so long that the scheduler gave its job to another one still has the
    lock of its shard, and commits it when it goes on."""
    root, config = tmp_path / "set", small_config()

    class Stalled(Whole):
        """The first job stalls until the second shard is made, and is given to another worker in the meantime."""

        def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
            recipe, shard = arguments[:2]
            if shard == 0 and not hasattr(self, "handle"):
                self.handle = lock_file(running_path(root, 0))
            elif shard == 1:
                os.close(self.handle)
                shard_job.run_shard(recipe, 0, arguments[2])
            return super().submit(function, *arguments)

    with jobs_go_to(Stalled()):
        result = build_fakes(config, root)
    assert result.complete and not files_of(root) and verify(root, deep=True).problems == ()


def test_a_shard_is_locked_from_its_first_scene_until_it_is_committed(tmp_path: Path) -> None:
    """Whatever its scenes come from: none of the moments between two jobs is one for another build to begin with
    it."""
    root, of_jobs = tmp_path / "set", list[str]()

    class Looked(HereAndNow):
        def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
            shard = arguments[1] if function is shard_job.run_shard else arguments[1] // 4
            assert lock_file(running_path(root, shard)) is None
            of_jobs.append(function.__name__)
            return super().submit(function, *arguments)

    with jobs_go_to(Looked()):
        build_fakes(small_config(), root)
    assert of_jobs == (["make_scene"] * 4 + ["run_shard"]) * 3 and not files_of(root)


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.usefixtures("at_once")
def test_two_builds_of_one_dataset_share_its_work(tmp_path: Path, workers: int) -> None:
    """Both end when everything is there, and no scene is made twice."""
    root, made = tmp_path / "set", list[int]()
    meeting = threading.Barrier(2)

    def sample(config: DatasetConfig, index: int) -> Any:
        made.append(index)
        if len(made) < 3:
            # Both are at work on a scene.
            meeting.wait()
        return fake_sample(config, index)

    results = list[building.BuildResult]()

    def build() -> None:
        try:
            results.append(build_fakes(small_config(), root, sample_function=sample))
        finally:
            # If one fails the other does not wait for it.
            meeting.abort()

    with jobs_go_to(HereAndNow() if workers == 1 else Whole()):
        builds = [threading.Thread(target=build) for _ in range(2)]
        for one in builds:
            one.start()
        for one in builds:
            one.join()
    assert sorted(made) == list(range(12))
    assert all(result.complete for result in results) and sum(result.built for result in results) == 3
    assert verify(root, deep=True).problems == () and not files_of(root)


@pytest.mark.usefixtures("at_once")
def test_failed_scenes_that_another_build_has_mended_meanwhile_are_taken_as_they_are(tmp_path: Path) -> None:
    root = tmp_path / "set"
    with jobs_go_to(HereAndNow()), pytest.raises(CheckError, match="scene 5"):
        build_fakes(small_config(), root, sample_function=fails_at_5)
    mended = list[int]()

    class Late(HereAndNow):
        @property
        def capacity(self) -> int:  # type: ignore[override]
            if not mended:
                mended.append(5)
                with jobs_go_to(HereAndNow()):
                    build_fakes(small_config(), root)
            return 1

    with jobs_go_to(Late()):
        result = build_fakes(small_config(), root, sample_function=fails_at_5)
    assert result.complete and result.built == 0 and verify(root, deep=True).problems == ()
