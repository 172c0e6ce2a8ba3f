"""Grids of voxels over the hidden part, and the volume labels of its objects: occupancy and signed distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.labels.frame import ViewFrame
from datagen.labels.raster import cut_voxels, enclosed_voxels
from datagen.labels.solids import ConnectedSurface, connected_surfaces
from datagen.labels.triangles import Triangles
from datagen.records import Scene
from datagen.records.arrays import Bools, Floats, Ints


@dataclass(frozen=True)
class VoxelGrid:
    """A box of voxels along the axes of the label frame.

    frame : the label frame.
    low, high : (3,) corners of the box along (right, up, depth) of the frame, metres.
    shape : voxels along (depth, row, column); row 0 is at the top, column 0 at −right, layer 0 next to the wall.
    """

    frame: ViewFrame
    low: Floats
    high: Floats
    shape: tuple[int, int, int]

    @classmethod
    def of(cls, scene: Scene, voxels: tuple[int, int, int]) -> VoxelGrid:
        """The grid of the smallest box along the frame's axes that holds `scene.hidden_bounds`."""
        if scene.hidden_bounds is None:
            raise InputError(
                "labels 'occupancy' and 'sdf': this scene has no hidden_bounds, the box that holds the hidden part; "
                "give Scene.from_parts(..., hidden_bounds=[[x0, y0, z0], [x1, y1, z1]])"
            )
        grid = cls.around(ViewFrame.of(scene), scene.hidden_bounds, voxels)
        if not (grid.high - grid.low > 0).all() or not np.isfinite(grid.high - grid.low).all():
            raise InputError(
                f"Scene.hidden_bounds = {scene.hidden_bounds.tolist()}: must span a volume in all three directions"
            )
        return grid

    @classmethod
    def around(cls, frame: ViewFrame, bounds: Floats, shape: tuple[int, int, int]) -> VoxelGrid:
        """The grid of the smallest box along the frame's axes that holds the box `bounds` (2, 3) of the scene."""
        corners = frame.to_view(np.stack(np.meshgrid(*bounds.T, indexing="ij"), axis=-1).reshape(8, 3))
        return cls(frame, corners.min(axis=0), corners.max(axis=0), shape)

    @classmethod
    def behind_images(cls, frame: ViewFrame, bounds: Floats, shape: tuple[int, int, int]) -> VoxelGrid:
        """The grid behind the label images, with their width and height, and as deep as the hidden part."""
        half, far = (frame.half_width_m, frame.half_height_m), cls.around(frame, bounds, shape).high[2]
        return cls(frame, np.array([-half[0], -half[1], 0.0]), np.array([*half, far]), shape)

    @property
    def voxel_m(self) -> Floats:
        """(3,) size of a voxel along (depth, row, column), metres."""
        return (self.high - self.low)[[2, 1, 0]] / self.shape

    def to_voxels(self, points: Floats) -> Floats:
        """(..., 3) column, row and depth in voxels (centres at +½) of points (..., 3) of the label frame."""
        layers, rows, columns = self.shape
        share = (points - self.low) / (self.high - self.low)
        return np.stack([share[..., 0] * columns, (1 - share[..., 1]) * rows, share[..., 2] * layers], axis=-1)

    @property
    def depths(self) -> Floats:
        """(depth,) middles of the layers, metres."""
        return np.asarray(self.low[2] + (np.arange(self.shape[0]) + 0.5) * self.voxel_m[0])

    @property
    def centers(self) -> Floats:
        """(depth, row, column, 3) middles of the voxels in the label frame, metres."""
        return self.middles(*np.indices(self.shape))

    def middles(self, layer: Ints, row: Ints, column: Ints) -> Floats:
        """(…, 3) middles of voxels in the label frame, metres."""
        layers, rows, columns = self.shape
        share = [(column + 0.5) / columns, 1 - (row + 0.5) / rows, (layer + 0.5) / layers]
        return self.low + np.stack(np.broadcast_arrays(*share), axis=-1) * (self.high - self.low)


def object_surfaces(scene: Scene) -> list[ConnectedSurface]:
    """The connected surfaces of all parts with the role `object`, part by part, in the label frame."""
    corners, surfaces = ViewFrame.of(scene).to_view(scene.corners), list[ConnectedSurface]()
    for part, role in enumerate(scene.roles):
        if role == "object":
            surfaces += connected_surfaces(corners[scene.face_part == part])
    return surfaces


def occupancy(grid: VoxelGrid, surfaces: list[ConnectedSurface]) -> NDArray[np.uint8]:
    """(depth, row, column) 1 where an object is, else 0.

    A voxel is occupied if its centre lies inside a closed surface, so that volumes are right on average. Surfaces
    that enclose nothing, or are thinner than a voxel (a panel, a letter) and may pass between the centres, occupy
    every voxel that they touch.
    """
    occupied = np.zeros(grid.shape, np.bool_)
    thinnest = float(grid.voxel_m.min())
    for surface in surfaces:
        if surface.closed:
            occupied |= _is_enclosed(grid, surface)
        if surface.mean_thickness_m < thinnest:
            occupied |= cut_voxels(grid.to_voxels(surface.corners), grid.shape)
    return occupied.astype(np.uint8)


def signed_distance(grid: VoxelGrid, surfaces: list[ConnectedSurface]) -> NDArray[np.float32]:
    """(depth, row, column) metres from the voxel centre to the nearest object surface, negative inside a closed one.

    Open surfaces enclose nothing, so their distance is positive on both sides. Where closed surfaces overlap, the
    result is the least of their signed distances: it is exact outside, and inside never larger in magnitude than the
    true distance. Without an object every distance is the diagonal of the grid, the largest distance in it.
    """
    if not surfaces:
        return np.full(grid.shape, np.linalg.norm(grid.high - grid.low), np.float32)
    smallest = np.empty(grid.shape, np.float32)
    every = Triangles(np.concatenate([surface.corners for surface in surfaces]))
    rows_and_columns = np.indices(grid.shape[1:])
    # Layer by layer, which bounds the memory of the finest grids.
    for layer in range(grid.shape[0]):
        smallest[layer] = every.distances(grid.middles(np.array(layer), *rows_and_columns))
    for surface in (surface for surface in surfaces if surface.closed):
        # Inside a solid only its own surface counts, even if another one is nearer.
        inside = np.nonzero(_is_enclosed(grid, surface))
        own = Triangles(surface.corners).distances(grid.middles(*inside))
        smallest[inside] = np.minimum(smallest[inside], -own)
    return smallest


def _is_enclosed(grid: VoxelGrid, surface: ConnectedSurface) -> Bools:
    """(depth, row, column) whether a closed surface encloses a voxel's centre."""
    return enclosed_voxels(grid.to_voxels(np.concatenate([surface.corners, surface.lid])), grid.shape)
