"""Grids of voxels over the hidden part, in the label frame: right, up, depth from the middle of `hidden_view`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from datagen.labels.frame import ViewFrame
from datagen.records import Rectangle
from datagen.records.arrays import Floats


def label_frame(hidden_view: Floats) -> Callable[[Floats], Floats]:
    """A function from points (..., 3) of the scene to the label frame; `hidden_view` (3, 3) is the stored field."""
    return ViewFrame.about(Rectangle(*hidden_view)).to_view


@dataclass(frozen=True)
class HiddenGrid:
    """A box of voxels in the label frame.

    low, high : (3,) its corners along (right, up, depth), metres. shape : number of voxels along (depth, row,
    column); row 0 is at the top.
    """

    low: Floats
    high: Floats
    shape: tuple[int, int, int]

    @classmethod
    def of_volumes(cls, view: Floats, bounds: Floats, shape: tuple[int, int, int]) -> HiddenGrid:
        """The grid of the label `occupancy`: the smallest box around `hidden_bounds` (2, 3)."""
        corners = label_frame(view)(np.stack(np.meshgrid(*bounds.T, indexing="ij"), axis=-1).reshape(8, 3))
        return cls(corners.min(axis=0), corners.max(axis=0), shape)

    @classmethod
    def behind_images(cls, view: Floats, bounds: Floats, shape: tuple[int, int, int]) -> HiddenGrid:
        """The grid behind the label images, with their width and height, and as deep as the hidden part."""
        far = cls.of_volumes(view, bounds, shape).high[2]
        half = np.linalg.norm(view[1:], axis=1)
        return cls(np.array([-half[0], -half[1], 0.0]), np.array([half[0], half[1], far]), shape)

    @property
    def depths(self) -> Floats:
        """(depth,) middles of the layers, metres."""
        share = (np.arange(self.shape[0]) + 0.5) / self.shape[0]
        return np.asarray(self.low[2] + share * (self.high[2] - self.low[2]))

    @property
    def centers(self) -> Floats:
        """(depth, row, column, 3) middles of the voxels, metres."""
        depth, row, column = ((np.arange(n) + 0.5) / n for n in self.shape)
        z, y, x = np.meshgrid(depth, 1 - row, column, indexing="ij")
        return self.low + np.stack([x, y, z], axis=-1) * (self.high - self.low)
