"""The section `labels`: which ground truth stands beside the measurement."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from datagen.config.base import Settings

Voxels = Annotated[int, Field(ge=1, le=1024)]


class LabelsConfig(Settings):
    """Label images look from the plane of the relay wall into the hidden part, orthographically. Which labels a
    dataset holds is said in `store.fields`."""

    rows: Annotated[int, Field(ge=1, le=4096)] = 64
    """Pixels of the label images from top to bottom."""
    columns: Annotated[int, Field(ge=1, le=4096)] = 64
    """Pixels of the label images from left to right, as seen from the room."""
    voxels: tuple[Voxels, Voxels, Voxels] = (32, 32, 32)
    """Voxels of the volume labels: along depth (away from the wall), rows (downwards), columns."""

    def _check(self) -> None:
        depth, rows, columns = self.voxels
        if depth * rows * columns > 2**26:
            raise ValueError(
                f"voxels = {list(self.voxels)}: {depth * rows * columns} voxels in all; at most {2**26} are allowed "
                "(256 MiB of signed distances a scene)"
            )
