"""The frame of all labels: the rectangle `Scene.hidden_view` and the depth behind it.

An image has row 0 at the top (+up) and column 0 at −right, as `Sensor.grid` numbers its pixels. It shows the hidden
part, which lies opposite the scan if objects stand before it, and beside the scan if they stand behind a corner
(`scan_place` gives the offset). Its values belong to pixel centres. A volume has the axes (depth, row, column): slice
`[k]` is an image, and `k` counts away from the wall.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.records import Rectangle, Scene
from datagen.records.arrays import Bools, Floats


@dataclass(frozen=True)
class ViewFrame:
    """An orthonormal, right-handed frame (right, up, normal) at the centre of a rectangle.

    center : (3,) centre of the rectangle, metres.
    axes : (3, 3) unit vectors right, up, normal = right × up as rows.
    half_width_m, half_height_m : half extents of the rectangle.
    """

    center: Floats
    axes: Floats
    half_width_m: float
    half_height_m: float

    @classmethod
    def of(cls, scene: Scene) -> ViewFrame:
        """The frame of `scene.hidden_view`; raises `InputError` if that is missing or has no area."""
        view = scene.hidden_view
        if view is None:
            raise InputError(
                "labels: this scene has no hidden_view, the rectangle from which label images are seen; "
                "give Scene.from_parts(..., hidden_view=Rectangle.of(center, right, up))"
            )
        return cls.about(view)

    @classmethod
    def about(cls, view: Rectangle) -> ViewFrame:
        """The frame at the centre of a rectangle; raises `InputError` if it has no area."""
        width, height = float(np.linalg.norm(view.right)), float(np.linalg.norm(view.up))
        if not (0 < width < np.inf and 0 < height < np.inf):
            raise InputError(
                f"Scene.hidden_view: half extents {width:g} m × {height:g} m; both must be positive and finite"
            )
        right, up = view.right / width, view.up / height
        normal = np.cross(right, up)
        axes = np.stack([right, up, normal / np.linalg.norm(normal)])
        return cls(np.asarray(view.center, np.float64), axes, width, height)

    def to_view(self, points: Floats) -> Floats:
        """(..., 3) metres along right, up and depth from the centre of the rectangle, of world points (..., 3)."""
        return (points - self.center) @ self.axes.T

    def to_world(self, points: Floats) -> Floats:
        """(..., 3) world points of view coordinates (..., 3): the inverse of `to_view`."""
        return points @ self.axes + self.center


def pixel_places(rows: int, columns: int, half_width_m: float, half_height_m: float) -> Floats:
    """(rows · columns, 2) right and up, in metres of the label frame, of the centres of image pixels, row by row."""
    right = (2 * (np.arange(columns) + 0.5) / columns - 1) * half_width_m
    up = (1 - 2 * (np.arange(rows) + 0.5) / rows) * half_height_m
    return np.stack(np.meshgrid(right, up), axis=-1).reshape(-1, 2)


def image_points(depth: NDArray[Any], mask: Bools, half_width_m: float, half_height_m: float) -> Floats:
    """(N, 3) right, up and depth, in metres of the label frame, of the centres of the image pixels in `mask`."""
    seen = mask.reshape(-1)
    rows, columns = depth.shape
    at = pixel_places(rows, columns, half_width_m, half_height_m)[seen]
    return np.concatenate([at, depth.reshape(-1, 1)[seen].astype(np.float64)], axis=-1)


def scan_place(view: Rectangle, laser_points: Floats) -> tuple[float, float] | None:
    """Metres right and up from the middle of the label images (`Scene.hidden_view`) to the middle of the scan; None
    if there is no laser point.

    laser_points : (L, 3), NaN where a laser ray meets nothing.
    """
    on_surfaces = laser_points[np.isfinite(laser_points).all(axis=1)]
    if not len(on_surfaces):
        return None
    in_view = ViewFrame.about(view).to_view(on_surfaces)
    right, up = (in_view.min(axis=0) + in_view.max(axis=0))[:2] / 2
    # Rounded to a nanometre, for further digits differ between processors.
    return round(float(right), 9) + 0.0, round(float(up), 9) + 0.0
