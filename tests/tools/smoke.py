"""`make smoke`: one tiny scene through the whole house, from its configuration to a training batch, in seconds.

The light is that of the definition (`datagen/transport/reference.py`), so that nothing which makes it fast is needed;
counts, labels, shards, verification and loader are those of every dataset. Exit status 1 where they disagree.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from datasets import write_dataset
from numpy.typing import NDArray

import datagen as dg
from datagen.config import config_from_mapping
from datagen.pipeline import SceneLight, Setup, sample_from
from datagen.records import Sample
from datagen.store import verify
from datagen.transport.reference import reference

CONFIG = {
    "name": "smoke",
    "scenes": 2,
    "seed": 1,
    "scene": {"layout": {"kind": "isolated_wall"}, "contents": [{"kind": "box"}]},
    "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 400}},
    "detector": {"mode": "ideal", "photons_per_pulse": 1e9, "cycles": 10**6},
    "labels": {"rows": 4, "columns": 4},
    "store": {"fields": ["histogram", "transient", "depth"], "scenes_per_shard": 1},
}
FIELDS = ("histogram", "transient", "depth")
SAMPLES = 1024
"""Paths for each laser point and pixel; with half as many the histograms would still not be empty."""


def simulated(config: dg.DatasetConfig, index: int) -> Sample:
    """Sample `index`, whose light is that of the definition."""
    scene = dg.scene_for(config, index)
    capture = dg.capture_for(config, scene, config.seed, index)
    light = reference(scene, capture, max_bounces=3, samples=SAMPLES, replicates=2, seed=config.seed)
    return sample_from(Setup.of(config, index, scene, capture), SceneLight(light))


def loaded(root: Path) -> list[dict[str, NDArray[np.generic]]]:
    """Field → values of each scene, as a training batch has them."""
    data = dg.TransientDataset(root, FIELDS, counts="stored")
    batch = dg.collate(data.__getitems__(range(len(data))))
    return [{name: batch[name][scene].numpy() for name in FIELDS} for scene in range(len(data))]


def main() -> int:
    """Build, verify and load the dataset; returns the exit status."""
    began = time.monotonic()
    config = config_from_mapping(CONFIG)
    samples = [simulated(config, index) for index in range(config.scenes)]
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "smoke.zarr"
        write_dataset(config, root, lambda _, index: samples[index])
        problems = list(verify(root, deep=True).problems)
        items = loaded(root)
    for index, (sample, item) in enumerate(zip(samples, items, strict=True)):
        if not sample.arrays["histogram"].any():
            problems.append(f"scene {index}: no counts")
        for name, value in item.items():
            if not np.array_equal(value, sample.arrays[name].astype(value.dtype)):
                problems.append(f"scene {index}: {name} was loaded otherwise than it was made")
    for problem in problems:
        print(f"smoke: {problem}", file=sys.stderr)
    counts = sum(int(sample.arrays["histogram"].sum()) for sample in samples)
    print(f"smoke: {config.scenes} scenes, {counts} counts, {time.monotonic() - began:.1f} s")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
