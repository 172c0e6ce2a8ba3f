"""Make the small dataset of a format that `test_format.py` reads: `python tests/tools/make_format.py NUMBER`.

It is made once for each number of the format, and again only where the number has not been released yet. The values
beside it are read by zarr, not by datagen's own reader.
"""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from datagen.building.build import build
from datagen.config import DatasetConfig, load_config
from datagen.pipeline import simulate_sample
from datagen.records import Sample
from datagen.store.verify import dataset_digest

FORMATS = Path(__file__).resolve().parents[1] / "regression"


@dataclass(frozen=True)
class Kept:
    """The files of a format: what it was built from, the dataset, and what zarr read in it."""

    format: int

    @property
    def folder(self) -> Path:
        return FORMATS / f"format_{self.format}"

    @property
    def config(self) -> Path:
        return self.folder / "config.yaml"

    @property
    def dataset(self) -> Path:
        return self.folder / "dataset"

    @property
    def values(self) -> Path:
        return self.folder / "values.json"


def values_of(dataset: Path) -> dict[str, Any]:
    """`digest` of the dataset, and field → sum of the magnitudes of each scene's values."""
    group = zarr.open_group(dataset / "data.zarr", mode="r")
    fields = {name: array for name, array in group.arrays() if array.metadata.dimension_names[0] == "scene"}
    sums = {
        name: np.abs(np.asarray(array[:], np.float64)).reshape(array.shape[0], -1).sum(axis=1).tolist()
        for name, array in sorted(fields.items())
    }
    return {"digest": dataset_digest(dataset), "sums": sums}


def with_few_parameters(config: DatasetConfig, index: int) -> Sample:
    """Scene `index` with the parameters that reading needs; all 150 would make two thirds of the files' bytes."""
    sample = simulate_sample(config, index)
    needed = ("detector.", "exposure.", "evidence.", "layout.", "scene.")
    few = {name: value for name, value in sample.parameters.items() if name.startswith(needed)}
    return replace(sample, parameters=few)


def main(number: int) -> None:
    kept = Kept(number)
    shutil.rmtree(kept.dataset, ignore_errors=True)
    build(load_config(kept.config), kept.dataset, progress=False, sample_function=with_few_parameters)
    kept.values.write_text(json.dumps(values_of(kept.dataset), indent=1) + "\n")


if __name__ == "__main__":
    main(int(sys.argv[1]))
