"""Datasets written in this process, without workers, and changed as if they had been written so."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np

from datagen.config import DatasetConfig
from datagen.pipeline import simulate_sample
from datagen.records import Sample
from datagen.store import finish, prepare, read_manifest, write_shard
from datagen.store.scenes import Scenes


def write_dataset(
    config: DatasetConfig, root: Path, sample: Callable[[DatasetConfig, int], Sample] = simulate_sample
) -> Path:
    """The whole dataset of a configuration; returns its folder."""
    manifest = prepare(root, config)
    for shard in range(manifest.schema.shards):
        samples = ((index, sample(config, index)) for index in manifest.schema.scenes_of(shard))
        write_shard(root, manifest.schema, shard, manifest.fingerprint, samples)
    finish(root, manifest)
    return root


def rewritten(source: Path, root: Path, scene: int, **arrays: np.ndarray) -> Path:
    """A copy of a dataset in which one scene has other arrays; files, record, table and cards fit what it holds."""
    shutil.copytree(source, root)
    manifest, scenes = read_manifest(root), Scenes(source)
    shard = scene // manifest.schema.scenes_per_shard
    samples = []
    for index in manifest.schema.scenes_of(shard):
        content = scenes.read(index)
        exchanged = arrays if index == scene else {}
        samples.append((index, Sample(index, {**content.arrays, **exchanged}, content.parameters, {})))
    write_shard(root, manifest.schema, shard, manifest.fingerprint, samples)
    finish(root, manifest)
    return root
