"""A small measurement, which many tests can simulate."""

from __future__ import annotations

from typing import Any

from datagen import DatasetConfig
from datagen.config import config_from_mapping

CONTENTS = [{"kind": "pillar"}, {"kind": "box"}]


def measurement(
    detector: dict[str, Any], contents: list[dict[str, Any]] | None = None, **others: Any
) -> DatasetConfig:
    """A configuration of four laser points and coarse light, for a detector."""
    values = {
        "seed": 3,
        "scenes": 4,
        "scene": {"contents": CONTENTS if contents is None else contents},
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}},
        "transport": {"target": 0.3},
        "labels": {"rows": 8, "columns": 8},
        "store": {"fields": ["histogram", "objects"], "histogram_dtype": "uint32"},
        "detector": {"photons_per_pulse": 1e9, **detector},
    }
    return config_from_mapping(values | others)
