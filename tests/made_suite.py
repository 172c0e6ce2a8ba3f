"""A dataset of a few tiny scenes with the labels of a suite, some of whose objects have no evidence."""

from __future__ import annotations

from pathlib import Path

import datagen as dg
from datagen.config import config_from_mapping

ROWS, COLUMNS, VOXELS = 8, 10, (4, 6, 6)


def made_suite(path: Path, scenes: int = 10) -> Path:
    """Two boxes before a wall, of albedos over four decades."""
    box = {
        "kind": "box", "count": 2, "width_m": 0.4, "depth_m": 0.3, "height_m": {"uniform": [0.4, 0.8]},
        "albedo": {"log_uniform": [1e-4, 0.9]},
    }  # fmt: skip
    place = {"wall_width_m": 2.0, "height_m": 2.0, "device_height_m": 1.0, "relay_distance_m": 3.0}
    config = {
        "name": "made", "scenes": scenes, "seed": 5,
        "scene": {"layout": {"kind": "isolated_wall", **place}, "contents": [box]},
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 300}},
        "transport": {"samples": 256},
        "detector": {"cycles": 100000, "photons_per_pulse": 1e8},
        "labels": {"rows": ROWS, "columns": COLUMNS, "voxels": list(VOXELS)},
        "store": {"fields": ["histogram", "depth", "part_id", "occupancy", "objects"]},
        "splits": {"train": 0.5, "val": 0.1, "test": 0.4},
    }  # fmt: skip
    dg.build(config_from_mapping(config), path, progress=False)
    return path
