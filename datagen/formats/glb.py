"""A scene as one glTF file (.glb) for Blender, MeshLab and Open3D: its parts with materials, device and scan.

Beside the parts by name a file has `laser`, `sensor`, `laser_points`, `sensor_points`, what the middles of pixels
look at, and `sensor_pixels`, the outlines of the fields of view. Lengths are metres. The scene's up is glTF's +Y,
which Blender turns to +Z again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.design.scene_for import scene_for
from datagen.errors import InputError
from datagen.records import Capture, Scene
from datagen.records.checks import check_kind, check_path
from datagen.records.materials import Material
from datagen.store.files import write_atomically
from datagen.store.scenes import SceneContent
from datagen.transport.brdf import model_of
from datagen.transport.brdf.ggx import HALF_WIDTH
from datagen.transport.lines_of_sight import lit_points, seen_points
from datagen.transport.rays import Raycaster

_MARK_M = 0.04
"""Radius of the spheres that mark laser and sensor, metres, to be seen in a room."""
_TINTS = {"relay_wall": (0.55, 0.75, 1.0), "structure": (1.0, 1.0, 1.0), "object": (1.0, 0.65, 0.3)}
"""Role of a part → colour that is multiplied by its albedo."""
_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def write_stored_glb(scene: SceneContent, path: Path) -> None:
    """Write one scene of a dataset, or one frame of a sequence, in the middle of that. Its room is drawn again from
    the dataset's seed.

    Raises `InputError` if a mesh file is missing or has changed, or the scenes were made in Python.
    """
    config = scene.manifest.parsed_config()
    room = scene_for(config, scene.index)
    if scene.frame is not None:
        room = room.at(float(scene.arrays["laser_time"].mean()))
    path.write_bytes(_glb_of(room, scene.arrays))


def write_glb(scene: Scene, path: str | Path, capture: Capture | None = None) -> None:
    """Write a scene as a glTF file (.glb), which Blender, MeshLab and Open3D open. The file has the parts by name,
    with albedo and roughness; with `capture` also laser, sensor, laser points, what pixels look at, and their
    outlines.

    Raises `InputError` for arguments of another type, and if the file cannot be written.

    >>> import datagen as dg, tempfile, trimesh
    >>> ball = dg.Part("ball", trimesh.creation.icosphere(2, 0.3), dg.Lambertian(0.6))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     dg.write_glb(dg.Scene.from_parts([ball]), f"{folder}/ball.glb")
    ...     sorted(trimesh.load(f"{folder}/ball.glb").geometry)
    ['ball']
    """
    check_kind("scene", scene, Scene)
    check_path("path", path, "name a .glb file")
    check_kind("capture", capture, Capture, type(None))
    placed = {}
    if capture is not None:
        laser, sensor, caster = capture.laser, capture.sensor, Raycaster(scene)
        placed = {
            "laser_position": laser.position, "sensor_position": sensor.position,
            "laser_points": lit_points(caster, laser).position,
            "sensor_points": seen_points(caster, sensor).position, "sensor_pixels": sensor.pixels,
        }  # fmt: skip
    try:
        write_atomically(Path(path), _glb_of(scene, placed))
    except OSError as error:
        raise InputError(f"path = {str(path)!r}: cannot be written ({error.strerror or error})") from None


def _glb_of(room: Scene, placed: Mapping[str, NDArray[Any]]) -> bytes:
    """The content of the glTF file of a room. `placed` has the fields `laser_position`, `sensor_position`,
    `laser_points`, `sensor_points` and `sensor_pixels`, or is empty."""
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
    for device, color in (("laser", (1.0, 0.1, 0.1)), ("sensor", (0.1, 0.3, 1.0))) if placed else ():
        ball = trimesh.creation.icosphere(2, _MARK_M).apply_translation(placed[f"{device}_position"])
        ball.visual = trimesh.visual.TextureVisuals(material=_plain(device, color))
        world.add_geometry(ball, node_name=device, geom_name=device)
    if placed:
        for name, rgba in (("laser_points", [255, 40, 40, 255]), ("sensor_points", [40, 80, 255, 255])):
            found = placed[name][np.isfinite(placed[name]).all(axis=1)]
            if len(found):
                dots = trimesh.PointCloud(found, colors=rgba)
                world.add_geometry(dots, node_name=name, geom_name=name)
        pixels = placed["sensor_pixels"]
        ends = np.stack([pixels, np.roll(pixels, -1, axis=1)], axis=2).reshape(-1, 2, 3)
        outlines = trimesh.load_path(ends, process=False)
        world.add_geometry(outlines, node_name="sensor_pixels", geom_name="sensor_pixels")
    world.apply_transform(_UP)
    content: bytes = world.export(file_type="glb")
    return content


def _look(material: Material, role: str) -> Any:
    """The glTF material of a surface: its colour is albedo times the role's tint, its roughness the lobe's width."""
    color = np.clip(material.albedo, 0, 1) * np.array(_TINTS[role])
    look = _plain(f"{type(material).__name__} {material.albedo:.2f}", color, _roughness(material))
    look.metallicFactor, look.doubleSided = 0.0, True
    return look


def _plain(name: str, color: Iterable[float], roughness: float = 1.0) -> Any:
    import trimesh

    return trimesh.visual.material.PBRMaterial(name=name, baseColorFactor=[*color, 1.0], roughnessFactor=roughness)


def _roughness(material: Material) -> float:
    # That of facets whose lobe is as wide as the material's; a surface without a lobe is as rough as there is.
    return min(math.sqrt(model_of(material).lobe_width_rad(material) / HALF_WIDTH), 1.0)
