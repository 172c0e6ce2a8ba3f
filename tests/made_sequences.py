"""A dataset of a few tiny sequences: boxes that walk before a wall, and one that stands."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import datagen as dg
from datagen.config import config_from_mapping

FRAMES = 5


def made_sequences(
    path: Path,
    scenes: int = 10,
    walkers: int = 2,
    albedo: Any = 0.8,
    side: int = 3,
    cycles: int = 100_000,
    photons: float = 1e9,
) -> Path:
    """Boxes of one albedo, or of albedos of a distribution, seen by side × side laser points."""
    size = {"width_m": 0.4, "depth_m": 0.3, "height_m": {"uniform": [0.5, 0.8]}}
    walk = {"kind": "walk", "speed_m_s": 1.0, "leg_m": 0.8}
    config = {
        "name": "walks", "scenes": scenes, "seed": 6,
        "sequence": {"frames": FRAMES, "rate_hz": 5},
        "scene": {
            "layout": {"kind": "isolated_wall", "wall_width_m": 2.0, "height_m": 2.0, "device_height_m": 1.0,
                       "relay_distance_m": 3.5},
            "contents": [
                {"kind": "box", "name": "stands", **size, "width_m": 0.2},
                {"kind": "box", "name": "walks", "count": walkers, "albedo": albedo, "motion": walk, **size},
            ],
        },
        "capture": {"scan": {"rows": side, "columns": side}, "time": {"bins": 96, "bin_width_ps": 200}},
        "transport": {"target": 0.1},
        "detector": {"cycles": cycles, "photons_per_pulse": photons},
        "store": {"fields": ["histogram", "objects"], "histogram_dtype": "uint32"},
        "splits": {"train": 0.5, "val": 0.1, "test": 0.4},
    }  # fmt: skip
    dg.build(config_from_mapping(config), path, progress=False)
    return path
