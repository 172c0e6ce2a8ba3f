"""Windows of frames: items of a sequence, their noise, events and volumes."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import zarr
from datasets import rewritten, write_dataset
from fake_samples import decoded_from_now, fake_sample, sequence_config, small_config
from torch.utils.data import DataLoader

import datagen as dg
from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.labels.frame import ViewFrame
from datagen.labels.volumes import VoxelGrid
from datagen.reconstruction.backprojection import GEOMETRY, backprojected_volume, scan_of
from datagen.records import Rectangle
from datagen.store import reader as reading
from datagen.store.scenes import Scenes

FRAMES, SCENES = 8, 12
FIELDS = ("histogram", "transient", "depth", "laser_points", "laser_time")


def config(**changes: Any) -> DatasetConfig:
    return sequence_config(**{"sequence": {"frames": FRAMES, "rate_hz": 10}} | changes)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(config(), tmp_path_factory.mktemp("windows") / "set", fake_sample)


@pytest.fixture(scope="module")
def stored(dataset: Path) -> dict[str, np.ndarray]:
    group = zarr.open_group(dataset / "data.zarr", mode="r")
    return {name: np.asarray(group[name][:]) for name in FIELDS}  # type: ignore[index]


@pytest.mark.parametrize(
    ("frames", "step", "firsts"),
    [(3, None, [0, 3]), (3, 2, [0, 2, 4]), (8, 4, [0]), (1, 1, [*range(8)]), (4, 1, [0, 1, 2, 3, 4])],
)
@pytest.mark.parametrize("memory", [0, 2**28], ids=["from shards", "in memory"])
@pytest.mark.parametrize("crop", [{}, {"lasers": [2, 0], "bins": slice(3, 9)}], ids=["whole", "cut"])
def test_items_are_windows_of_scenes(
    dataset: Path, stored: dict[str, np.ndarray], frames: int, step: int | None, firsts: list[int], memory: int,
    crop: dict[str, Any], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(reading, "MEMORY_BYTES", memory)
    data = dg.TransientDataset(dataset, FIELDS, counts="stored", frames=frames, frame_step=step, **crop)
    assert len(data) == SCENES * len(firsts)
    assert [(int(s), int(f)) for s, f in zip(data.scenes, data.first_frames, strict=True)] == [
        *itertools.product(range(SCENES), firsts)
    ]
    order = [len(data) - 1, 0, len(firsts), len(data) // 2, 0, -1]
    (batch,) = DataLoader(data, len(order), sampler=order, collate_fn=dg.collate)
    for row, item in enumerate(order):
        one = data[item]
        scene, first = int(one["scene"]), int(one["frame"])
        assert (scene, first) == (int(data.scenes[item]), int(data.first_frames[item]))
        for name in FIELDS:
            due = stored[name][scene]
            if name != "laser_points":
                due = due[first : first + frames]
            if crop and name in ("histogram", "transient"):
                due = due[:, [2, 0], :, 3:9]
            elif crop and name != "depth":
                due = due[[2, 0]] if name == "laser_points" else due[:, [2, 0]]
            np.testing.assert_array_equal(one[name].numpy(), due)
            assert torch.equal(batch[name][row], one[name]) and one[name].shape == data.shape(name)
        assert int(batch["frame"][row]) == first


def test_a_dataset_of_windows_says_so(dataset: Path) -> None:
    data = dg.TransientDataset(dataset, ("depth",), split="val", frames=3, frame_step=1)
    windows, scenes = len(data), len({*data.scenes.tolist()})
    assert windows == 6 * scenes
    said = f"{windows} windows of 3 frames, in {scenes} scenes of split 'val'; depth (3, 4, 5)"
    assert repr(data) == f"TransientDataset('{dataset}': {said})"


def test_without_windows_items_are_whole_sequences(dataset: Path, stored: dict[str, np.ndarray]) -> None:
    data = dg.TransientDataset(dataset, FIELDS, counts="stored")
    assert len(data) == SCENES and "frame" not in data[0]
    for name in FIELDS:
        np.testing.assert_array_equal(data[5][name].numpy(), stored[name][5])


def test_a_split_has_all_windows_of_its_scenes(dataset: Path) -> None:
    every = [dg.TransientDataset(dataset, frames=3, frame_step=2, split=split) for split in ("train", "val", "test")]
    whole = [dg.TransientDataset(dataset, split=split) for split in ("train", "val", "test")]
    for windows, scenes in zip(every, whole, strict=True):
        assert windows.scenes.tolist() == np.repeat(scenes.scenes, 3).tolist()
        assert windows.stats == scenes.stats
        column = scenes.parameters("box.width_m")
        assert windows.parameters("box.width_m").tolist() == np.repeat(column, 3).tolist()


def test_windows_that_overlap_have_the_same_noise(dataset: Path) -> None:
    """In each epoch, whatever the order and the workers; and each frame has noise of its own."""

    def epoch(frames: int | None, step: int | None, draw: int, **options: Any) -> dict[tuple[int, int], torch.Tensor]:
        chosen = {"frames": frames, "frame_step": step} if frames else {}
        data = dg.TransientDataset(dataset, ("histogram",), redraw_noise=True, seed=3, **chosen)
        sampler = dg.EpochSampler(data)
        sampler.set_epoch(draw)
        found: dict[tuple[int, int], torch.Tensor] = {}
        for batch in DataLoader(data, 5, sampler=sampler, collate_fn=dg.collate, **options):
            for scene, first, counts in zip(
                batch["scene"], batch.get("frame", torch.zeros(len(batch["scene"]))), batch["histogram"], strict=True
            ):
                for k, one in enumerate(counts):
                    key = int(scene), int(first) + k
                    assert torch.equal(found.setdefault(key, one), one)
        return found

    whole = epoch(None, None, 2)
    assert len(whole) == SCENES * FRAMES
    for frames, step, options in ((4, 1, {}), (3, 2, {"num_workers": 2}), (1, None, {})):
        other = epoch(frames, step, 2, **options)
        assert all(torch.equal(other[key], whole[key]) for key in other) and len(other) >= SCENES * 7
    another = epoch(None, None, 3)
    differ = [not torch.equal(whole[key], another[key]) for key in whole]
    assert np.mean(differ) > 0.9
    assert not torch.equal(whole[0, 0], whole[0, 1])


def test_redrawn_counts_have_the_mean_of_their_frame(dataset: Path, stored: dict[str, np.ndarray]) -> None:
    data = dg.TransientDataset(dataset, ("histogram",), redraw_noise=True, frames=2)
    counts = sum(data[1]["histogram"].numpy() for _ in range(300))
    # 100 cycles of 100 photons, of which 0.3 are detected; the jitter leads some per mille out of the window.
    due = 300 * 0.3 * 100 * 100 * stored["transient"][0, 2:4].sum(axis=(2, 3))
    np.testing.assert_allclose(counts.sum(axis=(2, 3)), due, rtol=0.02)
    assert np.ptp(due) > 0.1 * due.max()
    cut = dg.TransientDataset(dataset, ("histogram",), redraw_noise=True, frames=2, lasers=[3, 1], bins=slice(2, 9))
    whole = dg.TransientDataset(dataset, ("histogram",), redraw_noise=True, frames=2)
    assert torch.equal(cut[7]["histogram"], whole[7]["histogram"][:, [3, 1], :, 2:9])


def test_events_have_a_column_of_the_frame(dataset: Path) -> None:
    for chosen in ({"frames": 3, "frame_step": 2}, {}):
        data = dg.TransientDataset(dataset, ("histogram",), representation="events", **chosen)  # type: ignore[arg-type]
        due = dg.TransientDataset(dataset, ("histogram",), **chosen)  # type: ignore[arg-type]
        (batch,) = DataLoader(data, 4, sampler=[5, 0, 7, 5], collate_fn=dg.collate)
        assert batch["events"].shape[1] == 5 and data[0]["events"].shape[1] == 4
        back = dg.dense(batch["events"], batch["counts"], (4, *due.shape("histogram")))
        assert torch.equal(back, torch.stack([due[k]["histogram"] for k in (5, 0, 7, 5)]))
        one = data[5]
        assert torch.equal(dg.dense(one["events"], one["counts"], due.shape("histogram")), due[5]["histogram"])


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One sequence of a box that walks, in plenty of light."""
    made = config_from_mapping({
        "scenes": 1, "seed": 4, "transport": {"target": 0.1}, "sequence": {"frames": 6, "rate_hz": 2},
        "scene": {"contents": [{"kind": "box", "motion": {"kind": "walk", "speed_m_s": 1.0}}]},
        "capture": {"scan": {"rows": 6, "columns": 6}, "time": {"bins": 128, "bin_width_ps": 400}},
        "detector": {"cycles": 130_000, "photons_per_pulse": 1e9}, "labels": {"rows": 4, "columns": 4},
        "store": {"fields": ["histogram", "objects"]},
    })  # fmt: skip
    return write_dataset(made, tmp_path_factory.mktemp("walk") / "set")


VOXELS = (5, 6, 7)


def volumes_of(path: Path, frames: int, minus: str, item: int) -> np.ndarray:
    data = dg.TransientDataset(
        path, ("histogram",), representation="volume", voxels=VOXELS, frames=frames, frame_step=1, minus=minus
    )
    volumes: np.ndarray = data[item]["volume"].numpy()
    assert volumes.shape == data.shape("volume") == (frames, *VOXELS)
    return volumes


def test_volumes_are_made_of_each_frame(walk: Path) -> None:
    content = Scenes(walk).read(0)
    where = {name: content.arrays[name].astype(np.float64) for name in GEOMETRY}
    view, capture = Rectangle(*where["hidden_view"]), content.manifest.config["capture"]
    grid = VoxelGrid.behind_images(ViewFrame.about(view), where["hidden_bounds"], VOXELS)
    counts = content.arrays["histogram"][2:5]
    for minus, mean in (("scan", None), ("mean", counts.mean(axis=0))):
        found = volumes_of(walk, 3, minus, 2)
        for frame in range(3):
            due = backprojected_volume(scan_of(counts[frame], where, capture, content.time, mean), grid)
            np.testing.assert_allclose(found[frame], due, rtol=1e-5, atol=1e-5)


def test_what_stands_is_gone_from_volumes_and_noise_has_a_standard_deviation_of_one(
    walk: Path, tmp_path: Path
) -> None:
    """Up to the factor √(1 − 1/F), because the mean of F frames is subtracted."""
    shape = Scenes(walk).read(0).arrays["histogram"].shape
    mean = np.linspace(0, 40, shape[-1]) * np.linspace(0.2, 3, shape[1])[:, None, None]
    still = rewritten(walk, tmp_path / "still", 0, histogram=np.tile(mean.round().astype(np.uint16), (6, 1, 1, 1)))
    assert not volumes_of(still, 6, "mean", 0).any() and volumes_of(still, 6, "scan", 0).any()
    rng, found = np.random.default_rng(1), list[np.ndarray]()
    for number in range(6):
        drawn = rng.poisson(mean, shape).astype(np.uint16)
        path = rewritten(walk, tmp_path / str(number), 0, histogram=drawn)
        found.append(volumes_of(path, 6, "mean", 0))
    inside = np.stack(found)[np.stack(found) != 0]
    # Neighbouring voxels share histograms, so their number is far above that of independent ones.
    assert np.std(inside) == pytest.approx(np.sqrt(1 - 1 / 6), rel=0.1)


def test_a_window_decodes_no_more_than_its_frames(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reading, "MEMORY_BYTES", 0)
    decoded = decoded_from_now(monkeypatch)
    data = dg.TransientDataset(dataset, ("histogram",), frames=2, frame_step=1, check=False, counts="stored")
    for item in (0, 5, 13):
        decoded.clear()
        data[item]
        assert sum(decoded) == data[item]["histogram"].nbytes == 2 * 4 * 16 * 2


def test_wrong_windows_are_one_line(dataset: Path, tmp_path: Path) -> None:
    still = write_dataset(small_config(), tmp_path / "still", fake_sample)
    for path, options, words in (
        (dataset, {"frames": 9}, "frames = 9"),
        (dataset, {"frames": 0}, "frames = 0"),
        (dataset, {"frames": 2.5}, "frames = 2.5"),
        (dataset, {"frames": 2, "frame_step": 0}, "frame_step = 0"),
        (dataset, {"frame_step": 2}, "frame_step = 2 without frames"),
        (dataset, {"minus": "median"}, "minus = 'median'"),
        (still, {"frames": 2}, "has no sequences"),
        (still, {"representation": "volume", "minus": "mean"}, "minus = 'mean'"),
    ):
        with pytest.raises(InputError, match=words) as refused:
            dg.TransientDataset(path, ("histogram",), **options)  # type: ignore[arg-type]
        assert "\n" not in str(refused.value)
