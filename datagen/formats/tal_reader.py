"""Captures of y-tal (https://github.com/diegoroyo/tal, `tal.io.read_capture`), in every layout of its H."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.config.imported import ImportOptions
from datagen.config.yaml_text import parse_yaml
from datagen.errors import InputError, TooLargeError
from datagen.formats.containers import Content, hdf5_content
from datagen.formats.recording import UNKNOWN, Recording, time_bins
from datagen.formats.tal import HFormat
from datagen.records.arrays import Floats
from datagen.units import time_from_path

_WANTED = (
    "H", "H_format", "sensor_xyz", "sensor_grid_xyz", "sensor_grid_normals", "laser_xyz", "laser_grid_xyz",
    "laser_grid_normals", "delta_t", "t_start", "t_accounts_first_and_last_bounces", "scene_info",
)  # fmt: skip
_GRIDS = {HFormat.T_Sx_Sy: (2, False), HFormat.T_Lx_Ly_Sx_Sy: (2, True), HFormat.T_Si: (1, False),
          HFormat.T_Li_Si: (1, True)}  # fmt: skip
"""Format → number of axes of a set of points, and whether the laser points have axes of their own."""


def read_tal(path: Path, options: ImportOptions) -> Recording:
    """The recording in one file, in the file's frame. Its times are metres of path there, and become seconds.

    Raises `InputError`, one line, for a file that is damaged or lacks something.
    """
    for name in ("wall_m", "axes", "delays"):
        if getattr(options, name) is not None:
            flag = {"wall_m": "wall", "delays": "tof"}.get(name, name)
            raise InputError(f"--{flag}: a file of y-tal says it itself; leave the option out")
    content = hdf5_content(path, _WANTED)
    if "H" not in content.names and {"data", "cameraGridPositions"} <= {*content.names}:
        raise InputError(
            f"{path}: is of the Zaragoza NLOS dataset; let y-tal write it anew first: "
            "tal.io.write_capture(new, tal.io.read_capture(old))"
        )
    seen, lit = content.points("sensor_grid_xyz"), content.points("laser_grid_xyz")
    values, paired = _values(content, lit, seen)
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
        path, values.shape[-1], width_s, options, start_s=time_from_path(content.number("t_start")),
        origin="source" if from_source else "wall", named="delta_t",
    )  # fmt: skip
    return Recording(
        path, values, paired, lit.reshape(-1, 3), content.normals("laser_grid_normals", lit), seen.reshape(-1, 3),
        content.normals("sensor_grid_normals", seen), time, laser, sensor,
        _hidden(path, content.texts.get("scene_info", "")),
    )  # fmt: skip


def _values(content: Content, lit: Floats, seen: Floats) -> tuple[NDArray[Any], bool]:
    """H as (L, P, T), and whether each pixel has one laser point of its own (then P = 1)."""
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
        return np.moveaxis(h.reshape(len(h), lasers, pixels), 0, -1), False
    values = np.moveaxis(h.reshape(len(h), pixels), 0, -1)
    if lasers == pixels:
        return values[:, None], True
    if lasers == 1:
        return values[None], False
    raise InputError(
        f"{content.path}: laser_grid_xyz: {lasers} points beside {pixels} pixels in a {form.name}; one, or one for "
        "each pixel, is needed"
    )


def _check_grid(path: Path, name: str, axes: tuple[int, ...], points: Floats) -> None:
    there = points.shape[:-1]
    if math.prod(there) != math.prod(axes) or (len(there) == len(axes) and there != axes):
        raise InputError(f"{path}: {name}: shape {points.shape} does not fit H, which has {axes} of them")


def _hidden(path: Path, info: str) -> Floats | None:
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
