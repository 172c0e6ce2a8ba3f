"""Grids of points that a scan visits, read from files.

- `meas` (y, x, t), `tofgrid` (y, x) in ps and `wall_size` in m, the f-k migration data (Lindell, Wetzstein and
  O'Toole, *Wave-Based Non-Line-of-Sight Imaging using Fast f-k Migration*, 2019): times count from the laser; after a
  shift by −floor(tofgrid / bin) they count from the wall. The published files have 32 ps, 2 m × 2 m, and a file of
  its own for `tofgrid`. The interactive ones are `meas` (frame, y, x, t); those of an uneven wall have files with
  `z_offset` (y, x) and `width`, or `pos` (y, x, 3).
- `rect_data` (x, y, t), the data of the light-cone transform (O'Toole, Lindell and Wetzstein 2018): times count from
  the wall; `width` (m) is half of the wall's width. The published files have 4 ps.
- `data` and `wall_size` of Neural Transient Fields (Shen et al. 2021).
- Any other array, whose axes, times, wall and laser the options state.

Row 0 of a grid is at the top and column 0 at the left, for somebody who faces the wall, unless points say otherwise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.config.capture import TimeConfig
from datagen.config.imported import ImportOptions
from datagen.errors import InputError
from datagen.formats.containers import ALONE, FACING, ONE, POINTS, Content, matlab_content
from datagen.formats.recording import (
    SAME,
    UNKNOWN,
    Captured,
    Recording,
    Stated,
    WallFrame,
    bin_width_s,
    time_bins,
)
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import as_given, option
from datagen.units import time_from_path

_SHORTEST_LEG_PS = 66.7
"""Time to a wall 1 cm away and back, than which no galvo's is shorter."""
_PLACES = {"grid_points": POINTS, "grid_normals": POINTS, "pos": POINTS, "z_offset": POINTS, "width": ONE}
"""Variables of a file with the places of the points."""
OF_GRIDS = {
    "tofgrid": POINTS, "wall_size": 2, "width": ONE, "grid_points": POINTS, "grid_normals": POINTS,
    "bin_resolution": ONE,
}  # fmt: skip
"""Variables beside a grid, and the most numbers that each has."""
_SAYS_NOTHING = ("scene",)
"""Variables beside a grid that say nothing of where and when."""
_LETTERS = {"f": "frame", "y": "y", "x": "x", "t": "time", "c": "channel"}


@dataclass(frozen=True)
class _Grid:
    """The histograms of a grid, with the axes of the grid in the order of the file.

    values : (F, a, b, T). is_by_rows : whether axis a is y. axes : words on the array and its axes. has_frames :
    whether the array has an axis of frames.
    """

    values: NDArray[Any]
    is_by_rows: bool
    axes: str
    has_frames: bool

    def by_rows(self, array: NDArray[Any], first: int = 0) -> NDArray[Any]:
        """An array whose axes `first` and `first` + 1 are a and b, as (…, row, column, …)."""
        return array if self.is_by_rows else array.swapaxes(first, first + 1)

    @property
    def shape(self) -> tuple[int, int]:
        """The number of points along the two axes of the grid, in the order of the file."""
        return self.values.shape[1], self.values.shape[2]


@dataclass(frozen=True)
class _Places:
    """Where the points of a grid are.

    points : (row, column, 3). normals : (n, 3), NaN where unknown. device : (3,) the place of laser and sensor, or
        NaN.
    note : words on where they are from.
    """

    points: Floats
    normals: Floats
    frame: WallFrame
    device: Floats
    note: str


def read_grid(content: Content, name: str, axes: str, stated: Stated, *, counts_from_laser: bool) -> Captured:
    """The recording of `meas` or `rect_data`, confocal as published unless the options say otherwise.

    axes : their order as published; `options.axes` names another. counts_from_laser : whether delays are needed.
    """
    _check_nothing_else(content, name, stated.options)
    return _capture_of_grid(content, _grid(content, name, stated.options.axes or _usual_axes(content, name, axes)),
                     stated, start_s=0.0, counts_from_laser=counts_from_laser)  # fmt: skip


def read_array(content: Content, stated: Stated) -> Captured:
    """The recording of an array of which the file says nothing: axes, times, wall and laser are those of the options.

    Raises `InputError`, one line that names every option that is missing.
    """
    options, name = stated.options, stated.options.variable or ALONE
    known = {
        ("its axes", as_given("axes", "yxt")): options.axes,
        ("the width of its bins", as_given("bin_width", "32ps")): options.bin_width_ps,
        ("when its first bin begins", as_given("start", "0ns")): options.start_ns,
        ("whether times count from the wall", f"{as_given('tof', 'none')} or {as_given('tof', 'tof.mat')}"):
            options.delays or content.arrays.get("tofgrid"),
        ("where its points are", f"{as_given('wall', '2m')} or {option('points')}"): options.wall_m or stated.points,
        ("what the laser lit", f"{as_given('laser', 'confocal')}, or one point: {as_given('laser', '0.1,0,0')}"):
            options.laser,
    }  # fmt: skip
    missing = [f"{what} ({how})" for (what, how), value in known.items() if value is None]
    if missing:
        shape = content.array(name).shape
        sensor = f"; frames of a sensor need {as_given('device', 'tmf8820')}" if name == ALONE else ""
        raise InputError(f"{content.path}: {name} {shape} does not say {', '.join(missing)}: say it{sensor}")
    assert options.axes is not None and options.start_ns is not None
    grid = _grid(content, name, options.axes)
    return _capture_of_grid(content, grid, stated, start_s=options.start_ns * 1e-9, counts_from_laser=True)


def read_netf(content: Content, stated: Stated, *, axes: str, bin_width: str) -> Captured:
    """The recording of `data` and `wall_size` of Neural Transient Fields, as its loader and its model take them:
    confocal, times from the wall, x and z ascending over the wall y = 0, and the hidden part at y > 0.

    axes : their order; y is z there. bin_width : the variable with the width of a bin, `time_bin` (s) or `deltaT` (m
        of path).
    """
    grid = _grid(content, "data", stated.options.axes or axes)
    width = content.number(bin_width)
    width_s = width if bin_width == "time_bin" else float(time_from_path(width))
    time = time_bins(
        content.path, grid.values.shape[-1], width_s, stated.options, start_s=0.0, origin="wall", named=bin_width
    )
    values = grid.by_rows(grid.values, 1)
    across, up = _read_wall(content, "wall_size", stated.options)
    # The rows of the loader ascend.
    points = _flat(across, up, *values.shape[1:3])[::-1][..., [0, 2, 1]]
    normals = np.tile([0.0, 1.0, 0.0], (points.size // 3, 1))
    frame = WallFrame.facing(points.reshape(-1, 3), normals)
    places = _Places(points, normals, frame, UNKNOWN, "wall y = 0 of wall_size, hidden part at y > 0")
    return _with_places(grid, values, places, time, None, ("confocal and from the wall as NeTF takes it",))


def _capture_of_grid(
    content: Content, grid: _Grid, stated: Stated, *, start_s: float, counts_from_laser: bool
) -> Captured:  # fmt: skip
    """What a grid holds, with delays taken off, at its places."""
    path, options, values = content.path, stated.options, grid.values
    time = time_bins(
        path, values.shape[-1], bin_width_s(content), options, start_s=start_s, origin="wall", named="bin_resolution"
    )
    shifts = _read_shifts(content, grid.shape, TimeConfig.of(time).bin_width_ps, stated, counts_from_laser)
    notes = list[str]()
    if shifts is not None and shifts.any():
        kept = values.shape[-1] - int(shifts.max())
        if kept < 1:
            raise InputError(
                f"{path}: tofgrid: {int(shifts.max())} bins of {time.width_s * 1e12:g} ps to the wall and back, and "
                f"{values.shape[-1]} bins in all; are they ps, and is {option('bin_width')} right?"
            )
        values = _shifted_bins(values, shifts, kept)
        time = replace(time, bins=kept)
        notes.append(f"tofgrid taken off, {int(shifts.min())} to {int(shifts.max())} bins")
    values = grid.by_rows(values, 1)
    places = _read_places(content, grid, stated)
    return _with_places(grid, values, places, time, options.laser, tuple(notes))


def _with_places(
    grid: _Grid, values: NDArray[Any], places: _Places, time: Any, laser: object, notes: tuple[str, ...]
) -> Captured:
    """What a grid (frame, row, column, bin) of a confocal scan, or of one laser point at `laser`, holds."""
    frames, rows, columns, bins = values.shape
    points = places.points.reshape(-1, 3)
    lit, lit_normals, paired = points, places.normals, True
    listed = values.reshape(frames, rows * columns, 1, bins)
    if isinstance(laser, tuple):
        lit, lit_normals, paired = np.array([laser], np.float64), np.full((1, 3), np.nan), False
        listed = values.reshape(frames, 1, rows * columns, bins)
        notes = (*notes, f"laser point at {', '.join(f'{at:g}' for at in laser)} m")
    recording = Recording(
        listed[0], paired, lit, lit_normals, points, places.normals, time, places.device, places.device, places.frame
    )
    return Captured(recording, grid.axes, listed if grid.has_frames else None, (places.note, *notes))


def _usual_axes(content: Content, name: str, axes: str) -> str:
    """The order of the axes where no option states it."""
    shape = content.array(name).shape
    if len(shape) == 4:
        return f"f{axes}"
    # Time comes first if the last two axes have the same size and the first has not.
    return f"t{axes[:2]}" if len(shape) == 3 and shape[1] == shape[2] != shape[0] else axes


def _grid(content: Content, name: str, axes: str) -> _Grid:
    """The histograms of a variable with axes of this order. Raises `InputError` for one of another number of axes."""
    stored = content.array(name)
    words = ", ".join(_LETTERS[axis] for axis in axes)
    if stored.ndim != len(axes) or stored.size == 0:
        raise InputError(
            f"{content.path}: {name}: shape {stored.shape}, and ({words}) is needed; say {option('axes')}"
        )
    if "c" in axes:
        stored, axes = stored.sum(axis=axes.index("c")), axes.replace("c", "")
    has_frames = "f" in axes
    if not has_frames:
        stored, axes = stored[None], f"f{axes}"
    first, second = sorted(axes.index(axis) for axis in "yx")
    values = stored.transpose(axes.index("f"), first, second, axes.index("t"))
    return _Grid(values, axes.index("y") < axes.index("x"), f"{name} ({words})", has_frames)


def _check_nothing_else(content: Content, name: str, options: ImportOptions) -> None:
    """Raise `InputError` for a file with more variables than the published ones have, unless the laser is stated:
    what is not read may say that the laser lit one point alone."""
    known = {name, *OF_GRIDS, *_SAYS_NOTHING}
    # MATLAB writes variables of its own into files of version 7.3.
    others = [other for other in content.names if other not in known and not other.startswith(("#", "__")) and other]
    if others and options.laser is None:
        raise InputError(
            f"{content.path}: has {content.listed}: more than {name} as published, which may be of one laser point; "
            f"say {as_given('laser', 'confocal')}, or where it was, in metres: {as_given('laser', '0.1,0,0')}"
        )


def _shifted_bins(values: NDArray[Any], shifts: Ints, kept: int) -> NDArray[Any]:
    """(frame, a, b, kept) the first `kept` bins of each point of the grid after its shift."""
    found = np.empty((len(values), *shifts.shape, kept), values.dtype)
    for shift in np.unique(shifts):
        alike = shifts == shift
        for frame, shifted in zip(values, found, strict=True):
            shifted[alike] = frame[alike, shift : shift + kept]
    return found


def _read_shifts(
    content: Content, grid: tuple[int, int], bin_width_ps: float, stated: Stated, counts_from_laser: bool
) -> Ints | None:
    """(a, b) whole bins that light takes to the wall and back; None if times count from the wall."""
    options = stated.options
    if stated.delays is not None:
        if "tofgrid" in content.arrays:
            raise InputError(f"{content.path}: has a tofgrid of its own; leave {option('tof')} out")
        content = matlab_content(stated.delays, {"tofgrid": POINTS})
    elif "tofgrid" not in content.arrays:
        if counts_from_laser and options.delays is None:
            raise InputError(
                f"{content.path}: tofgrid: missing, and times count from the laser; name its file: "
                f"{as_given('tof', 'tof.mat')}, or {as_given('tof', 'none')} where it has been taken off"
            )
        return None
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


def _read_places(content: Content, grid: _Grid, stated: Stated) -> _Places:
    """Where the points are: of the file with the points that the options name, of the file itself, or on a flat wall
    whose size the file or the options state."""
    if stated.points is None:
        source = content if "grid_points" in content.arrays else None
    elif "grid_points" in content.arrays:
        raise InputError(f"{content.path}: has grid_points of its own; leave {option('points')} out")
    else:
        source = matlab_content(stated.points, _PLACES)
    if source is None:
        rows, columns = grid.by_rows(np.empty(grid.shape)).shape
        width, height = _read_wall(content, "wall_size", stated.options)
        points = _flat(width, height, rows, columns)
        normals = np.tile(FACING, (rows * columns, 1))
        frame = WallFrame.facing(points.reshape(-1, 3), normals)
        return _Places(points, normals, frame, UNKNOWN, "flat wall z = 0, row 0 at the top")
    kind = next((name for name in _KINDS if name in source.arrays), None)
    if kind is None:
        raise InputError(
            f"{source.path}: has {source.listed}; places of points are grid_points or pos (y, x, 3), or z_offset "
            "(y, x) with width, metres"
        )
    return _KINDS[kind](source, grid, stated.options)


def _of_grid_points(source: Content, grid: _Grid, _: ImportOptions) -> _Places:
    """Places from `grid_points` (row, column, 3) and `grid_normals`, in the frame of the wall."""
    points = source.points("grid_points")
    rows, columns = grid.by_rows(np.empty(grid.shape)).shape
    if points.shape != (rows, columns, 3):
        raise InputError(f"{source.path}: grid_points: shape {points.shape}, ({rows}, {columns}, 3) needed")
    normals = source.normals("grid_normals", points)
    frame = WallFrame.facing(points.reshape(-1, 3), normals)
    return _Places(points, normals, frame, UNKNOWN, "points of grid_points")


def _of_pos(source: Content, grid: _Grid, _: ImportOptions) -> _Places:
    """Places from `pos` (a, b, 3), which counts from the scanner: laser and sensor stand at its origin."""
    found = source.points("pos")
    if found.shape != (*grid.shape, 3):
        raise InputError(f"{source.path}: pos: shape {found.shape}, {(*grid.shape, 3)} needed: the grid's axes, xyz")
    points = grid.by_rows(found)
    flat = points.reshape(-1, 3)
    # Normal of the plane through the points, on the side of the scanner.
    normal = np.linalg.svd(flat - flat.mean(axis=0), full_matrices=False)[2][-1]
    normal = normal if normal @ (-flat.mean(axis=0)) > 0 else -normal
    unknown = np.full(flat.shape, np.nan)
    frame = WallFrame.facing(flat, normal[None])
    return _Places(points, unknown, frame, np.zeros(3), "points of pos, laser and sensor at their origin")


def _of_z_offset(source: Content, grid: _Grid, options: ImportOptions) -> _Places:
    """Places from `z_offset` (a, b), how far each point stands out from the plane of the wall towards the room, and
    `width`, the whole width of the square grid."""
    offset = source.array("z_offset")
    if offset.shape != grid.shape or not np.isfinite(offset).all() or abs(offset).max() > 1e3:
        raise InputError(
            f"{source.path}: z_offset: shape {offset.shape}; finite metres for a grid {grid.shape} needed"
        )
    if "width" in source.arrays:
        width = height = source.number("width")
        _check_wall(source, (width, height), options)
    else:
        width, height = _read_wall(source, "wall_size", options)
    rows, columns = grid.by_rows(offset).shape
    points = _flat(width, height, rows, columns)
    points[..., 2] = grid.by_rows(offset)
    unknown = np.full((rows * columns, 3), np.nan)
    frame = WallFrame.facing(points.reshape(-1, 3), unknown)
    return _Places(points, unknown, frame, UNKNOWN, "z of z_offset, towards the room, row 0 at the top")


_KINDS: dict[str, Callable[[Content, _Grid, ImportOptions], _Places]] = {
    "grid_points": _of_grid_points, "pos": _of_pos, "z_offset": _of_z_offset,
}  # fmt: skip
"""Variable of places → the function that reads it."""


def _flat(width: float, height: float, rows: int, columns: int) -> Floats:
    """(rows, columns, 3) points over a wall z = 0, from the top left."""
    across = np.linspace(-width / 2, width / 2, columns) if columns > 1 else np.zeros(1)
    up = np.linspace(height / 2, -height / 2, rows) if rows > 1 else np.zeros(1)
    x, y = np.meshgrid(across, up)
    return np.stack([x, y, np.zeros_like(x)], axis=-1)


def _read_wall(content: Content, known: str, options: ImportOptions) -> tuple[float, float]:
    """Width and height of the scanned grid, metres, from the file or the options."""
    said: tuple[float, float] | None = None
    if "rect_data" in content.names and "width" in content.arrays:
        said = (2 * content.number("width"),) * 2
    elif "wall_size" in content.arrays:
        size = content.array("wall_size").ravel()
        if size.size not in (1, 2) or size.dtype.kind not in "fiu" or not np.isfinite(size).all():
            raise InputError(f"{content.path}: wall_size: one or two numbers are needed, metres")
        said = float(size[0]), float(size[-1])
    if said is None and options.wall_m is None:
        known = "width" if "rect_data" in content.names else known
        raise InputError(
            f"{content.path}: {known}: missing; say how large the scanned grid is: {as_given('wall', '2m')}"
        )
    if said is not None:
        _check_wall(content, said, options)
    width, height = said or options.wall_m or (0.0, 0.0)
    return width, height


def _check_wall(content: Content, said: tuple[float, float], options: ImportOptions) -> None:
    """Raise `InputError` for a size of the wall that is none, or that the options contradict."""
    if options.wall_m is not None and not np.allclose(said, options.wall_m, rtol=SAME):
        raise InputError(
            f"{content.path}: says a wall of {said[0]:g} × {said[1]:g} m, {option('wall')} {options.wall_m[0]:g} × "
            f"{options.wall_m[1]:g} m; leave {option('wall')} out"
        )
    if not all(0 < size <= 1e5 for size in said):
        raise InputError(f"{content.path}: a wall of {said[0]:g} × {said[1]:g} m: must be > 0 and ≤ 100 km")
