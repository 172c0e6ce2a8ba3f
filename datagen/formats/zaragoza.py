"""Files of the Zaragoza NLOS dataset (Galindo et al., *A dataset for benchmarking time-resolved non-line-of-sight
imaging*, 2019), as published and as Neural Transient Fields makes them over.

As published (HDF5): `data` (colour, time, bounce, sensor x, sensor y), and (…, laser x, laser y) unless the scan is
confocal; `cameraGridPositions`, `laserGridPositions` and their normals (3, x, y); `deltaT` and `t0` in metres of
path, counted from the laser to the sensor. Files that MATLAB wrote have all axes the other way round. y-tal reads
them alike.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.formats.containers import ONE, POINTS, VALUES, Content
from datagen.formats.recording import UNKNOWN, Captured, Recording, Stated, WallFrame, time_bins
from datagen.records.arrays import Floats
from datagen.units import time_from_path

WANTED = {
    "data": VALUES, "cameraGridPositions": POINTS, "cameraGridNormals": POINTS, "cameraPosition": 3,
    "laserGridPositions": POINTS, "laserGridNormals": POINTS, "laserPosition": 3, "deltaT": ONE, "t0": ONE,
    "isConfocal": ONE, "hiddenVolumePosition": 3, "hiddenVolumeSize": 3,
}  # fmt: skip


def read_zaragoza(content: Content, stated: Stated) -> Captured:
    """The recording in a file as published, all bounces and colours added up, in the frame of the file."""
    path, light = content.path, content.array("data")
    positions = content.array("cameraGridPositions")
    # Of a file that MATLAB wrote all axes are turned.
    turned = positions.ndim > 1 and positions.shape[0] != 3 and positions.shape[-1] == 3
    light = light.T if turned else light
    seen, lit = (_points_of(content, name, turned) for name in ("cameraGridPositions", "laserGridPositions"))
    seen_normals, lit_normals = (
        _unit_normals(content, name, len(points), turned)
        for name, points in (("cameraGridNormals", seen), ("laserGridNormals", lit))
    )
    total = light.sum(axis=(0, 2), dtype=np.promote_types(light.dtype, np.float32))
    bins, pixels = len(total), int(np.prod(light.shape[3:5]))
    values: NDArray[Any] = np.moveaxis(total.reshape(bins, pixels, -1), 0, -1).swapaxes(0, 1)
    paired = light.ndim == 5 and len(lit) == pixels
    if paired:
        values = values.swapaxes(0, 1)
    if values.shape[:2] != (len(lit), 1 if paired else len(seen)) or len(seen) != pixels:
        raise InputError(
            f"{path}: data of shape {light.shape} for {len(lit)} laser points and {len(seen)} of the camera"
        )
    time = time_bins(
        path, bins, time_from_path(content.number("deltaT")), stated.options,
        start_s=time_from_path(content.number("t0")), origin="source", named="deltaT",
    )  # fmt: skip
    laser, sensor = (
        content.array(name).reshape(-1).astype(np.float64) for name in ("laserPosition", "cameraPosition")
    )
    if laser.shape != (3,) or sensor.shape != (3,) or not np.isfinite([laser, sensor]).all():
        raise InputError(f"{path}: laserPosition, cameraPosition: three finite numbers each are needed, metres")
    hidden = _hidden_box(content)
    frame, note = _facing(seen, seen_normals, hidden)
    recording = Recording(
        values, paired, lit, lit_normals, seen, seen_normals, time, laser, sensor, frame, hidden
    )  # fmt: skip
    axes = f"data ({'laser y, laser x, ' * (light.ndim == 7)}y, x, bounce, time, colour)" if turned else (
        f"data (colour, time, bounce, x, y{', laser x, laser y' * (light.ndim == 7)})")  # fmt: skip
    return Captured(recording, axes, notes=("colours and bounces added up", "lengths in m", *note))


def read_made_over(content: Content, stated: Stated) -> Captured:
    """The recording in a file that Neural Transient Fields made of one as published: `data` (time, a, b) and
    `cameraGridPositions` (3, a · b), confocal and with times from the wall, as its loader and its model take them."""
    path, light, seen = content.path, content.array("data"), _points_of(content, "cameraGridPositions", False)
    if "isConfocal" in content.arrays and not content.number("isConfocal"):
        raise InputError(f"{path}: isConfocal = 0, and data (time, a, b) of one laser point says not where that was; "
                         "take the file as published")  # fmt: skip
    if light.shape[1] * light.shape[2] != len(seen):
        raise InputError(f"{path}: data of shape {light.shape} for {len(seen)} cameraGridPositions")
    values = np.moveaxis(light.reshape(len(light), -1), 0, -1)[:, None]
    normals = _unit_normals(content, "cameraGridNormals", len(seen), False)
    time = time_bins(path, len(light), time_from_path(content.number("deltaT")), stated.options, start_s=0.0,
                     origin="wall", named="deltaT")  # fmt: skip
    hidden = _hidden_box(content)
    if not np.isfinite(normals).all():
        # The wall is a plane in these files; its normal is that of the plane through its points.
        normal = np.linalg.svd(seen - seen.mean(axis=0), full_matrices=False)[2][-1]
        normals = np.tile(normal, (len(seen), 1))
        if hidden is None:
            raise InputError(
                f"{path}: says neither normals of the wall (cameraGridNormals) nor on which side the hidden part is "
                "(hiddenVolumePosition, hiddenVolumeSize); take the file as published"
            )
        normals = normals if normal @ (hidden.mean(axis=0) - seen.mean(axis=0)) > 0 else -normals
    frame, note = _facing(seen, normals, hidden)
    recording = Recording(values, True, seen, normals, seen, normals, time, UNKNOWN, UNKNOWN, frame, hidden)
    notes = (
        "confocal and from the wall as NeTF takes it",
        "points with the last axis fastest",
        "lengths in m",
        *note,
    )
    return Captured(recording, "data (time, a, b)", notes=notes)


def _points_of(content: Content, name: str, turned: bool) -> Floats:
    """(n, 3) points of a variable (3, x, y), or (y, x, 3) where all axes are turned."""
    found = content.array(name).T if turned else content.array(name)
    if found.ndim < 2 or found.shape[0] != 3 or found.size == 0 or not np.isfinite(found).all():
        raise InputError(
            f"{content.path}: {name}: shape {content.array(name).shape}, (3, x, y) needed: finite metres"
        )
    return np.ascontiguousarray(found.reshape(3, -1).T, np.float64)


def _unit_normals(content: Content, name: str, count: int, turned: bool) -> Floats:
    """(n, 3) unit normals of a variable as `_points_of` reads points; NaN where the file has none of this count."""
    unknown = np.full((count, 3), np.nan)
    if name not in content.arrays or content.array(name).size != 3 * count:
        return unknown
    found = _points_of(content, name, turned)
    length = np.linalg.norm(found, axis=1, keepdims=True)
    return found / length if (length > 0.1).all() else unknown


def _hidden_box(content: Content) -> Floats | None:
    """(2, 3) corners of a box that holds the hidden part; None where the file does not state it."""
    if not {"hiddenVolumePosition", "hiddenVolumeSize"} <= {*content.arrays}:
        return None
    middle, size = (content.array(f"hiddenVolume{of}").reshape(-1).astype(np.float64) for of in ("Position", "Size"))
    if middle.shape != (3,) or size.size not in (1, 3) or not np.isfinite([*middle, *size]).all():
        return None
    # The size is that of the object before it is turned: the ball about it holds it however that is.
    reach = np.linalg.norm(np.broadcast_to(size, 3)) / 2
    return np.stack([middle - reach, middle + reach])


def _facing(seen: Floats, normals: Floats, hidden: Floats | None) -> tuple[WallFrame, tuple[str, ...]]:
    """The frame of the wall, turned so that the hidden part lies before it, and words on that where normals do not
    say so."""
    frame = WallFrame.facing(seen, normals)
    if hidden is None or frame.to_wall(hidden.mean(axis=0))[2] >= 0:
        return frame, ()
    return WallFrame.facing(seen, -normals), ("the hidden volume lies behind the normals: the wall faces it",)
