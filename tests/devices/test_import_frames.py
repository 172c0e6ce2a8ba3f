"""Frames of a sensor as a dataset: the fields of a simulated one, so that one loader takes both."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from torch.utils.data import ConcatDataset, DataLoader

import datagen as dg
from datagen.cli import cli
from datagen.config import config_from_mapping
from datagen.errors import InputError
from datagen.store.scenes import Scenes

pytestmark = pytest.mark.usefixtures("builds_here")

FIELDS = ("histogram", "sensor_position", "sensor_pixels", "laser_position", "laser_points")


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three frames with poses, as a file."""
    rng, poses = np.random.default_rng(0), np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = rng.uniform(-1, 1, (3, 3))
    path = tmp_path_factory.mktemp("frames") / "three.npz"
    np.savez(path, hists=rng.poisson(50, (3, 9, 128)), pose=poses, dist_to_plane=[0.1, 0.2, 0.3])
    return path


def test_frames_become_scenes_with_the_places_of_their_poses(frames: Path, tmp_path: Path) -> None:
    command = ["import", str(frames), str(frames), str(tmp_path / "real"), "--device", "tmf8820", "--quiet"]
    assert CliRunner().invoke(cli, command, catch_exceptions=False).exit_code == 0
    recorded = dg.read_frames(frames)
    assert recorded.poses is not None
    data, device = dg.TransientDataset(tmp_path / "real", FIELDS, counts="stored"), dg.device("tmf8820")
    assert len(data) == 6
    for index in range(6):
        item, frame = data[index], index % 3
        np.testing.assert_array_equal(item["histogram"][0], recorded.histograms[frame])
        capture, _, _ = device.at_pose(recorded.poses[frame])
        np.testing.assert_allclose(item["sensor_position"], recorded.poses[frame, :3, 3])
        np.testing.assert_allclose(item["sensor_pixels"], capture.sensor.pixels)
        parameters = Scenes(tmp_path / "real").read(index).parameters
        assert parameters["capture.frame"] == frame and parameters["capture.distance_m"] == [0.1, 0.2, 0.3][frame]


def test_frames_of_a_scan_have_a_histogram_for_each_laser_point(tmp_path: Path) -> None:
    bins = dg.device("galvo_spad").time.bins
    np.save(tmp_path / "scan.npy", np.arange(1024 * bins, dtype=np.int64).reshape(1, 1024, bins) % 7)
    dg.import_captures(tmp_path / "scan.npy", tmp_path / "real", device="galvo_spad", progress=False)
    stored = dg.TransientDataset(tmp_path / "real", ("histogram",), counts="stored")[0]["histogram"]
    np.testing.assert_array_equal(stored.numpy().reshape(1024, bins), np.load(tmp_path / "scan.npy")[0])


def test_one_loader_takes_real_and_simulated_frames(tmp_path: Path) -> None:
    large = tmp_path / "large.npy"
    np.save(large, np.full((3, 9, 128), 70_000))
    dg.import_captures(large, tmp_path / "real", device="tmf8820", progress=False)
    config = config_from_mapping({
        "name": "simulated", "scenes": 2, "capture": {"device": "tmf8820", "at_objects": {"distance_m": 0.6}},
        "transport": {"samples": 4, "max_bounces": 3},
        "store": {"fields": ["histogram"], "histogram_dtype": "uint32"},
    })  # fmt: skip
    dg.build(config, tmp_path / "simulated", progress=False)
    both = ConcatDataset(
        [dg.TransientDataset(tmp_path / name, FIELDS, counts="stored") for name in ("real", "simulated")]
    )
    (batch,) = DataLoader(both, batch_size=5, collate_fn=dg.collate)
    assert batch["histogram"].shape == (5, 1, 9, 128) and batch["sensor_pixels"].shape == (5, 9, 4, 3)


def test_wrong_frames_are_refused_in_a_line_and_nothing_is_made(frames: Path, tmp_path: Path) -> None:
    fractions = tmp_path / "fractions.npy"
    np.save(fractions, np.full((2, 9, 128), 0.5))
    for file, options, named in (
        (frames, {}, "device = 'tmf8820'"),
        (frames, {"device": "vl53l1x"}, "9 zones of 128 bins, vl53l1x has 1 of"),
        (frames, {"device": "tmf8820", "bins": 4}, "leave bin_width, wall"),
        (fractions, {"device": "tmf8820"}, "fractions"),
    ):
        with pytest.raises(InputError, match=named):
            dg.import_captures(file, tmp_path / "none", progress=False, **options)  # type: ignore[arg-type]
    assert not (tmp_path / "none").exists()


def test_files_with_and_without_poses_are_two_datasets(frames: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "bare.npy", np.ones((2, 9, 128)))
    for files in ([frames, tmp_path / "bare.npy"], [tmp_path / "bare.npy", frames]):
        with pytest.raises(InputError, match=r"three.npz has poses and .*bare.npy none.*import them apart"):
            dg.import_captures(files, tmp_path / "none", device="tmf8820", progress=False)
