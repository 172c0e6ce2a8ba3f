"""Datasets written in this process, without workers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from datagen.config import DatasetConfig
from datagen.pipeline import simulate_sample
from datagen.records import Sample
from datagen.store import finish, prepare, write_shard


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
