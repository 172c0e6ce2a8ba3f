"""Files of captures as other programs write them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

h5py = pytest.importorskip("h5py", reason="h5py is not installed (extra `export`)")


def stanford(folder: Path, axes: str = "xyt", **other: Any) -> tuple[Path, np.ndarray]:
    """The path of a file of the light-cone transform, and its counts (row, column, bin) from the top left."""
    counts = np.random.default_rng(1).poisson(0.7, (5, 6, 40))
    counts[0, 0, 0] = 9
    stored = counts.transpose(["yxt".index(axis) for axis in axes])
    path = folder / "data_s_u.mat"
    scipy.io.savemat(path, {"rect_data": stored.astype(np.float64), "width": 0.4} | other)
    return path, counts


def tal(path: Path, h: np.ndarray, form: int, lit: np.ndarray, seen: np.ndarray, **other: Any) -> Path:
    """A file as `tal.io.write_capture` writes it: an enum is an array of one element, None an empty dataset."""
    content: dict[str, Any] = {
        "H": h, "H_format": np.array([form], np.int32), "sensor_grid_xyz": seen, "laser_grid_xyz": lit,
        "sensor_grid_format": np.array([1 + (seen.ndim == 3)]), "laser_grid_format": np.array([1 + (lit.ndim == 3)]),
        "sensor_xyz": np.array([-0.5, 0, 0.25], np.float32), "laser_xyz": np.array([-0.5, 0, 0.25], np.float32),
        "sensor_grid_normals": None, "delta_t": 0.003, "t_start": 0.0, "t_accounts_first_and_last_bounces": True,
        "volume_format": np.array([2]), "scene_info": "original_format: HDF5_TAL\n",
    } | other  # fmt: skip
    with h5py.File(path, "w") as file:
        for name, value in content.items():
            file[name] = h5py.Empty(float) if value is None else value
    return path


def grid(nx: int, ny: int, mirrored: bool = False) -> np.ndarray:
    x, y = np.meshgrid(np.linspace(1, -1, nx) if mirrored else np.linspace(-1, 1, nx), np.linspace(-0.5, 0.5, ny))
    return np.stack([x.T, y.T, 0 * x.T], axis=-1).astype(np.float32)
