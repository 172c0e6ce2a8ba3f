"""A scene as one glTF file (.glb) for Blender, MeshLab and Open3D: its parts with materials, device and scan.

Beside the parts by name: `laser` and `sensor`, `laser_points`, and `sensor_pixels`, outlines of what each pixel sees.
Metres; what is up in the scene is glTF's +Y, which Blender turns to +Z again.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.design.scene_for import scene_for
from datagen.records import GGX, Phong, Retroreflector, Scene
from datagen.records.arrays import Floats
from datagen.records.materials import Material
from datagen.store.scenes import SceneContent

_MARK_M = 0.04
"""Radius of the balls that stand for laser and sensor, metres."""
_TINTS = {"relay_wall": (0.55, 0.75, 1.0), "structure": (1.0, 1.0, 1.0), "object": (1.0, 0.65, 0.3)}
"""Role → colour, which is multiplied by the albedo."""
_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def write_glb(scene: SceneContent, path: Path) -> None:
    """Write one scene, drawn again from the dataset's seed.

    Raises `InputError` where a mesh file is gone, or the scenes were made in Python.
    """
    config = scene.manifest.parsed_config()
    room = scene_for(config, scene.index)
    path.write_bytes(glb_of(room, scene.arrays))


def glb_of(room: Scene, arrays: dict[str, NDArray[Any]] | Any) -> bytes:
    """The glTF file of a room; `arrays` are the fields of a stored scene, which place the device and the scan."""
    import trimesh

    world = trimesh.Scene(base_frame="world")
    for number, name in enumerate(room.part_names):
        faces = room.triangles[room.faces_of(name)]
        used, index = np.unique(faces, return_inverse=True)
        material = _look(room.materials[number], room.roles[number])
        visual = trimesh.visual.TextureVisuals(material=material)
        mesh = trimesh.Trimesh(room.vertices[used], index.reshape(-1, 3), visual=visual, process=False)
        mesh.metadata |= {"role": room.roles[number], "material": repr(room.materials[number])}
        world.add_geometry(mesh, node_name=name, geom_name=name)
    for device, color in (("laser", (1.0, 0.1, 0.1)), ("sensor", (0.1, 0.3, 1.0))):
        ball = trimesh.creation.icosphere(2, _MARK_M).apply_translation(arrays[f"{device}_position"])
        ball.visual = trimesh.visual.TextureVisuals(material=_plain(device, color))
        world.add_geometry(ball, node_name=device, geom_name=device)
    lit = arrays["laser_points"][np.isfinite(arrays["laser_points"]).all(axis=1)]
    if len(lit):
        dots = trimesh.PointCloud(lit, colors=[255, 40, 40, 255])
        world.add_geometry(dots, node_name="laser_points", geom_name="laser_points")
    world.add_geometry(_outlines(arrays["sensor_pixels"]), node_name="sensor_pixels", geom_name="sensor_pixels")
    world.apply_transform(_UP)
    found: bytes = world.export(file_type="glb")
    return found


def _outlines(pixels: Floats) -> Any:
    import trimesh

    ends = np.stack([pixels, np.roll(pixels, -1, axis=1)], axis=2).reshape(-1, 2, 3)
    return trimesh.load_path(ends, process=False)


def _look(material: Material, role: str) -> Any:
    """The glTF material of a surface: albedo in the tint of its role, width of the lobe as roughness."""
    color = np.clip(material.albedo, 0, 1) * np.array(_TINTS[role])
    look = _plain(f"{type(material).__name__} {material.albedo:.2f}", color, _roughness(material))
    look.metallicFactor, look.doubleSided = 0.0, True
    return look


def _plain(name: str, color: Iterable[float], roughness: float = 1.0) -> Any:
    import trimesh

    return trimesh.visual.material.PBRMaterial(name=name, baseColorFactor=[*color, 1.0], roughnessFactor=roughness)


def _roughness(material: Material) -> float:
    match material:
        case GGX():
            return float(material.roughness)
        case Phong():
            # A lobe cosⁿ is as wide as that of a microfacet surface of roughness α with n = 2 / α⁴ − 2.
            return float((2.0 / (material.exponent + 2.0)) ** 0.25)
        case Retroreflector():
            return 0.2
    return 1.0
