"""MATLAB files that are written: confocal grids as Stanford publishes them, and lists of pairs of points.

- A confocal grid on a flat wall: `meas` (y, x, t), `tofgrid` (y, x) in ps, `wall_size` in m, as `grids` reads them,
  with `grid_points` and `grid_normals` (y, x, 3). A grid on an uneven wall is not written so, because programs that
  read `meas` take the wall from `wall_size` alone.
- Any other scan: `trans_data` and points, as `lists` reads them.

Both have `bin_resolution` (s), points in the frame of the relay wall (z = 0, hidden z > 0), and are of version 5,
which MATLAB, Octave and `scipy.io.loadmat` read; it holds at most 2 GiB in one variable.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.formats.recording import Recording, lattice, recording_of
from datagen.records.arrays import Floats, Ints
from datagen.records.checks import option
from datagen.store.scenes import SceneContent
from datagen.units import path_from_time, time_from_path
from datagen.untrusted import CAPTURE_BYTES, expands_too_far

_LARGEST_BYTES = 2**31 - 1
"""Largest variable of version 5 that MATLAB reads."""


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
        **_normals_variable("grid_normals", m.seen_normals[order]),
    }


def _normals_variable(name: str, normals: Floats) -> dict[str, Floats]:
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
        **_normals_variable("camera_normals", seen_normals), **_normals_variable("laser_normals", lit_normals),
    }  # fmt: skip
