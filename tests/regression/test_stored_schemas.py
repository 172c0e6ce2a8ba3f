"""A dataset of every earlier schema version is read by today's code as it was written.

`schema_N/dataset` was built from `schema_N/config.yaml` by the commit that its `dataset.json` names, and is never
written again; `schema_N/sums.json` has the sum of magnitudes of each field of each scene, as its own code read them.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import datagen as dg
from datagen.errors import InputError
from datagen.loader import collate
from datagen.report.pages import show
from datagen.report.preview import preview
from datagen.store import read_manifest, verify
from datagen.store.info import info
from datagen.store.schema import SCHEMA_VERSION, SCHEMA_VERSIONS

HERE = Path(__file__).parent
ONE = HERE / "schema_1" / "dataset"
EARLIER = {version: HERE / f"schema_{version}" / "dataset" for version in range(1, SCHEMA_VERSION)}


def sampler_column(version: int) -> str:
    """Where each version keeps the sampler of the detector."""
    return "detector_plan.sampler" if version == 1 else "sampler.name"


def sums(version: int) -> dict[str, list[float]]:
    found: dict[str, list[float]] = json.loads((EARLIER[version].parent / "sums.json").read_text())
    return found


every_version = pytest.mark.parametrize("version", EARLIER)


def test_every_earlier_version_has_its_dataset() -> None:
    for version, dataset in EARLIER.items():
        assert read_manifest(dataset).schema_version == version
    assert sorted(SCHEMA_VERSIONS) == list(range(1, SCHEMA_VERSION + 1))


@every_version
def test_it_is_as_it_was_written(version: int) -> None:
    found = verify(EARLIER[version], deep=True)
    assert (found.scenes, found.shards, found.problems) == (3, 2, ())


@every_version
@pytest.mark.parametrize("memory", [0, 2**26], ids=["from shards", "in memory"])
def test_a_batch_holds_the_values_of_then(memory: int, version: int, monkeypatch: pytest.MonkeyPatch) -> None:
    expected_sums = sums(version)
    monkeypatch.setattr("datagen.store.reader.MEMORY_BYTES", memory)
    data = dg.TransientDataset(EARLIER[version], fields=tuple(expected_sums), counts="stored")
    assert data.fields == tuple(expected_sums) and data.classes == ("box", "cone", "sphere")
    (batch,) = DataLoader(data, batch_size=3, collate_fn=collate)
    for name, expected in expected_sums.items():
        magnitudes = np.abs(batch[name].numpy().astype(np.float64)).reshape(3, -1)
        assert np.allclose(magnitudes.sum(axis=1), expected, rtol=2e-8, atol=0), name
    assert batch["histogram"].dtype == torch.uint16 and batch["histogram"].shape == (3, 6, 1, 64)
    assert data.parameters(sampler_column(version)).tolist() == ["return_chain"] * 3


@every_version
def test_its_noise_can_be_drawn_anew(version: int) -> None:
    counts = sum(sums(version)["histogram"])
    data = dg.TransientDataset(EARLIER[version], fields=("histogram",), redraw_noise=True)
    totals = []
    for epoch in range(5):
        data.set_epoch(epoch)
        totals.append(sum(float(item["histogram"].sum()) for item in data.__getitems__(range(3))))
    # Five standard errors of the mean of 5 draws.
    assert abs(np.mean(totals) - counts) < 5 * np.sqrt(counts * (1 + 1 / 5))
    assert np.ptp(totals) > 0


def test_it_can_be_described_and_shown(tmp_path: Path) -> None:
    assert "made by      datagen 0.1.0, schema 1" in info(ONE)
    assert all(picture.is_file() for picture in show(ONE, 1, tmp_path / "show"))
    page = preview(ONE, tmp_path / "one.html", scenes=1).read_text()
    assert "schema_1" in page and "image/png" in page


def test_nothing_is_built_into_it(tmp_path: Path) -> None:
    shutil.copytree(ONE, tmp_path / "set")
    with pytest.raises(InputError, match=r"schema version 1, .*build into a new folder") as refused:
        dg.build(dg.load_config("configs/quickstart.yaml"), tmp_path / "set", progress=False)
    assert "\n" not in str(refused.value)
    assert verify(tmp_path / "set").problems == ()
