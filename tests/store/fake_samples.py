"""Sample functions that stand in for the simulation: quick, a function of (seed, index), and some that misbehave."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from datagen.building.build import BuildResult, build
from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.records import Sample
from datagen.seeding import Purpose, generator
from datagen.store import read_manifest, reader, schema_of
from datagen.store.arrays import shard_file


def small_config(**changes: object) -> DatasetConfig:
    """12 scenes of 2 × 2 laser points and 16 bins, shards of 4."""
    values = {
        "name": "small",
        "seed": 3,
        "scenes": 12,
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 16}},
        "labels": {"rows": 4, "columns": 5},
        "store": {"fields": ["histogram", "transient", "depth"], "scenes_per_shard": 4},
    }
    return config_from_mapping(values | changes)


def noisy_config(**detector: Any) -> DatasetConfig:
    """`small_config` with a detector whose noise can be drawn anew."""
    return small_config(detector={"mode": "ideal", "photons_per_pulse": 100.0, "cycles": 100} | detector)


def sequence_config(**changes: object) -> DatasetConfig:
    """`small_config` of sequences of three frames."""
    detector = {"mode": "ideal", "photons_per_pulse": 100.0, "cycles": 100}
    return small_config(**{"sequence": {"frames": 3, "rate_hz": 10}, "detector": detector} | changes)


EITHER = pytest.mark.parametrize(
    "pristine", [small_config, sequence_config], ids=["scenes", "sequences"], indirect=True
)
"""For tests of what holds of scenes that are measured once and of sequences alike."""


def large_config() -> DatasetConfig:
    """`small_config` with 4096 bins: a shard of transients is larger than any other file."""
    return small_config(capture={"scan": {"rows": 2, "columns": 2}, "time": {"bins": 4096}})


def build_fakes(config: DatasetConfig, root: str | Path, workers: int = 1, **options: Any) -> BuildResult:
    """Build silently, by `fake_sample` unless `options` name another sample function."""
    return build(config, root, workers, **{"progress": False, "sample_function": fake_sample} | options)


def fake_sample(config: DatasetConfig, index: int) -> Sample:
    rng = generator(config.seed, index, Purpose.SCENE)
    arrays: dict[str, np.ndarray] = {}
    for field in schema_of(config).fields:
        counts = np.dtype(field.dtype).kind in "ui"
        arrays[field.name] = rng.poisson(0.7, field.shape) if counts else rng.random(field.shape)
    parameters = {"box.width_m": float(rng.random()), "kind": "box" if index % 2 else "mesh", "index": index}
    return Sample(index, arrays, parameters, {"scene": 0.001 * index, "transport": 0.002})


def changed_at_5(change: Callable[[Sample], Any]) -> Callable[[DatasetConfig, int], Any]:
    """A sample function whose fifth sample is what `change` returns."""

    def sample(config: DatasetConfig, index: int) -> Any:
        made = fake_sample(config, index)
        return change(made) if index == 5 else made

    return sample


def fails_at_5(config: DatasetConfig, index: int) -> Sample:
    if index == 5:
        raise ValueError("no room\nfor the box")
    return fake_sample(config, index)


def always_fails(config: DatasetConfig, index: int) -> Sample:
    raise InputError(f"scene {index}: impossible")


def dies_at_5(config: DatasetConfig, index: int) -> Sample:
    if index == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return fake_sample(config, index)


def dies_once_at_5(config: DatasetConfig, index: int) -> Sample:
    """Dies over scene 5 the first time. The description of the configuration names a file, to which each scene that
    is begun adds a line."""
    begun = Path(config.description)
    with begun.open("a") as file:
        file.write(f"{index}\n")
    if begun.read_text().split().count("5") == 1 and index == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return fake_sample(config, index)


def waits_for_another(config: DatasetConfig, index: int) -> Sample:
    """Waits for a second process; the description of the configuration names the folder where they meet."""
    folder = Path(config.description)
    (folder / f"{os.getpid()}.pid").touch()
    deadline = time.monotonic() + 60.0
    while len(list(folder.glob("*.pid"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    return fake_sample(config, index)


def hangs_at_5(config: DatasetConfig, index: int) -> Sample:
    while index == 5:
        with suppress(Exception):
            time.sleep(3600)
    return fake_sample(config, index)


def deaf_at_5(config: DatasetConfig, index: int) -> Sample:
    """Hangs where no signal is answered, as compiled code does."""
    if index == 5:
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGALRM])
        time.sleep(3600)
    return fake_sample(config, index)


def file_of(dataset: Path, field: str, shard: int) -> Path:
    """The file of a shard of a field."""
    return dataset / shard_file(read_manifest(dataset).schema.by_name[field], shard)


def decoded_from_now(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The bytes of each block that readers decode after this call; the list grows."""
    sizes, decompress = list[int](), reader.blosc.decompress

    def counting(frame: bytes, out: np.ndarray) -> None:
        sizes.append(out.nbytes)
        decompress(frame, out)

    monkeypatch.setattr(reader.blosc, "decompress", counting)
    return sizes
