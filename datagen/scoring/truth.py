"""The truth that predictions are scored against: labels of one split, and which objects have evidence."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.labels.boxes import objects_seen
from datagen.records.arrays import Bools, Floats, Ints
from datagen.store import DatasetReader, Manifest, read_manifest
from datagen.store.location import location_of
from datagen.store.table import read_table

NEEDED = (
    "depth", "part_id", "object_part", "object_box_center", "object_significance", "hidden_view", "hidden_bounds",
)  # fmt: skip
LEAST_SIGMA = 3.0
"""Standard deviations over the noise from which an object counts as having evidence; with half as many one empty
room in 15 would seem to have an object."""


@dataclass(frozen=True)
class Truth:
    """The labels of the scenes of one split.

    Attributes
    ----------
    manifest : of the dataset.
    scenes : (N,) their numbers.
    depth : (N, R, C) metres; shows : (N, R, C) row of the table of objects that a pixel shows, −1 for none.
    occupancy : (N, D, H, W), or None where the dataset has none.
    centers : (N, K, 3) middles of the objects' boxes in the label frame, metres; sigma : (N, K) their significance,
        NaN in rows without an object.
    view : (N, 2) half width and half height of the images, metres; span : (N,) diagonal of the hidden part; reach :
        (N,) its depth.
    """

    manifest: Manifest
    scenes: Ints
    depth: NDArray[np.float32]
    shows: Ints
    occupancy: NDArray[np.uint8] | None
    centers: Floats
    sigma: Floats
    view: Floats
    span: Floats
    reach: Floats

    @property
    def on_object(self) -> Bools:
        """(N, R, C) whether a pixel shows an object."""
        return self.shows >= 0

    @property
    def on_evident(self) -> Bools:
        """(N, R, C) whether a pixel shows an object that has evidence."""
        found = np.take_along_axis(self.evident, np.maximum(self.shows, 0).reshape(len(self.scenes), -1), axis=1)
        return found.reshape(self.shows.shape) & self.on_object

    @property
    def evident(self) -> Bools:
        """(N, K) whether an object has evidence."""
        return np.nan_to_num(self.sigma) >= LEAST_SIGMA

    @property
    def all_evident(self) -> Bools:
        """(N,) whether every object of a scene has evidence."""
        return np.asarray((self.evident | np.isnan(self.sigma)).all(axis=1))


def read_truth(dataset: str | Path, split: str) -> Truth:
    """The labels of one split of a dataset.

    Raises `InputError` where it is no dataset, has no such split, or lacks labels that scores need; `CheckError` for
    what is damaged.
    """
    root, manifest = location_of(dataset), read_manifest(dataset)
    fields = manifest.schema.by_name
    missing = [name for name in NEEDED if name not in fields]
    if missing:
        raise InputError(f"{dataset}: has no {', '.join(missing)}; build with store.fields depth, part_id, objects")
    table = read_table(root, ["split", "failure"], manifest.schema.scenes)
    splits = table["split"].to_pylist()
    scenes = [k for k, of in enumerate(splits) if of == split and table["failure"][k].as_py() is None]
    if not scenes:
        there = ", ".join(sorted({str(of) for of in splits if of}))
        raise InputError(f"--split {split}: {dataset} has {there or 'no scenes'}")
    volume = ["occupancy"] if "occupancy" in fields else []
    reader = DatasetReader(root, manifest, [*NEEDED, *volume])
    got: dict[str, Any] = {name: reader.read(name, scenes) for name in (*NEEDED, *volume)}
    there = got["object_part"] >= 0
    shows = objects_seen(got["part_id"], got["object_part"])
    view = np.linalg.norm(got["hidden_view"][:, 1:], axis=-1)
    normal = np.cross(got["hidden_view"][:, 1] / view[:, :1], got["hidden_view"][:, 2] / view[:, 1:])
    sides = got["hidden_bounds"][:, 1] - got["hidden_bounds"][:, 0]
    return Truth(
        manifest, np.array(scenes), got["depth"], shows, got.get("occupancy"),
        np.where(there[..., None], got["object_box_center"], np.nan),
        np.where(there, got["object_significance"], np.nan), view, np.linalg.norm(sides, axis=1),
        np.abs(normal * sides).sum(axis=1),
    )  # fmt: skip
