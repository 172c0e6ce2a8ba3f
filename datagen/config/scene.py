"""The section `scene` (owned by the scene helper)."""

from __future__ import annotations

from datagen.config.base import Settings


class SceneConfig(Settings):
    def mesh_digests(self) -> dict[str, str]:
        return {}
