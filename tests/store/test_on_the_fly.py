"""Samples that are simulated while they are read equal those of a build."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from datasets import write_dataset
from torch.utils.data import DataLoader

import datagen as dg
from datagen.config import config_from_mapping


def test_samples_are_those_of_a_build_for_any_number_of_workers(tmp_path: Path) -> None:
    config = config_from_mapping(
        {
            "seed": 5,
            "scenes": 3,
            "transport": {"lookins": 64, "fov_samples": 1},
            "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}},
            "labels": {"rows": 4, "columns": 4},
        }
    )
    fields = ("histogram", "transient", "depth", "laser_points")
    built = dg.TransientDataset(write_dataset(config, tmp_path / "built"), fields)
    made = dg.GeneratedDataset(config, fields)
    assert len(made) == 3
    for loader in (made, DataLoader(made, batch_size=None, num_workers=2)):
        found = {int(item["scene"]): item for item in loader}
        assert sorted(found) == [0, 1, 2]
        for scene, item in found.items():
            assert set(item) == set(built[scene])
            for name, value in built[scene].items():
                assert item[name].dtype == value.dtype
                assert torch.equal(item[name], value), name
    later = [int(item["scene"]) for item in dg.GeneratedDataset(config, fields, first=2)]
    assert later == [2]
    batch = next(iter(DataLoader(made, batch_size=3, collate_fn=dg.collate)))
    assert batch["histogram"].shape == (3, 4, 1, 64)


def test_fields_that_the_configuration_does_not_give_are_refused() -> None:
    with pytest.raises(dg.InputError, match="sdf"):
        dg.GeneratedDataset(config_from_mapping({}), ("sdf",))
    with pytest.raises(dg.InputError, match="first = -1"):
        dg.GeneratedDataset(config_from_mapping({}), first=-1)
