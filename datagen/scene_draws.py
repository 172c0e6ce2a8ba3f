"""Draws from settings to geometry: a layout's plan, an item's solid."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from datagen.config.distributions import draw
from datagen.config.scene_contents import Box, Item, Mesh, Pillar
from datagen.config.scene_layouts import AnyLayout, Closed
from datagen.errors import InputError
from datagen.records import Scalar
from scene_library import layouts
from scene_library.meshes import BadMesh, MeshOptions, unit_mesh
from scene_library.rooms import Plan, mirrored, out_of_square
from scene_library.solids import Solid, prism, rectangle

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
        angles = [draw(layout.out_of_square_deg, rng) for _ in plan.outline]
        angles[plan.relay_edge] = 0.0
        plan = out_of_square(plan, np.radians(angles))
        drawn |= {f"wall_{i}_turned_deg": angle for i, angle in enumerate(angles)}
    return plan if side == "left" else mirrored(plan), drawn


def draw_solid(item: Item, room_height_m: float, rng: np.random.Generator) -> tuple[Solid, dict[str, Scalar]]:
    """An item's solid, standing at the origin, and the sizes drawn for it."""
    sizes = {name: draw(d, rng) for name in item.sizes if (d := getattr(item, name)) is not None}
    drawn: dict[str, Scalar] = dict(sizes)
    match item:
        case Pillar():
            depth = sizes.get("depth_m", sizes["width_m"])
            drawn |= {"depth_m": depth, "height_m": room_height_m}
            return prism(rectangle(sizes["width_m"], depth), room_height_m), drawn
        case Box():
            return prism(rectangle(sizes["width_m"], sizes["depth_m"]), sizes["height_m"]), drawn
        case Mesh():
            try:
                unit = unit_mesh(item.file, MeshOptions(item.up, item.max_triangles))
            except BadMesh as error:
                raise InputError(f"path = {item.path!r}: {error}") from None
            drawn |= {"triangles": len(unit.triangles)}
            return unit.scaled(sizes["height_m"]), drawn
    raise TypeError(f"no solid is known for {type(item).__name__}")
