"""One scene of a dataset as other programs describe it: values, times, and points in the frame of the relay wall."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.records import TimeAxis
from datagen.records.arrays import Floats, Ints
from datagen.store.scenes import SceneContent

_SAME_PLACE_M = 1e-9
QUANTITIES = ("histogram", "transient", "background_histogram", "background_transient")


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


@dataclass(frozen=True)
class Measurement:
    """A measurement in the frame of the relay wall.

    values : (L, P, T) counts or photons; confocal: P = 1.
    quantity : one of `QUANTITIES`.
    time : bin i covers [start + i width, start + (i + 1) width).
    paired : whether pixel i was measured with laser point i alone (a confocal scan).
    laser_points, seen_points : (L, 3) laser points, and (P, 3) what each pixel looks at, metres; paired: both (L, 3).
        They lie off the plane of the wall where it is uneven, or where something stands before it.
    laser_normals, seen_normals : unit normals of the surfaces there, of the same shapes; NaN where unknown.
    laser_position, sensor_position : (3,) positions of the devices.
    frame : the frame of these coordinates, in the scene's frame.
    hidden : (2, 3) corners of the box that contains the hidden part, or None.
    """

    values: NDArray[Any]
    quantity: str
    time: TimeAxis
    paired: bool
    laser_points: Floats
    laser_normals: Floats
    seen_points: Floats
    seen_normals: Floats
    laser_position: Floats
    sensor_position: Floats
    frame: WallFrame
    hidden: Floats | None

    def from_time_zero(self) -> Measurement:
        """The measurement with empty bins added at both ends, so that time begins at 0 (or less than a bin later) and
        the number of bins is a power of two, as methods in the frequency domain need it."""
        lead = max(0, int(np.floor(self.time.start_s / self.time.width_s + 1e-6)))
        bins = 1 << (lead + self.time.bins - 1).bit_length()
        values = np.zeros((*self.values.shape[:2], bins), self.values.dtype)
        values[..., lead : lead + self.time.bins] = self.values
        start_s = self.time.start_s - lead * self.time.width_s
        # If the start was a whole number of bins, a tiny remainder is rounding.
        start_s = 0.0 if abs(start_s) < 1e-6 * self.time.width_s else start_s
        return replace(self, values=values, time=replace(self.time, bins=bins, start_s=start_s))


def measurement(scene: SceneContent, quantity: str | None = None) -> Measurement:
    """A stored scene as a measurement.

    quantity : one of `QUANTITIES`; left out: the first of these that the dataset has.

    Raises
    ------
    InputError : the dataset has no such field, the scene's relay wall is unknown, a laser point lies on no surface or
        a pixel looks at none, or all laser points were lit at once (a flood), which other formats cannot express.
    """
    where, arrays, capture = f"{scene.root}, scene {scene.index}", scene.arrays, scene.manifest.config["capture"]
    there = [name for name in QUANTITIES if name in arrays]
    if not there or quantity not in (None, *there):
        raise InputError(f"{where}: has no field {quantity or 'histogram or transient'}; it has {', '.join(arrays)}")
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
    hidden = (
        np.sort(frame.to_wall(arrays["hidden_bounds"]), axis=0)
        if np.isfinite(arrays["hidden_bounds"]).all()
        else None
    )
    name = quantity or there[0]
    return Measurement(
        arrays[name], name, scene.manifest.time_of(name), paired,
        frame.to_wall(lit), arrays["laser_normals"] @ axes.T, frame.to_wall(seen), arrays["sensor_normals"] @ axes.T,
        frame.to_wall(arrays["laser_position"]), frame.to_wall(arrays["sensor_position"]), frame, hidden,
    )  # fmt: skip


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
