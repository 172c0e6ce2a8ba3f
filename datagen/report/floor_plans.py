"""What backprojection makes of what changes in a sequence: a floor plan of each frame."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from datagen.labels import ViewFrame
from datagen.labels.volumes import VoxelGrid
from datagen.reconstruction.backprojection import GEOMETRY, volumes_of_frames
from datagen.records import Rectangle
from datagen.records.arrays import Floats
from datagen.report.replay import StoredScene
from datagen.report.stored import time_of_stored

VOXELS = (40, 8, 40)
"""Voxels along (depth, row, column), of which a plan is the mean over the rows: some 0.1 m wide in a room of 4 m, so
that somebody is a few of them wide, and 0.3 m high, as what is looked for is several of them high."""


@dataclass(frozen=True)
class FloorPlans:
    """Floor plans of the frames of a sequence.

    values : (frame, depth, column) backprojection of the counts less their mean over the frames, in units of noise.
    corners : (depth + 1, column + 1, 2) x and y of the corners of its cells, metres.
    """

    values: Floats
    corners: Floats

    @classmethod
    def of(cls, stored: StoredScene) -> FloorPlans | None:
        """The floor plans of a stored sequence; None without counts, and where it is not known where these were
        measured or where the hidden part is."""
        needed = ("histogram", *GEOMETRY)
        if stored.frames is None or not all(name in stored.arrays for name in needed):
            return None
        where = {name: np.asarray(stored.arrays[name], np.float64) for name in GEOMETRY}
        if not all(np.isfinite(where[name]).all() for name in ("hidden_view", "hidden_bounds")):
            return None
        counts, time = np.asarray(stored.arrays["histogram"], np.float64), time_of_stored(stored, "histogram")
        capture = stored.config.capture.model_dump(mode="json")
        frame = ViewFrame.about(Rectangle(*where["hidden_view"]))
        grid, mean = VoxelGrid.behind_images(frame, where["hidden_bounds"], VOXELS), counts.mean(axis=0)
        volumes = volumes_of_frames(counts, where, stored.framed, capture, time, grid, mean)
        plans = [volume.mean(axis=1) * math.sqrt(VOXELS[1]) for volume in volumes]
        depth, right = (np.linspace(grid.low[k], grid.high[k], n + 1) for k, n in ((2, VOXELS[0]), (0, VOXELS[2])))
        across, along = np.meshgrid(right, depth)
        corners = frame.to_world(np.stack([across, np.zeros_like(across), along], axis=-1))
        return cls(np.array(plans), corners[..., :2])
