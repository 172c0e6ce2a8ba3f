"""One capture of a file, whatever its format, and the fields of a dataset that hold it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from datagen.config.capture import TimeConfig
from datagen.config.imported import ImportOptions
from datagen.errors import InputError
from datagen.formats.containers import wall_normal
from datagen.formats.measurement import WallFrame, lattice
from datagen.records import OnSurfaces
from datagen.records.arrays import Floats, Ints
from datagen.records.sample import geometry_fields

UNKNOWN = np.full(3, np.nan)
SMALLEST_WALL_M = 0.01
"""Width of the relay wall of a scan of a single point, which has no extent of its own."""
_AT_ONCE = 2**22
"""Number of values that are checked together, because all of them would need a copy."""
SAME = 1e-6
"""Relative difference up to which a value of a file and an option count as equal: a file may state six digits."""
_SECONDS = {"fs": 1e-15, "ps": 1e-12, "ns": 1e-9, "us": 1e-6, "s": 1.0}
_METRES = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_FLAGS = {"wall_m": "wall", "axes": "axes", "delays": "tof"}
_NUMBER = r"(\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)"


@dataclass(frozen=True)
class Recording:
    """One capture, in the file's own frame, metres.

    path : the file.
    values : (L, P, T) counts or light, as in the file; paired: (L, 1, T).
    paired : whether pixel i was measured with laser point i alone (a confocal scan).
    laser_points, seen_points : (L, 3) and (P, 3) points on the wall; paired: both (L, 3).
    laser_normals, seen_normals : unit normals of the wall there, of the same shapes; NaN if the file does not state
        them.
    time : the time bins.
    laser_position, sensor_position : (3,) positions of the devices; NaN if the file does not state them.
    hidden : (2, 3) corners of the box that contains the hidden part, or None.
    """

    path: Path
    values: NDArray[Any]
    paired: bool
    laser_points: Floats
    laser_normals: Floats
    seen_points: Floats
    seen_normals: Floats
    time: TimeConfig
    laser_position: Floats
    sensor_position: Floats
    hidden: Floats | None = None

    @property
    def normal(self) -> Floats:
        """(3,) unit normal of the relay wall, towards the hidden part."""
        return wall_normal(self.seen_normals)

    @property
    def frame(self) -> WallFrame:
        """The frame of the relay wall, with the origin in the middle of the seen points. Up is the file's y, or its z
        if y is the wall's normal."""
        up = np.array([0.0, 1.0, 0.0] if abs(self.normal[1]) < 0.9 else [0.0, 0.0, 1.0])
        up = up - (up @ self.normal) * self.normal
        up = up / np.linalg.norm(up)
        seen = self.seen_points
        middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
        return WallFrame(middle, np.stack([np.cross(up, self.normal), up, self.normal]))

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

    def first_bins(self, bins: int | None) -> Recording:
        """The recording with its first `bins` bins only (None: all); raises `InputError` if it has fewer."""
        if bins is None:
            return self
        if bins > self.time.bins:
            raise InputError(f"{self.path}: has {self.time.bins} bins, --bins {bins} asks for more")
        return replace(self, values=self.values[..., :bins], time=self.time.model_copy(update={"bins": bins}))

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
) -> TimeConfig:  # fmt: skip
    """The time axis. The width of a bin comes from the file (`width_s`) or the options.

    Raises `InputError` if neither states the width or they contradict each other, and for an invalid time axis.
    """
    asked = None if options.bin_width_ps is None else options.bin_width_ps * 1e-12
    if width_s is None and asked is None:
        raise InputError(f"{path}: {named}: missing; say how wide a bin is: --bin 4ps")
    if width_s is not None and asked is not None and abs(width_s - asked) > SAME * asked:
        raise InputError(f"{path}: says {named} of {width_s * 1e12:g} ps, --bin {asked * 1e12:g}ps; leave --bin out")
    width = width_s if width_s is not None else asked
    assert width is not None
    try:
        # Rounded to twelve digits, because further ones come from the conversion of units.
        return TimeConfig(
            bins=bins, bin_width_ps=float(f"{width * 1e12:.12g}"), start_ns=float(f"{start_s * 1e9:.12g}"),
            origin=origin,
        )  # fmt: skip
    except InputError as error:
        raise InputError(f"{path}: {str(error).removeprefix('TimeConfig: ')}") from None


def refuse_options(options: ImportOptions, why: str) -> None:
    """Raise `InputError` for an option that states what the file states itself, as `why` says."""
    for name, flag in _FLAGS.items():
        if getattr(options, name) is not None:
            raise InputError(f"--{flag}: {why}; leave the option out")


def seconds_of(text: str) -> float:
    """Seconds of a text: `"4ps"` → 4e-12. Raises `InputError` for any other text."""
    found = re.fullmatch(rf"{_NUMBER}\s*(fs|ps|ns|us|s)", text.strip())
    if found is None or float(found[1]) <= 0:
        raise InputError(f"--bin {text}: must be a time such as 4ps or 0.032ns")
    return float(found[1]) * _SECONDS[found[2]]


def metres_of(text: str) -> tuple[float, float]:
    """Width and height of a text, metres: `"2m"` → (2, 2), `"2m x 1m"` → (2, 1); raises `InputError` for others."""
    unit = r"\s*(mm|cm|m)"
    found = re.fullmatch(rf"{_NUMBER}{unit}(?:\s*[x×]\s*{_NUMBER}{unit})?", text.strip())
    if found is None:
        raise InputError(f"--wall {text}: must be a size such as 2m, or width and height such as 2m x 150cm")
    width = float(found[1]) * _METRES[found[2]]
    return width, width if found[3] is None else float(found[3]) * _METRES[found[4]]
