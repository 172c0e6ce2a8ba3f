"""datagen: the dataset factory for machine learning on non-line-of-sight single-photon data.

The public face is imported lazily, so that `import datagen` and `datagen --help` stay quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from datagen._version import __version__

if TYPE_CHECKING:
    from datagen.building.build import build
    from datagen.capture import capture_for
    from datagen.config import load_config
    from datagen.detector import Exposure, Spad, detect, expected_histogram
    from datagen.effects import plan_effects
    from datagen.loader import TransientDataset
    from datagen.paper.as_printed import AsPrinted, simulate_as_printed
    from datagen.records import (
        GGX,
        Accuracy,
        Capture,
        Lambertian,
        Laser,
        OrenNayar,
        Part,
        Phong,
        Retroreflector,
        Scene,
        Sensor,
        SinLobe,
        TimeAxis,
    )
    from datagen.scene import generate_scene
    from datagen.transport import simulate

_HOME = {
    "Accuracy": "datagen.records",
    "AsPrinted": "datagen.paper.as_printed",
    "Capture": "datagen.records",
    "Exposure": "datagen.detector",
    "GGX": "datagen.records",
    "Lambertian": "datagen.records",
    "Laser": "datagen.records",
    "OrenNayar": "datagen.records",
    "Part": "datagen.records",
    "Phong": "datagen.records",
    "Retroreflector": "datagen.records",
    "Scene": "datagen.records",
    "Sensor": "datagen.records",
    "SinLobe": "datagen.records",
    "Spad": "datagen.detector",
    "TimeAxis": "datagen.records",
    "TransientDataset": "datagen.loader",
    "build": "datagen.building.build",
    "capture_for": "datagen.capture",
    "detect": "datagen.detector",
    "expected_histogram": "datagen.detector",
    "generate_scene": "datagen.scene",
    "load_config": "datagen.config",
    "plan_effects": "datagen.effects",
    "simulate": "datagen.transport",
    "simulate_as_printed": "datagen.paper.as_printed",
}

__all__ = [
    "GGX",
    "Accuracy",
    "AsPrinted",
    "Capture",
    "Exposure",
    "Lambertian",
    "Laser",
    "OrenNayar",
    "Part",
    "Phong",
    "Retroreflector",
    "Scene",
    "Sensor",
    "SinLobe",
    "Spad",
    "TimeAxis",
    "TransientDataset",
    "__version__",
    "build",
    "capture_for",
    "detect",
    "expected_histogram",
    "generate_scene",
    "load_config",
    "plan_effects",
    "simulate",
    "simulate_as_printed",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'datagen' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
