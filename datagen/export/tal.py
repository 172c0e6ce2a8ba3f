"""The HDF5 file of y-tal (https://github.com/diegoroyo/tal, `tal.io.read_capture`).

A flat root with exactly its names. The relay wall is z = 0 and what is hidden lies at z > 0; x comes before y, both
ascending; times are metres of path. Time is padded to begin at 0 and to a power of two of bins, which its fk and lct
take for granted.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from datagen.export.measurement import Measurement, lattice, measurement
from datagen.export.plain import h5py
from datagen.records.arrays import Floats
from datagen.store.scenes import SceneContent
from datagen.units import path_from_time


class HFormat(Enum):
    """The axes of H: time, then laser points (L) and pixels (S), each in a grid (x, y) or in a list (i)."""

    UNKNOWN = 0
    T_Sx_Sy = 1
    T_Lx_Ly_Sx_Sy = 2
    T_Si = 3
    T_Li_Si = 4


class GridFormat(Enum):
    """The axes of points: a list, or a grid."""

    UNKNOWN = 0
    N_3 = 1
    X_Y_3 = 2


class VolumeFormat(Enum):
    """The axes of volumes: y-tal has deprecated the key, and refuses files without it."""

    UNKNOWN = 0
    N_3 = 1
    X_Y_Z_3 = 2
    X_Y_3 = 3


@dataclass(frozen=True)
class _Shaped:
    """Values and points with the axes of y-tal."""

    h: NDArray[np.float32]
    h_format: HFormat
    lasers: Floats
    sensors: Floats

    @property
    def grid(self) -> GridFormat:
        return GridFormat.X_Y_3 if self.sensors.ndim == 3 else GridFormat.N_3


def write_tal(scene: SceneContent, path: Path, quantity: str | None = None) -> None:
    """Write one scene. A scan without a grid becomes a list of points (T_Si, T_Li_Si).

    Raises `InputError` as `measurement` does, and where h5py is missing.
    """
    m = measurement(scene, quantity).from_time_zero()
    shaped, bins = _shaped(m), m.time
    from_source = bins.origin == "source"
    content: dict[str, Any] = {
        "H": shaped.h,
        "H_format": shaped.h_format,
        "sensor_xyz": m.sensor_position.astype(np.float32),
        "sensor_grid_xyz": shaped.sensors.astype(np.float32),
        "sensor_grid_normals": _normals(shaped.sensors),
        "sensor_grid_format": shaped.grid,
        "laser_xyz": m.laser_position.astype(np.float32),
        "laser_grid_xyz": shaped.lasers.astype(np.float32),
        "laser_grid_normals": _normals(shaped.lasers),
        "laser_grid_format": shaped.grid,
        "volume_format": VolumeFormat.X_Y_Z_3,
        "delta_t": float(path_from_time(bins.width_s)),
        "t_start": float(path_from_time(bins.start_s)),
        "t_accounts_first_and_last_bounces": from_source,
        "scene_info": yaml.safe_dump(_scene_info(scene, m)),
    }
    with h5py().File(path, "w") as file:
        for name, value in content.items():
            if isinstance(value, Enum):
                kind = h5py().enum_dtype({choice.name: choice.value for choice in type(value)}, basetype="i")
                file.create_dataset(name, data=[value.value], dtype=kind)
            else:
                file.create_dataset(name, data=value, compression="gzip" if name == "H" else None)


def _shaped(m: Measurement) -> _Shaped:
    lasers, sensors = lattice(m.laser_points), lattice(m.seen_points)
    values = np.moveaxis(m.values, -1, 0)
    if m.paired:
        if sensors is None:
            return _Shaped(values[..., 0].astype(np.float32), HFormat.T_Si, m.laser_points, m.seen_points)
        h = values[:, sensors, 0].astype(np.float32)
        return _Shaped(h, HFormat.T_Sx_Sy, m.laser_points[sensors], m.seen_points[sensors])
    if lasers is None or sensors is None:
        alone = len(m.laser_points) == 1
        h = (values[:, 0] if alone else values).astype(np.float32)
        return _Shaped(h, HFormat.T_Si if alone else HFormat.T_Li_Si, m.laser_points, m.seen_points)
    h = values[:, lasers[:, :, None, None], sensors].astype(np.float32)
    alone = lasers.size == 1
    h, form = (h[:, 0, 0], HFormat.T_Sx_Sy) if alone else (h, HFormat.T_Lx_Ly_Sx_Sy)
    return _Shaped(h, form, m.laser_points[lasers], m.seen_points[sensors])


def _normals(points: Floats) -> NDArray[np.float32]:
    return np.broadcast_to(np.array([0, 0, 1], np.float32), points.shape).copy()


def _scene_info(scene: SceneContent, m: Measurement) -> dict[str, Any]:
    info: dict[str, Any] = {
        "original_format": "datagen",
        "datagen": {
            "dataset": str(scene.manifest.config["name"]),
            "scene": scene.index,
            "quantity": m.quantity,
            "origin_m": m.frame.origin.tolist(),
            "axes": m.frame.axes.tolist(),
            "parameters": dict(scene.parameters),
        },
    }
    if m.hidden is not None:
        low, high = m.hidden
        info["volume"] = {"center": ((low + high) / 2).tolist(), "size": (high - low).tolist()}
    return info
