"""MATLAB files: confocal grids as Stanford publishes them, and lists of pairs of points, written and read.

- `meas` (y, x, t), `tofgrid` (y, x) in ps and `wall_size` in m, the f-k migration data (Lindell, Wetzstein and
  O'Toole, *Wave-Based Non-Line-of-Sight Imaging using Fast f-k Migration*, 2019): times count from the laser; after a
  shift by −floor(tofgrid / bin) they count from the wall. The published files have 32 ps, 2 m × 2 m, and a file of
  its own for `tofgrid`. A confocal grid on a flat wall is written so, with `grid_points` and `grid_normals`
  (y, x, 3); one on an uneven wall is not, because programs that read `meas` take the wall from `wall_size` alone.
- `rect_data` (x, y, t), the data of the light-cone transform (O'Toole, Lindell and Wetzstein 2018): times count from
  the wall; `width` (m) is half of the wall's width. The published files have 4 ps. It is only read.
- `trans_data` (N, T), `camera_points`, `laser_points`, `camera_normals`, `laser_normals` (N, 3): a row for each pair
  of a laser point and a pixel; times count from the wall, as 3D Gaussian Transient Rendering (3D-GTR, 2026) loads
  them. Any other scan is written so.

Row 0 of a grid is at the top and column 0 at the left, for somebody who faces the wall. What is written has
`bin_resolution` (s), points in the frame of the relay wall (z = 0, hidden z > 0), and is of version 5, which MATLAB,
Octave and `scipy.io.loadmat` read; it holds at most 2 GiB in one variable. Versions 5 to 7.3 are read.
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
from datagen.formats.containers import FACING, ONE, POINTS, VALUES, Content, matlab_content
from datagen.formats.recording import (
    SAME,
    UNKNOWN,
    Recording,
    WallFrame,
    lattice,
    recording_of,
    refuse_options,
    time_bins,
)
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import as_given, option
from datagen.store.scenes import SceneContent
from datagen.units import path_from_time, time_from_path
from datagen.untrusted import CAPTURE_BYTES, expands_too_far

_SHORTEST_LEG_PS = 66.7
"""Time to a wall 1 cm away and back, than which no galvo's is shorter."""
_LARGEST_BYTES = 2**31 - 1
"""Largest variable of version 5 that MATLAB reads."""
_WANTED = {
    "meas": VALUES, "rect_data": VALUES, "tofgrid": POINTS, "wall_size": 2, "width": ONE, "grid_points": POINTS,
    "grid_normals": POINTS, "trans_data": VALUES, "camera_points": POINTS, "laser_points": POINTS,
    "camera_normals": POINTS, "laser_normals": POINTS, "bin_resolution": ONE,
}  # fmt: skip
_AXES = {"meas": "yxt", "rect_data": "xyt"}


def write_mat(scene: SceneContent, path: Path, quantity: str | None = None) -> None:
    """Write one scene. Raises `InputError` as `recording_of` does, and if the scan is too large for the format."""
    from scipy.io import savemat

    m = recording_of(scene, quantity).on_wall().from_time_zero()
    place = lattice(m.seen_points) if m.paired and _is_on_flat_wall(m) else None
    variables = _variables_of_pairs(m) if place is None or min(place.shape) < 2 else _variables_of_grid(m, place)
    for name, value in variables.items():
        if value.nbytes > _LARGEST_BYTES:
            raise InputError(
                f"scene {scene.index}: {name} would have {value.nbytes} bytes, and a MATLAB variable has at "
                f"most {_LARGEST_BYTES}; take {option('format')} h5 or npz"
            )
    written = variables | {"bin_resolution": m.time.width_s, "scene": scene.index}
    savemat(path, written, do_compression=True)
    if expands_too_far(sum(value.nbytes for value in variables.values()), path.stat().st_size, CAPTURE_BYTES):
        # A scan of few photons packs so far that it would not be read again.
        savemat(path, written, do_compression=False)


def _is_on_flat_wall(m: Recording) -> bool:
    """Whether pixels look at their laser points, and no way from them differs from that of a flat wall by a bin."""
    half_a_bin_m = path_from_time(m.time.width_s) / 2
    return np.array_equal(m.seen_points, m.laser_points) and bool(np.abs(m.seen_points[:, 2]).max() <= half_a_bin_m)


def _variables_of_grid(m: Recording, place: Ints) -> dict[str, NDArray[Any]]:
    """Variables of a confocal grid; `place` is its `lattice`."""
    # Columns × rows with y ascending → rows from the top × columns.
    order = place.T[::-1]
    points = m.seen_points[order]
    width, height = np.ptp(points[..., 0]), np.ptp(points[..., 1])
    square = abs(width - height) < 1e-3 * width
    return {
        "meas": m.values[order, 0],
        "tofgrid": 1e12 * _legs_s(m, m.laser_points, m.seen_points)[order],
        "wall_size": np.array([width] if square else [width, height]),
        "grid_points": points,
        **_stated("grid_normals", m.seen_normals[order]),
    }


def _stated(name: str, normals: Floats) -> dict[str, Floats]:
    """The variable of normals; none where a capture that was imported does not state them."""
    return {name: normals} if np.isfinite(normals).all() else {}


def _legs_s(m: Recording, lit: Floats, seen: Floats) -> Floats:
    """(N,) seconds from the laser to its point and from the seen point to the sensor; 0 for times from the wall."""
    if m.time.origin == "wall":
        return np.zeros(len(lit))
    ways = np.linalg.norm(lit - m.laser_position, axis=1) + np.linalg.norm(seen - m.sensor_position, axis=1)
    return np.asarray(time_from_path(ways))


def _variables_of_pairs(m: Recording) -> dict[str, NDArray[Any]]:
    """Variables of a list of pairs, with all times shifted to count from the wall."""
    lasers, pixels, bins = m.values.shape
    lit, lit_normals = (of if m.paired else np.repeat(of, pixels, axis=0) for of in (m.laser_points, m.laser_normals))
    seen, seen_normals = (of if m.paired else np.tile(of, (lasers, 1)) for of in (m.seen_points, m.seen_normals))
    transients = np.zeros((len(lit), bins), np.float32)
    shifts = np.floor(_legs_s(m, lit, seen) / m.time.width_s).astype(int)
    for row, (values, shift) in enumerate(zip(m.values.reshape(-1, bins), shifts, strict=True)):
        transients[row, : bins - shift] = values[shift:]
    return {
        "trans_data": transients, "camera_points": seen, "laser_points": lit,
        **_stated("camera_normals", seen_normals), **_stated("laser_normals", lit_normals),
    }  # fmt: skip


def read_mat(path: Path, options: ImportOptions, delays: Path | None = None) -> Recording:
    """The recording in one file. `delays` is the file with `tofgrid`, if that is another file.

    Raises `InputError`, one line, for a file that is damaged or lacks something that no option states.
    """
    content = matlab_content(path, _WANTED)
    if "trans_data" in content.names:
        return _read_pairs(content, options)
    name = next((name for name in _AXES if name in content.names), None)
    if name is None:
        raise InputError(f"{path}: has {content.listed}; meas, rect_data or trans_data is needed")
    return _read_grid(content, name, options, delays)


def _bin_width_s(content: Content) -> float | None:
    return content.number("bin_resolution") if "bin_resolution" in content.arrays else None


def _read_grid(content: Content, name: str, options: ImportOptions, delays: Path | None) -> Recording:
    """The recording of a confocal grid."""
    path, stored = content.path, content.array(name)
    if stored.ndim != 3 or stored.size == 0:
        raise InputError(f"{path}: {name}: shape {stored.shape}; one capture has two axes of the grid and time")
    # Time comes first if the last two axes have the same size and the first has not.
    first_is_time = stored.shape[1] == stored.shape[2] != stored.shape[0]
    axes = options.axes or (f"t{_AXES[name][:2]}" if first_is_time else _AXES[name])
    at = [axes.index(axis) for axis in "yx"]
    # The file's other variables have the two axes of the grid in the same order as this one.
    first, second = sorted(at)
    values = stored.transpose(first, second, axes.index("t"))
    time = time_bins(
        path, values.shape[-1], _bin_width_s(content), options, start_s=0.0, origin="wall", named="bin_resolution"
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


def _read_pairs(content: Content, options: ImportOptions) -> Recording:
    """The recording of a list of pairs: every pixel for every laser point, or (confocal) one for each."""
    refuse_options(options, f"{content.path} lists its points itself")
    rows, seen, lit = content.array("trans_data"), content.points("camera_points"), content.points("laser_points")
    if rows.ndim != 2 or rows.size == 0 or seen.shape != (len(rows), 3) or lit.shape != (len(rows), 3):
        raise InputError(
            f"{content.path}: trans_data {rows.shape}, camera_points {seen.shape}, laser_points {lit.shape}: must be "
            "(N, T), (N, 3), (N, 3)"
        )
    time = time_bins(
        content.path, rows.shape[1], _bin_width_s(content), options, start_s=0.0, origin="wall",
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
