"""Scene settings + scene library → Scene: draw a room, furnish it, check it, or say why that cannot be done.

`generate_scene` is a pure function of (settings, seed, index). Every attempt at a room has its own random stream, so
what one attempt consumed never shifts the next.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray

from datagen.config.scene import SceneConfig
from datagen.config.scene_contents import Content, Mesh, MeshFolder, draw_count
from datagen.config.scene_files import label_of
from datagen.config.scene_materials import Surface
from datagen.errors import InputError
from datagen.records import Lambertian, Material, Rectangle, Role, Scalar, Scene
from datagen.scene_checks import explain
from datagen.scene_draws import draw_object, draw_plan, load_mesh
from datagen.scene_placing import Unmet, place
from datagen.seeding import Purpose, generator
from scene_library.placement import FreeSpace
from scene_library.rooms import Plan, RoomDoesNotClose, surfaces
from scene_library.sightlines import even_points, seen_fractions
from scene_library.visibility import visible_fan, visible_interval

MESHES_CHECKED = 200
"""At most about this many files of a folder are loaded before a build."""
SMALLEST_VIEW_M = 0.05
"""A relay wall seen over less than this width is no relay wall."""


@dataclass
class _Parts:
    """Surfaces collected so far, in the order of their part index."""

    names: list[str] = field(default_factory=list)
    roles: list[Role] = field(default_factory=list)
    materials: list[Material] = field(default_factory=list)
    vertices: list[NDArray[np.float64]] = field(default_factory=list)
    triangles: list[NDArray[np.int64]] = field(default_factory=list)

    def add(
        self, name: str, role: Role, material: Material, vertices: NDArray[np.float64], faces: NDArray[np.int64]
    ) -> None:
        self.names.append(name)
        self.roles.append(role)
        self.materials.append(material)
        self.vertices.append(vertices)
        self.triangles.append(faces)

    def free_name(self, wanted: str) -> str:
        """The name itself, or numbered from 2 when it is taken."""
        number, name = 1, wanted
        while name in self.names:
            number += 1
            name = f"{wanted}_{number}"
        return name

    def joined(self) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]:
        offsets = np.cumsum([0] + [len(v) for v in self.vertices])
        faces = np.concatenate([f + o for f, o in zip(self.triangles, offsets, strict=False)])
        part = np.repeat(np.arange(len(self.names)), [len(f) for f in self.triangles])
        return np.concatenate(self.vertices), faces.astype(np.int32), part.astype(np.int32)


def generate_scene(spec: SceneConfig, seed: int, index: int) -> Scene:
    """Draw scene `index` of the dataset with this `seed`.

    The first attempt that meets every constraint is taken: the room closes, every object stands inside with
    `clearance_m` to walls and other objects, none can be seen from the device, and each is seen from the visible part
    of the relay wall (`minimum_seen`). The same arguments give the same scene, whoever asks and when.

    Raises `InputError` when `spec.max_attempts` rooms failed, naming what failed how often and what to change.
    """
    reasons: Counter[tuple[str, str]] = Counter()
    for attempt in range(spec.max_attempts):
        try:
            return _attempt(spec, generator(seed, index, Purpose.SCENE, attempt), attempt)
        except Unmet as unmet:
            reasons[unmet.args] += 1
    raise InputError(explain(spec, seed, index, reasons))


def _attempt(spec: SceneConfig, rng: np.random.Generator, attempt: int) -> Scene:
    parameters: dict[str, Scalar] = {"attempts": attempt + 1, "layout.kind": spec.layout.kind}
    try:
        plan, drawn = draw_plan(spec.layout, rng)
    except RoomDoesNotClose as error:
        raise Unmet("layout", str(error)) from None
    parameters.update({f"layout.{name}": value for name, value in drawn.items()})
    fan = visible_fan(plan.limits, plan.device[:2])
    relay_wall = _visible_relay_wall(plan, fan)

    parts = _Parts()
    for name, (vertices, faces) in surfaces(plan, floor=spec.layout.floor, ceiling=spec.layout.ceiling).items():
        material = _material(spec, getattr(spec.materials, name), name, parameters, rng)
        parts.add(name, "relay_wall" if name == "relay_wall" else "structure", material, vertices, faces)

    space = FreeSpace(plan.outline, plan.hidden, plan.walls, plan.height_m, fan, spec.clearance_m)
    objects: list[tuple[str, str]] = []
    for where, item in _items(spec, rng):
        drawn_object = draw_object(item, plan.height_m, rng)
        spot = place(where, item, drawn_object.solid, plan, space, rng)
        name = parts.free_name(item.name or label_of(drawn_object.label))
        material = _material(spec, item, name, parameters, rng)
        parts.add(name, "object", material, spot.vertices(drawn_object.solid), drawn_object.solid.triangles)
        parameters |= {f"{name}.kind": item.kind, f"{name}.class": drawn_object.label}
        parameters |= {f"{name}.{key}": value for key, value in (drawn_object.sizes | asdict(spot)).items()}
        objects.append((where, name))
    parameters["objects"] = len(objects)

    corners, triangles, face_part = parts.joined()
    if objects:
        first = len(parts.names) - len(objects)
        wanted = np.arange(first, len(parts.names))
        seen = seen_fractions(corners[triangles], face_part, wanted, even_points(*_spread(relay_wall)))
        for (where, name), fraction in zip(objects, seen, strict=True):
            if fraction <= spec.minimum_seen:
                raise Unmet(where, "unseen")
            parameters[f"{name}.seen_fraction"] = float(fraction)
    return Scene(
        vertices=corners,
        triangles=triangles,
        face_part=face_part,
        part_names=tuple(parts.names),
        materials=tuple(parts.materials),
        roles=tuple(parts.roles),
        relay_wall=relay_wall,
        hidden_view=_hidden_view(plan),
        hidden_bounds=np.array([[*plan.hidden[0], 0.0], [*plan.hidden[1], plan.height_m]]),
        device_position=plan.device,
        parameters=parameters,
    )


def _items(spec: SceneConfig, rng: np.random.Generator) -> Iterator[tuple[str, Content]]:
    """The objects to place, one after the other, with where their settings stand."""
    for i, item in enumerate(spec.contents):
        for _ in range(draw_count(item.count, rng)):
            yield f"contents[{i}]", item


def _material(
    spec: SceneConfig, surface: Surface, name: str, parameters: dict[str, Scalar], rng: np.random.Generator
) -> Material:
    """Draw the material of the part `name`, and note its numbers."""
    material, catalogue_name = surface.draw_material(spec.wavelength_nm, rng)
    if catalogue_name is not None:
        parameters[f"{name}.material"] = catalogue_name
    numbers = {key: value for key, value in asdict(material).items() if isinstance(value, (int, float))}
    parameters |= {f"{name}.{key}": value for key, value in numbers.items()}
    if not isinstance(material, Lambertian):
        parameters[f"{name}.brdf"] = type(material).__name__
    return material


def _visible_relay_wall(plan: Plan, fan: NDArray[np.float64]) -> Rectangle:
    start, end = plan.relay_segment
    seen = visible_interval(fan, start, end)
    if seen is None or seen[1] - seen[0] < SMALLEST_VIEW_M:
        raise Unmet("layout", f"the device sees less than {SMALLEST_VIEW_M} m of the relay wall: widen the corridor")
    unit = (end - start) / np.linalg.norm(end - start)
    return _upright(start + seen[0] * unit, start + seen[1] * unit, plan.visible_top_m)


def _hidden_view(plan: Plan) -> Rectangle:
    """The hidden part's width and height in the plane of the relay wall."""
    x = plan.relay_segment[0, 0]
    return _upright(np.array([x, plan.hidden[0, 1]]), np.array([x, plan.hidden[1, 1]]), plan.height_m)


def _upright(right_end: NDArray[np.float64], left_end: NDArray[np.float64], height_m: float) -> Rectangle:
    """The rectangle above a plan segment given from right to left as seen from the room; its normal points there."""
    center = np.array([*(right_end + left_end) / 2, height_m / 2])
    return Rectangle.of(center, [*(right_end - left_end) / 2, 0.0], [0.0, 0.0, height_m / 2])


def _spread(wall: Rectangle) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    return wall.center, wall.right, wall.up


def check_scene_config(spec: SceneConfig) -> None:
    """Load the meshes named, so that a bad file is refused before anything is built. Raises `InputError`.

    Of a folder with very many files an even selection is loaded.
    """
    for i, item in enumerate(spec.contents):
        try:
            if isinstance(item, Mesh):
                load_mesh(item, item.file, item.path)
            elif isinstance(item, MeshFolder):
                files = [file for files in item.files().values() for file in files]
                for file in files[:: 1 + len(files) // MESHES_CHECKED]:
                    load_mesh(item, file, f"{item.path}/{file.relative_to(item.folder).as_posix()}")
        except InputError as error:
            raise InputError(f"scene.contents[{i}].{error}") from None
