"""Draw a room and its objects from the settings: floor plan, solids, materials. Objects get their place later."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from datagen.config.distributions import draw, draw_count
from datagen.config.scene import SceneConfig
from datagen.config.scene_contents import (
    Box,
    Content,
    Item,
    Library,
    Mesh,
    MeshFolder,
    MeshItem,
    Pillar,
    Standing,
    label_of,
)
from datagen.config.scene_layouts import AnyLayout, Closed, IsolatedWall
from datagen.config.scene_materials import SurfaceMaterial
from datagen.errors import InputError
from datagen.records import Lambertian, Material, Scalar
from datagen.scene.relay_wall import draw_clutter, draw_relay_wall
from scene_library.layouts import PLANS
from scene_library.mesh_file import BadMesh
from scene_library.meshes import MeshOptions, unit_mesh_and_doubt
from scene_library.objects import build
from scene_library.placement import Occupied
from scene_library.rooms import FloorPlan, mirrored, out_of_square, surfaces, wall_groups
from scene_library.solids import Solid, Surface, prism, rectangle, regular_polygon


@dataclass(frozen=True)
class Thing:
    """An object to be placed: everything that is drawn for it except its place.

    where, item : key of its settings, such as contents[0], and the settings.
    name, label : of its part, and its class.
    solid : its triangles, standing at the origin.
    """

    where: str
    item: Content
    name: str
    label: str
    solid: Solid
    material: Material
    rotation_deg: float
    elevation_m: float


@dataclass(frozen=True)
class DrawnRoom:
    """A drawn room, whose objects have no places yet.

    surfaces, materials : of the room's own parts, by name.
    clutter : the space taken by those parts that stand before the relay wall.
    things : its objects.
    parameters : every number drawn, by dotted name.
    """

    plan: FloorPlan
    surfaces: dict[str, Surface]
    materials: dict[str, Material]
    clutter: dict[str, Occupied]
    things: tuple[Thing, ...]
    parameters: dict[str, Scalar]


def draw_room(spec: SceneConfig, rng: np.random.Generator) -> DrawnRoom:
    """A room: layout, materials, and objects with number, classes and sizes, each from its declared distribution.

    Raises `scene_library.rooms.RoomDoesNotClose`.
    """
    plan, drawn = draw_plan(spec.layout, rng)
    parameters: dict[str, Scalar] = {"layout.kind": spec.layout.kind}
    parameters |= {f"layout.{name}": value for name, value in drawn.items()}
    room = surfaces(plan, floor=spec.layout.floor, ceiling=spec.layout.ceiling)
    uneven, numbers = draw_relay_wall(spec.layout.relay_wall, plan, rng)
    if uneven is not None:
        room["relay_wall"] = uneven
    parameters |= numbers
    materials = {name: _material(spec, getattr(spec.materials, name), name, parameters, rng) for name in room}
    names, things, clutter = set(room), [], dict[str, Occupied]()
    for piece in draw_clutter(spec.layout.relay_wall, plan, spec.clearance_m, rng):
        name = _free_name(f"clutter_{piece.kind}", names)
        names.add(name)
        room[name], clutter[name] = piece.surface, piece.occupied
        materials[name] = _material(spec, spec.layout.relay_wall.clutter, name, parameters, rng)
        parameters |= {f"{name}.{key}": value for key, value in piece.parameters.items()}
    for i, item in enumerate(spec.contents):
        for _ in range(draw_count(item.count, rng)):
            drawn_object = draw_object(item, plan.height_m, rng)
            name = _free_name(item.name or label_of(drawn_object.label), names)
            names.add(name)
            parameters |= {f"{name}.kind": item.kind, f"{name}.class": drawn_object.label}
            parameters |= {f"{name}.{key}": value for key, value in drawn_object.sizes.items()}
            rotation = draw(item.rotation_deg, rng)
            elevation = draw(item.elevation_m, rng) if isinstance(item, Standing) else 0.0
            if isinstance(item, Standing):
                parameters |= {f"{name}.placement": item.placement, f"{name}.elevation_m": elevation}
            material = _material(spec, item, name, parameters, rng)
            label, solid = drawn_object.label, drawn_object.solid
            things.append(Thing(f"contents[{i}]", item, name, label, solid, material, rotation, elevation))
    parameters["objects"] = len(things)
    return DrawnRoom(plan, room, materials, clutter, tuple(things), parameters)


def _free_name(wanted: str, taken: set[str]) -> str:
    """The name itself, or numbered from 2 when it is taken."""
    number, name = 1, wanted
    while name in taken:
        number += 1
        name = f"{wanted}_{number}"
    return name


def _material(
    spec: SceneConfig, surface: SurfaceMaterial, name: str, parameters: dict[str, Scalar], rng: np.random.Generator
) -> Material:
    """Draw the material of the part `name`, and add its numbers to `parameters`."""
    material, catalogue_name = surface.draw_material(spec.wavelength_nm, rng)
    if catalogue_name is not None:
        parameters[f"{name}.material"] = catalogue_name
    numbers = {key: value for key, value in asdict(material).items() if isinstance(value, (int, float))}
    parameters |= {f"{name}.{key}": value for key, value in numbers.items()}
    if not isinstance(material, Lambertian):
        parameters[f"{name}.brdf"] = type(material).__name__
    return material


def draw_plan(layout: AnyLayout, rng: np.random.Generator) -> tuple[FloorPlan, dict[str, Scalar]]:
    """A floor plan, and the numbers drawn for it by name. Raises `scene_library.rooms.RoomDoesNotClose`."""
    dimensions = {name: draw(d, rng) for name, d in layout.dimensions().items()}
    side = ("left", "right")[int(rng.integers(2))] if layout.turn == "random" else layout.turn
    plan = PLANS[layout.plan](**dimensions)
    drawn: dict[str, Scalar] = {**dimensions, "turn": side}
    if isinstance(layout, IsolatedWall) and layout.place != "beside":
        drawn["place"] = layout.place
    if isinstance(layout, Closed) and layout.out_of_square_deg != 0:
        groups = wall_groups(plan)
        angles = {wall: draw(layout.out_of_square_deg, rng) for wall in dict.fromkeys(groups)}
        angles[groups[plan.relay_edge]] = 0.0
        plan = out_of_square(plan, np.radians([angles[wall] for wall in groups]))
        drawn |= {f"wall_{wall}_turned_deg": angle for wall, angle in angles.items()}
    return plan if side == "left" else mirrored(plan), drawn


@dataclass(frozen=True)
class Drawn:
    """Solid, class and sizes of a drawn object."""

    solid: Solid
    label: str
    sizes: dict[str, Scalar]


def draw_object(item: Item, room_height_m: float, rng: np.random.Generator) -> Drawn:
    """An object of an item, standing at the origin. Raises `InputError` for a mesh file that cannot be used."""
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
            name = item.class_names[int(rng.integers(len(item.class_names)))]
            solid = build(name, rng)
            if "height_m" in sizes:
                solid = solid.scaled(sizes["height_m"] / solid.top_m)
            return Drawn(solid, name, _extents(solid))
        case Mesh():
            return _mesh(item, item.place, item.part_name, item.path, sizes["height_m"])
        case MeshFolder():
            classes = item.files()
            if not classes:
                raise InputError(f"path = {item.path!r}: holds no mesh files any more; put them back")
            label = list(classes)[int(rng.integers(len(classes)))]
            file = classes[label][int(rng.integers(len(classes[label])))]
            return _mesh(item, file, label, item.shown(file), sizes["height_m"])
    raise TypeError(f"no solid is known for {type(item).__name__}")


def load_mesh(item: MeshItem, file: Path, shown: str) -> tuple[Solid, str]:
    """The solid in a mesh file, 1 m high, and what the file leaves open ("" if nothing), in a line for users.

    Raises `InputError`, which calls the file `shown`.
    """
    try:
        return unit_mesh_and_doubt(file, MeshOptions(item.up, item.front, item.max_triangles))
    except BadMesh as error:
        raise InputError(f"path = {shown!r}: {error}") from None


def _mesh(item: MeshItem, file: Path, label: str, shown: str, height_m: float) -> Drawn:
    solid = load_mesh(item, file, shown)[0].scaled(height_m)
    return Drawn(solid, label, {**_extents(solid), "triangles": len(solid.triangles), "file": shown})


def _extents(solid: Solid) -> dict[str, Scalar]:
    width, depth = np.ptp(solid.vertices[:, :2], axis=0)
    return {"width_m": float(width), "depth_m": float(depth), "height_m": solid.top_m}
