"""The HDF5 file of y-tal (https://github.com/diegoroyo/tal, `tal.io.read_capture`).

All arrays lie at the root, with the names of y-tal. The relay wall is z = 0 and the hidden part lies at z > 0; points
on an uneven wall lie off that plane, each with the normal of the surface there. x
comes before y, both ascending; times are metres of path. Time is padded to begin at 0 and to a number of bins that is
a power of two, which y-tal's fk and lct assume.
"""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from datagen.formats.measurement import Measurement, lattice, measurement
from datagen.formats.plain import h5py
from datagen.records.arrays import Floats, Ints
from datagen.store.scenes import SceneContent
from datagen.units import path_from_time

HFormat = Enum("HFormat", "UNKNOWN T_Sx_Sy T_Lx_Ly_Sx_Sy T_Si T_Li_Si", start=0)
"""The axes of H: time, then laser points (L) and pixels (S), each as a grid (x, y) or a list (i)."""
GridFormat = Enum("GridFormat", "UNKNOWN N_3 X_Y_3", start=0)
"""The axes of points: list or grid."""
VolumeFormat = Enum("VolumeFormat", "UNKNOWN N_3 X_Y_Z_3 X_Y_3", start=0)
"""The axes of volumes: y-tal has deprecated the key, and refuses files without it."""


def write_tal(scene: SceneContent, path: Path, quantity: str | None = None) -> None:
    """Write one scene. A scan without a grid becomes a list of points (T_Si, T_Li_Si).

    Raises `InputError` as `measurement` does, and where h5py is missing.
    """
    m = measurement(scene, quantity).from_time_zero()
    h, h_format, lasers, sensors = _with_axes(m)
    grid_format = GridFormat.X_Y_3 if sensors.ndim == 2 else GridFormat.N_3
    content: dict[str, Any] = {
        "H": h.astype(np.float32),
        "H_format": h_format,
        "sensor_xyz": m.sensor_position.astype(np.float32),
        "sensor_grid_xyz": m.seen_points[sensors].astype(np.float32),
        "sensor_grid_normals": _known(m.seen_normals[sensors]),
        "sensor_grid_format": grid_format,
        "laser_xyz": m.laser_position.astype(np.float32),
        "laser_grid_xyz": m.laser_points[lasers].astype(np.float32),
        "laser_grid_normals": _known(m.laser_normals[lasers]),
        "laser_grid_format": grid_format,
        "volume_format": VolumeFormat.X_Y_Z_3,
        "delta_t": float(path_from_time(m.time.width_s)),
        "t_start": float(path_from_time(m.time.start_s)),
        "t_accounts_first_and_last_bounces": m.time.origin == "source",
        "scene_info": yaml.safe_dump(_scene_info(scene, m)),
    }
    with h5py().File(path, "w") as file:
        for name, value in content.items():
            if isinstance(value, Enum):
                kind = h5py().enum_dtype({choice.name: choice.value for choice in type(value)}, basetype="i")
                file.create_dataset(name, data=[value.value], dtype=kind)
            elif value is None:
                # As y-tal writes it: a name without values.
                file.create_dataset(name, data=h5py().Empty(float))
            else:
                file.create_dataset(name, data=value, compression="gzip" if name == "H" else None)


def _with_axes(m: Measurement) -> tuple[NDArray[Any], HFormat, Ints, Ints]:
    """H and its format, and the numbers of laser points and pixels along the axes of y-tal: grids (x, y) if both are
    grids, else lists."""
    lasers, sensors = lattice(m.laser_points), lattice(m.seen_points)
    h = np.moveaxis(m.values, -1, 0)
    is_alone = len(m.laser_points) == 1
    if sensors is None or (lasers is None and not m.paired):
        one_each = m.paired or is_alone
        flat = h[..., 0] if m.paired else h[:, 0] if is_alone else h
        listed = np.arange(len(m.laser_points)), np.arange(len(m.seen_points))
        return flat, HFormat.T_Si if one_each else HFormat.T_Li_Si, *listed
    if m.paired:
        return h[:, sensors, 0], HFormat.T_Sx_Sy, sensors, sensors
    assert lasers is not None
    if is_alone:
        return h[:, 0, sensors], HFormat.T_Sx_Sy, lasers, sensors
    return h[:, lasers[:, :, None, None], sensors], HFormat.T_Lx_Ly_Sx_Sy, lasers, sensors


def _known(normals: Floats) -> NDArray[np.float32] | None:
    """Normals as the file has them; None if they are those of an imported capture that does not state them."""
    return normals.astype(np.float32) if np.isfinite(normals).all() else None


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
