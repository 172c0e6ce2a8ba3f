"""The baselines, and their predictions for a split of a suite as a file that `datagen score` reads."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from datagen.baselines.scenes import SuiteScenes, suite_scenes
from datagen.errors import InputError
from datagen.labels.frame import ViewFrame, image_points
from datagen.labels.volumes import VoxelGrid
from datagen.reconstruction.backprojection import reconstructed, scan_of
from datagen.records import Rectangle
from datagen.records.arrays import Bools, Floats
from datagen.records.checks import as_given, check_seed
from datagen.store.files import write_atomically
from datagen.store.scenes import Scenes

Predicted = dict[str, NDArray[Any]]

LAYERS = 32
"""Layers of the grid from which backprojection takes depth: its steps of depth."""
BRIGHT = 0.5
"""Fraction of the brightest voxel above which a voxel counts as an object."""
SMALLEST = 4
"""Least number of pixels of an object: smaller patches are noise."""


def mean_of_training(train: SuiteScenes, wanted: SuiteScenes, seed: int) -> Predicted:
    """Predictions that ignore the measurement: mean depth and centre of the training objects, and the pixels and
    voxels that objects cover most often, as many as they cover on average.
    """
    count, depth = len(wanted.scene), float(train.depth[train.mask].mean())
    center = np.nanmean(train.centers.reshape(-1, 3), axis=0)
    found = {
        "depth": np.full(wanted.depth.shape, depth),
        "mask": np.repeat(_most_often(train.mask)[None], count, axis=0),
        "centers": np.tile(center, (count, _objects(train), 1)),
    }
    return found | {"occupancy": np.repeat(_most_often(train.occupancy)[None], count, axis=0)}


def _objects(train: SuiteScenes) -> int:
    """The mean number of objects in a scene."""
    return max(1, round(float((~np.isnan(train.centers[..., 0])).sum(axis=1).mean())))


def _most_often(sets: Bools) -> Bools:
    """The places that most of `sets` (scene, …) contain, as many as a set has on average."""
    share = sets.mean(axis=0)
    most = np.sort(share, axis=None)[::-1][: max(1, round(float(share.sum())))]
    return np.asarray(share >= most[-1])


def backprojection(train: SuiteScenes, wanted: SuiteScenes, seed: int) -> Predicted:
    """Predictions by filtered backprojection, scene by scene: depth is that of the brightest voxel behind a pixel."""
    root, rows = Scenes(wanted.root), []
    for number in wanted.scene:
        content = root.read(int(number))
        arrays = content.arrays
        scan = scan_of(arrays["histogram"], arrays, content.manifest.config["capture"], content.time)
        frame, bounds = ViewFrame.about(Rectangle(*arrays["hidden_view"])), arrays["hidden_bounds"]
        behind = VoxelGrid.behind_images(frame, bounds, (LAYERS, *wanted.depth.shape[1:]))
        seen = reconstructed(scan, behind)
        brightest = seen.max(axis=0)
        volume = reconstructed(scan, VoxelGrid.around(frame, bounds, wanted.occupancy.shape[1:]))
        rows.append((
            behind.depths[seen.argmax(axis=0)], brightest > BRIGHT * brightest.max(), volume > BRIGHT * volume.max()
        ))  # fmt: skip
    depth, mask, occupancy = (np.stack(parts) for parts in zip(*rows, strict=True))
    centers = centers_of(depth, mask, wanted.view, _objects(train))
    return {"depth": depth, "mask": mask, "occupancy": occupancy, "centers": centers}


def network(train: SuiteScenes, wanted: SuiteScenes, seed: int) -> Predicted:
    """Predictions by a small network that is trained on the suite's own training scenes."""
    from datagen.baselines.network import predicted

    found = predicted(train, suite_scenes(train.root, "val"), wanted, seed)
    return found | {"centers": centers_of(found["depth"], found["mask"], wanted.view, _objects(train))}


BASELINES: dict[str, Callable[[SuiteScenes, SuiteScenes, int], Predicted]] = {
    "mean": mean_of_training, "backprojection": backprojection, "network": network,
}  # fmt: skip
"""Name → function of (training scenes, scenes to predict, seed)."""


def write_baseline(method: str, suite: str | Path, out: str | Path, split: str = "test", seed: int = 0) -> Path:
    """Predict the scenes of a split, and write an `.npz` file that `datagen score` reads; returns its path.

    method : `mean`, `backprojection` or `network`.

    Raises `InputError` for an unknown method, a seed that is none, and a folder that is no dataset or lacks fields
    that are needed.
    """
    if method not in BASELINES:
        raise InputError(f"{as_given('method', method)}: must be one of {', '.join(BASELINES)}")
    path = Path(out)
    if path.suffix != ".npz":
        raise InputError(
            f"{as_given('out', str(out))}: predictions are a NumPy archive; name a file that ends in .npz"
        )
    check_seed(seed)
    train, wanted = suite_scenes(suite, "train"), suite_scenes(suite, split)
    arrays: dict[str, Any] = {"scene": wanted.scene, "suite": str(Scenes(suite).manifest.config["name"])}
    for name, values in BASELINES[method](train, wanted, seed).items():
        arrays[name] = values.astype("f4") if values.dtype.kind == "f" else values
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content.getvalue())
    return path


def centers_of(depth: Floats, mask: Bools, view: Floats, least: int = 1) -> Floats:
    """(N, K, 3) mean of the points of each connected patch of a mask, in the label frame. If a scene has fewer
    patches than `least`, patches are repeated; other missing rows are NaN.

    depth, mask : (N, row, column). view : (N, 2) half extents of the images, metres.
    """
    found = [_centers(*scene) for scene in zip(depth, mask, view, strict=True)]
    centers = np.full((len(found), max(least, *map(len, found)), 3), np.nan)
    for row, middles in zip(centers, found, strict=True):
        if len(middles):
            row[: max(least, len(middles))] = middles[np.arange(max(least, len(middles))) % len(middles)]
    return centers


def _centers(depth: Floats, mask: Bools, half: Floats) -> Floats:
    patches, count = label(mask, np.ones((3, 3)))
    found = []
    for number in range(1, count + 1):
        points = image_points(depth, patches == number, *half)
        if len(points) >= SMALLEST:
            found.append(points.mean(axis=0))
    return np.array(found).reshape(-1, 3)
