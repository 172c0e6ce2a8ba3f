"""Grids of points that a scan visits, read from files: `meas` of f-k migration and `rect_data` of the light-cone
transform.

- `meas` (y, x, t), `tofgrid` (y, x) in ps and `wall_size` in m, the f-k migration data (Lindell, Wetzstein and
  O'Toole, *Wave-Based Non-Line-of-Sight Imaging using Fast f-k Migration*, 2019): times count from the laser; after a
  shift by −floor(tofgrid / bin) they count from the wall. The published files have 32 ps, 2 m × 2 m, and a file of
  its own for `tofgrid`.
- `rect_data` (x, y, t), the data of the light-cone transform (O'Toole, Lindell and Wetzstein 2018): times count from
  the wall; `width` (m) is half of the wall's width. The published files have 4 ps.

Row 0 of a grid is at the top and column 0 at the left, for somebody who faces the wall.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.config.capture import TimeConfig
from datagen.config.imported import ImportOptions
from datagen.errors import InputError
from datagen.formats.containers import FACING, POINTS, Content, matlab_content
from datagen.formats.recording import SAME, UNKNOWN, Recording, WallFrame, bin_width_s, time_bins
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import as_given, option

_SHORTEST_LEG_PS = 66.7
"""Time to a wall 1 cm away and back, than which no galvo's is shorter."""
AXES = {"meas": "yxt", "rect_data": "xyt"}
"""Variable → the order of its axes as published."""


def read_grid(content: Content, name: str, options: ImportOptions, delays: Path | None) -> Recording:
    """The recording of a confocal grid."""
    path, stored = content.path, content.array(name)
    if stored.ndim != 3 or stored.size == 0:
        raise InputError(f"{path}: {name}: shape {stored.shape}; one capture has two axes of the grid and time")
    # Time comes first if the last two axes have the same size and the first has not.
    first_is_time = stored.shape[1] == stored.shape[2] != stored.shape[0]
    axes = options.axes or (f"t{AXES[name][:2]}" if first_is_time else AXES[name])
    at = [axes.index(axis) for axis in "yx"]
    # The file's other variables have the two axes of the grid in the same order as this one.
    first, second = sorted(at)
    values = stored.transpose(first, second, axes.index("t"))
    time = time_bins(
        path, values.shape[-1], bin_width_s(content), options, start_s=0.0, origin="wall", named="bin_resolution"
    )
    shifts = _read_shifts(content, name, values.shape[:2], TimeConfig.of(time).bin_width_ps, options, delays)
    if shifts.any():
        kept = values.shape[-1] - int(shifts.max())
        if kept < 1:
            raise InputError(
                f"{path}: tofgrid: {int(shifts.max())} bins of {time.width_s * 1e12:g} ps to the wall and back, and "
                f"{values.shape[-1]} bins in all; are they ps, and is {option('bin_width')} right?"
            )
        values = _shifted(values, shifts, kept)
        time = replace(time, bins=kept)
    values = values if at[0] < at[1] else values.swapaxes(0, 1)
    rows, columns, bins = values.shape
    points = _read_points(content, name, rows, columns, options).reshape(-1, 3)
    # Without points of its own a grid fills a flat wall in the plane of x and y.
    flat = "grid_points" not in content.arrays
    normals = np.tile(FACING, (len(points), 1)) if flat else content.normals("grid_normals", points)
    frame = WallFrame.facing(points, normals)
    return Recording(
        values.reshape(-1, 1, bins), True, points, normals, points, normals, time, UNKNOWN, UNKNOWN, frame
    )  # fmt: skip


def _shifted(values: NDArray[Any], shifts: Ints, kept: int) -> NDArray[Any]:
    """(row, column, kept) the first `kept` bins of each point of the grid after its shift."""
    found = np.empty((*shifts.shape, kept), values.dtype)
    for shift in np.unique(shifts):
        alike = shifts == shift
        found[alike] = values[alike, shift : shift + kept]
    return found


def _read_shifts(
    content: Content,
    name: str,
    grid: tuple[int, ...],
    bin_width_ps: float,
    options: ImportOptions,
    delays: Path | None,
) -> Ints:
    """(row, column) whole bins that light takes to the wall and back; 0 if times count from the wall."""
    if delays is not None:
        if "tofgrid" in content.arrays:
            raise InputError(f"{content.path}: has a tofgrid of its own; leave {option('tof')} out")
        content = matlab_content(delays, {"tofgrid": POINTS})
    elif "tofgrid" not in content.arrays:
        if name == "meas" and options.delays is None:
            raise InputError(
                f"{content.path}: tofgrid: missing, and meas counts from the laser; name its file: "
                f"{as_given('tof', 'tof.mat')}, or {as_given('tof', 'none')} where it has been taken off"
            )
        return np.zeros(grid, np.int64)
    elif options.delays == "none":
        raise InputError(f"{content.path}: has a tofgrid, and {as_given('tof', 'none')}; leave {option('tof')} out")
    found = content.array("tofgrid")
    if found.shape != grid:
        raise InputError(f"{content.path}: tofgrid: shape {found.shape}, the grid is {grid}")
    if not np.isfinite(found).all() or (found < 0).any() or (found > 1e12).any():
        raise InputError(f"{content.path}: tofgrid: must be picoseconds ≥ 0, finite")
    if 0 < found.max() < _SHORTEST_LEG_PS:
        raise InputError(
            f"{content.path}: tofgrid: at most {found.max():.3g} ps to the wall and back, which is no way; is it in "
            "seconds or nanoseconds? Picoseconds are needed"
        )
    return np.floor(found.astype(np.float64) / bin_width_ps).astype(np.int64)


def _read_points(content: Content, name: str, rows: int, columns: int, options: ImportOptions) -> Floats:
    """(rows, columns, 3) points of the grid from the top left, metres, in the frame of the wall."""
    if "grid_points" in content.arrays:
        points = content.points("grid_points")
        if points.shape != (rows, columns, 3):
            raise InputError(f"{content.path}: grid_points: shape {points.shape}, ({rows}, {columns}, 3) needed")
        return points
    width, height = _read_wall(content, name, options)
    across = np.linspace(-width / 2, width / 2, columns) if columns > 1 else np.zeros(1)
    up = np.linspace(height / 2, -height / 2, rows) if rows > 1 else np.zeros(1)
    x, y = np.meshgrid(across, up)
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def _read_wall(content: Content, name: str, options: ImportOptions) -> tuple[float, float]:
    """Width and height of the scanned grid, metres, from the file or the options."""
    said: tuple[float, float] | None = None
    if name == "rect_data" and "width" in content.arrays:
        said = (2 * content.number("width"),) * 2
    elif "wall_size" in content.arrays:
        size = content.array("wall_size").ravel()
        if size.size not in (1, 2) or size.dtype.kind not in "fiu" or not np.isfinite(size).all():
            raise InputError(f"{content.path}: wall_size: one or two numbers are needed, metres")
        said = float(size[0]), float(size[-1])
    if said is None and options.wall_m is None:
        known = "width" if name == "rect_data" else "wall_size"
        raise InputError(
            f"{content.path}: {known}: missing; say how large the scanned grid is: {as_given('wall', '2m')}"
        )
    if said is not None and options.wall_m is not None and not np.allclose(said, options.wall_m, rtol=SAME):
        raise InputError(
            f"{content.path}: says a wall of {said[0]:g} × {said[1]:g} m, {option('wall')} {options.wall_m[0]:g} × "
            f"{options.wall_m[1]:g} m; leave {option('wall')} out"
        )
    width, height = said or options.wall_m or (0.0, 0.0)
    if not (0 < width <= 1e5 and 0 < height <= 1e5):
        raise InputError(f"{content.path}: a wall of {width:g} × {height:g} m: must be > 0 and ≤ 100 km")
    return width, height
