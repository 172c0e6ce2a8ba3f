"""Scenes that no configuration would draw: shapes of trimesh and meshes of others, any BRDF, any device and scan.

`foreign_scene(index)` is a function of its number (and of the meshes in a folder, if one is named): a wall at x = 0,
seen from a device anywhere in front of it; one to three shapes, turned at random, that may touch or cut each other;
an open space, an open space with a floor, or a closed room; any BRDF over its whole allowed range on objects,
sometimes on the wall or the room; pixels of 2 mm to 20 cm, bins of 20 to 300 ps, three or four bounces.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from datagen.errors import InputError
from datagen.records import GGX, Capture, Lambertian, Laser, Part, Phong, Scene, Sensor, TimeAxis
from datagen.records.arrays import Floats
from datagen.records.materials import Material, OrenNayar, Retroreflector, SinLobe
from datagen.units import SPEED_OF_LIGHT_M_PER_S

FOREIGN_STREAM = 7301
MOST_BINS = 4096
LONGEST_PATHS = 3.0
"""Length of the time window, in diagonals of the scene: light of three and four bounces seldom comes later."""
OF_OTHERS = 0.5
"""Share of objects that are meshes of the folder, where one is named."""
SIZES_M = (0.2, 0.8)
"""Smallest and largest longest side of an object."""
Generator = np.random.Generator


@dataclass(frozen=True)
class ForeignScene:
    """A scene, its capture, and its ingredients in words, for reports.

    max_bounces : 3 or 4.
    shapes, brdfs : object part → name of its shape, and of its BRDF.
    surroundings : "open", "floor" or "room".
    scan : "confocal", "exhaustive" or "array".
    """

    scene: Scene
    capture: Capture
    max_bounces: int
    shapes: dict[str, str]
    brdfs: dict[str, str]
    surroundings: str
    scan: str


def foreign_scene(index: int, meshes: Path | None = None) -> ForeignScene:
    """The scene of a number ≥ 0. Raises `InputError` for a folder without meshes."""
    rng = np.random.default_rng([FOREIGN_STREAM, index])
    # Room: depth, width and height in front of the wall, whose middle is (0, 0, height / 2).
    size = rng.uniform([1.2, 1.5, 1.5], [5.0, 4.0, 3.0])
    surroundings = str(rng.choice(["open", "floor", "room"], p=[0.3, 0.2, 0.5]))
    parts, shapes = _surroundings(rng, size, surroundings), {}
    spheres = []
    for number in range(int(rng.integers(1, 4))):
        kind, mesh = _shape(rng, meshes)
        center = _place(rng, mesh, size)
        spheres.append((center, float(np.linalg.norm(mesh.vertices - center, axis=1).max())))
        shapes[f"object {number}"] = kind
        parts.append(Part(f"object {number}", mesh, _material(rng)))
    device = _device(rng, size, spheres)
    scene = Scene.from_parts(parts)
    brdfs = {part.name: type(part.material).__name__ for part in parts if part.role == "object"}
    scan = str(rng.choice(["confocal", "exhaustive", "array"], p=[0.5, 0.25, 0.25]))
    diagonal = float(np.linalg.norm(np.ptp(scene.vertices, axis=0)))
    capture = _capture(rng, size, device, scan, diagonal)
    return ForeignScene(scene, capture, int(rng.integers(3, 5)), shapes, brdfs, surroundings, scan)


def _log_uniform(rng: Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))


def _material(rng: Generator) -> Material:
    """Any of six BRDFs, over its whole allowed range. A seventh would change all scenes, which tests name by number;
    `every_brdf.py` has every kind."""
    albedo, share = float(rng.uniform(0.1, 1.0)), float(rng.choice([1.0, rng.uniform(0.0, 1.0)]))
    match int(rng.integers(6)):
        case 0:
            return Lambertian(albedo)
        case 1:
            return OrenNayar(albedo, sigma_rad=float(rng.uniform(0.0, math.pi / 2)))
        case 2:
            return Phong(albedo, exponent=_log_uniform(rng, 1.0, 1e4), specular=share)
        case 3:
            return GGX(albedo, roughness=float(rng.uniform(0.1, 1.0)), f0=share)
        case 4:
            return Retroreflector(albedo, half_width_rad=_log_uniform(rng, 1e-3, math.pi / 4), retro=share)
    x, y, z = rng.normal(size=3)
    return SinLobe(albedo, axis=(float(x), float(y), float(z)))


def _rectangle(center: Floats, right: Floats, up: Floats) -> trimesh.Trimesh:
    corners = [center - right - up, center + right - up, center + right + up, center - right + up]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def _surroundings(rng: Generator, size: Floats, kind: str) -> list[Part]:
    """The wall, and floor, walls and ceiling if there are any; one surface in five has any BRDF, others are matt."""
    middle, (x, y, z) = np.array([size[0] / 2, 0.0, size[2] / 2]), np.diag(size * [0.5, 0.5, 0.5])

    def matt() -> Material:
        return _material(rng) if rng.random() < 0.2 else Lambertian(float(rng.uniform(0.2, 0.95)))

    parts = [Part("relay_wall", _rectangle(middle - x, y, z), matt(), "relay_wall")]
    if kind != "open":
        parts.append(Part("floor", _rectangle(middle - z, x, y), matt(), "structure"))
    if kind == "room":
        walls = [_rectangle(middle + x, y, z), _rectangle(middle - y, x, z), _rectangle(middle + y, x, z)]
        three: Any = trimesh.util.concatenate(walls)
        parts.append(Part("walls", three, matt(), "structure"))
        parts.append(Part("ceiling", _rectangle(middle + z, x, y), matt(), "structure"))
    return parts


SHAPES: dict[str, Callable[[], trimesh.Trimesh]] = {
    "box": lambda: trimesh.creation.box((1.0, 0.7, 0.5)),
    "icosphere": lambda: trimesh.creation.icosphere(subdivisions=2),
    "fine icosphere": lambda: trimesh.creation.icosphere(subdivisions=4),
    "uv sphere": lambda: trimesh.creation.uv_sphere(count=(14, 20)),
    "cylinder": lambda: trimesh.creation.cylinder(radius=0.3, height=1.0, sections=24),
    "capsule": lambda: trimesh.creation.capsule(height=1.0, radius=0.3, count=(10, 16)),
    "cone": lambda: trimesh.creation.cone(radius=0.4, height=1.0, sections=20),
    "torus": lambda: trimesh.creation.torus(0.5, 0.2, major_sections=24, minor_sections=12),
    "annulus": lambda: trimesh.creation.annulus(r_min=0.25, r_max=0.5, height=0.2, sections=20),
    "open half": lambda: _half(trimesh.creation.icosphere(subdivisions=3)),
    "plate": lambda: _rectangle(np.zeros(3), np.array([0.0, 0.5, 0.0]), np.array([0.0, 0.0, 0.35])),
}


def _half(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.update_faces(mesh.triangles_center[:, 2] < 0.1)
    mesh.remove_unreferenced_vertices()
    return mesh


def _shape(rng: Generator, folder: Path | None) -> tuple[str, trimesh.Trimesh]:
    """Name and mesh, its longest side within `SIZES_M`, turned at random about the origin."""
    foreign = folder is not None and rng.random() < OF_OTHERS
    names = sorted(SHAPES) if not foreign else [path.name for path in mesh_files(folder)]  # type: ignore[arg-type]
    name = str(rng.choice(names))
    mesh = _read(folder / name).copy() if foreign else SHAPES[name]()  # type: ignore[operator]
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    if not foreign:
        mesh.apply_transform(np.diag([*rng.uniform(0.6, 1.0, 3), 1.0]))
    mesh.apply_scale(float(rng.uniform(*SIZES_M) / np.ptp(mesh.vertices, axis=0).max()))
    mesh.apply_transform(trimesh.transformations.random_rotation_matrix(rng.random(3)))
    return name, mesh


def mesh_files(folder: Path) -> list[Path]:
    """The meshes of a folder, in the order of their names. Raises `InputError` if it has none."""
    found = sorted(path for path in folder.glob("*") if path.suffix in (".obj", ".stl", ".ply", ".off"))
    if not found:
        raise InputError(f"--meshes {folder}: no .obj, .stl, .ply or .off file there; name another folder")
    return found


@lru_cache(maxsize=16)
def _read(path: Path) -> trimesh.Trimesh:
    mesh: Any = trimesh.load(path, force="mesh", process=False)
    # Files with texture repeat vertices wherever the texture has a seam.
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def _place(rng: Generator, mesh: trimesh.Trimesh, size: Floats) -> Floats:
    """The middle of a mesh after it is moved to a place in front of the wall; one in four stands on the floor."""
    half = np.ptp(mesh.vertices, axis=0) / 2
    low, high = np.array([0.0, -size[1] / 2, 0.0]) + half + 1e-3, np.array([size[0], size[1] / 2, size[2]]) - half
    center = np.where(high > low, rng.uniform(low, np.maximum(high, low)), (low + high) / 2)
    if rng.random() < 0.25:
        center[2] = half[2]
    mesh.apply_translation(center - mesh.bounds.mean(axis=0))
    return np.asarray(center)


def _device(rng: Generator, size: Floats, spheres: list[tuple[Floats, float]]) -> Floats:
    """A place in front of the wall; outside of all objects, unless a hundred trials do not find one."""
    for _ in range(100):
        place = rng.uniform([0.2, -size[1] / 2 + 0.05, 0.05], [size[0] - 0.05, size[1] / 2 - 0.05, size[2] - 0.05])
        if all(np.linalg.norm(place - center) > radius for center, radius in spheres):
            break
    return np.asarray(place)


def _capture(rng: Generator, size: Floats, device: Floats, scan: str, diagonal_m: float) -> Capture:
    """A scan of the wall, or of objects that stand before it."""
    half = _log_uniform(rng, 1e-3, 0.1)
    room = np.array([size[1] / 2, size[2] / 2]) - half

    def places(count: int) -> Floats:
        yz = rng.uniform(-0.95 * room, 0.95 * room, (count, 2))
        return np.column_stack([np.zeros(count), yz[:, 0], yz[:, 1] + size[2] / 2])

    def squares(centers: Floats) -> Floats:
        corners = np.array([[0, -half, -half], [0, half, -half], [0, half, half], [0, -half, half]])
        return np.asarray(centers[:, None] + corners)

    width_s = _log_uniform(rng, 20e-12, 300e-12)
    bins = min(math.ceil(LONGEST_PATHS * diagonal_m / (width_s * SPEED_OF_LIGHT_M_PER_S)), MOST_BINS)
    time = TimeAxis(bins, width_s, 0.0, "wall")
    if scan == "confocal":
        points = places(int(rng.integers(4, 17)))
        return Capture(Laser(device, points), Sensor(device, squares(points)), time, "confocal")
    if scan == "exhaustive":
        lasers, pixels = places(int(rng.integers(2, 4))), places(int(rng.integers(3, 6)))
        return Capture(Laser(device, lasers), Sensor(device, squares(pixels)), time)
    side = int(rng.integers(3, 5))
    across = np.minimum(half * side, room)
    center = places(1)[0]
    low, high = np.array([-size[1] / 2, 0.0]), np.array([size[1] / 2, size[2]])
    center[1:] = np.clip(center[1:], low + across, high - across)
    sensor = Sensor.grid(device, center, (0, across[0], 0), (0, 0, across[1]), rows=side, columns=side)
    return Capture(Laser(device, places(1)), sensor, time)
