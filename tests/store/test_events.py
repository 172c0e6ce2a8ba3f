"""Samples as events, the indices and counts of filled bins, and back."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from datasets import write_dataset
from fake_samples import fake_sample, noisy_config, sequence_config
from torch.utils.data import ConcatDataset, DataLoader, Subset

import datagen as dg
from datagen.config import DatasetConfig
from datagen.errors import InputError
from datagen.loader.events import events_of
from datagen.records import Sample


def one_dark(config: DatasetConfig, index: int) -> Sample:
    """A `fake_sample`; that of scene 3 has no counts."""
    sample = fake_sample(config, index)
    if index == 3:
        dark = {**sample.arrays, "histogram": np.zeros_like(sample.arrays["histogram"])}
        sample = dataclasses.replace(sample, arrays=dark)
    return sample


@pytest.fixture(scope="module", params=[noisy_config, sequence_config], ids=["scenes", "sequences"])
def dataset(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(request.param(), tmp_path_factory.mktemp("events") / "set", one_dark)


@pytest.mark.parametrize(("counts", "dtype", "workers"), [("stored", torch.uint16, 2), ("int64", torch.int64, 0)])
def test_events_are_the_histograms(dataset: Path, counts: str, dtype: torch.dtype, workers: int) -> None:
    whole = next(iter(DataLoader(dg.TransientDataset(dataset), 12)))
    data = dg.TransientDataset(dataset, representation="events", counts=counts)
    joined: ConcatDataset[Any] = ConcatDataset([Subset(data, [0, 1, 2]), Subset(data, range(3, 12))])
    for parts in (data, joined):
        loader: DataLoader[Any] = DataLoader(
            parts, 12, collate_fn=dg.collate, num_workers=workers, multiprocessing_context="fork" if workers else None
        )
        (batch,) = loader
        assert set(batch) == {"events", "counts", "depth", "scene"}
        assert batch["events"].dtype == torch.int16 and batch["counts"].dtype == dtype
        assert batch["counts"].long().min() > 0 and len(batch["events"]) == int((whole["histogram"] > 0).sum())
        back = dg.dense(batch["events"], batch["counts"], (12, *data.shape("histogram")))
        assert back.dtype == torch.float32 and torch.equal(back, whole["histogram"])
        assert torch.equal(batch["depth"], whole["depth"])


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.uint32, np.int64])
@pytest.mark.parametrize(
    "shape", [(2, 3, 1, 5), (1, 1, 1, 40_000), (3, 1, 2, 1), (2, 70, 70, 70), (2, 5, 3, 64), (0, 5, 3, 64)]
)
def test_indices_are_numpys(shape: tuple[int, ...], dtype: type[np.integer[Any]]) -> None:
    """Also for axes of every length, and without any histogram."""
    histograms = np.random.default_rng(0).poisson(0.1, shape).astype(dtype)
    histograms[..., -1:] *= np.iinfo(dtype).max // 4
    events, counts = events_of(histograms)
    assert events.dtype == (np.int32 if max(shape) > 32767 else np.int16)
    assert np.array_equal(events, np.argwhere(histograms)) and np.array_equal(counts, histograms[histograms > 0])


def test_an_item_has_its_own_events(dataset: Path) -> None:
    data, stored = dg.TransientDataset(dataset, representation="events"), dg.TransientDataset(dataset)
    shape = stored.shape("histogram")
    for item in (*range(12), -1):
        sample = data[item]
        assert sample["events"].shape == (len(sample["counts"]), len(shape))
        assert torch.equal(dg.dense(sample["events"], sample["counts"], shape), stored[item]["histogram"])
    assert data[3]["events"].shape == (0, len(shape)), "a scene without a count"
    assert len(data.__getitems__([3, 3])) == 2


def test_wrong_representations_and_shapes_are_refused(dataset: Path) -> None:
    with pytest.raises(InputError, match="representation = 'sparse': must be one of dense, events, volume"):
        dg.TransientDataset(dataset, representation="sparse")
    events, counts = torch.zeros((5, 4), dtype=torch.int32), torch.ones(5)
    for shape, n in (((4, 1, 16), 5), ((1, 4, 1, 16), 4)):
        with pytest.raises(InputError, match="a size for each axis"):
            dg.dense(events, counts[:n], shape)
