"""Samples as volumes: the compiled sum equals the plain one, noise has a standard deviation of 1, crops are crops."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, Subset

import datagen as dg
from datagen.config import config_from_mapping
from datagen.errors import InputError
from datagen.labels.frame import ViewFrame
from datagen.labels.volumes import VoxelGrid
from datagen.reconstruction.backprojection import (
    BLOCK,
    GEOMETRY,
    Scan,
    backprojected,
    backprojected_volume,
    scan_of,
    whitened,
)
from datagen.store.scenes import Scenes

pytestmark = pytest.mark.usefixtures("builds_here")

VOXELS = (5, 6, 7)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = config_from_mapping({
        "scenes": 8, "capture": {"scan": {"rows": 3, "columns": 4}, "time": {"bins": 96, "bin_width_ps": 500}},
        "transport": {"samples": 64}, "labels": {"rows": 4, "columns": 4},
        "detector": {"cycles": 10**6}, "store": {"fields": ["histogram", "transient", "depth"]},
    })  # fmt: skip
    root = tmp_path_factory.mktemp("volumes") / "set"
    dg.build(config, root, 1)
    return root


def random_scan(rng: np.random.Generator, lasers: int, pixels: int, bins: int, confocal: bool) -> Scan:
    points = [np.pad(rng.uniform(-1, 1, (n, 2)), ((0, 0), (0, 1))) for n in (lasers, pixels)]
    if confocal:
        laser = pixel = np.arange(lasers)
        points[1] = points[0]
    else:
        laser, pixel = (of.ravel() for of in np.indices((lasers, pixels)))
    signal = rng.normal(size=(len(laser), bins)).astype(np.float32).astype(np.float64)
    return Scan(signal, points[0], points[1], laser, pixel, rng.uniform(-5, 20, len(laser)), 0.03)


def plain(scan: Scan, places: Any) -> Any:
    """The sum B as it is defined, histogram by histogram."""
    single = np.float32
    at, lasers, pixels = ((of / scan.bin_m).astype(single) for of in (places, scan.laser_points, scan.pixels))
    total = np.zeros(len(places), single)
    for row, laser, pixel, first in zip(scan.signal, scan.laser, scan.pixel, scan.first.astype(single), strict=True):
        ways = [((at - of) ** 2) for of in (lasers[laser], pixels[pixel])]
        there, back = (np.sqrt(of[:, 0] + of[:, 1] + of[:, 2]) for of in ways)
        bins = np.floor(there + back + (single(1) - first)).astype(int) - 1
        inside = (bins >= 0) & (bins < len(row))
        total[inside] += row[bins[inside]].astype(single)
    return total


@pytest.mark.parametrize(("confocal", "places"), [(True, 1), (True, 2 * BLOCK + 5), (False, 2 * BLOCK + 5)])
def test_the_compiled_sum_is_the_plain_one(confocal: bool, places: int) -> None:
    rng = np.random.default_rng(places)
    scan = random_scan(rng, 7, 3, 90, confocal)
    at = rng.uniform((-2, -2, 0), (2, 2, 3), (places, 3))
    assert np.array_equal(backprojected(scan, at), plain(scan, at))


def test_noise_alone_has_a_standard_deviation_of_one() -> None:
    """Up to the factor √(1 − 1/64), because the mean of 64 histograms is subtracted. 1000 draws, at a level of 10⁻⁶
    for all 12 places together."""
    rng, draws = np.random.default_rng(5), 1000
    scan = random_scan(rng, 64, 1, 200, confocal=True)
    frame = ViewFrame(np.zeros(3), np.eye(3), 1.0, 1.0)
    grid = VoxelGrid(frame, np.array([-0.5, -0.5, 0.4]), np.array([0.5, 0.5, 1.4]), (3, 2, 2))
    counts = rng.poisson(6.0, (draws, *scan.signal.shape)).astype(float)
    values = []
    for one in counts:
        drawn = Scan(whitened(one), scan.laser_points, scan.pixels, scan.laser, scan.pixel, 0 * scan.first, 0.03)
        values.append(backprojected_volume(drawn, grid).ravel())
    spread = np.var(values, axis=0) / (1 - 1 / 64)
    # Counts of 6 divided by the root of the mean of 64 of them: its own noise adds less than 1 %.
    assert np.abs(spread - 1).max() < 5.4 * np.sqrt(2 / draws) + 0.01


def test_unknown_points_and_places_add_nothing(dataset: Path) -> None:
    """A laser point that met no surface; places that are endlessly far, or nowhere."""
    stored = Scenes(dataset).read(2)
    capture = config_from_mapping({"capture": {"scan": {"rows": 3, "columns": 4}}}).model_dump()["capture"]
    arrays = {name: stored.arrays[name].astype(float) for name in GEOMETRY}
    whole = scan_of(stored.arrays["histogram"][1:], {**arrays, "laser_points": arrays["laser_points"][1:],
                    "sensor_points": arrays["sensor_points"][1:]}, capture, stored.time)  # fmt: skip
    arrays["laser_points"][0] = arrays["sensor_points"][0] = np.nan
    scan = scan_of(stored.arrays["histogram"], arrays, capture, stored.time)
    at = np.array([[0.2, 0.1, 1.0], [1e200, 0, 0], [np.nan, 0, 1], [0, np.inf, 0], [1e12, 0, 0]])
    with np.errstate(over="ignore"):
        found = backprojected(scan, at)
        assert np.array_equal(found, backprojected(whole, at)) and found[0] != 0 and not found[1:].any()
    arrays["laser_points"][:] = np.nan
    assert not backprojected(scan_of(stored.arrays["histogram"], arrays, capture, stored.time), at[:1]).any()


def test_what_gives_no_volume_is_refused(dataset: Path) -> None:
    data = dg.TransientDataset(dataset, representation="volume")
    geometry = {name: Scenes(dataset).read(7).arrays[name][None] for name in GEOMETRY}
    geometry["hidden_bounds"] = np.full((1, 2, 3), np.nan)
    with pytest.raises(InputError, match="scene 7 has no hidden_view and hidden_bounds"):
        data._volumes.backproject([7], np.zeros((1, 12, 1, 96)), geometry)  # type: ignore[union-attr]
    for voxels in ((0, 4, 4), (4.0, 4, 4), 32, (2**10, 2**10, 2**10)):
        with pytest.raises(InputError, match=r"voxels = .*: must be three whole numbers ≥ 1"):
            dg.TransientDataset(dataset, representation="volume", voxels=voxels)  # type: ignore[arg-type]


def volume_of(counts: Any, arrays: Any, capture: Any, time: dg.TimeAxis) -> Any:
    where = {name: arrays[name].astype(float) for name in GEOMETRY}
    grid = VoxelGrid.behind_images(
        ViewFrame.about(dg.Rectangle(*where["hidden_view"])), where["hidden_bounds"], VOXELS
    )
    return torch.from_numpy(backprojected_volume(scan_of(counts, where, capture, time), grid)).float()


def test_volumes_are_those_of_the_histograms(dataset: Path) -> None:
    data = dg.TransientDataset(dataset, representation="volume", voxels=VOXELS)
    (batch,) = DataLoader(
        Subset(data, range(1, 8)), 7, collate_fn=dg.collate, num_workers=1, multiprocessing_context="fork"
    )
    assert set(batch) == {"volume", "volume_bounds", "depth", "scene"}
    assert data.shape("volume") == VOXELS and data.shape("volume_bounds") == (2, 3)
    assert "volume (5, 6, 7)" in repr(data)
    stored = Scenes(dataset)
    for row, scene in enumerate(range(1, 8)):
        of = stored.read(scene)
        due = volume_of(of.arrays["histogram"], of.arrays, stored.manifest.config["capture"], of.time)
        assert torch.equal(batch["volume"][row], due) and due.std() > 0
        view, far = of.arrays["hidden_view"], batch["volume_bounds"][row, 1, 2]
        half = torch.from_numpy(np.linalg.norm(view[1:], axis=1))
        torch.testing.assert_close(batch["volume_bounds"][row, :, :2].double(), torch.stack([-half, half]))
        # As deep as the hidden part reaches from the wall.
        normal = np.cross(*view[1:]) / np.linalg.norm(np.cross(*view[1:]))
        corners = np.stack(np.meshgrid(*of.arrays["hidden_bounds"].T), axis=-1).reshape(-1, 3)
        assert batch["volume_bounds"][row, 0, 2] == 0
        assert far == pytest.approx(float(((corners - view[0]) @ normal).max()), rel=1e-6)


def test_noise_is_drawn_anew_and_parts_are_parts(dataset: Path) -> None:
    crop = {"lasers": np.s_[1:, :3], "bins": slice(10, 80)}
    volumes = dg.TransientDataset(dataset, redraw_noise=True, representation="volume", voxels=VOXELS, seed=3, **crop)
    counts = dg.TransientDataset(dataset, ("histogram", *GEOMETRY), redraw_noise=True, seed=3, **crop)
    of = Scenes(dataset).read(4)
    later = dg.TimeAxis(70, of.time.width_s, of.time.start_s + 10 * of.time.width_s, of.time.origin)
    capture, drawn = volumes._manifest.config["capture"], []
    for _ in range(2):
        item = {name: value.numpy() for name, value in counts[4].items()}
        drawn.append(volumes[4]["volume"])
        assert torch.equal(drawn[-1], volume_of(item["histogram"], item, capture, later))
    assert not torch.equal(*drawn)
