"""Random scene settings: everything that can be declared, drawn anew, so that laws are met by more than defaults."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np
import trimesh
from every_brdf import KINDS

from datagen.config import SceneConfig, config_from_mapping
from datagen.config.distributions import support
from datagen.config.scene_layouts import AnyLayout, Closed
from datagen.errors import InputError
from scene_library.materials import MATERIALS
from scene_library.objects import CLASSES, GROUPS

CLOSED = frozenset(
    settings.model_fields["kind"].default
    for settings in get_args(get_args(AnyLayout)[0])
    if issubclass(settings, Closed)
)
"""Layouts with walls all around."""


def _range(rng: np.random.Generator, low: float, high: float) -> Any:
    """A distribution of any kind, or a constant, inside low … high."""
    a, b = sorted(rng.uniform(low, high, 2))
    kind = rng.integers(6)
    if kind == 0:
        return {"uniform": [a, b]}
    if kind == 1 and low > 0:
        return {"log_uniform": [a, b]}
    if kind == 2:
        return {"normal": {"mean": (a + b) / 2, "std": (b - a) / 3 + 1e-3, "low": a, "high": b}}
    if kind == 3:
        return a
    if kind == 4:
        return {"choice": [a, b, (a + b) / 2], "weights": [*rng.uniform(0, 1, 2), 0.1]}
    return {"choice": [a, b, (a + b) / 2]}


@cache
def _wider(kind: str) -> dict[str, tuple[float, float]]:
    """Dimension of a layout → range that goes beyond the one that it has by itself."""
    plan = config_from_mapping({"scene": {"layout": {"kind": kind}}}).scene.layout
    ranges = {name: support(of) for name, of in plan.dimensions().items()}
    wider = {
        name: (0.8 * low, 1.25 * high) if name.endswith("_m") else (0.8 * low, 0.8 * high + 0.2)
        for name, (low, high) in ranges.items()
    }
    # An opening may be at the very end of its wall.
    return wider | ({"opening_offset": (0.0, 1.0)} if "opening_offset" in ranges else {})


def _layout(rng: np.random.Generator, kind: str) -> dict[str, Any]:
    drawn = {name: _range(rng, *bounds) for name, bounds in _wider(kind).items()}
    layout = {"kind": kind, "turn": str(rng.choice(["left", "right", "random"])), **drawn}
    if rng.random() < 0.5:
        layout |= {"floor": bool(rng.random() < 0.5), "ceiling": bool(rng.random() < 0.5)}
    if kind in CLOSED and rng.random() < 0.5:
        most = float(rng.choice([2.0, 5.0, 12.0]))
        layout["out_of_square_deg"] = _range(rng, -most, most)
    if rng.random() < 0.3:
        layout["relay_wall"] = _relay_wall(rng)
    return layout


def _relay_wall(rng: np.random.Generator) -> dict[str, Any]:
    """An uneven one, clutter before it, or both."""
    shape = {
        "kind": str(rng.choice(["flat", "curved", "corrugated", "bumpy", "stepped"])),
        "relief_m": _range(rng, 0.01, 0.1),
        "length_m": _range(rng, 0.3, 1.0),
        "ridges": str(rng.choice(["vertical", "horizontal"])),
        "max_triangles": 3000,
    }
    clutter = {"count": _count(rng), "reach_m": _range(rng, 0.02, 0.2), "width_m": _range(rng, 0.05, 0.4)}
    return shape | ({"clutter": {**clutter, **_surface(rng)}} if rng.random() < 0.5 else {})


def _surface(rng: np.random.Generator) -> dict[str, Any]:
    """An albedo or materials of the catalogue, and one of the ways to scatter."""
    named = rng.random() < 0.4
    surface: dict[str, Any] = (
        {"material": [str(name) for name in rng.choice(list(MATERIALS), int(rng.integers(1, 5)), replace=False)]}
        if named
        else {"albedo": _range(rng, 0.0, 1.0)}
    )
    if rng.random() < 0.5:
        kind = str(rng.choice([*KINDS, "catalogue"] if named else [*KINDS]))
        keys = KINDS[kind].keys if kind in KINDS else {}
        # A table is no range: it is as in the row of its kind.
        given = KINDS[kind].read[1] if kind in KINDS else {}
        surface["brdf"] = {"kind": kind, **given, **{key: _range(rng, *bounds) for key, bounds in keys.items()}}
    return surface


def _count(rng: np.random.Generator) -> Any:
    return [
        1,
        2,
        {"uniform": [0, 3]},
        {"choice": [0, 1, 4], "weights": [1, 2, 1]},
        {"normal": {"mean": 1, "std": 1, "low": 0, "high": 3}},
    ][int(rng.integers(5))]


def _item(rng: np.random.Generator, walls: bool) -> dict[str, Any]:
    kind = str(rng.choice(["pillar", "box", "library", "mesh", "mesh_folder"], p=[0.2, 0.25, 0.35, 0.1, 0.1]))
    item: dict[str, Any] = {"kind": kind, "count": _count(rng), **_surface(rng)}
    if rng.random() < 0.3:
        item["name"] = f"thing{int(rng.integers(3))}"
    if rng.random() < 0.3:
        item |= {"along": _range(rng, 0.0, 1.0), "across": _range(rng, 0.0, 1.0)}
    if rng.random() < 0.5:
        item["rotation_deg"] = _range(rng, -360.0, 360.0)
    match kind:
        case "pillar":
            item |= {"shape": str(rng.choice(["square", "round"])), "width_m": _range(rng, 0.1, 0.6)}
            if rng.random() < 0.7:
                item["depth_m"] = _range(rng, 0.1, 0.6)
            return item
        case "box":
            item |= {"width_m": _range(rng, 0.1, 0.6), "depth_m": _range(rng, 0.1, 0.6)}
            item["height_m"] = _range(rng, 0.1, 1.0)
        case "library":
            names = [*GROUPS, *GROUPS, *CLASSES]
            item["classes"] = [str(name) for name in rng.choice(names, int(rng.integers(1, 4)), replace=False)]
            if rng.random() < 0.7:
                item["height_m"] = _range(rng, 0.3, 0.8)
        case "mesh":
            item |= {"path": str(rng.choice(["meshes/hat/hat.ply", "meshes/fin.obj", "meshes/two.glb"]))}
            item |= {"height_m": _range(rng, 0.3, 0.8), "up": str(rng.choice(["x", "-x", "y", "-y", "z", "-z"]))}
        case "mesh_folder":
            item |= {"path": "meshes", "height_m": _range(rng, 0.3, 0.8)}
            if rng.random() < 0.3:
                item["classes"] = ["ball", "hat"]
            if rng.random() < 0.3:
                item["max_triangles"] = 60
    item["placement"] = str(rng.choice(["floor", "wall", "hanging"] if walls else ["floor", "hanging"]))
    if rng.random() < 0.3:
        item["elevation_m"] = _range(rng, 0.0, 0.8)
    return item


@cache
def mesh_folder() -> Path:
    """A folder that holds `meshes`: closed ones, a scene graph, a sheet with three leaves on one edge."""
    kept = tempfile.TemporaryDirectory()
    _alive.append(kept)
    folder = Path(kept.name) / "meshes"
    for label in ("ball", "hat"):
        (folder / label).mkdir(parents=True)
    trimesh.creation.icosphere(subdivisions=2).export(folder / "ball" / "ball.stl")
    trimesh.creation.cone(radius=0.6, height=1.0, sections=24).export(folder / "hat" / "hat.ply")
    (folder / "fin.obj").write_text(
        "v 0 0 0\nv 0.1 0.2 1\nv 1 0 0.1\nv 0 1 0\nv -1 -1 0.2\nf 1 2 3\nf 1 2 4\nf 1 2 5\n"
    )
    graph = trimesh.Scene()
    graph.add_geometry(trimesh.creation.box(extents=[1, 0.7, 0.4]), node_name="low")
    move = trimesh.transformations.translation_matrix([0.3, 0.1, 0.8])
    graph.add_geometry(trimesh.creation.torus(0.4, 0.1, 12, 8), node_name="high", transform=move)
    graph.export(folder / "two.glb")
    return Path(kept.name)


_alive: list[tempfile.TemporaryDirectory[str]] = []


def random_spec(rng: np.random.Generator, kind: str) -> SceneConfig:
    """Settings that can be read; whether rooms come of them is another matter."""
    while True:
        contents = [_item(rng, kind in CLOSED) for _ in range(int(rng.integers(0, 4)))]
        surfaces = ("relay_wall", "walls", "floor", "ceiling", "screen")
        scene = {
            "layout": _layout(rng, kind),
            "contents": contents,
            "materials": {name: _surface(rng) for name in surfaces},
            "wavelength_nm": float(rng.uniform(532, 1550)),
            "clearance_m": float(rng.choice([0.001, 0.02, 0.1])),
            "minimum_seen": float(rng.choice([0.0, 0.02, 0.05])),
            # Settings that ask for too much would otherwise take most of the time.
            "max_attempts": 24,
        }
        try:
            return config_from_mapping({"scene": scene}, base_directory=mesh_folder()).scene
        except InputError as error:
            # Only what no draw can meet, such as a device always above the ceiling, may be refused at reading.
            assert "≥" in str(error) or "at least" in str(error), error
