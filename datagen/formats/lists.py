"""Lists of pairs of a laser point and a pixel, read from files: `trans_data`.

`trans_data` (N, T), `camera_points`, `laser_points`, `camera_normals`, `laser_normals` (N, 3): a row for each pair
of a laser point and a pixel; times count from the wall, as 3D Gaussian Transient Rendering (3D-GTR, 2026) loads them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.config.imported import ImportOptions
from datagen.errors import InputError
from datagen.formats.containers import Content
from datagen.formats.recording import UNKNOWN, Recording, WallFrame, bin_width_s, refuse_options, time_bins
from datagen.records.arrays import Floats


def read_pairs(content: Content, options: ImportOptions) -> Recording:
    """The recording of a list of pairs: every pixel for every laser point, or (confocal) one for each."""
    refuse_options(options, f"{content.path} lists its points itself")
    rows, seen, lit = content.array("trans_data"), content.points("camera_points"), content.points("laser_points")
    if rows.ndim != 2 or rows.size == 0 or seen.shape != (len(rows), 3) or lit.shape != (len(rows), 3):
        raise InputError(
            f"{content.path}: trans_data {rows.shape}, camera_points {seen.shape}, laser_points {lit.shape}: must be "
            "(N, T), (N, 3), (N, 3)"
        )
    time = time_bins(
        content.path, rows.shape[1], bin_width_s(content), options, start_s=0.0, origin="wall",
        named="bin_resolution",
    )  # fmt: skip
    lit_normals, seen_normals = content.normals("laser_normals", lit), content.normals("camera_normals", seen)
    lasers, pixels = _every_pixel(lit, seen)
    if lasers * pixels == len(rows):
        values: NDArray[Any] = rows.reshape(lasers, pixels, -1)
        lit, lit_normals = lit[::pixels], lit_normals[::pixels]
        seen, seen_normals = seen[:pixels], seen_normals[:pixels]
    else:
        values = rows[:, None]
    paired = lasers * pixels != len(rows)
    frame = WallFrame.facing(seen, seen_normals)
    return Recording(values, paired, lit, lit_normals, seen, seen_normals, time, UNKNOWN, UNKNOWN, frame)


def _every_pixel(lit: Floats, seen: Floats) -> tuple[int, int]:
    """(lasers, pixels) if the list has all pixels for one laser point after the other; (0, 0) if it has not."""
    changes = np.flatnonzero((lit != lit[0]).any(axis=1))
    pixels = int(changes[0]) if len(changes) else len(lit)
    if len(lit) % pixels or (pixels == 1 and (seen != seen[0]).any()):
        return 0, 0
    lasers = len(lit) // pixels
    in_order = np.array_equal(lit, np.repeat(lit[::pixels], pixels, axis=0))
    alike = np.array_equal(seen, np.tile(seen[:pixels], (lasers, 1)))
    return (lasers, pixels) if in_order and alike else (0, 0)
