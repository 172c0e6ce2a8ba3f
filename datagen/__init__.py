"""datagen: the dataset factory for machine learning on non-line-of-sight single-photon data.

The public face is imported lazily, so that `import datagen` and `datagen --help` stay quick.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from datagen._version import __version__

if TYPE_CHECKING:
    from datagen.building.build import BuildResult, build
    from datagen.building.build_from import build_from
    from datagen.building.on_the_fly import GeneratedDataset
    from datagen.capture import capture_for
    from datagen.config import DatasetConfig, EffectsConfig, SceneConfig, load_config
    from datagen.design.exposure import with_exposure_found
    from datagen.design.scene_for import scene_for
    from datagen.detector import Exposure, Spad, detect, expected_histogram
    from datagen.effects import Decision, EffectDecisions, plan_effects
    from datagen.errors import CheckError, InputError, InputWarning
    from datagen.evidence import Evidence, Presence, own_evidence, presence_evidence
    from datagen.importing import import_captures
    from datagen.loader import EpochSampler, TransientDataset, collate, dense
    from datagen.paper.as_printed import AsPrinted, simulate_as_printed
    from datagen.records import (
        GGX,
        Accuracy,
        Capture,
        Lambertian,
        Laser,
        Material,
        OrenNayar,
        Part,
        Phong,
        Pose,
        Rectangle,
        Retroreflector,
        Sample,
        Scene,
        Sensor,
        SinLobe,
        Spend,
        TimeAxis,
        Transient,
    )
    from datagen.scene import generate_scene
    from datagen.scoring import Scores, score
    from datagen.suites import SuiteResult, build_suite
    from datagen.transport import simulate

# Type checkers want a literal; `_HOME` says at run time where each of these names is.
__all__ = [
    "GGX", "Accuracy", "AsPrinted", "BuildResult", "Capture", "CheckError", "DatasetConfig", "Decision",
    "EffectDecisions", "EffectsConfig", "EpochSampler", "Evidence", "Exposure", "GeneratedDataset", "InputError",
    "InputWarning", "Lambertian", "Laser", "Material", "OrenNayar", "Part", "Phong", "Pose", "Presence", "Rectangle",
    "Retroreflector", "Sample", "Scene", "SceneConfig", "Scores", "Sensor", "SinLobe", "Spad", "Spend", "SuiteResult",
    "TimeAxis", "Transient", "TransientDataset", "__version__", "build", "build_from", "build_suite", "capture_for",
    "collate", "dense", "detect", "expected_histogram", "generate_scene", "import_captures", "load_config",
    "own_evidence", "plan_effects", "presence_evidence", "scene_for", "score", "simulate", "simulate_as_printed",
    "with_exposure_found",
]  # fmt: skip
_HOME = dict.fromkeys(__all__, "datagen.records") | {
    "AsPrinted": "datagen.paper.as_printed",
    "BuildResult": "datagen.building.build",
    "CheckError": "datagen.errors",
    "DatasetConfig": "datagen.config",
    "Decision": "datagen.effects",
    "EffectDecisions": "datagen.effects",
    "EffectsConfig": "datagen.config",
    "EpochSampler": "datagen.loader",
    "Evidence": "datagen.evidence",
    "Exposure": "datagen.detector",
    "GeneratedDataset": "datagen.building.on_the_fly",
    "InputError": "datagen.errors",
    "InputWarning": "datagen.errors",
    "Presence": "datagen.evidence",
    "SceneConfig": "datagen.config",
    "Scores": "datagen.scoring",
    "Spad": "datagen.detector",
    "SuiteResult": "datagen.suites",
    "TransientDataset": "datagen.loader",
    "build": "datagen.building.build",
    "build_from": "datagen.building.build_from",
    "build_suite": "datagen.suites",
    "capture_for": "datagen.capture",
    "collate": "datagen.loader",
    "dense": "datagen.loader",
    "detect": "datagen.detector",
    "expected_histogram": "datagen.detector",
    "generate_scene": "datagen.scene",
    "import_captures": "datagen.importing",
    "load_config": "datagen.config",
    "own_evidence": "datagen.evidence",
    "plan_effects": "datagen.effects",
    "presence_evidence": "datagen.evidence",
    "scene_for": "datagen.design.scene_for",
    "score": "datagen.scoring",
    "simulate": "datagen.transport",
    "simulate_as_printed": "datagen.paper.as_printed",
    "with_exposure_found": "datagen.design.exposure",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'datagen' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
