"""Baselines: backprojection finds a point, and the network learns more than the mean."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_suite import made_suite

import datagen as dg
from datagen.baselines.network import predictions_of
from datagen.baselines.predict import centers_of, mean_of_training
from datagen.baselines.scenes import SuiteScenes
from datagen.cli import run
from datagen.labels.frame import ViewFrame
from datagen.labels.volumes import VoxelGrid
from datagen.reconstruction.backprojection import reconstructed, scan_of
from datagen.units import time_from_path

pytestmark = pytest.mark.usefixtures("builds_here")

POINT = np.array([0.3, -0.2, 0.9])
"""Right, up and depth in the label frame."""
VIEW = np.array([[2.0, 5.0, 1.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
"""Its depth is the scene's x."""


def scene(kind: str, origin: str) -> Any:
    """Light of one point, without noise, in bins of 100 ps."""
    to_scene = lambda at: VIEW[0] + at @ np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0.0]])  # noqa: E731
    steps = np.linspace(-0.7, 0.7, 8)
    grid = np.stack([*np.meshgrid(steps, steps), np.zeros((8, 8))], axis=-1).reshape(-1, 3)
    lasers = {"confocal": grid, "single": np.zeros((1, 3)), "flood": grid}[kind]
    device = np.array([0.5, 0.1, 2.0])
    ways = [np.linalg.norm(at - POINT, axis=1) for at in (lasers, grid)]
    if origin == "source":
        ways = [way + np.linalg.norm(at - device, axis=1) for way, at in zip(ways, (lasers, grid), strict=True)]
    path = np.diag(ways[0][:, None] + ways[1])[:, None] if kind == "confocal" else ways[0][:, None] + ways[1]
    counts = np.zeros((*path.shape, 280))
    bins = (time_from_path(path) / 1e-10 - 10).astype(int)
    np.put_along_axis(counts, bins[..., None], 100.0, axis=-1)
    if kind == "flood":
        counts = np.zeros((1, 64, 280))
        np.add.at(counts, (0, np.arange(64)[None].repeat(64, 0), bins), 1.0)
    arrays = {
        "histogram": counts, "hidden_view": VIEW, "laser_points": to_scene(lasers),
        "sensor_points": to_scene(grid),
        "laser_position": to_scene(device), "sensor_position": to_scene(device),
    }  # fmt: skip
    capture = {"pairing": "confocal" if kind == "confocal" else "exhaustive",
               "illumination": "flood" if kind == "flood" else "scan"}  # fmt: skip
    time = dg.TimeAxis(bins=280, width_s=1e-10, start_s=1e-9, origin=origin)
    return SimpleNamespace(arrays=arrays, manifest=SimpleNamespace(config={"capture": capture}), time=time)


@pytest.mark.parametrize(("kind", "origin"), [("confocal", "wall"), ("single", "source"), ("flood", "source")])
def test_a_point_is_found(kind: str, origin: str) -> None:
    bounds = VIEW[0] + np.array([[0, -1, -1], [1.6, 1, 1]])
    grid = VoxelGrid.behind_images(ViewFrame.about(dg.Rectangle(*VIEW)), bounds, (32, 40, 40))
    of = scene(kind, origin)
    scan = scan_of(of.arrays["histogram"], of.arrays, of.manifest.config["capture"], of.time)
    volume = reconstructed(scan, grid)
    found = grid.centers[np.unravel_index(volume.argmax(), volume.shape)]
    # Within two voxels; a bin is 3 cm of path.
    assert np.abs(found - POINT).max() < 0.1


def made(count: int, seed: int) -> SuiteScenes:
    """An object of 4 × 4 pixels at one of two places; the bin says how far, the laser point which."""
    rng = np.random.default_rng(seed)
    depth, left = rng.uniform(0.3, 1.3, count), rng.random(count) < 0.5
    light = 60 * np.exp(-(((np.arange(16) - 10 * depth[:, None]) / 1.5) ** 2))
    place = np.stack([left, ~left], axis=1)
    histogram = rng.poisson(1 + (place[:, :, None, None] * light[:, None, None])).astype(np.float32)
    mask = np.zeros((count, 8, 8), bool)
    mask[left, 2:6, :4] = True
    mask[~left, 2:6, 4:] = True
    image = (mask * depth[:, None, None]).astype(np.float32)
    centers = np.stack([np.where(left, -0.5, 0.5), np.zeros(count), depth], axis=-1)[:, None]
    return SuiteScenes(Path(), np.arange(count), histogram, image, mask, mask[:, None], centers, np.ones((count, 2)))


def test_the_network_learns_and_the_mean_does_not() -> None:
    train, val, test = made(120, 1), made(30, 2), made(60, 3)
    found, blind = predictions_of(train, val, test, 0), mean_of_training(train, test, 0)
    off = [np.sqrt(np.mean((of["depth"] - test.depth)[test.mask] ** 2)) for of in (found, blind)]
    assert off[1] == pytest.approx(1 / np.sqrt(12), rel=0.1) and off[0] < 0.4 * off[1]
    assert (found["mask"] == test.mask).mean() > 0.98 and (found["occupancy"] == test.occupancy).mean() > 0.98
    assert blind["centers"][0, 0] == pytest.approx(np.nanmean(train.centers, axis=(0, 1)))
    assert blind["mask"][0].sum() == pytest.approx(16, abs=16) and blind["mask"][0, 2:6].any()
    centers = centers_of(found["depth"], found["mask"], test.view)
    assert np.median(np.linalg.norm(centers[:, 0] - test.centers[:, 0], axis=-1)) < 0.15


def test_patches_have_a_centre_each() -> None:
    mask, depth = np.zeros((2, 8, 8), bool), np.full((2, 8, 8), 2.0)
    mask[0, :2, :2] = mask[0, 4:, 4:] = True
    mask[1, 0, 0] = True
    depth[0, :2, :2] = 1.0
    found = centers_of(depth, mask, np.full((2, 2), 4.0))
    assert found[0].tolist() == [[-3, 3, 1], [2, -2, 2]] and np.isnan(found[1]).all()
    several = centers_of(depth, mask, np.full((2, 2), 4.0), least=3)
    assert several[0].tolist() == [[-3, 3, 1], [2, -2, 2], [-3, 3, 1]] and np.isnan(several[1]).all()


def test_the_command_writes_what_is_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    suite = made_suite(tmp_path / "made.zarr")
    for method in ("mean", "backprojection", "network"):
        out = tmp_path / "out" / f"{method}.npz"
        assert run(["baseline", method, str(suite), str(out)]) == 0
        assert capsys.readouterr().out == f"{out}\n"
        scores = dg.score(suite, out)
        assert (
            len(scores.all) == 7 and scores.all["depth_rmse_m"] < 2 and np.isfinite(list(scores.all.values())).all()
        )
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "backprojection.npz", "mean.npz", "network.npz",
    ]  # fmt: skip
    for arguments, piece in (
        (["guess", str(suite), "x.npz"], "METHOD = 'guess': must be one of mean, backprojection, network"),
        (["mean", str(suite), "x.zarr"], "name a file that ends in .npz"),
        (["mean", "nowhere", "x.npz"], "no such dataset"),
    ):
        assert run(["baseline", *arguments]) == 2
        err = capsys.readouterr().err
        assert piece in err and err.count("\n") == 1
