"""Random scenes and captures for the promise that `target.py` tests: a target is met, at a fair cost."""

from __future__ import annotations

from typing import Any

import numpy as np

from datagen.config import DatasetConfig, config_from_mapping

LAYOUTS = ("l_corridor", "t_corridor", "corridor_room", "z_corridor", "straight_corridor")
WINDOWS = ((32, 2000), (64, 1000), (128, 500), (256, 250), (512, 100))
"""Bins and their width in ps."""
BRDFS: tuple[dict[str, Any], ...] = (
    {"kind": "lambertian"},
    {"kind": "lambertian"},
    {"kind": "phong", "exponent": 20, "specular": 0.5},
    {"kind": "oren_nayar", "sigma_deg": 25},
    {"kind": "ggx", "roughness": 0.4},
)


def random_case(index: int, seed: int = 0) -> DatasetConfig:
    """Case `index`: a room of any layout with anything in it, of matt or glossy materials, clean or foggy; a confocal
    scan, a pixel array, a scan with several pixels or a single large pixel; coarse to fine bins; 3, 4, 5 or all
    bounces, with or without the direct return. The same index and seed give the same case."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    bins, width = WINDOWS[rng.integers(len(WINDOWS))]
    return config_from_mapping(
        {
            "name": f"case {index}",
            "seed": int(rng.integers(2**31)),
            "scenes": 1,
            "scene": {
                "layout": {"kind": LAYOUTS[rng.integers(len(LAYOUTS))]},
                "contents": _contents(rng),
                "materials": {name: _surface(rng) for name in ("relay_wall", "walls", "floor", "ceiling")},
                "attenuation_per_m": float(rng.choice([0.0, 0.0, 0.1])),
            },
            "capture": {**_capture(rng), "time": {"bins": bins, "bin_width_ps": width, "start_ns": 25.0}},
            "transport": {
                "max_bounces": (3, 3, 4, 4, 4, 5, None)[rng.integers(7)],
                "direct": bool(rng.random() < 0.1),
            },
        }
    )


def _surface(rng: np.random.Generator) -> dict[str, Any]:
    return {"albedo": float(rng.uniform(0.1, 0.95)), "brdf": BRDFS[rng.integers(len(BRDFS))]}


def _contents(rng: np.random.Generator) -> list[dict[str, Any]]:
    groups = ("figures", "furniture", "shapes", "letters", "household")
    return [
        {"kind": "library", "name": f"thing{k}", "classes": [groups[rng.integers(len(groups))]], **_surface(rng)}
        for k in range(rng.integers(1, 4))
    ]


def _capture(rng: np.random.Generator) -> dict[str, Any]:
    kind = rng.integers(4)
    side = float(rng.uniform(0.3, 1.0))
    grid = {"rows": 4, "columns": 4, "width_m": side, "height_m": side}
    if kind == 0:
        small = float(rng.choice([0.02, 0.05, 0.2]))
        return {"pairing": "confocal", "scan": grid, "field_of_view": {"width_m": small, "height_m": small}}
    view = {"width_m": side, "height_m": side}
    scan = {"rows": 2, "columns": 2, **view} if kind == 2 else {"rows": 1, "columns": 1}
    pixels = {1: {"rows": 6, "columns": 6}, 2: {"rows": 3, "columns": 3}}.get(int(kind), {})
    return {"pairing": "exhaustive", "scan": scan, "field_of_view": {**view, **pixels}}
