"""Scene settings + scene library → Scene: draw a room, furnish it, check it, or say why that cannot be done.

`generate_scene` is a pure function of (settings, seed, index). Every drawn room and every attempt at placing its
objects has a random stream of its own, so that no attempt changes what a later one draws.
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
from datagen.records import Clock, Pose, Rectangle, Role, Scalar, Scene
from datagen.records.arrays import Floats
from datagen.records.checks import check_kind
from datagen.scene.draws import DrawnRoom, draw_room, load_mesh
from datagen.scene.motions import Ways, draw_paces, first_rotation, pace_parameters, path_of
from datagen.scene.placing import Spot, Unmet, place, spot_at
from datagen.scene.refusals import explain
from datagen.seeding import Purpose, generator
from scene_library.moving import Mover
from scene_library.placement import FreeSpace
from scene_library.rooms import FloorPlan, RoomDoesNotClose
from scene_library.sightlines import even_points, seen_fractions
from scene_library.solids import Solid, joined
from scene_library.visibility import visible_fan, visible_interval

MESHES_CHECKED = 200
"""About how many files of a folder are loaded, at most, before a build."""
SMALLEST_VIEW_M = 0.05
"""Least visible width of the relay wall: scans of a narrower one would be a line."""
Shortfall = Callable[[Scene, Mapping[str, float]], str | None]
"""(scene, least significance of its objects by name) → an object that has less; None where all have enough."""


def generate_scene(
    spec: SceneConfig, seed: int, index: int, short_of: Shortfall | None = None, clock: Clock | None = None
) -> Scene:
    """Draw scene `index` of the dataset with this `seed`.

    A room is drawn with all its objects, which are then placed: inside, with `clearance_m` to walls and other
    objects, hidden from the device, and each visible from the visible part of the relay wall (`minimum_seen`). Where
    that fails the same objects are placed anew, and only after many attempts (`placings`) everything is drawn again.
    So objects that are hard to place are as frequent in the dataset as they are declared to be.

    Objects with a `motion` get a path through free space (`Scene.paths`): at all times until the last frame ends they
    keep the same distances, to each other at the same times, and stay hidden. Where no path is found, all objects are
    placed anew.

    Parameters
    ----------
    spec : the section `scene` of a configuration.
    seed, index : seed of the dataset and number of the scene in it, ≥ 0; the same arguments give the same scene.
    short_of : returns an object with less evidence than `evidence_at_least`, for which all objects are placed anew;
        `dg.scene_for` passes the function that follows from capture and detector.
    clock : frames of the sequence, which settings with a `motion` need; `config.clock`.

    Returns
    -------
    Scene with relay wall, hidden view, hidden bounds, device position, and every number drawn as `parameters`.

    Raises
    ------
    InputError : after `spec.max_attempts` placings in all, naming what failed how often and what to change; settings
        that ask for evidence, without `short_of`, or for a motion, without `clock`.

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
    check_kind("clock", clock, Clock, type(None), remedy="such as config.clock")
    if short_of is None:
        _check_needs_no_light(spec)
    if clock is None:
        _check_stands(spec)
    reasons: Counter[tuple[str, str]] = Counter()
    draws = 0
    while (left := spec.max_attempts - reasons.total()) > 0:
        try:
            room = draw_room(spec, generator(seed, index, Purpose.SCENE, draws))
            view = _View.of(room.plan)
            paces = draw_paces(room.things, generator(seed, index, Purpose.MOTION, draws))
            room.parameters.update(pace_parameters(paces))
            ways = None if clock is None else Ways(room.plan, view.relay_wall, clock, paces)
        except RoomDoesNotClose as error:
            reasons["layout", str(error)] += 1
        else:
            attempts = min(left, placings(spec.max_attempts, draws))
            for number in range(attempts):
                # Ways have random numbers of their own: a room is the same whether its objects move or stand.
                rng, own = (generator(seed, index, of, draws, 1 + number) for of in (Purpose.SCENE, Purpose.MOTION))
                counts: dict[str, Scalar] = {"attempts": reasons.total() + 1, "draws": draws + 1}
                if short_of is not None:
                    counts["evidence.placed_anew"] = sum(n for (_, what), n in reasons.items() if what == "dim")
                try:
                    placed = _find_places(spec, room, view, rng, rotate_anew=2 * number > attempts)
                    movers = dict[str, Mover]() if ways is None else ways.found(room, *placed, own)
                    scene = _furnished_scene(spec, room, view, placed[0], movers, rng, counts)
                    if short_of is not None:
                        _check_evidence(room, short_of, scene)
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


def _check_stands(spec: SceneConfig) -> None:
    for i, item in enumerate(spec.contents):
        if item.motion is not None:
            raise InputError(
                f"scene.contents[{i}].motion: how far it leads depends on the frames, too; give clock = "
                "config.clock, or use dg.scene_for(config, index)"
            )


def _check_evidence(room: DrawnRoom, short_of: Shortfall, scene: Scene) -> None:
    """Raise `Unmet` for an object with less evidence than its `evidence_at_least`."""
    least_of = {thing.name: least for thing in room.things if (least := thing.item.evidence_at_least) is not None}
    dim = short_of(scene, least_of) if least_of else None
    if dim is not None:
        raise Unmet(next(thing.where for thing in room.things if thing.name == dim), "dim")


def placings(max_attempts: int, draw_number: int) -> int:
    """How often the objects of a drawn room are placed before another room is drawn.

    An eighth of all attempts for the first room, half as many for each further one, at least one: most attempts are
    left for other rooms, in case the objects fit into few of them.
    """
    return max(1, max_attempts >> min(3 + draw_number, 62))


@dataclass(frozen=True)
class _View:
    """What the device sees: `fan`, (n, 3, 2) triangles in plan, and the visible part of the relay wall."""

    fan: Floats
    relay_wall: Rectangle

    @classmethod
    def of(cls, plan: FloorPlan) -> _View:
        """The view of a room's device; raises `RoomDoesNotClose` where it sees too little of the relay wall."""
        fan = visible_fan(plan.limits, plan.device[:2])
        return cls(fan, _visible_relay_wall(plan, fan))


def _find_places(
    spec: SceneConfig, room: DrawnRoom, view: _View, rng: np.random.Generator, rotate_anew: bool
) -> tuple[dict[str, Spot], FreeSpace]:
    """Free places of a room's objects by name, and the room with all that stands in it. Raises `Unmet`.

    rotate_anew : draw rotations again, too, since an object may fit at another rotation only.
    """
    plan, spots = room.plan, dict[str, Spot]()
    space = FreeSpace(plan.outline, plan.hidden, plan.walls, plan.height_m, view.fan, spec.clearance_m)
    space.taken.extend(room.clutter.values())
    for thing in room.things:
        rotation = draw(thing.item.rotation_deg, rng) if rotate_anew else thing.rotation_deg
        spots[thing.name] = place(thing, first_rotation(thing, rotation, rng), plan, view.relay_wall, space, rng)
    return spots, space


def _furnished_scene(
    spec: SceneConfig, room: DrawnRoom, view: _View, spots: Mapping[str, Spot], movers: Mapping[str, Mover],
    rng: np.random.Generator, counts: dict[str, Scalar],
) -> Scene:  # fmt: skip
    """The scene of a room whose objects have places, at time 0 for those that move. Raises `Unmet` for an object that
    the relay wall does not see.

    counts : numbers of attempts and draws, for the scene's parameters.
    """
    plan, parameters = room.plan, counts | room.parameters
    surfaces, materials, poses = room.surfaces.copy(), room.materials.copy(), dict[str, Pose]()
    for thing in room.things:
        spot = spots[thing.name]
        if thing.name in movers and (first := movers[thing.name].pose(0.0)) != spot.pose:
            spot = spot_at(plan, spot.z_m, *first)
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
        paths={name: path_of(mover) for name, mover in movers.items()},
    )  # fmt: skip


def _role(name: str, room: DrawnRoom) -> Role:
    if name not in room.surfaces:
        return "object"
    # Clutter before the relay wall counts as part of it: labels look through it, and scans may meet it.
    return "relay_wall" if name == "relay_wall" or name in room.clutter else "structure"


def _visible_relay_wall(plan: FloorPlan, fan: Floats) -> Rectangle:
    start, end = plan.relay_segment
    seen = visible_interval(fan, start, end)
    if seen is None or seen[1] - seen[0] < SMALLEST_VIEW_M:
        raise RoomDoesNotClose(f"the device sees less than {SMALLEST_VIEW_M} m of the relay wall: widen the corridor")
    if plan.all_in_view:
        return _upright(start, end, plan.visible_top_m)
    unit = (end - start) / np.linalg.norm(end - start)
    return _upright(start + seen[0] * unit, start + seen[1] * unit, plan.visible_top_m)


def _hidden_view(plan: FloorPlan) -> Rectangle:
    """The rectangle in the plane of the relay wall that is as wide and high as the hidden part."""
    x = plan.relay_segment[0, 0]
    return _upright(np.array([x, plan.hidden[0, 1]]), np.array([x, plan.hidden[1, 1]]), plan.height_m)


def _upright(right_end: Floats, left_end: Floats, height_m: float) -> Rectangle:
    """The upright rectangle on a plan segment with ends as seen from the room, into which its normal points."""
    center = np.array([*(right_end + left_end) / 2, height_m / 2])
    return Rectangle.of(center, [*(right_end - left_end) / 2, 0.0], [0.0, 0.0, height_m / 2])


def check_scene_config(spec: SceneConfig) -> None:
    """Raise `InputError` for a bad mesh file, before anything is built."""
    for _ in meshes_named(spec):
        pass


def meshes_named(spec: SceneConfig) -> Iterator[tuple[str, Solid, str]]:
    """Each mesh of the settings: where it is named, as `scene.contents[0].path = 'spot.obj'`, its solid, 1 m high,
    and what its file leaves open ("" if nothing).

    Of a folder with more than `MESHES_CHECKED` files only some, evenly spread. Raises `InputError` for a bad file.
    """
    for i, item in enumerate(spec.contents):
        if not isinstance(item, Mesh | MeshFolder):
            continue
        if isinstance(item, Mesh):
            files = {item.path: item.place}
        else:
            every = [file for files in item.files().values() for file in files]
            files = {item.shown(file): file for file in every[:: 1 + len(every) // MESHES_CHECKED]}
        for shown, file in files.items():
            try:
                solid, doubt = load_mesh(item, file, shown)
            except InputError as error:
                raise InputError(f"scene.contents[{i}].{error}") from None
            yield f"scene.contents[{i}].path = {shown!r}", solid, doubt
