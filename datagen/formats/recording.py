"""One measurement as formats of other programs know it, read from a file or taken from a dataset, and the fields of a
dataset that hold it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from datagen.config.capture import TimeConfig
from datagen.config.imported import ImportOptions
from datagen.errors import InputError
from datagen.formats.containers import Content, wall_normal
from datagen.records import OnSurfaces, TimeAxis
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import as_given
from datagen.records.sample import geometry_fields
from datagen.store.scenes import SceneContent
from datagen.units import time_from_path

UNKNOWN = np.full(3, np.nan)
QUANTITIES = ("histogram", "transient", "moving_transient", "background_histogram", "background_transient")
_SAME_PLACE_M = 1e-9
SMALLEST_WALL_M = 0.01
"""Width of the relay wall of a scan of a single point, which has no extent of its own."""
_AT_ONCE = 2**22
"""Number of values that are checked together, because all of them would need a copy."""
SAME = 1e-6
"""Relative difference up to which a value of a file and an option count as equal: a file may state six digits."""
_SECONDS = {"fs": 1e-15, "ps": 1e-12, "ns": 1e-9, "us": 1e-6, "s": 1.0}
_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_NUMBER = r"(\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)"


@dataclass(frozen=True)
class WallFrame:
    """Coordinates with the relay wall at z = 0 and the hidden part at z > 0, x to the right and y up as seen from the
    room, metres.

    origin : (3,) origin of this frame, in the scene's frame.
    axes : (3, 3) rows are the unit vectors right, up, and into the room.
    """

    origin: Floats
    axes: Floats

    def to_wall(self, points: Floats) -> Floats:
        """(..., 3) the points (..., 3) of the scene in this frame."""
        return (points - self.origin) @ self.axes.T

    @classmethod
    def facing(cls, seen_points: Floats, seen_normals: Floats) -> WallFrame:
        """The frame of a wall from points on it and its normals there, which may be NaN. The origin is in the middle
        of the points; up is the y of their own frame, or its z if y is the wall's normal."""
        normal = wall_normal(seen_normals)
        up = np.array([0.0, 1.0, 0.0] if abs(normal[1]) < 0.9 else [0.0, 0.0, 1.0])
        up = up - (up @ normal) * normal
        up = up / np.linalg.norm(up)
        middle = (seen_points.min(axis=0) + seen_points.max(axis=0)) / 2
        return cls(middle, np.stack([np.cross(up, normal), up, normal]))


@dataclass(frozen=True)
class Recording:
    """One measurement, with positions in the frame of its file or of its scene, metres.

    values : (L, P, T) counts or light; paired: (L, 1, T).
    paired : whether pixel i was measured with laser point i alone (a confocal scan).
    laser_points, seen_points : (L, 3) laser points, and (P, 3) what each pixel looks at; paired: both (L, 3). They
        lie off the plane of the wall where it is uneven, or where something stands before it.
    laser_normals, seen_normals : unit normals of the surfaces there, of the same shapes; NaN where unknown.
    time : the time bins.
    laser_position, sensor_position : (3,) positions of the devices; NaN where unknown.
    frame : the frame of the relay wall.
    hidden : (2, 3) corners of the box that contains the hidden part, or None.
    """

    values: NDArray[Any]
    paired: bool
    laser_points: Floats
    laser_normals: Floats
    seen_points: Floats
    seen_normals: Floats
    time: TimeAxis
    laser_position: Floats
    sensor_position: Floats
    frame: WallFrame
    hidden: Floats | None = None

    def on_wall(self) -> Recording:
        """The recording with positions in the frame of the relay wall, with the wall at z = 0."""
        to_wall, axes = self.frame.to_wall, self.frame.axes
        return replace(
            self, laser_points=to_wall(self.laser_points), laser_normals=self.laser_normals @ axes.T,
            seen_points=to_wall(self.seen_points), seen_normals=self.seen_normals @ axes.T,
            laser_position=to_wall(self.laser_position), sensor_position=to_wall(self.sensor_position),
            frame=WallFrame(np.zeros(3), np.eye(3)),
            hidden=None if self.hidden is None else np.sort(to_wall(self.hidden), axis=0),
        )  # fmt: skip

    def from_time_zero(self) -> Recording:
        """The recording with empty bins added at both ends, so that time begins at 0 (or less than a bin later) and
        the number of bins is a power of two, as methods in the frequency domain need it."""
        lead = max(0, int(np.floor(self.time.start_s / self.time.width_s + 1e-6)))
        bins = 1 << (lead + self.time.bins - 1).bit_length()
        values = np.zeros((*self.values.shape[:2], bins), self.values.dtype)
        values[..., lead : lead + self.time.bins] = self.values
        start_s = self.time.start_s - lead * self.time.width_s
        # If the start was a whole number of bins, a tiny remainder is rounding.
        start_s = 0.0 if abs(start_s) < 1e-6 * self.time.width_s else start_s
        return replace(self, values=values, time=replace(self.time, bins=bins, start_s=start_s))

    def in_order(self) -> Recording:
        """The recording with grids row by row from the top left, as seen by somebody who faces the wall. Points that
        form no grid keep their order."""
        if self.paired:
            order = _rows(self.frame.to_wall(self.seen_points))
            return self._chosen(self.values[order], order, order)
        lasers, pixels = _rows(self.frame.to_wall(self.laser_points)), _rows(self.frame.to_wall(self.seen_points))
        return self._chosen(self.values[lasers[:, None], pixels], lasers, pixels)

    def _chosen(self, values: NDArray[Any], lasers: Ints, pixels: Ints) -> Recording:
        return replace(
            self, values=values, laser_points=self.laser_points[lasers], laser_normals=self.laser_normals[lasers],
            seen_points=self.seen_points[pixels], seen_normals=self.seen_normals[pixels],
        )  # fmt: skip

    def geometry(self) -> dict[str, Floats]:
        """Field → value of the fields of positions. A pixel's corners are one point, since files state no extent."""
        frame = self.frame
        both = frame.to_wall(np.concatenate([self.laser_points, self.seen_points]))[:, :2]
        low, high = both.min(axis=0), both.max(axis=0)
        halves = np.maximum((high - low) / 2, SMALLEST_WALL_M / 2)
        center = frame.origin + ((low + high) / 2) @ frame.axes[:2]
        wall = np.stack([center, halves[0] * frame.axes[0], halves[1] * frame.axes[1]])
        pixels = np.repeat(self.seen_points[:, None], 4, axis=1)
        lit, seen = OnSurfaces(self.laser_points, self.laser_normals), OnSurfaces(self.seen_points, self.seen_normals)
        return geometry_fields(
            lit, pixels, seen, self.laser_position, self.sensor_position, wall, hidden_bounds=self.hidden
        )


@dataclass(frozen=True)
class Stated:
    """What the options of an import state about a file.

    options : as the dataset keeps them. delays, points : paths of the files with `tofgrid` and with the places of the
        points, if they are files of their own.
    """

    options: ImportOptions = field(default_factory=ImportOptions)
    delays: Path | None = None
    points: Path | None = None

    @property
    def files(self) -> tuple[Path | None, Path | None]:
        """The paths of the two files."""
        return self.delays, self.points


@dataclass(frozen=True)
class Captured:
    """What a layout takes from a file.

    first : the recording; of a file of many frames the first one.
    axes : words on the array and the order of its axes.
    frames : (F, L, P, T) the values of all frames; None where the file has one recording.
    notes : words on what else was taken, such as delays that were subtracted.
    """

    first: Recording
    axes: str
    frames: NDArray[Any] | None = None
    notes: tuple[str, ...] = ()

    @property
    def values(self) -> NDArray[Any]:
        """All values of the file."""
        return self.first.values if self.frames is None else self.frames

    def frame(self, number: int) -> Recording:
        """The recording of one frame."""
        return self.first if self.frames is None else replace(self.first, values=self.frames[number])

    def with_bins(self, bins: int) -> Captured:
        """The first `bins` bins alone."""
        first = replace(self.first, values=self.first.values[..., :bins], time=replace(self.first.time, bins=bins))
        return replace(self, first=first, frames=None if self.frames is None else self.frames[..., :bins])

    def sentence(self, layout: str) -> str:
        """What was taken for layout, axes, laser points, units, time zero and wall, in one line."""
        m = self.first
        lasers, pixels = len(m.laser_points), len(m.seen_points)
        pairing = f"confocal, {lasers} points" if m.paired else f"{lasers} laser points × {pixels} pixels"
        size = np.ptp(m.frame.to_wall(m.seen_points), axis=0)
        zero = "the laser" if m.time.origin == "source" else "the wall"
        depth = f", {size[2]:.3g} m deep" if size[2] > 1e-3 * max(size) else ""
        said = [
            layout, self.axes, *([] if self.frames is None else [f"{len(self.frames)} frames"]), pairing,
            f"bins of {m.time.width_s * 1e12:.6g} ps from {m.time.start_s * 1e9:.6g} ns, counted from {zero}",
            f"points over {size[0]:.4g} × {size[1]:.4g} m{depth}", *self.notes,
        ]  # fmt: skip
        return "; ".join(said)


def recording_of(scene: SceneContent, quantity: str | None = None) -> Recording:
    """A stored scene as a recording.

    quantity : one of `QUANTITIES`; left out: the first of these that the dataset has.

    Raises
    ------
    InputError : the dataset has no such field, the scene's relay wall is unknown, a laser point lies on no surface or
        a pixel looks at none, or all laser points were lit at once (a flood), which other formats cannot express.
    """
    where, arrays, capture = f"{scene.root}, scene {scene.index}", scene.arrays, scene.manifest.config["capture"]
    name = quantity_in(scene, quantity)
    if capture.get("illumination", "scan") == "flood":
        raise InputError(f"{where}: all laser points were lit at once, which this format cannot say; take npz or h5")
    if not np.isfinite(arrays["relay_wall"]).all():
        raise InputError(f"{where}: its relay wall is unknown, and this format counts from it; take npz or h5")
    lit, seen = arrays["laser_points"], arrays["sensor_points"]
    for points, which in ((lit, "laser point {} lies on"), (seen, "the middle of pixel {} looks at")):
        if not np.isfinite(points).all():
            missing = int(np.argmin(np.isfinite(points).all(axis=1)))
            raise InputError(f"{where}: {which.format(missing)} no surface; take npz or h5")
    center, right, up = arrays["relay_wall"]
    axes = np.stack([right / np.linalg.norm(right), up / np.linalg.norm(up), np.zeros(3)])
    axes[2] = np.cross(axes[0], axes[1])
    paired = capture["pairing"] == "confocal"
    if paired and np.abs(seen - lit).max() <= _SAME_PLACE_M:
        # Rays of two devices that aim at one place meet it but for rounding, and a grid has one set of points.
        seen = lit
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    frame = WallFrame(center + axes[:2].T @ (axes[:2] @ (middle - center)), axes)
    hidden = arrays["hidden_bounds"]
    return Recording(
        arrays[name], paired, lit, arrays["laser_normals"], seen, arrays["sensor_normals"],
        scene.manifest.time_of(name), arrays["laser_position"], arrays["sensor_position"], frame,
        hidden if np.isfinite(hidden).all() else None,
    )  # fmt: skip


def quantity_in(scene: SceneContent, quantity: str | None) -> str:
    """The one of `QUANTITIES` asked for, or the first that a scene has; raises `InputError` if it has none."""
    there = [name for name in QUANTITIES if name in scene.arrays]
    if not there or quantity not in (None, *there):
        raise InputError(
            f"{scene.root}, scene {scene.index}: has no field {quantity or 'histogram or transient'}; it has "
            f"{', '.join(scene.arrays)}"
        )
    return quantity or there[0]


def lattice(points: Floats) -> Ints | None:
    """(columns, rows) index of the point at each place of the grid of (N, 3) points, x and y ascending; or None."""
    extent = float(np.ptp(points[:, :2], axis=0).max())
    for tolerance in (1e-9, 1e-6, 1e-4, 1e-3, 1e-2, 3e-2):
        columns, rows = (_clusters(points[:, axis], tolerance * extent) for axis in (0, 1))
        number = columns * (rows.max() + 1) + rows
        if (columns.max() + 1) * (rows.max() + 1) == len(points) == len(np.unique(number)):
            found: Ints = np.argsort(number).reshape(columns.max() + 1, rows.max() + 1)
            return found
    return None


def _clusters(values: Floats, gap: float) -> Ints:
    """(N,) the index of each value's group; groups lie more than `gap` apart."""
    order = np.argsort(values, kind="stable")
    groups = np.empty(len(values), np.int64)
    groups[order] = np.append(0, np.cumsum(np.diff(values[order]) > gap))
    return groups


def _rows(points: Floats) -> Ints:
    """(N,) indices of points row by row from the top left; 0, 1, 2 … if they form no grid."""
    place = lattice(points)
    return np.arange(len(points)) if place is None else place.T[::-1].ravel()


def numbers_in(path: Path, values: NDArray[Any]) -> tuple[bool, float]:
    """Whether all values are whole numbers, and the largest value.

    Raises `InputError` for negative and not finite values, which are neither counts nor light.
    """
    whole, most = True, 0.0
    for some in _pieces(values):
        if some.dtype.kind == "f" and not np.isfinite(some).all():
            count = int(np.count_nonzero(~np.isfinite(some)))
            raise InputError(f"{path}: holds NaN or infinite values ({count} and perhaps more); mend them first")
        if some.dtype.kind in "fi" and (some < 0).any():
            raise InputError(
                f"{path}: holds negative values, such as {some.min():g}: neither counts nor light; undo what was "
                "subtracted first"
            )
        whole = whole and (some.dtype.kind != "f" or bool((some == np.rint(some)).all()))
        most = max(most, float(some.max()))
    return whole, most


def _pieces(values: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """All values piece by piece, in the order of memory."""
    flat = values.ravel(order="K")
    for begin in range(0, flat.size, _AT_ONCE):
        yield flat[begin : begin + _AT_ONCE]


def time_bins(
    path: Path, bins: int, width_s: float | None, options: ImportOptions, *, start_s: float,
    origin: Literal["source", "wall"], named: str,
) -> TimeAxis:  # fmt: skip
    """The time axis. The width of a bin comes from the file (`width_s`) or the options.

    Raises `InputError` if neither states the width or they contradict each other, and for an invalid time axis.
    """
    asked = None if options.bin_width_ps is None else options.bin_width_ps * 1e-12
    if width_s is None and asked is None:
        raise InputError(f"{path}: {named}: missing; say how wide a bin is: {as_given('bin_width', '4ps')}")
    if width_s is not None and asked is not None and abs(width_s - asked) > SAME * asked:
        raise InputError(
            f"{path}: says {named} of {width_s * 1e12:g} ps, "
            f"{as_given('bin_width', f'{asked * 1e12:g}ps')}; leave it out"
        )
    width = width_s if width_s is not None else asked
    assert width is not None
    try:
        # Rounded to twelve digits, because further ones come from the conversion of units.
        return TimeConfig(
            bins=bins, bin_width_ps=float(f"{width * 1e12:.12g}"), start_ns=float(f"{start_s * 1e9:.12g}"),
            origin=origin,
        ).axis()  # fmt: skip
    except InputError as error:
        raise InputError(f"{path}: {str(error).removeprefix('TimeConfig: ')}") from None


def bin_width_s(content: Content) -> float | None:
    """Seconds of `bin_resolution`, the width of a bin as files of MATLAB state it; None for a file without it."""
    return content.number("bin_resolution") if "bin_resolution" in content.arrays else None


def seconds_of(argument: str, text: str) -> float:
    """Seconds of a text, a time or the path of light: `"4ps"` → 4e-12, `"3mm"` → 1e-11. Raises `InputError`, which
    names the argument, for any other text."""
    found = re.fullmatch(rf"{_NUMBER}\s*(fs|ps|ns|us|s|mm|cm|m)", text.strip())
    if found is None:
        raise InputError(
            f"{as_given(argument, text)}: must be a time such as 4ps or 0.032ns, or the path of light such as 3mm"
        )
    number, unit = float(found[1]), found[2]
    return number * _SECONDS[unit] if unit in _SECONDS else float(time_from_path(number * _METRES[unit]))


def metres_of(text: str) -> tuple[float, float]:
    """Width and height of a text, metres: `"2m"` → (2, 2), `"2m x 1m"` → (2, 1); raises `InputError` for others."""
    unit = r"\s*(mm|cm|m)"
    found = re.fullmatch(rf"{_NUMBER}{unit}(?:\s*[x×]\s*{_NUMBER}{unit})?", text.strip())
    if found is None:
        raise InputError(
            f"{as_given('wall', text)}: must be a size such as 2m, or width and height such as 2m x 150cm"
        )
    width = float(found[1]) * _METRES[found[2]]
    return width, width if found[3] is None else float(found[3]) * _METRES[found[4]]
