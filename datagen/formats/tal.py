"""The HDF5 file of y-tal (https://github.com/diegoroyo/tal, `tal.io.read_capture`), written and read.

All arrays lie at the root, with the names of y-tal; times are metres of path. What is written has the relay wall at
z = 0 and the hidden part at z > 0; points on an uneven wall lie off that plane, each with the normal of the surface
there. x comes before y, both ascending; time is padded to begin at 0 and to a number of bins that is a power of two,
which y-tal's fk and lct assume. Every layout of H is read.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from datagen.config.yaml_text import parse_yaml
from datagen.errors import InputError, TooLargeError
from datagen.formats.containers import ONE, POINTS, VALUES, Content, h5py
from datagen.formats.recording import (
    UNKNOWN,
    Captured,
    Recording,
    Stated,
    WallFrame,
    lattice,
    quantity_in,
    recording_of,
    time_bins,
)
from datagen.records.arrays import Floats, Ints
from datagen.store.scenes import SceneContent
from datagen.units import path_from_time, time_from_path
from datagen.untrusted import CAPTURE_BYTES, expands_too_far

HFormat = Enum("HFormat", "UNKNOWN T_Sx_Sy T_Lx_Ly_Sx_Sy T_Si T_Li_Si", start=0)
"""The axes of H: time, then laser points (L) and pixels (S), each as a grid (x, y) or a list (i)."""
GridFormat = Enum("GridFormat", "UNKNOWN N_3 X_Y_3", start=0)
"""The axes of points: list or grid."""
VolumeFormat = Enum("VolumeFormat", "UNKNOWN N_3 X_Y_Z_3 X_Y_3", start=0)
"""The axes of volumes: y-tal has deprecated the key, and refuses files without it."""
WANTED = {
    "H": VALUES, "H_format": ONE, "sensor_xyz": POINTS, "sensor_grid_xyz": POINTS, "sensor_grid_normals": POINTS,
    "laser_xyz": POINTS, "laser_grid_xyz": POINTS, "laser_grid_normals": POINTS, "delta_t": ONE, "t_start": ONE,
    "t_accounts_first_and_last_bounces": ONE, "scene_info": ONE,
}  # fmt: skip
_GRIDS = {HFormat.T_Sx_Sy: (2, False), HFormat.T_Lx_Ly_Sx_Sy: (2, True), HFormat.T_Si: (1, False),
          HFormat.T_Li_Si: (1, True)}  # fmt: skip
"""Format → number of axes of a set of points, and whether the laser points have axes of their own."""


def write_tal(scene: SceneContent, path: Path, quantity: str | None = None) -> None:
    """Write one scene. A scan without a grid becomes a list of points (T_Si, T_Li_Si).

    Raises `InputError` as `recording_of` does, and where h5py is missing.
    """
    stored = recording_of(scene, quantity)
    m = stored.on_wall().from_time_zero()
    h, h_format, lasers, sensors = _with_axes(m)
    grid_format = GridFormat.X_Y_3 if sensors.ndim == 2 else GridFormat.N_3
    content: dict[str, Any] = {
        "H": h.astype(np.float32),
        "H_format": h_format,
        "sensor_xyz": m.sensor_position.astype(np.float32),
        "sensor_grid_xyz": m.seen_points[sensors].astype(np.float32),
        "sensor_grid_normals": _known_normals(m.seen_normals[sensors]),
        "sensor_grid_format": grid_format,
        "laser_xyz": m.laser_position.astype(np.float32),
        "laser_grid_xyz": m.laser_points[lasers].astype(np.float32),
        "laser_grid_normals": _known_normals(m.laser_normals[lasers]),
        "laser_grid_format": grid_format,
        "volume_format": VolumeFormat.X_Y_Z_3,
        "delta_t": float(path_from_time(m.time.width_s)),
        "t_start": float(path_from_time(m.time.start_s)),
        "t_accounts_first_and_last_bounces": m.time.origin == "source",
        "scene_info": yaml.safe_dump(_scene_info(scene, quantity, stored.frame, m.hidden)),
    }
    _write(path, content, "gzip")
    if expands_too_far(content["H"].nbytes, path.stat().st_size, CAPTURE_BYTES):
        # A scan of few photons packs so far that it would not be read again.
        _write(path, content, None)


def _write(path: Path, content: Mapping[str, Any], compression: str | None) -> None:
    """Write a file of y-tal, its H compressed as named."""
    with h5py().File(path, "w") as file:
        for name, value in content.items():
            if isinstance(value, Enum):
                kind = h5py().enum_dtype({choice.name: choice.value for choice in type(value)}, basetype="i")
                file.create_dataset(name, data=[value.value], dtype=kind)
            elif value is None:
                # As y-tal writes it: a name without values.
                file.create_dataset(name, data=h5py().Empty(float))
            else:
                file.create_dataset(name, data=value, compression=compression if name == "H" else None)


def _with_axes(m: Recording) -> tuple[NDArray[Any], HFormat, Ints, Ints]:
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


def _known_normals(normals: Floats) -> NDArray[np.float32] | None:
    """Normals as the file has them; None if they are those of an imported capture that does not state them."""
    return normals.astype(np.float32) if np.isfinite(normals).all() else None


def _scene_info(scene: SceneContent, quantity: str | None, frame: WallFrame, hidden: Floats | None) -> dict[str, Any]:
    info: dict[str, Any] = {
        "original_format": "datagen",
        "datagen": {
            "dataset": str(scene.manifest.config["name"]),
            "scene": scene.index,
            "quantity": quantity_in(scene, quantity),
            "origin_m": frame.origin.tolist(),
            "axes": frame.axes.tolist(),
            "parameters": dict(scene.parameters),
        },
    }
    if hidden is not None:
        low, high = hidden
        info["volume"] = {"center": ((low + high) / 2).tolist(), "size": (high - low).tolist()}
    return info


def read_tal(content: Content, stated: Stated) -> Captured:
    """The recording in a file of y-tal, in the file's frame. Its times are metres of path there, and become seconds.

    Raises `InputError`, one line, for a file that is damaged or lacks something.
    """
    path, seen, lit = content.path, content.points("sensor_grid_xyz"), content.points("laser_grid_xyz")
    values, form, paired = _values(content, lit, seen)
    from_source = bool(content.number("t_accounts_first_and_last_bounces"))
    laser, sensor = (
        content.points(name).reshape(-1)[:3] if name in content.arrays else UNKNOWN
        for name in ("laser_xyz", "sensor_xyz")
    )
    if from_source and np.isnan([laser, sensor]).any():
        raise InputError(
            f"{path}: laser_xyz, sensor_xyz: missing, and its times count from the laser "
            "(t_accounts_first_and_last_bounces)"
        )
    width_s = time_from_path(content.number("delta_t")) if "delta_t" in content.arrays else None
    time = time_bins(
        path, values.shape[-1], width_s, stated.options, start_s=time_from_path(content.number("t_start")),
        origin="source" if from_source else "wall", named="delta_t",
    )  # fmt: skip
    lit_normals = content.normals("laser_grid_normals", lit)
    seen_normals = content.normals("sensor_grid_normals", seen)
    lit, seen = lit.reshape(-1, 3), seen.reshape(-1, 3)
    recording = Recording(
        values, paired, lit, lit_normals, seen, seen_normals, time, laser, sensor,
        WallFrame.facing(seen, seen_normals), _hidden_box(path, content.texts.get("scene_info", "")),
    )  # fmt: skip
    return Captured(recording, f"H ({form.name})", notes=("lengths in m",))


def _values(content: Content, lit: Floats, seen: Floats) -> tuple[NDArray[Any], HFormat, bool]:
    """H as (L, P, T), its format, and whether each pixel has one laser point of its own (then P = 1)."""
    h, number = content.array("H"), content.number("H_format")
    try:
        form = HFormat(int(number))
        axes, exhaustive = _GRIDS[form]
    except (ValueError, KeyError):
        known = ", ".join(f"{one.value} ({one.name})" for one in _GRIDS)
        raise InputError(f"{content.path}: H_format = {number:g}: must be one of {known}") from None
    if h.ndim != 1 + axes * (1 + exhaustive) or h.size == 0:
        raise InputError(f"{content.path}: H: shape {h.shape}, which is no {form.name}")
    _check_grid(content.path, "sensor_grid_xyz", h.shape[-axes:], seen)
    pixels = math.prod(h.shape[-axes:])
    lasers = math.prod(lit.shape[:-1])
    if exhaustive:
        _check_grid(content.path, "laser_grid_xyz", h.shape[1 : 1 + axes], lit)
        return np.moveaxis(h.reshape(len(h), lasers, pixels), 0, -1), form, False
    values = np.moveaxis(h.reshape(len(h), pixels), 0, -1)
    if lasers == pixels:
        return values[:, None], form, True
    if lasers == 1:
        return values[None], form, False
    raise InputError(
        f"{content.path}: laser_grid_xyz: {lasers} points beside {pixels} pixels in a {form.name}; one, or one for "
        "each pixel, is needed"
    )


def _check_grid(path: Path, name: str, axes: tuple[int, ...], points: Floats) -> None:
    there = points.shape[:-1]
    if math.prod(there) != math.prod(axes) or (len(there) == len(axes) and there != axes):
        raise InputError(f"{path}: {name}: shape {points.shape} does not fit H, which has {axes} of them")


def _hidden_box(path: Path, info: str) -> Floats | None:
    """(2, 3) corners of the hidden box that `scene_info` states in plain YAML; None where it does not.
    Raises `TooLargeError` for text whose aliases stand for more than a description ever has."""
    try:
        volume = parse_yaml(info, f"{path}: scene_info")["volume"]
        center, size = (np.asarray(volume[name], np.float64).reshape(3) for name in ("center", "size"))
    except TooLargeError:
        raise
    except (KeyError, TypeError, ValueError):
        # The text may be notes of any kind.
        return None
    corners = np.stack([center - size / 2, center + size / 2])
    return corners if np.isfinite(corners).all() else None
