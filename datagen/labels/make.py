"""The labels of a scene that a dataset stores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from numpy.typing import NDArray

from datagen.config import LabelsConfig
from datagen.errors import InputError
from datagen.labels.boxes import ObjectBoxes, classes_in
from datagen.labels.images import HiddenSurface, albedo_image, depth_image, hidden_surface, normal_image, part_image
from datagen.labels.shading import shaded_image
from datagen.labels.solids import ConnectedSurface
from datagen.labels.volumes import VoxelGrid, object_surfaces, occupancy, signed_distance
from datagen.records import Scene

Array = NDArray[Any]

_IMAGES: dict[str, Callable[[HiddenSurface], Array]] = {
    "depth": depth_image,
    "normal": normal_image,
    "albedo": albedo_image,
    "part_id": part_image,
    "shaded": shaded_image,
}
_VOLUMES: dict[str, Callable[[VoxelGrid, list[ConnectedSurface]], Array]] = {
    "occupancy": occupancy,
    "sdf": signed_distance,
}

MADE_HERE = (*_IMAGES, *_VOLUMES, "objects")
"""The labels that `make_labels` makes. `objects` stands for several arrays (`OBJECT_TABLES`)."""


def make_labels(
    config: LabelsConfig, scene: Scene, fields: Sequence[str], classes: Sequence[str] | None = None,
    capacity: int | None = None, surface: HiddenSurface | None = None,
) -> dict[str, Array]:  # fmt: skip
    """Field → array of one scene's ground truth, aligned with the relay wall.

    `LABEL_FIELDS` of `datagen.records.label_fields` says what each array is.

    Images show `scene.hidden_view` orthographically along its normal, row 0 at the top, column 0 at −right, with the
    relay wall as a window. Volumes fill the box along the same axes that holds `scene.hidden_bounds`. `objects` gives
    the tables of `ObjectBoxes`, in the same frame, for these `classes` and `capacity` rows (left out: this scene's
    own). `surface` is the surface that the images show, if it is known already.

    Raises
    ------
    InputError : a field that is no label; a scene without `hidden_view`, `hidden_bounds` or `relay_wall`; more
        objects than rows.
    """
    for field in fields:
        if field not in MADE_HERE:
            raise InputError(f"labels: {field!r} is no label; known are {', '.join(MADE_HERE)}")
    labels: dict[str, Array] = {}
    if any(field in _IMAGES for field in fields):
        surface = hidden_surface(scene, config.rows, config.columns) if surface is None else surface
        labels |= {field: make(surface) for field, make in _IMAGES.items() if field in fields}
    if any(field in _VOLUMES for field in fields):
        grid, surfaces = VoxelGrid.of(scene, config.voxels), object_surfaces(scene)
        labels |= {field: make(grid, surfaces) for field, make in _VOLUMES.items() if field in fields}
    if "objects" in fields:
        classes = classes_in(scene) if classes is None else classes
        capacity = len(scene.objects) if capacity is None else capacity
        labels |= ObjectBoxes.of(scene, classes, capacity).tables()
    return labels
