"""Scenes: rooms are drawn and furnished; objects are hidden from the device, the relay wall is in its view."""

from datagen.scene.generate import check_scene_config, generate_scene, meshes_named

__all__ = ["check_scene_config", "generate_scene", "meshes_named"]
