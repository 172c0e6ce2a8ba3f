"""Configuration: frozen pydantic models ↔ YAML, with units in the key names."""

from datagen.config.capture import CaptureConfig
from datagen.config.dataset import (
    DatasetConfig,
    config_from_mapping,
    fingerprint_of,
    json_schema,
    load_config,
    stored_axes,
    time_axes,
)
from datagen.config.detector import DetectorConfig
from datagen.config.effects import EffectsConfig
from datagen.config.labels import LabelsConfig
from datagen.config.scene import SceneConfig
from datagen.config.splits import SplitsConfig
from datagen.config.store import StoreConfig
from datagen.config.transport import TransportConfig

__all__ = [
    "CaptureConfig", "DatasetConfig", "DetectorConfig", "EffectsConfig", "LabelsConfig", "SceneConfig",
    "SplitsConfig", "StoreConfig", "TransportConfig", "config_from_mapping", "fingerprint_of", "json_schema",
    "load_config", "stored_axes", "time_axes",
]  # fmt: skip
