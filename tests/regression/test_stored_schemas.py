"""A dataset of every earlier schema version is read by today's code as it was written.

`schema_N/dataset` was built from `schema_N/config.yaml` by the commit that its `dataset.json` names, and is never
written again.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import datagen as dg
from datagen.errors import InputError
from datagen.loader import collate
from datagen.report.preview import preview
from datagen.report.show import show
from datagen.store import read_manifest, verify
from datagen.store.info import info
from datagen.store.schema import SCHEMA_VERSION, SCHEMA_VERSIONS

HERE = Path(__file__).parent
ONE = HERE / "schema_1" / "dataset"

SUMS = {
    "histogram": (1396, 1909, 1216),
    "transient": (4.76071041e-10, 6.56533251e-10, 4.2354657e-10),
    "transient_stderr": (4.61102282e-11, 9.08109029e-11, 4.60155357e-11),
    "depth": (3.0404945, 2.58751526, 0.696780503),
    "normal": (4.55767316, 6.29749247, 1.6077283),
    "part_id": (51, 56, 49),
    "occupancy": (7, 18, 8),
    "sdf": (80.0478857, 61.1440154, 100.503184),
    "object_count": (1, 2, 1),
    "object_class": (2, 1, 2),
    "object_part": (3, 5, 3),
    "object_box_center": (1.81485301, 4.53126657, 2.07140267),
    "object_box_size": (2.29746068, 4.05476364, 2.05772746),
    "object_box_rotation": (3.61223924, 6.07003646, 3.50892293),
    "laser_points": (26.8233906, 33.9922044, 29.6755436),
    "sensor_pixels": (107.293562, 135.968818, 118.702174),
    "laser_position": (0.938147358, 0.865437744, 0.863162256),
    "sensor_position": (0.938147358, 0.865437744, 0.863162256),
    "relay_wall": (6.20173218, 7.60013191, 6.91576962),
    "hidden_view": (7.40096697, 8.97576946, 8.34347274),
    "hidden_bounds": (8.41782674, 11.691627, 10.0394937),
}
"""Field → sum of magnitudes of each scene, as its own code read them."""


def test_every_earlier_version_has_its_dataset() -> None:
    for version in range(1, SCHEMA_VERSION):
        assert read_manifest(HERE / f"schema_{version}" / "dataset").schema_version == version
    assert sorted(SCHEMA_VERSIONS) == list(range(1, SCHEMA_VERSION + 1))


def test_it_is_as_it_was_written() -> None:
    found = verify(ONE)
    assert (found.scenes, found.shards, found.problems) == (3, 2, ())


@pytest.mark.parametrize("memory", [0, 2**26], ids=["from shards", "in memory"])
def test_a_batch_holds_the_values_of_then(memory: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("datagen.loader.dataset.MEMORY_BYTES", memory)
    data = dg.TransientDataset(ONE, fields=tuple(SUMS), counts="stored")
    assert data.fields == tuple(SUMS) and data.classes == ("box", "cone", "sphere")
    (batch,) = DataLoader(data, batch_size=3, collate_fn=collate)
    for name, expected in SUMS.items():
        magnitudes = np.abs(batch[name].numpy().astype(np.float64)).reshape(3, -1)
        assert np.allclose(magnitudes.sum(axis=1), expected, rtol=2e-8, atol=0), name
    assert batch["histogram"].dtype == torch.uint16 and batch["histogram"].shape == (3, 6, 1, 64)
    assert data.parameters("detector_plan.sampler").tolist() == ["return_chain"] * 3


def test_its_noise_can_be_drawn_anew() -> None:
    data = dg.TransientDataset(ONE, fields=("histogram",), redraw_noise=True)
    totals = []
    for epoch in range(40):
        data.set_epoch(epoch)
        totals.append(sum(float(item["histogram"].sum()) for item in data.__getitems__(range(3))))
    # Five standard errors of the mean of 40 draws.
    assert abs(np.mean(totals) - sum(SUMS["histogram"])) < 5 * np.sqrt(sum(SUMS["histogram"]) * (1 + 1 / 40))
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
