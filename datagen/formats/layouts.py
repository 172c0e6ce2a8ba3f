"""The layouts of files of captures that imports know, and which of them a file has."""

from __future__ import annotations

from pathlib import Path

from datagen.config.imported import ImportOptions
from datagen.errors import InputError
from datagen.formats.containers import ONE, POINTS, VALUES, matlab_content
from datagen.formats.grids import AXES, read_grid
from datagen.formats.lists import read_pairs
from datagen.formats.recording import Recording

_WANTED = {
    "meas": VALUES, "rect_data": VALUES, "tofgrid": POINTS, "wall_size": 2, "width": ONE, "grid_points": POINTS,
    "grid_normals": POINTS, "trans_data": VALUES, "camera_points": POINTS, "laser_points": POINTS,
    "camera_normals": POINTS, "laser_normals": POINTS, "bin_resolution": ONE,
}  # fmt: skip


def read_mat(path: Path, options: ImportOptions, delays: Path | None = None) -> Recording:
    """The recording in one file of MATLAB. `delays` is the file with `tofgrid`, if that is another file.

    Raises `InputError`, one line, for a file that is damaged or lacks something that no option states.
    """
    content = matlab_content(path, _WANTED)
    if "trans_data" in content.names:
        return read_pairs(content, options)
    name = next((name for name in AXES if name in content.names), None)
    if name is None:
        raise InputError(f"{path}: has {content.listed}; meas, rect_data or trans_data is needed")
    return read_grid(content, name, options, delays)
