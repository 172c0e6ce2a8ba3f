"""Scene settings + scene library → Scene: draw a room, furnish it, check it, or say why that cannot be done.

`generate_scene` is a pure function of (settings, seed, index). Every attempt at a room has its own random stream, so
what one attempt consumed never shifts the next.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from datagen.config.distributions import draw
from datagen.config.scene import SceneConfig
from datagen.config.scene_contents import Item, Mesh, Standing, draw_count
from datagen.errors import InputError
from datagen.records import Lambertian, Rectangle, Role, Scalar, Scene
from datagen.scene_checks import explain
from datagen.scene_draws import draw_plan, draw_solid
from datagen.seeding import Purpose, generator
from scene_library.placement import FreeSpace, Occupied
from scene_library.rooms import Plan, RoomDoesNotClose, surfaces
from scene_library.sightlines import even_points, seen_fractions
from scene_library.solids import Solid
from scene_library.visibility import visible_fan, visible_interval

POSITIONS_PER_OBJECT = 40
"""Positions tried for one object before its room is given up and everything is drawn again."""
SMALLEST_VIEW_M = 0.05
"""A relay wall seen over less than this width is no relay wall."""


class Unmet(Exception):
    """One attempt failed; the arguments are (what, detail) for the tally."""


@dataclass
class _Parts:
    """Surfaces collected so far, in the order of their part index."""

    names: list[str] = field(default_factory=list)
    roles: list[Role] = field(default_factory=list)
    albedos: list[float] = field(default_factory=list)
    vertices: list[NDArray[np.float64]] = field(default_factory=list)
    triangles: list[NDArray[np.int64]] = field(default_factory=list)

    def add(
        self, name: str, role: Role, albedo: float, vertices: NDArray[np.float64], faces: NDArray[np.int64]
    ) -> None:
        self.names.append(name)
        self.roles.append(role)
        self.albedos.append(albedo)
        self.vertices.append(vertices)
        self.triangles.append(faces)

    def joined(self) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]:
        offsets = np.cumsum([0] + [len(v) for v in self.vertices])
        faces = np.concatenate([f + o for f, o in zip(self.triangles, offsets, strict=False)])
        part = np.repeat(np.arange(len(self.names)), [len(f) for f in self.triangles])
        return np.concatenate(self.vertices), faces.astype(np.int32), part.astype(np.int32)


def generate_scene(spec: SceneConfig, seed: int, index: int) -> Scene:
    """Draw scene `index` of the dataset with this `seed`.

    The first attempt that meets every constraint is taken: the room closes, every object stands inside with
    `clearance_m` to walls and other objects, none can be seen from the device, and each is seen from the visible part
    of the relay wall. The same arguments give the same scene, whoever asks and when.

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
        albedo = draw(getattr(spec.materials, name).albedo, rng)
        parameters[f"{name}.albedo"] = albedo
        parts.add(name, "relay_wall" if name == "relay_wall" else "structure", albedo, vertices, faces)

    space = FreeSpace(plan.outline, plan.hidden, plan.walls, plan.height_m, fan, spec.clearance_m)
    objects: list[tuple[int, str]] = []
    for i, name, item in _objects(spec, rng):
        solid, drawn = draw_solid(item, plan.height_m, rng)
        rotation_deg = draw(item.rotation_deg, rng)
        albedo = draw(item.albedo, rng)
        spot = _place(i, item, solid, rotation_deg, plan, space, rng)
        parameters[f"{name}.kind"] = str(getattr(item, "kind", ""))
        parameters[f"{name}.class"] = item.part_name
        parameters.update({f"{name}.{key}": value for key, value in drawn.items()})
        parameters.update({f"{name}.{key}": value for key, value in spot.items()})
        parameters[f"{name}.rotation_deg"] = rotation_deg
        parameters[f"{name}.albedo"] = albedo
        objects.append((i, name))
        vertices = solid.placed(spot["x_m"], spot["y_m"], spot["z_m"], rotation_deg)
        parts.add(name, "object", albedo, vertices, solid.triangles)
    parameters["objects"] = len(objects)

    corners, triangles, face_part = parts.joined()
    if objects:
        first = len(parts.names) - len(objects)
        wanted = np.arange(first, len(parts.names))
        seen = seen_fractions(corners[triangles], face_part, wanted, even_points(*_spread(relay_wall)))
        for (i, name), fraction in zip(objects, seen, strict=True):
            if fraction == 0:
                raise Unmet(f"contents[{i}]", "unseen")
            parameters[f"{name}.seen_fraction"] = float(fraction)
    return Scene(
        vertices=corners,
        triangles=triangles,
        face_part=face_part,
        part_names=tuple(parts.names),
        materials=tuple(Lambertian(a) for a in parts.albedos),
        roles=tuple(parts.roles),
        relay_wall=relay_wall,
        hidden_view=_hidden_view(plan),
        hidden_bounds=np.array([[*plan.hidden[0], 0.0], [*plan.hidden[1], plan.height_m]]),
        device_position=plan.device,
        parameters=parameters,
    )


def _objects(spec: SceneConfig, rng: np.random.Generator) -> Iterator[tuple[int, str, Item]]:
    """The objects to place: (position in `contents`, part name, settings)."""
    used: Counter[str] = Counter()
    for i, item in enumerate(spec.contents):
        for _ in range(draw_count(item.count, rng)):
            used[item.part_name] += 1
            number = used[item.part_name]
            yield i, item.part_name if number == 1 else f"{item.part_name}_{number}", item


def _place(
    i: int,
    item: Item,
    solid: Solid,
    rotation_deg: float,
    plan: Plan,
    space: FreeSpace,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Try positions until one is free; take it. Raises `Unmet` with the commonest obstacle."""
    obstacles: Counter[str] = Counter()
    elevation = draw(item.elevation_m, rng) if isinstance(item, Standing) else 0.0
    hanging = isinstance(item, Standing) and item.hanging
    z = plan.height_m - elevation - solid.top_m if hanging else elevation
    (x0, y0), (x1, y1) = plan.hidden
    for _ in range(POSITIONS_PER_OBJECT):
        along, across = draw(item.along, rng), draw(item.across, rng)
        x = x0 + along * (x1 - x0)
        y = y0 + across * (y1 - y0) if plan.across_from_low else y1 - across * (y1 - y0)
        place = Occupied(solid.footprint(x, y, rotation_deg), z, z + solid.top_m)
        obstacle = space.obstacle(place)
        if obstacle is None:
            space.taken.append(place)
            return {"x_m": float(x), "y_m": float(y), "z_m": z, "along": along, "across": across}
        obstacles[obstacle] += 1
        if obstacle == "height":
            break
    raise Unmet(f"contents[{i}]", obstacles.most_common(1)[0][0])


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
    """Load every mesh named, so that a bad file is refused before anything is built. Raises `InputError`."""
    for i, item in enumerate(spec.contents):
        if isinstance(item, Mesh):
            try:
                draw_solid(item, 1.0, np.random.default_rng(0))
            except InputError as error:
                raise InputError(f"scene.contents[{i}].{error}") from None
