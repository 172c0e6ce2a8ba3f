"""Datasets of format 1 stay readable: one that is stored here is read as it was written.

`format_1/dataset` was built from `format_1/config.yaml`, and `format_1/values.json` has what zarr reads in it
(`make_format_1.py`).
"""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from make_format_1 import DATASET, VALUES
from torch.utils.data import DataLoader

import datagen as dg
from datagen.loader import collate
from datagen.store import verify
from datagen.store.info import info
from datagen.store.schema import FORMAT
from datagen.store.verify import dataset_digest

KEPT = json.loads(VALUES.read_text())
SUMS: dict[str, list[float]] = KEPT["sums"]


def test_it_is_as_it_was_written() -> None:
    assert json.loads((DATASET / "dataset.json").read_text())["format"] == FORMAT == 1
    found = verify(DATASET, deep=True)
    assert (found.scenes, found.shards, found.problems) == (3, 2, ())
    assert dataset_digest(DATASET) == KEPT["digest"]
    assert "scenes       3 of 3" in info(DATASET)


@pytest.mark.parametrize("memory", [0, 2**26], ids=["from shards", "in memory"])
def test_a_batch_holds_the_values_that_were_written(memory: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("datagen.store.reader.MEMORY_BYTES", memory)
    data = dg.TransientDataset(DATASET, fields=tuple(SUMS), counts="stored")
    (batch,) = DataLoader(data, batch_size=3, collate_fn=collate)
    for name, due in SUMS.items():
        magnitudes = np.abs(batch[name].numpy().astype(np.float64)).reshape(3, -1)
        assert np.allclose(magnitudes.sum(axis=1), due, rtol=1e-12, atol=0), name
    assert batch["histogram"].dtype == torch.uint16 and batch["histogram"].shape == (3, 6, 1, 64)
    assert data.classes == ("cone", "sphere")
    assert data.stats["histogram"]["nonzero"] > 0 and len(data.parameters("evidence.weakest")) == 3


def test_its_noise_can_be_drawn_anew() -> None:
    counts = sum(SUMS["histogram"])
    data = dg.TransientDataset(DATASET, fields=("histogram",), redraw_noise=True)
    totals = [sum(float(item["histogram"].sum()) for item in data.__getitems__(range(3))) for _ in range(5)]
    # Five standard errors of the mean of 5 draws.
    assert abs(np.mean(totals) - counts) < 5 * np.sqrt(counts * (1 + 1 / 5))
    assert np.ptp(totals) > 0
