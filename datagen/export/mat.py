"""MATLAB files: a confocal grid as the Stanford data have it, any other scan as a list of pairs of points.

- Confocal grid: version 7.3, `meas` (y, x, t), `tofgrid` (y, x) in ps and `wall_size` in m, as the demonstrations of
  Lindell, Wetzstein and O'Toole, *Wave-Based Non-Line-of-Sight Imaging using Fast f-k Migration* (2019), read them:
  row 0 at the top, column 0 to the left; shifted by −floor(tofgrid / bin), `meas` counts from the wall.
- Any other: version 5, `camera_points`, `laser_points`, `camera_normals`, `laser_normals` (N, 3) and `trans_data`
  (N, T), a row for each pair of a laser point and a pixel, counted from the wall, as 3D Gaussian Transient Rendering
  (3D-GTR, 2026) loads them.

Both have `bin_resolution` (s); points are in the frame of the relay wall (z = 0, hidden z > 0). A file of version 7.3
is HDF5 behind a head of 512 bytes, its arrays transposed and told their MATLAB class by an attribute.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.export.hdf5 import h5py
from datagen.export.measurement import Measurement, lattice, measurement
from datagen.records.arrays import Floats
from datagen.store.scenes import SceneContent
from datagen.units import time_from_path

_HEAD = b"MATLAB 7.3 MAT-file, HDF5 schema 1.00 ."
_CLASS = {"float32": "single", "float64": "double"}
_LARGEST_V5 = 2**31 - 1


def write_mat(scene: SceneContent, path: Path, quantity: str | None = None) -> None:
    """Write one scene. Raises `InputError` as `measurement` does, and where h5py is missing or a list is too long."""
    m = measurement(scene, quantity).from_time_zero()
    place = lattice(m.seen_points) if m.paired and np.array_equal(m.seen_points, m.laser_points) else None
    common: dict[str, Any] = {"bin_resolution": m.time.width_s, "scene": scene.index}
    if place is not None and min(place.shape) > 1:
        _write_v73(path, common | _confocal_grid(m, place))
        return
    lists = common | _pairs(m)
    if lists["trans_data"].nbytes > _LARGEST_V5:
        raise InputError(f"{path.name}: trans_data has {lists['trans_data'].nbytes} bytes, this format at most 2 GiB")
    from scipy.io import savemat

    savemat(path, lists, do_compression=True)


def _confocal_grid(m: Measurement, place: NDArray[np.int64]) -> dict[str, Any]:
    # Columns × rows with y ascending → rows from the top × columns.
    order = place.T[::-1]
    points = m.seen_points[order]
    width, height = np.ptp(points[..., 0]), np.ptp(points[..., 1])
    square = abs(width - height) < 1e-3 * width
    return {
        "meas": m.values[order, 0],
        "tofgrid": 1e12 * _legs_s(m, m.laser_points, m.seen_points)[order],
        "wall_size": width if square else np.array([width, height]),
        "grid_points": points,
    }


def _legs_s(m: Measurement, lit: Floats, seen: Floats) -> Floats:
    """(N,) s: the way from the laser to the wall and from there to the sensor, as far as arrival times hold it."""
    if m.time.origin == "wall":
        return np.zeros(len(lit))
    ways = np.linalg.norm(lit - m.laser_position, axis=1) + np.linalg.norm(seen - m.sensor_position, axis=1)
    return np.asarray(time_from_path(ways))


def _pairs(m: Measurement) -> dict[str, Any]:
    lasers, pixels, bins = m.values.shape
    lit = m.laser_points if m.paired else np.repeat(m.laser_points, pixels, axis=0)
    seen = m.seen_points if m.paired else np.tile(m.seen_points, (lasers, 1))
    transients = np.zeros((len(lit), bins), np.float32)
    shifts = np.floor(_legs_s(m, lit, seen) / m.time.width_s).astype(int)
    for row, (values, shift) in enumerate(zip(m.values.reshape(-1, bins), shifts, strict=True)):
        transients[row, : bins - shift] = values[shift:]
    normals = np.broadcast_to([0.0, 0.0, 1.0], lit.shape)
    points = {"camera_points": seen, "laser_points": lit, "camera_normals": normals, "laser_normals": normals}
    return {"trans_data": transients} | points


def _write_v73(path: Path, variables: dict[str, Any]) -> None:
    with h5py().File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            array = np.atleast_2d(np.asarray(value))
            array = array.astype(np.float64) if array.dtype.kind == "i" else array
            # MATLAB's arrays run along the first axis first.
            stored = file.create_dataset(name, data=array.T, compression="gzip" if array.size > 64 else None)
            stored.attrs["MATLAB_class"] = np.bytes_(_CLASS.get(array.dtype.name, array.dtype.name))
    with path.open("r+b") as raw:
        # 116 letters of text, 8 bytes for a subsystem that there is none of, version and byte order.
        raw.write(_HEAD.ljust(116) + bytes(8) + b"\x00\x02IM")
