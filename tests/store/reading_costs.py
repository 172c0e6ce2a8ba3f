"""Costs of reading: `python tests/store/reading_costs.py` prints what reading and checking costs.

Processor milliseconds, medians over samples and epochs: checks of a sample of 1024 × 512 counts, and parts of a
sample of 64 × 64 × 1024 counts (3 % of bins filled).
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from datasets import write_dataset

import datagen as dg
from datagen.config import DatasetConfig, config_from_mapping
from datagen.records import Sample
from datagen.store import DatasetReader, read_manifest, reader, schema_of, verify
from datagen.store.record import read_record

EPOCHS = 5
PARTS: dict[str, dict[str, Any]] = {
    "whole": {},
    "rows and columns 24 … 39": {"lasers": np.s_[24:40, 24:40]},
    "every second row and column": {"lasers": np.s_[::2, ::2]},
    "64 laser points anywhere": {"lasers": np.sort(np.random.default_rng(0).permutation(4096)[:64])},
    "one laser point": {"lasers": [2080]},
    "bins 256 … 511": {"bins": slice(256, 512)},
}


def dataset(root: Path, scenes: int, side: int, bins: int, mean: float) -> Path:
    """A dataset of a confocal scan of side × side points, with Poisson counts of this mean."""

    def sample(config: DatasetConfig, index: int) -> Sample:
        rng = np.random.default_rng(index)
        arrays = {
            field.name: rng.poisson(mean, field.shape) if "u" in field.dtype else rng.random(field.shape)
            for field in schema_of(config).fields
        }
        return Sample(index, arrays, {f"parameter.{k}": k / 3 for k in range(100)}, {"scene": 1.0})

    capture = {"scan": {"rows": side, "columns": side}, "time": {"bins": bins}}
    store = {"fields": ["histogram"], "scenes_per_shard": 64}
    return write_dataset(config_from_mapping({"scenes": scenes, "capture": capture, "store": store}), root, sample)


def milliseconds(call: Callable[[int], object], times: int) -> float:
    """The median of several calls, whose argument is their number."""
    taken = []
    for turn in range(times):
        began = time.process_time()
        call(turn)
        taken.append(1e3 * (time.process_time() - began))
    return statistics.median(taken)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = dataset(Path(folder) / "checks", 128, 32, 512, 0.2)
        manifest = read_manifest(root)
        seen = {"histogram": np.zeros(128, bool)}
        for what, check in (("without digests", False), ("first read", True), ("later reads", True)):
            reading = DatasetReader(root, manifest, ["histogram"], check, seen)
            taken = milliseconds(lambda i, of=reading: of.read("histogram", [i]), 128)
            print(f"{what:20}{taken:8.2f} ms a MiB")
        taken = milliseconds(lambda i: read_record(root, i % 2, True), 40)
        print(f"{'commit record':20}{taken:8.2f} ms a shard of 64")
        for deep in (False, True):
            taken = milliseconds(lambda _, deep=deep: verify(root, deep), 3)
            print(f"{'verify --deep' if deep else 'verify':20}{taken:8.0f} ms for 128 samples")
        root = dataset(Path(folder) / "parts", 48, 64, 1024, 0.03)
        # Room for the indices of shards, and for no value.
        reader.MEMORY_BYTES = 2**14
        for name, crop in PARTS.items():
            data = dg.TransientDataset(root, ("histogram",), counts="stored", **crop)
            first, *later = [
                milliseconds(partial(dg.TransientDataset.__getitem__, data), 48) for _ in range(1 + EPOCHS)
            ]
            print(f"{name:30}{first:8.1f} ms, read again {statistics.median(later):8.1f}")


if __name__ == "__main__":
    main()
