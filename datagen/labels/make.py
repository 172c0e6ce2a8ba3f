"""The labels of a scene that a dataset stores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
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


@dataclass(frozen=True)
class Truth:
    """What the labels of a scene are made of. What several of them need is found once.

    classes, capacity : of the tables of objects, the names of classes and the number of rows; None: this scene's own.
    """

    config: LabelsConfig
    scene: Scene
    classes: Sequence[str] | None = None
    capacity: int | None = None

    @cached_property
    def surface(self) -> HiddenSurface:
        """The surface that images show."""
        return hidden_surface(self.scene, self.config.rows, self.config.columns)

    @cached_property
    def grid(self) -> VoxelGrid:
        """The voxels of volumes."""
        return VoxelGrid.of(self.scene, self.config.voxels)

    @cached_property
    def solids(self) -> list[ConnectedSurface]:
        """The surfaces of objects."""
        return object_surfaces(self.scene)

    def objects(self) -> dict[str, Array]:
        """The tables of `ObjectBoxes`."""
        classes = classes_in(self.scene) if self.classes is None else self.classes
        capacity = len(self.scene.objects) if self.capacity is None else self.capacity
        return ObjectBoxes.of(self.scene, classes, capacity).tables()


LABEL_MAKERS: dict[str, Callable[[Truth], dict[str, Array]]] = {
    "depth": lambda of: {"depth": depth_image(of.surface)},
    "normal": lambda of: {"normal": normal_image(of.surface)},
    "albedo": lambda of: {"albedo": albedo_image(of.surface)},
    "part_id": lambda of: {"part_id": part_image(of.surface)},
    "shaded": lambda of: {"shaded": shaded_image(of.surface)},
    "occupancy": lambda of: {"occupancy": occupancy(of.grid, of.solids)},
    "sdf": lambda of: {"sdf": signed_distance(of.grid, of.solids)},
    "objects": Truth.objects,
}
"""Label that needs the scene alone → its arrays."""


def make_labels(
    config: LabelsConfig, scene: Scene, fields: Sequence[str], classes: Sequence[str] | None = None,
    capacity: int | None = None,
) -> dict[str, Array]:  # fmt: skip
    """Field → array of one scene's ground truth, aligned with the relay wall.

    `LABEL_FIELDS` of `datagen.records.label_fields` says what each array is.

    Images show `scene.hidden_view` orthographically along its normal, row 0 at the top, column 0 at −right, with the
    relay wall as a window. Volumes fill the box along the same axes that holds `scene.hidden_bounds`. `objects` gives
    the tables of `ObjectBoxes`, in the same frame, for these `classes` and `capacity` rows (left out: this scene's
    own).

    Raises
    ------
    InputError : a field that is no label; a scene without `hidden_view`, `hidden_bounds` or `relay_wall`; more
        objects than rows.
    """
    for field in fields:
        if field not in LABEL_MAKERS:
            raise InputError(f"labels: {field!r} is no label; known are {', '.join(LABEL_MAKERS)}")
    labels, truth = dict[str, Array](), Truth(config, scene, classes, capacity)
    for field in fields:
        labels |= LABEL_MAKERS[field](truth)
    return labels
