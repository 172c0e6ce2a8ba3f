"""A build killed between any two steps of writing resumes to the same dataset, a repair likewise."""

from __future__ import annotations

import os
import shutil
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from fake_samples import fails_at_5, fake_sample, small_config

from datagen.building.build import build
from datagen.errors import CheckError, InputError
from datagen.loader import TransientDataset
from datagen.store import verify
from datagen.store.digest import dataset_digest

CONFIG = small_config(scenes=6, store={"fields": ["histogram"], "scenes_per_shard": 4})
STEPS = ("fsync", "replace", "rename", "unlink", "mkdir", "pwrite", "link")
"""Calls of the operating system that change what is there, or make it last."""


def whole_build(root: Path) -> None:
    build(CONFIG, root, progress=False, sample_function=fake_sample)


def in_a_child(call: Callable[[], object]) -> int:
    """The exit status of a process that does this and ends without any clearing up."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        child = os.fork()
    if child == 0:
        try:
            call()
            os._exit(0)
        finally:
            os._exit(1)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def killed_at(step: int, call: Callable[[], object]) -> bool:
    """Do something in a process that is gone at the given step; whether it came to that."""

    def dying() -> None:
        left = step

        def counted(change: Callable[..., Any]) -> Callable[..., Any]:
            def changed(*args: Any, **options: Any) -> Any:
                nonlocal left
                left -= 1
                if left < 0:
                    os._exit(9)
                return change(*args, **options)

            return changed

        for name in STEPS:
            setattr(os, name, counted(getattr(os, name)))
        call()

    status = in_a_child(dying)
    assert status in (0, 9)
    return status == 9


@pytest.fixture(autouse=True)
def no_server(monkeypatch: pytest.MonkeyPatch) -> None:
    """A child cannot wait for its parent's."""
    monkeypatch.setattr("datagen.building.build.start_imports", lambda *_: None)


@pytest.fixture(scope="module")
def due(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("kills") / "set"
    whole_build(root)
    return root


def histograms(root: Path) -> dict[int, bytes]:
    """Every scene there is; none where the dataset is not believed to be whole."""
    with suppress(CheckError, InputError), warnings.catch_warnings():
        # A scene that failed before is told, and left out.
        warnings.simplefilter("ignore", UserWarning)
        data = TransientDataset(root, ("histogram",))
        items = [data[item] for item in range(len(data))]
        return {int(item["scene"]): item["histogram"].numpy().tobytes() for item in items}
    return {}


def resumes(root: Path, due: Path, where: str) -> None:
    """What a reader gets after a kill is what was to be stored, and building again makes the dataset."""
    assert histograms(root).items() <= histograms(due).items(), where
    whole_build(root)
    assert verify(root, deep=True).problems == () and dataset_digest(root) == dataset_digest(due), where
    assert not list(root.rglob("*.running")), where


@pytest.mark.parametrize(
    "steps",
    [range(20, 400, 100), pytest.param(range(400), marks=pytest.mark.nightly)],
    ids=["some steps", "every step"],
)
def test_a_kill_between_any_two_steps_loses_nothing(tmp_path: Path, due: Path, steps: range) -> None:
    kills = 0
    for step in steps:
        root = tmp_path / str(step)
        if not killed_at(step, lambda root=root: whole_build(root)):  # type: ignore[misc]
            break
        kills += 1
        resumes(root, due, f"killed at step {step}")
        shutil.rmtree(root)
    assert kills >= min(3, len(steps)) and step < 399, "the steps ran out before the build did"


@pytest.mark.parametrize(
    "steps",
    [range(30, 400, 120), pytest.param(range(400), marks=pytest.mark.nightly)],
    ids=["some steps", "every step"],
)
def test_a_kill_while_a_dataset_is_mended_loses_nothing(tmp_path: Path, due: Path, steps: range) -> None:
    """A scene is tried anew, a damaged shard is made again and a lost dataset.json restored."""
    harmed = tmp_path / "harmed"
    with pytest.raises(CheckError):
        build(CONFIG, harmed, progress=False, sample_function=fails_at_5)
    (harmed / "dataset.json").unlink()
    (harmed / "data.zarr/histogram/c/0/0/0/0").write_bytes(b"")
    for step in steps:
        root = shutil.copytree(harmed, tmp_path / "set")
        if not killed_at(step, lambda root=root: whole_build(root)):  # type: ignore[misc]
            break
        resumes(root, due, f"killed at step {step}")
        shutil.rmtree(root)
    assert step < 399, "the steps ran out before the build did"
