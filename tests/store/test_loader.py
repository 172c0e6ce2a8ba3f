"""The torch dataset: values, order, workers, refused arguments; and samples simulated while they are read."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import zarr
from datasets import write_dataset
from fake_samples import fails_at_5, fake_sample, noisy_config, sequence_config, small_config
from scipy.stats import chi2
from torch.utils.data import DataLoader

import datagen as dg
from datagen.building.build import build
from datagen.config import DatasetConfig, config_from_mapping
from datagen.detector import detector_for, expected_histogram
from datagen.errors import CheckError, InputError
from datagen.loader import EpochSampler, TransientDataset, collate
from datagen.store import read_manifest

pytestmark = pytest.mark.usefixtures("builds_here")


@pytest.fixture(scope="module", params=[noisy_config, sequence_config], ids=["scenes", "sequences"])
def dataset(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(request.param(), tmp_path_factory.mktemp("loader") / "set", fake_sample)


def test_items_are_the_stored_values(dataset: Path) -> None:
    data = TransientDataset(dataset, fields=("histogram", "depth", "laser_points"))
    stored = {name: np.asarray(zarr.open_array(dataset / "data.zarr" / name, mode="r")[:]) for name in data.selected}
    assert len(data) == 12 and stored["histogram"].max() > 0
    for item in data.__getitems__([3, 11, 0]):
        scene = int(item["scene"])
        for name in data.selected:
            assert np.array_equal(item[name].numpy(), stored[name][scene])
    assert data[3]["histogram"].dtype == torch.float32 and data[3]["depth"].dtype == torch.float32
    for counts, dtype in (("int32", torch.int32), ("float64", torch.float64), ("stored", torch.uint16)):
        cast = TransientDataset(dataset, ("histogram",), counts=counts)[5]["histogram"]
        assert cast.dtype == dtype and np.array_equal(cast.numpy(), stored["histogram"][5])


@pytest.mark.parametrize(("start", "workers"), [("fork", 2), pytest.param("spawn", 1, marks=pytest.mark.nightly)])
def test_loader_workers_give_the_same_batches(
    dataset: Path, monkeypatch: pytest.MonkeyPatch, start: str, workers: int
) -> None:
    monkeypatch.setattr("datagen.store.reader.MEMORY_BYTES", 0)
    data = TransientDataset(dataset)
    data[0]
    here = list(DataLoader(data, batch_size=5))
    there = list(DataLoader(data, batch_size=5, num_workers=workers, multiprocessing_context=start))
    assert [batch["histogram"].shape for batch in here] == [(n, *data.shape("histogram")) for n in (5, 5, 2)]
    for a, b in zip(here, there, strict=True):
        assert all(torch.equal(a[name], b[name]) for name in a)


def test_collating_without_a_copy_equals_collating(dataset: Path) -> None:
    data = TransientDataset(dataset, counts="stored")
    plain = list(DataLoader(data, 5))
    quick = list(DataLoader(data, 5, num_workers=1, collate_fn=collate))
    for a, b in zip(plain, quick, strict=True):
        assert a.keys() == b.keys() and all(
            torch.equal(a[name], b[name]) and a[name].dtype == b[name].dtype for name in a
        )
    assert torch.equal(collate([data[1], data[2]])["histogram"], plain[0]["histogram"][1:3])


def test_items_are_numbers(dataset: Path) -> None:
    data = TransientDataset(dataset, ("depth",))
    for number in (2, np.int64(2), torch.tensor(2), -10):
        assert int(data[number]["scene"]) == 2  # type: ignore[index]
    for wrong in (slice(0, 3), [1, 2], 1.0, "a"):
        with pytest.raises(InputError, match="must be a whole"):
            data[wrong]  # type: ignore[index]
    for outside in (12, -13):
        with pytest.raises(IndexError, match=f"item {outside}: this dataset has 12 items"):
            data[outside]
    assert len(list(data)) == 12, "a loop ends where the items do"


def test_wrong_arguments_of_a_loader_are_refused(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"fields: 'albedo' is not in .*; it has histogram, transient, depth"):
        TransientDataset(dataset, ("albedo",))
    with pytest.raises(InputError, match="counts = 'uint16': must be one of"):
        TransientDataset(dataset, counts="uint16")
    with pytest.raises(InputError, match=r"'colour' is no column .*; it has scene, shard, failure"):
        TransientDataset(dataset).parameters("colour")
    shutil.copytree(dataset, tmp_path / "set")
    (tmp_path / "set/build/shard-000001.json").unlink()
    with pytest.raises(InputError, match=r"1 of 3 shards are not committed, the first is 1"):
        TransientDataset(tmp_path / "set")


@pytest.mark.parametrize("made_of", [small_config, sequence_config], ids=["scenes", "sequences"])
def test_scenes_that_failed_are_left_out(tmp_path: Path, made_of: Callable[[], DatasetConfig]) -> None:
    with pytest.raises(CheckError):
        build(made_of(), tmp_path / "set", progress=False, sample_function=fails_at_5)
    due = [0, 1, 2, 3, 4, 6, 7, 8, 9, 10, 11]
    with pytest.warns(UserWarning, match="1 scenes could not be made"):
        data = TransientDataset(tmp_path / "set")
        if made_of is sequence_config:
            windows = TransientDataset(tmp_path / "set", frames=2, frame_step=1)
            assert windows.scenes.tolist() == np.repeat(due, 2).tolist()
        splits = [TransientDataset(tmp_path / "set", split=name) for name in ("train", "val", "test")]
    assert [int(item["scene"]) for item in data.__getitems__(range(11))] == due
    assert data.parameters("index").tolist() == due
    assert sorted(scene for of in splits for scene in of.scenes) == due


def test_the_order_is_a_function_of_seed_and_epoch() -> None:
    def order(seed: int, epoch: int, **options: int | bool) -> list[int]:
        sampler = EpochSampler(range(10), seed, **options)  # type: ignore[arg-type]
        sampler.set_epoch(epoch)
        return list(sampler)

    assert order(1, 0) == order(1, 0) and sorted(order(1, 0)) == list(range(10))
    assert len({tuple(order(seed, epoch)) for seed in range(3) for epoch in range(3)}) == 9
    assert order(1, 0, shuffle=False) == list(range(10))
    ranks = [order(1, 4, rank=rank, ranks=3) for rank in range(3)]
    assert {len(rank) for rank in ranks} == {4} and set().union(*ranks) == set(range(10))
    assert [i for together in zip(*ranks, strict=True) for i in together][:10] == order(1, 4)
    with pytest.raises(InputError, match="rank"):
        EpochSampler(range(10), rank=3, ranks=3)


@pytest.mark.parametrize("detector", [{}, {"tdc_dnl": 0.5}], ids=["equal bins", "unequal bins"])
def test_redrawn_noise_has_the_detectors_mean(detector: dict[str, float], tmp_path: Path) -> None:
    """χ² over all bins of the sum of 200 epochs against the exact mean, at a significance level of 10⁻⁶."""
    dataset = write_dataset(noisy_config(**detector), tmp_path / "set", fake_sample)
    data = TransientDataset(dataset, ("histogram", "transient"), redraw_noise=True)
    config = read_manifest(dataset).parsed_config()
    total = np.zeros(data.shape("histogram"))
    for epoch in range(200):
        data.set_epoch(epoch)
        total += data[2]["histogram"].numpy()
    axis = config.capture.time.axis()
    spad, exposure = detector_for(config.detector, config.seed, 2, axis)
    mean = 200 * expected_histogram(data[2]["transient"].numpy().astype(float), axis, spad, exposure)
    used = mean > 10
    statistic = float((((total - mean) ** 2) / np.where(used, mean, 1))[used].sum())
    assert used.sum() > 30 and statistic < chi2.isf(1e-6, used.sum())


def test_samples_are_those_of_a_build_for_any_number_of_workers(tmp_path: Path) -> None:
    config = config_from_mapping(
        {
            "seed": 5,
            "scenes": 3,
            "transport": {"samples": 64},
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
    with pytest.raises(dg.InputError, match=r"GeneratedDataset\.first = -1"):
        dg.GeneratedDataset(config_from_mapping({}), first=-1)
