"""Scenes: a room is drawn, furnished and checked; everything hidden is hidden, the relay wall in view."""

from datagen.scene.generate import check_scene_config, generate_scene, meshes_named

__all__ = ["check_scene_config", "generate_scene", "meshes_named"]
