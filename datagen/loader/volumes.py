"""Histograms as volumes: backprojections over the hidden part of each scene."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError, shown
from datagen.labels.frame import ViewFrame
from datagen.labels.volumes import VoxelGrid
from datagen.loader.crops import Crops
from datagen.reconstruction.backprojection import GEOMETRY, volumes_of_frames
from datagen.records import Rectangle
from datagen.store import Manifest

MOST_VOXELS = 2**26
"""The most voxels of a volume, 256 MiB of float32: some 400³."""


class Volumes:
    """Backprojects the histograms of a dataset onto the space behind its label images.

    shape : number of voxels along (depth, row, column).

    Raises `InputError` for an invalid shape, and if the dataset does not say where its measurement was made.
    """

    def __init__(
        self, manifest: Manifest, crops: Crops, shape: tuple[int, int, int], minus: str = "scan"
    ) -> None:  # fmt: skip
        whole = isinstance(shape, tuple | list) and all(isinstance(n, int) and n > 0 for n in shape)
        if not whole or len(shape) != 3 or math.prod(shape) > MOST_VOXELS:
            raise InputError(
                f"voxels = {shown(shape)}: must be three whole numbers ≥ 1 along (depth, row, column), "
                f"{MOST_VOXELS} voxels at most, such as (32, 32, 32)"
            )
        missing = [name for name in GEOMETRY if name not in manifest.schema.by_name]
        if missing:
            raise InputError(f"representation = 'volume': this dataset has no {', '.join(missing)}, which it needs")
        self.shape = (shape[0], shape[1], shape[2])
        if minus == "mean" and manifest.frames is None:
            raise InputError("minus = 'mean': the dataset has no sequences whose mean over frames could be taken off")
        self._minus = minus
        self._capture = manifest.config["capture"]
        self._framed = [name for name in GEOMETRY if manifest.schema.by_name[name].frame_bytes is not None]
        self._time = manifest.time
        if "bin" in crops.chosen:
            first, bins = float(crops.chosen["bin"][0]), len(crops.chosen["bin"])
            self._time = replace(self._time, bins=bins, start_s=self._time.start_s + first * self._time.width_s)

    def backproject(
        self, scenes: Sequence[int], counts: NDArray[Any], geometry: Mapping[str, NDArray[Any]]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(N, depth, row, column) volumes of N scenes, from counts (N, laser, pixel, bin) and the fields `GEOMETRY`;
        of sequences (N, frame, …), from counts (N, frame, …). And (N, 2, 3) lowest and highest corner of each volume
        along right, up and depth of the label frame, metres.

        Raises `InputError` for a scene that does not say where its hidden part is.
        """
        volumes = np.empty((*counts.shape[:-3], *self.shape), np.float32)
        bounds_m = np.empty((len(counts), 2, 3), np.float32)
        for row, histograms in enumerate(counts):
            where = {name: values[row].astype(np.float64) for name, values in geometry.items()}
            view, bounds = where["hidden_view"], where["hidden_bounds"]
            if not (np.isfinite(view).all() and np.isfinite(bounds).all()):
                raise InputError(
                    f"representation = 'volume': scene {scenes[row]} has no hidden_view and hidden_bounds; give them "
                    "to Scene.from_parts, or take another representation"
                )
            grid = VoxelGrid.behind_images(ViewFrame.about(Rectangle(*view)), bounds, self.shape)
            bounds_m[row] = grid.low, grid.high
            # With the mean over the frames taken off, what stands is gone, and the signal is whitened by that mean.
            mean = histograms.mean(axis=0) if self._minus == "mean" else None
            made = volumes_of_frames(histograms, where, self._framed, self._capture, self._time, grid, mean)
            for out, volume in zip(volumes[row].reshape(-1, *self.shape), made, strict=True):
                out[:] = volume
        return volumes, bounds_m
