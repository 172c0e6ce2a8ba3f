"""How fast the objects of a sequence move and turn, as tables like those of their boxes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.labels.boxes import middle_of_box
from datagen.labels.frame import ViewFrame
from datagen.records import Scene
from datagen.records.arrays import Floats
from datagen.records.label_fields import names_made_by

MOTION_TABLES = names_made_by("labels.motion")


def motion_tables(scene: Scene, times_s: Floats, rows: int) -> dict[str, NDArray[Any]]:
    """Field → (F, rows, 3) float32 velocity of the middle of each object's box, and angular velocity, along (right,
    up, depth) of the label frame, at F times; 0 for objects that stand and in rows without an object."""
    frame = ViewFrame.of(scene)
    velocity, turning = np.zeros((2, len(times_s), rows, 3))
    for row, name in enumerate(scene.objects):
        if name not in scene.moving:
            continue
        path, middles = scene.paths[name], scene.moves(name, times_s).apply(middle_of_box(scene, name))
        velocity[:, row] = path.velocity(times_s, at=middles) @ frame.axes.T
        turning[:, row] = path.turning(times_s)[:, None] * frame.axes[:, 2]
    return dict(zip(MOTION_TABLES, (velocity.astype(np.float32), turning.astype(np.float32)), strict=True))
