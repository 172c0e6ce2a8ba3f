"""A dataset that grows is what it was, for every reader, until the larger one is complete, wherever it is killed."""

from __future__ import annotations

import fcntl
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import harm
import kills
import numpy as np
import pytest
import torch
import zarr
from damage import told
from fake_samples import build_fakes, fails_at_5, fake_sample, file_of, sequence_config, small_config

from datagen.config import DatasetConfig
from datagen.errors import CheckError, InputError
from datagen.formats import export
from datagen.formats.hub import DATASET
from datagen.loader import TransientDataset
from datagen.records import Sample
from datagen.store import growth, planned_manifest, read_manifest, verify
from datagen.store.info import info
from datagen.store.record import GROWTH
from datagen.store.verify import dataset_digest

FIELDS = ("histogram", "depth", "laser_points")
FEW, MANY = 10, 18
"""Scenes before and after: the last shard of four is filled up, and two more are made."""
Config = Callable[[int], DatasetConfig]
"""The configuration of so many scenes."""


@pytest.fixture(autouse=True)
def quiet() -> Iterator[None]:
    with harm.quietly():
        yield


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(small_config, id="scenes"),
        # A growth moves shards, whatever axes their fields have.
        pytest.param(sequence_config, id="sequences", marks=pytest.mark.nightly),
    ],
)
def config(request: pytest.FixtureRequest) -> Config:
    """Of scenes that are measured once, and of sequences."""
    made_of: Callable[..., DatasetConfig] = request.param
    return lambda scenes: made_of(scenes=scenes)


def grow(root: Path, **options: Any) -> Any:
    """What `config` asks for, whichever that is."""
    made_of = small_config if read_manifest(root).frames is None else sequence_config
    return build_fakes(made_of(scenes=MANY), root, **options)


def values(data: TransientDataset) -> dict[int, dict[str, torch.Tensor]]:
    return {int(item["scene"]): item for item in (data[i] for i in range(len(data)))}


def same(found: dict[int, dict[str, torch.Tensor]], due: dict[int, dict[str, torch.Tensor]]) -> bool:
    return all(torch.equal(item[name], due[scene][name]) for scene, item in found.items() for name in item)


def files(root: Path) -> dict[str, bytes]:
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in root.rglob("*") if path.is_file()}


@pytest.fixture(scope="module")
def small(config: Config, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A complete dataset, of which one scene of a full shard could not be made."""
    root = tmp_path_factory.mktemp("small") / "set"
    with harm.quietly(), suppress(CheckError):
        build_fakes(config(FEW), root, sample_function=fails_at_5)
    return root


@pytest.fixture(scope="module")
def sound(config: Config, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same without a failure."""
    root = tmp_path_factory.mktemp("sound") / "set"
    with harm.quietly():
        build_fakes(config(FEW), root)
    return root


@pytest.fixture(scope="module")
def large(config: Config, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The dataset that it grows into."""
    root = tmp_path_factory.mktemp("large") / "set"
    with harm.quietly():
        build_fakes(config(MANY), root)
    return root


def check_old_or_new(root: Path, small: Path, large: Path, before: TransientDataset) -> int:
    """Hold what all readers say of a dataset against those of the smaller and the larger one; returns its scenes."""
    scenes = read_manifest(root).schema.scenes
    due = {FEW: TransientDataset(small, FIELDS), MANY: TransientDataset(large, FIELDS)}[scenes]
    now = TransientDataset(root, FIELDS)
    assert now.scenes.tolist() == due.scenes.tolist() and now.stats == due.stats
    assert now.parameters("box.width_m").tolist() == due.parameters("box.width_m").tolist()
    made = values(TransientDataset(large, FIELDS))
    assert same(values(now), made)
    before._reader = None
    assert same(values(before), made) and before.stats == TransientDataset(small).stats
    assert before.parameters("kind").tolist() == TransientDataset(small).parameters("kind").tolist()
    # The group's metadata are consolidated, so that all arrays have one size for readers of the group.
    arrays = dict(zarr.open_group(root / "data.zarr", mode="r").arrays())
    lengths = {arrays[name].shape[0] for name in FIELDS}
    assert len(lengths) == 1 and lengths <= {FEW, MANY}
    for name in FIELDS:
        for scene, row in enumerate(np.asarray(arrays[name][:])):
            assert scene == 5 or np.array_equal(row, made[scene][name].numpy()), (name, scene)
    problems = [problem for problem in verify(root, deep=True).problems if "could not be made" not in problem]
    assert problems == [] and f"of {scenes}\n" in info(root)
    there = TransientDataset(root, FIELDS, partial=True)
    assert len(there) >= len(now) and same(values(there), made)
    assert len(there.parameters("index")) == len(there) and set(there.stats) == {"histogram", "depth"}
    return scenes


@pytest.mark.parametrize("number", [2, pytest.param(None, marks=pytest.mark.nightly)])
def test_a_growth_that_is_killed_between_any_two_steps(
    tmp_path: Path, config: Config, small: Path, large: Path, number: int | None
) -> None:
    """Half of the kills come in the last step, in which files take their places. Building with the old number of
    scenes does no harm, and the same growth again makes the larger dataset."""
    root, found = tmp_path / "set", set[int]()
    opened = TransientDataset(small, FIELDS)
    opened.path = root
    shutil.copytree(small, root)
    steps, begin = list[None](), list[int]()

    def counted(where: Path) -> None:
        begin.append(len(steps))
        growth.take_places(where)

    with pytest.MonkeyPatch.context() as patch, kills.before_each_step(lambda: steps.append(None)):
        patch.setattr(sys.modules["datagen.store.verify"], "take_places", counted)
        grow(root)
    (last,), end = begin, len(steps)
    chosen = [*range(end)]
    if number is not None:
        chosen = [*range(1, last, last // number), *np.linspace(last, end - 1, number + 1, dtype=int).tolist()]
    for step in chosen:
        shutil.rmtree(root)
        shutil.copytree(small, root)
        assert kills.killed_at(step, lambda: grow(root)), f"step {step} of {end} was not reached"
        found.add(check_old_or_new(root, small, large, opened))
        if step % 2:
            outcome = told(lambda: build_fakes(config(FEW), root))
            assert outcome is None or outcome.complete
        grow(root)
        assert verify(root, deep=True).problems == () and dataset_digest(root) == dataset_digest(large)
        assert set(files(root)) == set(files(large))
    assert found == {FEW, MANY}


def test_until_it_is_complete_no_file_of_the_smaller_dataset_changes(
    tmp_path: Path, config: Config, sound: Path, large: Path
) -> None:
    root, tried = tmp_path / "set", list[int]()
    shutil.copytree(sound, root)
    before = files(root)

    def sample(config: DatasetConfig, index: int) -> Sample:
        tried.append(index)
        assert before.items() <= files(root).items()
        return fake_sample(config, index)

    first = grow(root, shards="2-3", sample_function=sample)
    assert not first.complete and "growth to 18 scenes not complete (2 of its 3 shards are there)" in first.summary()
    assert before.items() <= files(root).items()
    assert "unfinished   growth to 18 scenes" in info(root) and len(TransientDataset(root)) == FEW
    assert TransientDataset(root, partial=True).scenes.tolist() == [*range(FEW), 12, 13, 14, 15]
    # The old command says that the dataset is complete, and what is not.
    again = build_fakes(config(FEW), root, sample_function=sample)
    assert again.complete and "complete with 10 scenes; growth to 18 scenes not complete" in again.summary()
    for scenes, message in ((9, "holds a dataset of 10 scenes, scenes = 9 is fewer"), (12, "ask for 18 or more")):
        with pytest.raises(InputError, match=message):
            build_fakes(config(scenes), root)
    last = grow(root, sample_function=sample)
    assert last.complete and sorted(tried) == [*range(FEW, MANY)], "no stored scene is made again"
    assert dataset_digest(root) == dataset_digest(large)
    plain = {name: data for name, data in files(large).items() if not name.startswith("build/")}
    assert {name: data for name, data in files(root).items() if not name.startswith("build/")} == plain


def test_a_growth_may_go_further_before_it_is_complete(tmp_path: Path, config: Config) -> None:
    root, due, tried = tmp_path / "set", tmp_path / "due", list[int]()

    def sample(config: DatasetConfig, index: int) -> Sample:
        tried.append(index)
        return fake_sample(config, index)

    build_fakes(config(6), root)
    build_fakes(config(10), root, shards="1", sample_function=sample)
    build_fakes(config(11), root, shards="2", sample_function=sample)
    build_fakes(config(13), root, sample_function=sample)
    build_fakes(config(13), due)
    assert sorted(tried) == list(range(6, 13)) and dataset_digest(root) == dataset_digest(due)
    assert set(files(root)) == set(files(due)) and verify(root, deep=True).problems == ()


def test_a_growth_that_version_1_0_0_began(tmp_path: Path, config: Config, sound: Path, large: Path) -> None:
    """It stated the larger dataset at once, and the last shard of the smaller one has too few scenes for that."""
    root, tried = tmp_path / "set", list[int]()
    shutil.copytree(sound, root)
    content = planned_manifest(root, config(MANY)).to_bytes()
    for name in ("samples.parquet", "croissant.json"):
        (root / name).unlink()
    for path in large.rglob("zarr.json"):
        shutil.copy(path, root / path.relative_to(large))
    (root / "dataset.json").write_bytes(content)
    with pytest.raises(InputError, match=r"3 of 5 shards are not committed.*partial=True"):
        TransientDataset(root)
    data = TransientDataset(root, FIELDS, partial=True)
    assert data.scenes.tolist() == [*range(FEW)] and same(values(data), values(TransientDataset(large, FIELDS)))
    assert verify(root).problems and info(root)

    def sample(config: DatasetConfig, index: int) -> Sample:
        tried.append(index)
        return fake_sample(config, index)

    grow(root, sample_function=sample)
    assert sorted(tried) == [*range(FEW, MANY)] and dataset_digest(root) == dataset_digest(large)


def test_exports_of_a_dataset_that_grows_are_those_of_the_smaller_one(tmp_path: Path, sound: Path) -> None:
    root = tmp_path / "set"
    shutil.copytree(sound, root)
    grow(root, shards="2-3")
    export(root, tmp_path / "hub", "hub")
    assert files(tmp_path / "hub" / DATASET) == files(sound)
    assert len(export(root, tmp_path / "npz", "npz")) == FEW
    assert dataset_digest(root) == dataset_digest(sound)


def test_damage_to_what_waits_is_told_and_made_anew(tmp_path: Path, sound: Path, large: Path) -> None:
    harms: list[Callable[[Path], object]] = [
        lambda waiting: (waiting / "dataset.json").write_text("{}"),
        lambda waiting: (waiting / "build/shard-000002.json").write_bytes(b"{"),
        lambda waiting: file_of(waiting, "histogram", 2).write_bytes(b""),
        shutil.rmtree,
    ]
    for change in harms:
        root = tmp_path / "set"
        shutil.copytree(sound, root)
        grow(root, shards="2-3")
        change(root / growth.GROWTH)
        assert same(values(TransientDataset(root, FIELDS)), values(TransientDataset(sound, FIELDS)))
        told(partial(verify, root, deep=True))
        grow(root)
        assert verify(root, deep=True).problems == () and dataset_digest(root) == dataset_digest(large)
        assert set(files(root)) == set(files(large))
        shutil.rmtree(root)


def test_two_builds_that_complete_a_growth_at_once(tmp_path: Path, large: Path, small: Path) -> None:
    """As of jobs that each make some shards: the one that comes second finds the growth complete."""
    root = tmp_path / "set"
    shutil.copytree(small, root)
    grow(root, shards="1-4")
    with ThreadPoolExecutor(3) as pool:
        statuses = [*pool.map(kills.in_a_child, [lambda: grow(root)] * 3)]
    assert statuses == [0, 0, 0]
    assert dataset_digest(root) == dataset_digest(large) and set(files(root)) == set(files(large))


def test_a_build_does_not_wait_for_ever_for_one_that_was_stopped(
    tmp_path: Path, sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While that one completes the growth; when it is gone the same command completes it."""
    root = tmp_path / "set"
    shutil.copytree(sound, root)
    grow(root, shards="2-3")
    stopped = os.open(root / GROWTH, os.O_RDONLY)
    fcntl.flock(stopped, fcntl.LOCK_EX)
    monkeypatch.setattr(growth, "_PATIENCE_S", 0.2)
    with pytest.raises(CheckError, match="another build has been completing it"):
        grow(root)
    os.close(stopped)
    grow(root)
    assert not (root / GROWTH).exists() and verify(root, deep=True).problems == ()


def test_an_incomplete_first_build_is_read_in_part(tmp_path: Path, config: Config, large: Path) -> None:
    root = tmp_path / "set"
    build_fakes(config(MANY), root, shards="1,3")
    with pytest.raises(InputError, match=r"3 of 5 shards are not committed.*partial=True"):
        TransientDataset(root)
    data = TransientDataset(root, FIELDS, partial=True)
    assert data.scenes.tolist() == [4, 5, 6, 7, 12, 13, 14, 15]
    assert same(values(data), values(TransientDataset(large, FIELDS)))
    assert data.parameters("index").tolist() == data.scenes.tolist() and data.stats["histogram"]["std"] > 0
    assert data.parameters("index").dtype == np.int64
    with pytest.raises(InputError, match="parameters: 'weight' is no column"):
        data.parameters("weight")
    parts = [TransientDataset(root, split="train", partial=True).scenes.tolist()]
    whole = TransientDataset(large, split="train").scenes.tolist()
    assert parts == [[scene for scene in whole if scene in data.scenes]], "scenes keep their split"
    some = TransientDataset(root, split="val", fractions=(0.5, 0.5, 0.0), partial=True)
    assert {*some.scenes.tolist()} <= {*data.scenes.tolist()}
    build_fakes(config(MANY), root)
    assert same(values(data), values(TransientDataset(large, FIELDS))) and len(data) == 8
    assert len(TransientDataset(root, partial=True)) == MANY
    # All shards are there, but the build has not written the hash of the table yet.
    (root / "croissant.json").unlink()
    last = TransientDataset(root, FIELDS, partial=True)
    assert (
        same(values(last), values(TransientDataset(large, FIELDS)))
        and len(last) == len(last.parameters("index")) == MANY
    )
    assert last.stats == TransientDataset(large).stats
    empty = tmp_path / "empty"
    shutil.copytree(root, empty)
    shutil.rmtree(empty / "build")
    with pytest.raises(InputError, match="no scene of it is there yet"):
        TransientDataset(empty, partial=True)
