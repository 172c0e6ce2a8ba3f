"""Measurements with a known truth: light that was reflected by one hidden point, in one bin for each pair."""

from __future__ import annotations

import numpy as np

from datagen.capture import capture_for
from datagen.config import DatasetConfig, config_from_mapping
from datagen.records import Sample
from datagen.records.sample import geometry_fields
from datagen.scene import generate_scene
from datagen.store import schema_of
from datagen.transport.lines_of_sight import lit_points, seen_points
from datagen.transport.rays import Raycaster

LIGHT = 299_792_458.0
CONFOCAL = {"scan": {"rows": 4, "columns": 5, "width_m": 0.8, "height_m": 0.6}}
SINGLE = {
    "pairing": "exhaustive",
    "scan": {"kind": "points", "points_m": [[0.1, -0.2]]},
    "field_of_view": {"rows": 3, "columns": 6, "width_m": 0.8, "height_m": 0.6},
}
EXHAUSTIVE = SINGLE | {"scan": {"rows": 2, "columns": 3, "width_m": 0.5, "height_m": 0.4}}
CIRCLE = {"scan": {"kind": "circle", "count": 7, "radius_m": 0.3}}
IRREGULAR = EXHAUSTIVE | {"scan": {"kind": "random", "count": 3}}
SCANS = {"confocal": CONFOCAL, "single": SINGLE, "exhaustive": EXHAUSTIVE, "circle": CIRCLE, "irregular": IRREGULAR}


def config_of(scan: str, origin: str, scenes: int = 2) -> DatasetConfig:
    """A corridor and a scan of it. From the source time begins where no light can have come back yet."""
    bins, start_ns = (1500, 2.025) if origin == "wall" else (2500, 25.0)
    time = {"bins": bins, "bin_width_ps": 50, "origin": origin, "start_ns": start_ns}
    return config_from_mapping(
        {
            "name": scan,
            "scenes": scenes,
            "capture": SCANS[scan] | {"time": time, "laser_offset_m": [0.0, 0.1, 0.0]},
            "labels": {"rows": 8, "columns": 8},
            "store": {"fields": ["histogram", "transient", "depth"], "scenes_per_shard": 1},
        }
    )


def hidden_point(config: DatasetConfig, index: int) -> np.ndarray:
    """(3,) in the scene's frame: in the hidden box, off its middle."""
    bounds = generate_scene(config.scene, config.seed, index).hidden_bounds
    assert bounds is not None
    return bounds[0] + (bounds[1] - bounds[0]) * [0.3, 0.6, 0.7]


def point_sample(config: DatasetConfig, index: int) -> Sample:
    """Seven counts in the bin in which light arrives that goes from laser point to the hidden point to pixel."""
    scene = generate_scene(config.scene, config.seed, index)
    capture = capture_for(config, scene, config.seed, index)
    caster = Raycaster(scene)
    at_lasers, at_pixels = lit_points(caster, capture.laser), seen_points(caster, capture.sensor)
    lit, seen = at_lasers.position[:, None], at_pixels.position[None]
    seen = seen.swapaxes(0, 1) if capture.pairing == "confocal" else seen
    point = hidden_point(config, index)
    way = np.linalg.norm(lit - point, axis=-1) + np.linalg.norm(seen - point, axis=-1)
    if capture.time.origin == "source":
        way = way + np.linalg.norm(lit - capture.laser.position, axis=-1)
        way = way + np.linalg.norm(seen - capture.sensor.position, axis=-1)
    bins = np.floor((way / LIGHT - capture.time.start_s) / capture.time.width_s).astype(int)
    assert ((bins >= 0) & (bins < capture.time.bins)).all()
    counts = 7 * (np.arange(capture.time.bins) == bins[..., None])
    wall, view = scene.relay_wall, scene.hidden_view
    assert wall is not None and view is not None
    assert counts.shape == capture.shape
    given = {
        "histogram": counts,
        "transient": counts * 1e-9,
        "depth": np.arange(64.0).reshape(8, 8),
        **geometry_fields(
            at_lasers, capture.sensor.pixels, at_pixels, capture.laser.position, capture.sensor.position,
            np.stack([wall.center, wall.right, wall.up]), np.stack([view.center, view.right, view.up]),
            scene.hidden_bounds,
        ),
    }  # fmt: skip
    assert set(given) == set(schema_of(config).by_name)
    return Sample(index, given, dict(scene.parameters), {"scene": 0.0})
