"""The scenes of a suite in memory, for baselines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from torch.utils.data import DataLoader

from datagen.errors import InputError
from datagen.labels.boxes import objects_seen
from datagen.loader import TransientDataset, collate
from datagen.records.arrays import Bools, Floats, Ints

FIELDS = ("depth", "part_id", "object_part", "object_box_center", "occupancy", "hidden_view")


@dataclass(frozen=True)
class SuiteScenes:
    """The scenes of one split.

    root : the dataset.
    scene : (N,) indices of the scenes.
    histogram : (N, laser, pixel, bin) counts.
    depth : (N, row, column) depth of the surface seen, metres.
    mask : (N, row, column) whether a pixel shows an object.
    occupancy : (N, depth, row, column) whether a voxel is inside an object.
    centers : (N, K, 3) middles of the objects' boxes in the label frame; NaN in rows without an object.
    view : (N, 2) half width and half height of the images, metres.
    """

    root: Path
    scene: Ints
    histogram: NDArray[np.float32]
    depth: NDArray[np.float32]
    mask: Bools
    occupancy: Bools
    centers: Floats
    view: Floats


def suite_scenes(root: str | Path, split: str) -> SuiteScenes:
    """All scenes of a split.

    Raises `InputError` if `root` is no dataset, has no such split, or lacks labels that are needed.
    """
    data = TransientDataset(root, ("histogram",), split=split)
    missing = [name for name in FIELDS if name not in data.fields]
    if missing:
        raise InputError(
            f"{root}: has no {', '.join(missing)}; store.fields must have depth, part_id, occupancy, objects"
        )
    data = TransientDataset(root, ("histogram", *FIELDS), split=split)
    (whole,) = DataLoader(data, len(data), collate_fn=collate)
    batch = {name: values.numpy() for name, values in whole.items()}
    mask = objects_seen(batch["part_id"], batch["object_part"]) >= 0
    centers = np.where((batch["object_part"] >= 0)[..., None], batch["object_box_center"].astype(np.float64), np.nan)
    view = np.linalg.norm(batch["hidden_view"][:, 1:].astype(np.float64), axis=-1)
    return SuiteScenes(
        Path(root), batch["scene"].astype(np.int64), batch["histogram"].astype(np.float32),
        batch["depth"].astype(np.float32), mask, batch["occupancy"] > 0, centers, view,
    )  # fmt: skip
