"""The objects of a scene and their oriented boxes, as tables that have the same length in all scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.labels.frame import ViewFrame
from datagen.records import Pose, Scene
from datagen.records.arrays import Floats, Ints
from datagen.records.label_fields import names_made_by

OBJECT_TABLES = names_made_by("labels.boxes")
NO_OBJECT = -1
"""Class and part in a row without an object; its box is all zeros."""


@dataclass(frozen=True)
class ObjectBoxes:
    """The objects of one scene in the order of its parts; rows beyond `count` hold no object.

    count : number of objects.
    label : (K,) int16 class, an index into the dataset's list of classes; −1 in rows without an object.
    part : (K,) int16 index into `Scene.part_names`, as in the label `part_id`; −1 in rows without an object.
    center : (K, 3) float32 middle of the box along (right, up, depth) of the label frame, metres.
    size : (K, 3) float32 full extents along the object's own width, depth and height, metres.
    rotation : (K, 3, 3) float32; its columns are those own axes in the label frame, so a box corner is
        `center + rotation @ (± size / 2)`. Rows without an object are zeros.
    """

    count: int
    label: NDArray[np.int16]
    part: NDArray[np.int16]
    center: NDArray[np.float32]
    size: NDArray[np.float32]
    rotation: NDArray[np.float32]

    @classmethod
    def of(cls, scene: Scene, classes: Sequence[str], capacity: int) -> ObjectBoxes:
        """The bounding boxes of the objects' vertices along the axes of `Scene.poses`.

        Raises `InputError` for more objects than `capacity`, or for a class that is not in `classes`.
        """
        frame = ViewFrame.of(scene)
        parts = [k for k, role in enumerate(scene.roles) if role == "object"]
        if len(parts) > capacity:
            raise InputError(f"label 'objects': {len(parts)} objects in a scene, the table has room for {capacity}")
        label, part = np.full(capacity, NO_OBJECT, np.int16), np.full(capacity, NO_OBJECT, np.int16)
        center, size = np.zeros((capacity, 3), np.float32), np.zeros((capacity, 3), np.float32)
        rotation = np.zeros((capacity, 3, 3), np.float32)
        for row, k in enumerate(parts):
            pose = scene.pose_of(scene.part_names[k])
            if pose.label not in classes:
                raise InputError(f"label 'objects': class {pose.label!r} is none of {', '.join(classes)}")
            low, high = _corners_of_box(scene, k, pose)
            label[row], part[row] = classes.index(pose.label), k
            center[row], size[row] = frame.to_view((low + high) / 2 @ pose.axes), high - low
            rotation[row] = frame.axes @ pose.axes.T
        return cls(len(parts), label, part, center, size, rotation)

    @classmethod
    def from_tables(cls, tables: dict[str, NDArray[Any]]) -> ObjectBoxes:
        """The boxes whose `tables` are these."""
        count, *rest = (np.asarray(tables[name]) for name in OBJECT_TABLES)
        return cls(int(count), *rest)

    def tables(self) -> dict[str, NDArray[Any]]:
        """Field → array, in the order of `OBJECT_TABLES`."""
        values = (np.int32(self.count), self.label, self.part, self.center, self.size, self.rotation)
        return {name: np.asarray(value) for name, value in zip(OBJECT_TABLES, values, strict=True)}

    def corners(self) -> Floats:
        """(count, 8, 3) corners of the boxes along (right, up, depth). Corner k lies on the positive side of the
        box's width, depth or height if bit 0, 1 or 2 of k is set."""
        sides = np.array([[k & 1, k >> 1 & 1, k >> 2 & 1] for k in range(8)]) - 0.5
        n = self.count
        offset = sides * self.size[:n, None].astype(np.float64)
        return np.asarray(self.center[:n, None] + np.einsum("nij,nkj->nki", self.rotation[:n], offset))


def middle_of_box(scene: Scene, part: str) -> Floats:
    """(3,) middle of the box of a part, in the scene, metres."""
    pose = scene.pose_of(part)
    low, high = _corners_of_box(scene, scene.part_names.index(part), pose)
    return np.asarray((low + high) / 2 @ pose.axes)


def _corners_of_box(scene: Scene, part: int, pose: Pose) -> tuple[Floats, Floats]:
    """Two opposite corners of the bounding box of a part's vertices along the axes of its pose."""
    own = scene.vertices[np.unique(scene.triangles[scene.face_part == part])] @ pose.axes.T
    return own.min(axis=0), own.max(axis=0)


def classes_in(scene: Scene) -> tuple[str, ...]:
    """Names of the classes of a scene's objects, sorted."""
    return tuple(sorted({scene.pose_of(name).label for name in scene.objects}))


def objects_seen(part_id: NDArray[np.integer[Any]], object_part: NDArray[np.integer[Any]]) -> Ints:
    """(N, row, column) row of the object tables whose object a pixel shows, −1 for no object.

    part_id : (N, row, column) and object_part : (N, K), with −1 in rows without an object: labels of N scenes.
    """
    listed = object_part[:, None, None]
    same = (part_id[..., None] == listed) & (listed >= 0)
    return np.where(same.any(axis=-1), same.argmax(axis=-1), -1)
