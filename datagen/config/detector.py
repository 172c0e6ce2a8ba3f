"""The section `detector` (owned by the detector helper)."""

from __future__ import annotations

from datagen.config.base import Settings


class DetectorConfig(Settings):
    pass
