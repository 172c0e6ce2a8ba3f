"""Datasets of all formats stay readable: those that are stored here are read as they were written.

`format_N/dataset` was built from `format_N/config.yaml`, and `format_N/values.json` has what zarr reads in it
(`tools/make_format.py`). Format 2 is that of sequences; its sensor moves.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from tools.make_format import Kept
from torch.utils.data import DataLoader

import datagen as dg
from datagen.formats import export
from datagen.loader import collate
from datagen.store import read_manifest, verify
from datagen.store.info import info
from datagen.store.scenes import Scenes
from datagen.store.schema import FORMAT, FORMAT_OF_SEQUENCES
from datagen.store.verify import dataset_digest

BOTH = [Kept(FORMAT), Kept(FORMAT_OF_SEQUENCES)]
SHAPES = {1: (6, 1, 64), 2: (4, 6, 1, 64)}
"""Of a scene's counts."""
CLASSES = {1: ("cone", "sphere"), 2: ("box", "cone", "sphere")}
MEMORIES = pytest.mark.parametrize("memory", [0, 2**26], ids=["from shards", "in memory"])


@pytest.fixture(params=BOTH, ids=["one", "sequences"])
def kept(request: pytest.FixtureRequest) -> Kept:
    one: Kept = request.param
    return one


def sums_of(kept: Kept) -> dict[str, list[float]]:
    sums: dict[str, list[float]] = json.loads(kept.values.read_text())["sums"]
    return sums


def test_it_is_as_it_was_written(kept: Kept) -> None:
    assert json.loads((kept.dataset / "dataset.json").read_text())["format"] == kept.format
    found = verify(kept.dataset, deep=True)
    assert (found.scenes, found.shards, found.problems) == (3, 2, ())
    assert dataset_digest(kept.dataset) == json.loads(kept.values.read_text())["digest"]
    assert "scenes       3 of 3" in info(kept.dataset)


@MEMORIES
def test_a_batch_holds_the_values_that_were_written(kept: Kept, memory: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("datagen.store.reader.MEMORY_BYTES", memory)
    sums = sums_of(kept)
    data = dg.TransientDataset(kept.dataset, fields=tuple(sums), counts="stored")
    (batch,) = DataLoader(data, batch_size=3, collate_fn=collate)
    for name, due in sums.items():
        magnitudes = np.abs(batch[name].numpy().astype(np.float64)).reshape(3, -1)
        assert np.allclose(magnitudes.sum(axis=1), due, rtol=1e-12, atol=0), name
    assert batch["histogram"].dtype == torch.uint16 and batch["histogram"].shape == (3, *SHAPES[kept.format])
    assert data.classes == CLASSES[kept.format]
    assert data.stats["histogram"]["nonzero"] > 0 and len(data.parameters("evidence.weakest")) == 3


@MEMORIES
def test_windows_of_its_frames_are_those_that_were_written(memory: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows of one frame: each frame once. What has no axis of frames comes with each of them."""
    monkeypatch.setattr("datagen.store.reader.MEMORY_BYTES", memory)
    kept = Kept(FORMAT_OF_SEQUENCES)
    sums = sums_of(kept)
    data = dg.TransientDataset(kept.dataset, fields=tuple(sums), counts="stored", frames=1)
    (batch,) = DataLoader(data, batch_size=12, collate_fn=collate)
    assert batch["scene"].tolist() == [0] * 4 + [1] * 4 + [2] * 4 and batch["frame"].tolist() == [0, 1, 2, 3] * 3
    for name, due in sums.items():
        each_frame = read_manifest(kept.dataset).schema.by_name[name].frame_bytes is not None
        magnitudes = np.abs(batch[name].numpy().astype(np.float64)).reshape(3, -1).sum(axis=1)
        assert np.allclose(magnitudes / (1 if each_frame else 4), due, rtol=1e-12, atol=0), name
        # Sums would not notice frames that are exchanged.
        whole = Scenes(kept.dataset).read(1).arrays[name]
        assert all(np.array_equal(batch[name][4 + f], whole[f : f + 1] if each_frame else whole) for f in range(4))


def test_its_files_hold_what_was_written(kept: Kept, tmp_path: Path) -> None:
    for scene, path in enumerate(export(kept.dataset, tmp_path, "npz")):
        with np.load(path) as file:
            for name, due in sums_of(kept).items():
                assert np.isclose(np.abs(file[name].astype(np.float64)).sum(), due[scene], rtol=1e-12, atol=0), name
    files = export(kept.dataset, tmp_path, "tal")
    assert len(files) == (3 if kept.format == FORMAT else 12)


def test_its_noise_can_be_drawn_anew(kept: Kept) -> None:
    counts = sum(sums_of(kept)["histogram"])
    data = dg.TransientDataset(kept.dataset, fields=("histogram",), redraw_noise=True)
    totals = [sum(float(item["histogram"].sum()) for item in data.__getitems__(range(3))) for _ in range(5)]
    # Five standard errors of the mean of 5 draws.
    assert abs(np.mean(totals) - counts) < 5 * np.sqrt(counts * (1 + 1 / 5))
    assert np.ptp(totals) > 0
