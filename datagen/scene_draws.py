"""Draws from settings to geometry: a layout's plan, an item's solid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datagen.config.distributions import draw
from datagen.config.scene_contents import Box, Item, Library, Mesh, MeshFolder, Pillar
from datagen.config.scene_layouts import AnyLayout, Closed
from datagen.errors import InputError
from datagen.records import Scalar
from scene_library import layouts
from scene_library.meshes import BadMesh, MeshOptions, unit_mesh
from scene_library.objects import build
from scene_library.rooms import Plan, mirrored, out_of_square, wall_groups
from scene_library.solids import Solid, prism, rectangle, regular_polygon

PLANS: dict[str, Callable[..., Plan]] = {
    "straight_corridor": layouts.straight_corridor,
    "l_corridor": layouts.l_corridor,
    "t_corridor": layouts.t_corridor,
    "z_corridor": layouts.z_corridor,
    "corridor_room": layouts.corridor_room,
    "doorway_room": layouts.doorway_room,
    "isolated_wall": layouts.isolated_wall,
}


def draw_plan(layout: AnyLayout, rng: np.random.Generator) -> tuple[Plan, dict[str, Scalar]]:
    """A plan and the dimensions drawn for it. Raises `scene_library.rooms.RoomDoesNotClose`."""
    dimensions = {name: draw(d, rng) for name, d in layout.dimensions().items()}
    side = ("left", "right")[int(rng.integers(2))] if layout.turn == "random" else layout.turn
    plan = PLANS[layout.kind](**dimensions)
    drawn: dict[str, Scalar] = {**dimensions, "turn": side}
    if isinstance(layout, Closed) and layout.out_of_square_deg != 0:
        groups = wall_groups(plan)
        turned = {wall: draw(layout.out_of_square_deg, rng) for wall in dict.fromkeys(groups)}
        turned[groups[plan.relay_edge]] = 0.0
        plan = out_of_square(plan, np.radians([turned[wall] for wall in groups]))
        drawn |= {f"wall_{wall}_turned_deg": angle for wall, angle in turned.items()}
    return plan if side == "left" else mirrored(plan), drawn


@dataclass(frozen=True)
class Drawn:
    """An object before it is placed: its solid, its class, and the sizes drawn for it."""

    solid: Solid
    label: str
    sizes: dict[str, Scalar]


def draw_object(item: Item, room_height_m: float, rng: np.random.Generator) -> Drawn:
    """An item's solid, standing at the origin. Raises `InputError` for a mesh file that cannot be used."""
    sizes = {name: draw(d, rng) for name in item.sizes if (d := getattr(item, name)) is not None}
    match item:
        case Pillar():
            width, depth = sizes["width_m"], sizes.get("depth_m", sizes["width_m"])
            base = rectangle(width, depth) if item.shape == "square" else regular_polygon(1.0, 32) * [width, depth]
            drawn: dict[str, Scalar] = {**sizes, "depth_m": depth, "height_m": room_height_m}
            return Drawn(prism(base, room_height_m), item.part_name, drawn)
        case Box():
            base = rectangle(sizes["width_m"], sizes["depth_m"])
            return Drawn(prism(base, sizes["height_m"]), item.part_name, dict(sizes))
        case Library():
            name = item.names[int(rng.integers(len(item.names)))]
            solid = build(name, rng)
            if "height_m" in sizes:
                solid = solid.scaled(sizes["height_m"] / solid.top_m)
            return Drawn(solid, name, _extents(solid))
        case Mesh():
            return _mesh(item, item.file, item.part_name, item.path, sizes["height_m"])
        case MeshFolder():
            classes = item.files()
            if not classes:
                raise InputError(f"path = {item.path!r}: holds no mesh files any more; put them back")
            label = list(classes)[int(rng.integers(len(classes)))]
            file = classes[label][int(rng.integers(len(classes[label])))]
            return _mesh(
                item, file, label, f"{item.path}/{file.relative_to(item.folder).as_posix()}", sizes["height_m"]
            )
    raise TypeError(f"no solid is known for {type(item).__name__}")


def load_mesh(item: Mesh | MeshFolder, file: Path, shown: str) -> Solid:
    """The file's solid at height 1. Raises `InputError` naming it as `shown`."""
    try:
        return unit_mesh(file, MeshOptions(item.up, item.max_triangles))
    except BadMesh as error:
        raise InputError(f"path = {shown!r}: {error}") from None


def _mesh(item: Mesh | MeshFolder, file: Path, label: str, shown: str, height_m: float) -> Drawn:
    solid = load_mesh(item, file, shown).scaled(height_m)
    return Drawn(solid, label, {**_extents(solid), "triangles": len(solid.triangles), "file": shown})


def _extents(solid: Solid) -> dict[str, Scalar]:
    width, depth = np.ptp(solid.hull, axis=0)
    return {"width_m": float(width), "depth_m": float(depth), "height_m": solid.top_m}
