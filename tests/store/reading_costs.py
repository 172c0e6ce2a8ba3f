"""What checking costs when a dataset is read: `python tests/store/reading_costs.py` prints the figures of
docs/datasets.md. Processor milliseconds, medians over reads of one sample of 1024 × 512 counts.
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from datasets import write_dataset

from datagen.config import DatasetConfig, config_from_mapping
from datagen.records import Sample
from datagen.store import DatasetReader, read_manifest, schema_of, verify
from datagen.store.record import read_record

SCENES = 128
MEAN = 0.2


def sample(config: DatasetConfig, index: int) -> Sample:
    rng = np.random.default_rng(index)
    arrays = {
        field.name: rng.poisson(MEAN, field.shape) if "u" in field.dtype else rng.random(field.shape)
        for field in schema_of(config).fields
    }
    return Sample(index, arrays, {f"parameter.{k}": k / 3 for k in range(100)}, {"scene": 1.0})


def milliseconds(call: Callable[[int], object], times: int) -> float:
    taken = []
    for turn in range(times):
        began = time.process_time()
        call(turn)
        taken.append(1e3 * (time.process_time() - began))
    return statistics.median(taken)


def main() -> None:
    config = config_from_mapping({
        "scenes": SCENES,
        "capture": {"scan": {"rows": 32, "columns": 32}, "time": {"bins": 512}},
        "store": {"fields": ["histogram"], "scenes_per_shard": 64},
    })  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        root = write_dataset(config, Path(folder) / "set", sample)
        manifest = read_manifest(root)
        seen = {"histogram": np.zeros(SCENES, bool)}
        for what, check in (("without digests", False), ("first read", True), ("later reads", True)):
            reader = DatasetReader(root, manifest, ["histogram"], check, seen)
            taken = milliseconds(lambda i, reader=reader: reader.read("histogram", [i]), SCENES)
            print(f"{what:20}{taken:8.2f} ms a MiB")
        taken = milliseconds(lambda i: read_record(root, i % 2, True), 40)
        print(f"{'commit record':20}{taken:8.2f} ms a shard of 64")
        for deep in (False, True):
            taken = milliseconds(lambda _, deep=deep: verify(root, deep), 3)
            print(f"{'verify --deep' if deep else 'verify':20}{taken:8.0f} ms for {SCENES} samples")


if __name__ == "__main__":
    main()
