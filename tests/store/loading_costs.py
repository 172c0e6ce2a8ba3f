"""What parts of a sample cost to read: `python tests/store/loading_costs.py` prints the table of docs/datasets.md.
48 samples of 64 × 64 × 1024 counts, 3 % of bins filled, medians over samples and epochs.
"""

from __future__ import annotations

import itertools
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from datasets import write_dataset

import datagen as dg
from datagen.config import DatasetConfig, config_from_mapping
from datagen.records import Sample
from datagen.store import reader, schema_of

SCENES, EPOCHS = 48, 5
PARTS: dict[str, dict[str, Any]] = {
    "whole": {},
    "rows and columns 24 … 39": {"lasers": np.s_[24:40, 24:40]},
    "every second row and column": {"lasers": np.s_[::2, ::2]},
    "64 laser points anywhere": {"lasers": np.sort(np.random.default_rng(0).permutation(4096)[:64])},
    "one laser point": {"lasers": [2080]},
    "bins 256 … 511": {"bins": slice(256, 512)},
}


def sample(config: DatasetConfig, index: int) -> Sample:
    rng = np.random.default_rng(index)
    arrays = {
        field.name: rng.poisson(0.03, field.shape) if "u" in field.dtype else rng.random(field.shape)
        for field in schema_of(config).fields
    }
    return Sample(index, arrays, {"index": index}, {})


def main() -> None:
    config = config_from_mapping({
        "scenes": SCENES,
        "capture": {"scan": {"rows": 64, "columns": 64}, "time": {"bins": 1024}},
        "store": {"fields": ["histogram"]},
    })  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        root = write_dataset(config, Path(folder) / "set", sample)
        # Room for the indices of shards, and for no value.
        reader.MEMORY_BYTES = 2**14
        for name, crop in PARTS.items():
            data = dg.TransientDataset(root, ("histogram",), counts="stored", **crop)
            first, *later = [statistics.median(milliseconds(data)) for _ in range(1 + EPOCHS)]
            print(f"{name:30}{first:8.1f} processor ms, read again {statistics.median(later):8.1f}")


def milliseconds(data: dg.TransientDataset) -> list[float]:
    """Of the processor, for each sample by itself."""
    taken = [time.process_time()]
    for item in range(len(data)):
        data[item]
        taken.append(time.process_time())
    return [1e3 * (b - a) for a, b in itertools.pairwise(taken)]


if __name__ == "__main__":
    main()
