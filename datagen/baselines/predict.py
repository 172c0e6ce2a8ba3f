"""The baselines, and their predictions for a split of a suite as a file that `datagen score` reads."""

from __future__ import annotations

import io
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from datagen.baselines.scenes import SuiteScenes, suite_scenes
from datagen.baselines.walks import Walks, read_walks
from datagen.errors import InputError
from datagen.labels.frame import ViewFrame, image_points
from datagen.labels.volumes import VoxelGrid
from datagen.reconstruction.backprojection import reconstructed, scan_of
from datagen.records import Rectangle
from datagen.records.arrays import Bools, Floats, Ints
from datagen.records.checks import as_given, check_seed
from datagen.store import read_manifest
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
    from datagen.baselines.network import predictions_of

    found = predictions_of(train, suite_scenes(train.root, "val"), wanted, seed)
    return found | {"centers": centers_of(found["depth"], found["mask"], wanted.view, _objects(train))}


BASELINES: dict[str, Callable[[SuiteScenes, SuiteScenes, int], Predicted]] = {
    "mean": mean_of_training, "backprojection": backprojection, "network": network,
}  # fmt: skip
"""Name → function of (training scenes, scenes to predict, seed)."""


def mean_walk(train: Walks, wanted: Walks, seed: int) -> Predicted:
    """Predictions that ignore the measurement: the mean place and velocity of the walkers of training."""
    return _track(wanted, train.centers.mean(axis=(0, 1)), train.velocities.mean(axis=(0, 1)))


def tracking(train: Walks, wanted: Walks, seed: int) -> Predicted:
    """Predictions by backprojection of what changes, and a Kalman filter."""
    from datagen.baselines.tracking import kalman_ways

    return _level_track(train, wanted, *kalman_ways(train, wanted))


def walk_network(train: Walks, wanted: Walks, seed: int) -> Predicted:
    """Predictions by a small network on floor plans that is trained on the suite's own training sequences."""
    from datagen.baselines.plan_network import learnt_ways

    return _level_track(train, wanted, *learnt_ways(train, wanted, seed))


def _level_track(train: Walks, wanted: Walks, places: Floats, velocities: Floats) -> Predicted:
    """Predictions of one track along right and depth (N, F, 2), which goes level."""
    return _track(wanted, train.at_mean_height(places), np.insert(velocities, 1, 0.0, axis=-1))


def _track(wanted: Walks, centers: Floats, velocities: Floats) -> Predicted:
    """The one track of each sequence, whose centres and velocities are (N, F, 3), or (3,) for all."""
    both = (np.broadcast_to(of, wanted.centers.shape)[:, :, None] for of in (centers, velocities))
    return dict(zip(("centers", "velocities"), both, strict=True))


OF_SEQUENCES: dict[str, Callable[[Walks, Walks, int], Predicted]] = {
    "mean": mean_walk, "tracking": tracking, "network": walk_network,
}  # fmt: skip
"""Name → function of (training sequences, sequences to predict, seed)."""


def write_baseline(method: str, suite: str | Path, out: str | Path, split: str = "test", seed: int = 0) -> Path:
    """Predict the scenes of a split, and write an `.npz` file that `datagen score` reads; returns its path.

    method : `mean`, `backprojection` or `network`; of sequences `mean`, `tracking` or `network`.

    Raises `InputError` for an unknown method, a seed that is none, and a folder that is no dataset or lacks fields
    that are needed.
    """
    check_seed(seed)
    if method not in {*BASELINES, *OF_SEQUENCES}:
        raise InputError(f"{as_given('method', method)}: must be one of {', '.join({**BASELINES, **OF_SEQUENCES})}")
    path = Path(out)
    if path.suffix != ".npz":
        raise InputError(
            f"{as_given('out', str(out))}: predictions are a NumPy archive; name a file that ends in .npz"
        )
    manifest = read_manifest(suite)
    scene, found = (_of_scenes if manifest.frames is None else _of_sequences)(method, suite, split, seed)
    arrays: dict[str, Any] = {"scene": scene, "suite": str(manifest.config["name"])}
    for name, values in found.items():
        arrays[name] = values.astype("f4") if values.dtype.kind == "f" else values
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content.getvalue())
    return path


def _of_scenes(method: str, suite: str | Path, split: str, seed: int) -> tuple[Ints, Predicted]:
    """Indices of the scenes of a split, and what a baseline predicts for them."""
    _check_fits(method, BASELINES, f"{suite} holds single scenes")
    train, wanted = suite_scenes(suite, "train"), suite_scenes(suite, split)
    return wanted.scene, BASELINES[method](train, wanted, seed)


def _of_sequences(method: str, suite: str | Path, split: str, seed: int) -> tuple[Ints, Predicted]:
    """Indices of the sequences of a split, and what a baseline predicts for them."""
    _check_fits(method, OF_SEQUENCES, f"{suite} holds sequences")
    train, wanted = read_walks(suite, "train"), read_walks(suite, split)
    return wanted.scene, OF_SEQUENCES[method](train, wanted, seed)


def _check_fits(method: str, known: Collection[str], why: str) -> None:
    """Raise `InputError` for a method that is none of those known; why : what the dataset holds, as a clause."""
    if method not in known:
        raise InputError(f"{as_given('method', method)}: {why}; must be one of {', '.join(known)}")


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
