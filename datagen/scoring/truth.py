"""The truth that predictions of single scenes are compared with: the labels of a split, and which objects have
evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.labels.boxes import objects_seen
from datagen.records.arrays import Bools, Floats, Ints
from datagen.records.checks import as_given
from datagen.store import DatasetReader, Manifest
from datagen.store.location import location_of
from datagen.store.summaries import LEAST
from datagen.store.table import read_table

NEEDED = (
    "depth", "part_id", "object_part", "object_box_center", "object_significance", "hidden_view", "hidden_bounds",
)  # fmt: skip


@dataclass(frozen=True)
class Truth:
    """The labels of the scenes of one split.

    manifest : the dataset's manifest.
    scenes : (N,) indices of the scenes.
    depth : (N, R, C) metres.
    shows : (N, R, C) row of the object that a pixel shows in the table of objects; −1 for no object.
    occupancy : (N, D, H, W), or None if the dataset has none.
    centers : (N, K, 3) middles of the objects' boxes in the label frame, metres; NaN in rows without an object.
    sigma : (N, K) significance of the objects; NaN in rows without an object.
    view : (N, 2) half width and half height of the images, metres.
    span, reach : (N,) diagonal and depth of the hidden part, metres.
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
        """(N, K) whether an object has evidence, a significance of `LEAST` or more."""
        return np.nan_to_num(self.sigma) >= LEAST

    @property
    def all_evident(self) -> Bools:
        """(N,) whether every object of a scene has evidence."""
        return np.asarray((self.evident | np.isnan(self.sigma)).all(axis=1))


def scenes_of_split(dataset: str | Path, manifest: Manifest, split: str) -> list[int]:
    """Indices of the scenes of a split that did not fail; raises `InputError` if there are none."""
    table = read_table(location_of(dataset), ["split", "failure"], manifest.schema.scenes)
    splits = table["split"].to_pylist()
    scenes = [k for k, name in enumerate(splits) if name == split and table["failure"][k].as_py() is None]
    if not scenes:
        there = ", ".join(sorted({str(name) for name in splits if name}))
        raise InputError(f"{as_given('split', split)}: {dataset} has {there or 'no scenes'}")
    return scenes


def labels_of(
    dataset: str | Path, manifest: Manifest, scenes: Sequence[int], names: Sequence[str]
) -> dict[str, Any]:  # fmt: skip
    """Field → its values (N, …) in some scenes; raises `CheckError` if they are damaged."""
    reader = DatasetReader(location_of(dataset), manifest, list(names))
    return {name: reader.read(name, scenes) for name in names}


def read_truth(dataset: str | Path, manifest: Manifest, split: str) -> Truth:
    """The labels of one split of a dataset of single scenes.

    Raises `InputError` if it has no such split, or lacks labels that scores need; `CheckError` if it is damaged.
    """
    fields = manifest.schema.by_name
    missing = [name for name in NEEDED if name not in fields]
    if missing:
        raise InputError(f"{dataset}: has no {', '.join(missing)}; build with store.fields depth, part_id, objects")
    scenes = scenes_of_split(dataset, manifest, split)
    got = labels_of(dataset, manifest, scenes, [*NEEDED, *(["occupancy"] if "occupancy" in fields else [])])
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
