"""The sequences of a suite in memory, as floor plans: for baselines that follow somebody."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.labels.frame import ViewFrame
from datagen.labels.volumes import VoxelGrid
from datagen.loader import TransientDataset
from datagen.records import Rectangle
from datagen.records.arrays import Floats, Ints
from datagen.store import read_manifest

VOXELS = (32, 16, 32)
"""Voxels of a volume along (depth, row, column), from which plans are made: a person is one to two wide."""
PLANS = ("upper", "lower")
"""Of what rows of a volume a plan is the mean: those of the upper or of the lower half."""
FIELDS = ("histogram", "objects", "hidden_view", "hidden_bounds")


@dataclass(frozen=True)
class Walks:
    """The sequences of one split, in each of which one object moves.

    root : the dataset.
    scene : (N,) indices of the scenes.
    plans : (N, F, plan, depth, column) floor plans, in units of the noise of a voxel; the middle axis is that of
        `PLANS`.
    low, high : (N, 2) corners of the plans along right and depth of the label frame, metres.
    centers, velocities : (N, F, 3) of the object's box in the label frame, metres and metres a second.
    sigma : (N,) significance of the change by the object, the median over the frames after the first.
    step_s : seconds from one frame to the next.
    """

    root: Path
    scene: Ints
    plans: NDArray[np.float32]
    low: Floats
    high: Floats
    centers: Floats
    velocities: Floats
    sigma: Floats
    step_s: float

    @property
    def shares(self) -> Floats:
        """(N, F, 2) where the object is in the plan: 0 at `low`, 1 at `high`."""
        place: Floats = self.centers[..., [0, 2]]
        return (place - self.low[:, None]) / (self.high - self.low)[:, None]

    @property
    def apart(self) -> Walks:
        """(N F) walks of a single frame each."""
        frames = self.plans.shape[1]
        low, high = (np.repeat(of, frames, axis=0) for of in (self.low, self.high))
        centers, velocities = (of.reshape(-1, 1, 3) for of in (self.centers, self.velocities))
        plans = self.plans.reshape(-1, 1, *self.plans.shape[2:])
        scene, sigma = np.repeat(self.scene, frames), np.repeat(self.sigma, frames)
        return Walks(self.root, scene, plans, low, high, centers, velocities, sigma, self.step_s)

    def at_mean_height(self, places: Floats) -> Floats:
        """(…, 3) right, up and depth of places (…, 2), as high as the objects of these walks in the mean, metres."""
        return np.insert(places, 1, self.centers[..., 1].mean(), axis=-1)

    def metres(self, shares: Floats) -> Floats:
        """(N, F, 2) right and depth in the label frame of places in the plans, metres: the inverse of `shares`."""
        return self.low[:, None] + shares * (self.high - self.low)[:, None]


def read_walks(root: str | Path, split: str, minus: str = "mean") -> Walks:
    """All sequences of a split.

    minus : what is taken off the counts before they are backprojected, as for `TransientDataset`: `"mean"`, their
        mean over the frames, which leaves what changes; or `"scan"`, which leaves each frame by itself.

    Raises `InputError` if `root` is no dataset, has no such split, lacks labels that are needed, or has scenes in
    which no object moves or several do.
    """
    data = TransientDataset(root, ("histogram",), split=split)
    missing = [name for name in ("object_velocity", "hidden_bounds") if name not in data.fields]
    if missing:
        raise InputError(f"{root}: has no {', '.join(missing)}; store.fields must have histogram and objects")
    data = TransientDataset(root, FIELDS, split=split, representation="volume", voxels=VOXELS, minus=minus)
    plans, corners, tracks, sigma = [], [], [], []
    for number in range(len(data)):
        item = {name: np.asarray(values) for name, values in data[number].items()}
        plans.append(floor_plans(item["volume"]))
        frame = ViewFrame.about(Rectangle(*item["hidden_view"].astype(np.float64)))
        grid = VoxelGrid.behind_images(frame, item["hidden_bounds"].astype(np.float64), VOXELS)
        corners.append((grid.low[[0, 2]], grid.high[[0, 2]]))
        moves = np.flatnonzero(item["object_velocity"].any(axis=(0, 2)))
        if len(moves) != 1:
            raise InputError(
                f"{root}: {len(moves)} objects move in scene {item['scene']}, and baselines follow one; build scenes "
                "in which one does"
            )
        tracks.append([item[name][:, moves[0]] for name in ("object_box_center", "object_velocity")])
        sigma.append(np.median(item["object_change"][1:, moves[0]]))
    low, high = np.array(corners).swapaxes(0, 1)
    centers, velocities = np.array(tracks, np.float64).swapaxes(0, 1)
    sequence = read_manifest(root).config["sequence"]
    return Walks(
        Path(root), data.scenes, np.array(plans), low, high, centers, velocities, np.array(sigma, np.float64),
        1.0 / float(sequence["rate_hz"]),
    )  # fmt: skip


def floor_plans(volumes: NDArray[np.float32]) -> NDArray[np.float32]:
    """(F, plan, depth, column) plans of volumes (F, depth, row, column), in the order of `PLANS`.

    A mean is taken times the root of the number of rows, so that its noise is like that of one voxel.
    """
    halves = np.array_split(volumes, 2, axis=2)
    return np.stack([half.mean(axis=2) * np.float32(math.sqrt(half.shape[2])) for half in halves], axis=1)
