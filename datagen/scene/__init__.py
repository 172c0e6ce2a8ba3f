"""Scenes: rooms are drawn, furnished and checked; objects are hidden from the device, the relay wall is in its
view."""

from datagen.scene.generate import check_scene_config, generate_scene, meshes_named

__all__ = ["check_scene_config", "generate_scene", "meshes_named"]
