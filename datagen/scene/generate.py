"""Scene settings + scene library → Scene: draw a room, furnish it, check it, or say why that cannot be done.

`generate_scene` is a pure function of (settings, seed, index). Every room drawn has its own random stream, and so has
every try at placing its objects, so what one consumed never shifts the next.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass

import numpy as np

from datagen.config.distributions import draw
from datagen.config.scene import SceneConfig
from datagen.config.scene_contents import Mesh, MeshFolder
from datagen.config.scene_layouts import NoLayout
from datagen.errors import InputError
from datagen.records import Pose, Rectangle, Role, Scalar, Scene
from datagen.records.arrays import Floats
from datagen.records.checks import check_kind
from datagen.scene.draws import DrawnRoom, draw_room, load_mesh
from datagen.scene.placing import Unmet, place
from datagen.scene.refusals import explain
from datagen.seeding import Purpose, generator
from scene_library.placement import FreeSpace
from scene_library.rooms import FloorPlan, RoomDoesNotClose
from scene_library.rounding import length
from scene_library.sightlines import even_points, seen_fractions
from scene_library.solids import Solid, joined
from scene_library.visibility import visible_fan, visible_interval

MESHES_CHECKED = 200
"""At most about this many files of a folder are loaded before a build."""
SMALLEST_VIEW_M = 0.05
"""A relay wall seen over less than this width is no relay wall."""


Shortfall = Callable[[Scene, Mapping[str, float]], str | None]
"""Scene, and the least evidence of its objects by name → one that has less; None where all have enough."""


def generate_scene(spec: SceneConfig, seed: int, index: int, short_of: Shortfall | None = None) -> Scene:
    """Draw scene `index` of the dataset with this `seed`.

    A room is drawn with everything in it, then its objects are placed: inside, with `clearance_m` to walls and other
    objects, none to be seen from the device, and each seen from the visible part of the relay wall (`minimum_seen`).
    Where that fails the same objects are placed anew; only after many tries (`placings`) is the room given up and all
    of it drawn again, so that what is declared is what is found in the dataset, whether it is easy to place or not.

    Parameters
    ----------
    spec : the section `scene` of a configuration.
    seed, index : of the dataset, and of the scene in it, ≥ 0; the same arguments give the same scene, whoever asks.
    short_of : tells an object with less evidence than `evidence_at_least` asks for, and all are placed anew;
        `dg.scene_for` has the one that follows from capture and detector.

    Returns
    -------
    Scene with relay wall, hidden view and bounds, the device's position, and every number drawn as `parameters`.

    Raises
    ------
    InputError : after `spec.max_attempts` placings in all, naming what failed how often and what to change; settings
        that ask for evidence, without `short_of`.

    >>> import datagen as dg
    >>> config = dg.load_config("configs/quickstart.yaml")
    >>> scene = dg.generate_scene(config.scene, seed=7, index=3)
    >>> scene.part_names
    ('relay_wall', 'walls', 'floor', 'ceiling', 'pillar', 'box')
    >>> scene.parameters["layout.kind"]
    'l_corridor'
    """
    check_kind("spec", spec, SceneConfig, remedy="such as load_config(path).scene")
    if isinstance(spec.layout, NoLayout):
        raise InputError(f"scene.layout.kind = {spec.layout.kind!r}: {spec.layout.why}")
    if short_of is None:
        _check_needs_no_light(spec)
    reasons: Counter[tuple[str, str]] = Counter()
    draws = 0
    while (left := spec.max_attempts - reasons.total()) > 0:
        try:
            room = draw_room(spec, generator(seed, index, Purpose.SCENE, draws))
            view = _View.of(room.plan)
        except RoomDoesNotClose as error:
            reasons["layout", str(error)] += 1
        else:
            tries = min(left, placings(spec.max_attempts, draws))
            for number in range(tries):
                rng = generator(seed, index, Purpose.SCENE, draws, 1 + number)
                counted: dict[str, Scalar] = {"attempts": reasons.total() + 1, "draws": draws + 1}
                if short_of is not None:
                    counted["evidence.placed_anew"] = sum(n for (_, what), n in reasons.items() if what == "dim")
                try:
                    scene = _furnished(spec, room, view, rng, counted, rotate_anew=2 * number > tries)
                    if short_of is not None:
                        _check_seen(room, short_of, scene)
                    return scene
                except Unmet as unmet:
                    reasons[unmet.args] += 1
                    if unmet.final:
                        break
        draws += 1
    raise InputError(explain(spec, seed, index, reasons))


def _check_needs_no_light(spec: SceneConfig) -> None:
    for i, item in enumerate(spec.contents):
        if item.evidence_at_least is not None:
            raise InputError(
                f"scene.contents[{i}].evidence_at_least = {item.evidence_at_least:g}: what an object has depends on "
                "capture and detector, too; use dg.scene_for(config, index)"
            )


def _check_seen(room: DrawnRoom, short_of: Shortfall, scene: Scene) -> None:
    """Raises `Unmet` for an object with less evidence than is asked for."""
    asked = {thing.name: least for thing in room.things if (least := thing.item.evidence_at_least) is not None}
    dim = short_of(scene, asked) if asked else None
    if dim is not None:
        raise Unmet(next(thing.where for thing in room.things if thing.name == dim), "dim")


def placings(max_attempts: int, draw_number: int) -> int:
    """How often the objects of a drawn room are placed before it is given up.

    An eighth of all attempts for the first room, half as many for each further one, at least one: most attempts are
    left for rooms drawn anew, in case few of those that can be drawn are possible at all.
    """
    return max(1, max_attempts >> min(3 + draw_number, 62))


@dataclass(frozen=True)
class _View:
    """What the device sees: `fan` (n, 3, 2) in plan, and the part of the relay wall in it."""

    fan: Floats
    relay_wall: Rectangle

    @classmethod
    def of(cls, plan: FloorPlan) -> _View:
        """The view of a room's device; raises `RoomDoesNotClose` where it sees too little of the relay wall."""
        fan = visible_fan(plan.limits, plan.device[:2])
        return cls(fan, _visible_relay_wall(plan, fan))


def _furnished(
    spec: SceneConfig, room: DrawnRoom, view: _View, rng: np.random.Generator, counted: dict[str, Scalar],
    rotate_anew: bool,
) -> Scene:  # fmt: skip
    """Place every object and check what is seen of it. Raises `Unmet`.

    rotate_anew : draw rotations afresh too, since an object may only fit at another one.
    """
    plan, parameters = room.plan, counted | room.parameters
    surfaces, materials, poses = room.surfaces.copy(), room.materials.copy(), dict[str, Pose]()
    space = FreeSpace(plan.outline, plan.hidden, plan.walls, plan.height_m, view.fan, spec.clearance_m)
    space.taken.extend(room.clutter.values())
    for thing in room.things:
        rotation = draw(thing.item.rotation_deg, rng) if rotate_anew else thing.rotation_deg
        spot = place(thing, rotation, plan, view.relay_wall, space, rng)
        surfaces[thing.name] = spot.vertices(thing.solid), thing.solid.triangles
        materials[thing.name] = thing.material
        poses[thing.name] = Pose.upright(thing.label, spot.rotation_deg)
        parameters |= {f"{thing.name}.{key}": value for key, value in asdict(spot).items()}

    vertices, triangles = joined(list(surfaces.values()))
    face_part = np.repeat(np.arange(len(surfaces), dtype=np.int32), [len(faces) for _, faces in surfaces.values()])
    if room.things:
        wanted, wall = np.arange(len(room.surfaces), len(surfaces)), view.relay_wall
        wall_points = even_points(wall.center, wall.right, wall.up)
        seen = seen_fractions(vertices[triangles], face_part, wanted, wall_points)
        for thing, fraction in zip(room.things, seen, strict=True):
            if fraction <= spec.minimum_seen:
                raise Unmet(thing.where, "unseen")
            parameters[f"{thing.name}.seen_fraction"] = float(fraction)
    parameters["attenuation_per_m"] = attenuation_per_m = draw(spec.attenuation_per_m, rng)
    return Scene(
        vertices=vertices, triangles=triangles.astype(np.int32), face_part=face_part, part_names=tuple(surfaces),
        materials=tuple(materials[name] for name in surfaces), roles=tuple(_role(name, room) for name in surfaces),
        relay_wall=view.relay_wall, hidden_view=_hidden_view(plan),
        hidden_bounds=np.array([[*plan.hidden[0], 0.0], [*plan.hidden[1], plan.height_m]]),
        device_position=plan.device, parameters=parameters, poses=poses, attenuation_per_m=attenuation_per_m,
    )  # fmt: skip


def _role(name: str, room: DrawnRoom) -> Role:
    if name not in room.surfaces:
        return "object"
    # What stands before the relay wall scatters like it: labels look through it, scans may meet it.
    return "relay_wall" if name == "relay_wall" or name in room.clutter else "structure"


def _visible_relay_wall(plan: FloorPlan, fan: Floats) -> Rectangle:
    start, end = plan.relay_segment
    seen = visible_interval(fan, start, end)
    if seen is None or seen[1] - seen[0] < SMALLEST_VIEW_M:
        raise RoomDoesNotClose(f"the device sees less than {SMALLEST_VIEW_M} m of the relay wall: widen the corridor")
    if plan.all_in_view:
        return _upright(start, end, plan.visible_top_m)
    unit = (end - start) / length(end - start)
    return _upright(start + seen[0] * unit, start + seen[1] * unit, plan.visible_top_m)


def _hidden_view(plan: FloorPlan) -> Rectangle:
    """The hidden part's width and height in the plane of the relay wall."""
    x = plan.relay_segment[0, 0]
    return _upright(np.array([x, plan.hidden[0, 1]]), np.array([x, plan.hidden[1, 1]]), plan.height_m)


def _upright(right_end: Floats, left_end: Floats, height_m: float) -> Rectangle:
    """The rectangle above a plan segment given from right to left as seen from the room; its normal points there."""
    center = np.array([*(right_end + left_end) / 2, height_m / 2])
    return Rectangle.of(center, [*(right_end - left_end) / 2, 0.0], [0.0, 0.0, height_m / 2])


def check_scene_config(spec: SceneConfig) -> None:
    """Load the meshes named, so that a bad file is refused before anything is built. Raises `InputError`."""
    for _ in meshes_named(spec):
        pass


def meshes_named(spec: SceneConfig) -> Iterator[tuple[str, Solid]]:
    """Each mesh that the settings name, as `scene.contents[0].path = 'spot.obj'` and its solid at height 1.

    Of a folder with very many files an even selection. Raises `InputError` for a bad file.
    """
    for i, item in enumerate(spec.contents):
        if not isinstance(item, Mesh | MeshFolder):
            continue
        if isinstance(item, Mesh):
            files = {item.path: item.file}
        else:
            every = [file for files in item.files().values() for file in files]
            files = {item.shown(file): file for file in every[:: 1 + len(every) // MESHES_CHECKED]}
        for shown, file in files.items():
            try:
                solid = load_mesh(item, file, shown)
            except InputError as error:
                raise InputError(f"scene.contents[{i}].{error}") from None
            yield f"scene.contents[{i}].path = {shown!r}", solid
