"""Make the small dataset of format 1 that `test_format.py` reads: `python tests/regression/make_format_1.py`.

It is made once for each number of the format, and again only where the number has not been released yet. The values
beside it are read by zarr, not by datagen's own reader.
"""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from datagen.building.build import build
from datagen.config import DatasetConfig, load_config
from datagen.pipeline import simulate_sample
from datagen.records import Sample
from datagen.store.verify import dataset_digest

FOLDER = Path(__file__).parent / "format_1"
DATASET, VALUES = FOLDER / "dataset", FOLDER / "values.json"


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


def main() -> None:
    shutil.rmtree(DATASET, ignore_errors=True)
    config = load_config(FOLDER / "config.yaml")
    build(config, DATASET, progress=False, sample_function=with_few_parameters)
    VALUES.write_text(json.dumps(values_of(DATASET), indent=1) + "\n")


if __name__ == "__main__":
    main()
