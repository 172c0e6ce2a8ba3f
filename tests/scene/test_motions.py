"""Laws of rooms whose objects move: what holds of objects that stand holds at every 2 cm of every path."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from room_laws import (
    assert_frames_hold_the_objects,
    assert_hidden,
    assert_keeps_clear,
    assert_nothing_floats,
    assert_nothing_intersects,
    assert_room_laws,
    object_names,
)

import datagen as dg
from datagen.capture import capture_for
from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.records import Scene
from datagen.scene import generate_scene
from datagen.transport.lines_of_sight import lit_points
from datagen.transport.rays import Raycaster
from scene_library.moving import LOST_CLEARANCE, Mover, obstacle_on_way
from scene_library.placement import FreeSpace, Occupied
from scene_library.polygons import segments_of
from scene_library.solids import prism, rectangle, regular_polygon

STEP_M, STEP_DEG = 0.02, 5.0
CLEARANCE_M = 0.02
UNIT = {"uniform": [0, 1]}
POINTS = [
    {"time_s": 0.1, "along": UNIT, "across": UNIT},
    {"time_s": 0.6, "along": UNIT, "across": UNIT, "rotation_deg": 90},
]
MOTIONS: dict[str, dict[str, Any]] = {
    "walk": {"kind": "walk", "leg_m": {"uniform": [0.2, 1.0]}},
    "straight": {"kind": "straight", "turning_deg_s": {"uniform": [-90, 90]}},
    "points": {"kind": "points", "points": POINTS},
    "jump": {"kind": "jump"},
}
LAYOUTS = ("l_corridor", "corridor_room", "t_corridor", "doorway_room")


def config_of(
    *contents: dict[str, Any], layout: str = "l_corridor", frames: int = 8, scene: dict[str, Any] | None = None
) -> DatasetConfig:
    """A sequence of frames at 10 Hz."""
    return config_from_mapping(
        {
            "sequence": {"frames": frames, "rate_hz": 10},
            "detector": {"cycles": 3000},
            "scene": {"layout": {"kind": layout}, "contents": [*contents], **(scene or {})},
        }
    )


def two_movers(motion: dict[str, Any], layout: str = "l_corridor") -> DatasetConfig:
    """A chair and a box that move, and a pillar between them."""
    chair = {"kind": "library", "classes": ["chair"], "motion": motion}
    box = {"kind": "box", "width_m": 0.4, "depth_m": 0.3, "height_m": 0.5, "motion": motion}
    return config_of(chair, box, {"kind": "pillar", "width_m": 0.3}, layout=layout)


def times_of(scene: Scene, duration_s: float) -> Iterator[float]:
    """Times between which no mover goes farther than `STEP_M`, or turns by more than `STEP_DEG`."""
    knots = np.unique([0.0, duration_s, *(t for path in scene.paths.values() for t in path.times_s)])
    for start, end in pairwise(knots):
        middle = 0.5 * (start + end)
        rates = [
            max(np.linalg.norm(path.velocity(middle)) / STEP_M, np.degrees(abs(path.turning(middle))) / STEP_DEG)
            for path in scene.paths.values()
        ]
        steps = 1 + int((end - start) * max(rates, default=0.0))
        # At the end of a piece a part may jump.
        yield from np.minimum(np.linspace(start, end, steps + 1), np.nextafter(end, start))
    yield duration_s


@pytest.mark.parametrize("kind", MOTIONS)
def test_the_laws_of_rooms_hold_at_every_2_cm(kind: str) -> None:
    """Of 20 rooms, of four layouts, with two objects that move and one that stands."""
    rng, poses, moved = np.random.default_rng(5), 0, 0.0
    for index in range(20):
        config = two_movers(MOTIONS[kind], LAYOUTS[index % len(LAYOUTS)])
        scene = dg.scene_for(config, index)
        assert len(scene.paths) == 2
        assert_room_laws(scene, rng)
        duration = config.clock.duration_s  # type: ignore[union-attr]
        for time_s in times_of(scene, duration):
            there = scene.at(float(time_s))
            assert_nothing_intersects(there)
            assert_keeps_clear(there, CLEARANCE_M * (1 - LOST_CLEARANCE))
            assert_hidden(there, rng)
            assert_frames_hold_the_objects(there)
            assert_nothing_floats(there)
            poses += 1
        for path in scene.paths.values():
            moved += float(np.linalg.norm(np.diff(path.places, axis=0), axis=1).sum())
    # The laws were asked of something: of frames of a jump, else of every 2 cm.
    assert poses >= (2 * 8 * 20 if kind == "jump" else moved / 2 / STEP_M) and moved > 20 * 0.3


def test_the_laws_notice_a_path_through_a_wall_a_thing_or_sight() -> None:
    config = two_movers(MOTIONS["straight"])
    scene = dg.scene_for(config, 0)
    rng, place = np.random.default_rng(0), scene.paths["box"].places[0]
    pillar = scene.corners[scene.faces_of("pillar")].reshape(-1, 3).mean(axis=0) * [1, 1, 0]
    for end, law in (
        (pillar, assert_nothing_intersects),
        (place * [9.0, 1, 1], assert_nothing_intersects),
        (np.array([2.0, 0.0, 0.0]), lambda there: assert_hidden(there, rng)),
    ):
        wrong = replace(scene, paths={"box": dg.Path((0, 1), [place, end])})
        with pytest.raises(AssertionError):
            law(wrong.at(1.0))


@pytest.mark.parametrize("kind", MOTIONS)
def test_laser_points_stay_where_they_are(kind: str) -> None:
    for index in range(3):
        config = two_movers(MOTIONS[kind])
        scene = dg.scene_for(config, index)
        capture = capture_for(config, scene, config.seed, index)
        due = lit_points(Raycaster(scene), capture.laser).position
        for time_s in np.linspace(0, 0.8, 9):
            there = scene.at(float(time_s))
            np.testing.assert_allclose(lit_points(Raycaster(there), capture.laser).position, due, atol=1e-5)
            again = capture_for(config, there, config.seed, index)
            np.testing.assert_array_equal(again.laser.targets, capture.laser.targets)


def same(a: Scene, b: Scene, *parts: str) -> bool:
    return all(np.array_equal(a.corners[a.faces_of(part)], b.corners[b.faces_of(part)]) for part in parts)


@pytest.mark.parametrize("kind", MOTIONS)
def test_same_seed_same_path(kind: str) -> None:
    config = two_movers(MOTIONS[kind])
    ahead = [dg.scene_for(config, index) for index in (0, 1, 2)]
    back = [dg.scene_for(config, index) for index in (2, 1, 0)][::-1]
    for a, b in zip(ahead, back, strict=True):
        assert dict(a.paths) == dict(b.paths) and a.parameters == b.parameters and same(a, b, *a.part_names)
    assert ahead[0].paths["box"] != ahead[1].paths["box"]
    other = dg.scene_for(config.model_copy(update={"seed": 1}), 0)
    assert other.paths["box"] != ahead[0].paths["box"]


def test_a_room_is_the_same_whether_its_objects_move_or_stand() -> None:
    """As long as ways are found for the first places: motion has random numbers of its own."""
    compared = 0
    for index in range(12):
        moving = dg.scene_for(two_movers(MOTIONS["straight"]), index)
        values = two_movers(MOTIONS["straight"]).model_dump(mode="json")
        del values["sequence"]
        for item in values["scene"]["contents"]:
            item.pop("motion", None)
        standing = dg.scene_for(config_from_mapping(values), index)
        assert not standing.paths and not any("motion" in name for name in standing.parameters)
        if moving.parameters["attempts"] == 1 == standing.parameters["attempts"]:
            assert same(moving, standing, *standing.part_names)
            kept = {key: value for key, value in moving.parameters.items() if ".motion." not in key}
            assert kept == standing.parameters
            compared += 1
        else:
            assert same(moving, standing, *(n for n in standing.part_names if n not in object_names(standing)))
    assert compared >= 3


def test_a_sequence_in_which_nothing_moves_has_the_rooms_of_scenes_that_stand() -> None:
    config = config_of({"kind": "box"}, {"kind": "pillar"})
    values = config.model_dump(mode="json")
    del values["sequence"]
    for index in range(4):
        a, b = dg.scene_for(config, index), dg.scene_for(config_from_mapping(values), index)
        assert a.parameters == b.parameters and not a.paths and a.moving == ()
        np.testing.assert_array_equal(a.vertices, b.vertices)


def test_an_object_that_moves_does_not_change_what_is_drawn_of_the_room() -> None:
    """Nor of the objects before and after it."""
    for index in range(4):
        drawn = []
        for motion in (None, MOTIONS["walk"], MOTIONS["jump"]):
            box = {"kind": "box", "width_m": {"uniform": [0.2, 0.4]}, **({"motion": motion} if motion else {})}
            scene = dg.scene_for(config_of({"kind": "pillar"}, box, {"kind": "library", "classes": ["chair"]}), index)
            kept = ("layout.", "pillar.width", "box.width", "chair.width", "pillar.albedo", "chair.albedo")
            drawn.append({key: value for key, value in scene.parameters.items() if key.startswith(kept)})
        assert drawn[0] == drawn[1] == drawn[2]


def test_the_path_is_that_of_the_mesh_at_the_origin() -> None:
    """At time 0 it takes the solid, which stands about the origin, to the triangles of the scene."""
    for motion in MOTIONS.values():
        scene = dg.scene_for(two_movers(motion), 3)
        for name, path in scene.paths.items():
            own = path.at(0.0).undo(scene.vertices[np.unique(scene.triangles[scene.faces_of(name)])])
            low, high = own.min(axis=0), own.max(axis=0)
            np.testing.assert_allclose([low[2], *(low + high)[:2]], 0, atol=1e-9)
            sizes = [scene.parameters[f"{name}.{key}"] for key in ("width_m", "depth_m", "height_m")]
            np.testing.assert_allclose(high - low, sizes, rtol=1e-9)
            np.testing.assert_allclose(scene.pose_of(name).axes, path.at(0.0).turn(np.eye(3)), atol=1e-9)
            assert [scene.parameters[f"{name}.{key}"] for key in ("x_m", "y_m", "z_m")] == path.at(
                0.0
            ).shifts_m.tolist()


def test_a_walker_goes_front_first_at_its_speed() -> None:
    legs = []
    for index in range(12):
        config = config_of({"kind": "library", "classes": ["mannequin"], "motion": MOTIONS["walk"]}, frames=30)
        scene = dg.scene_for(config, index)
        path, pace = scene.paths["mannequin"], scene.parameters["mannequin.motion.speed_m_s"]
        assert scene.parameters["mannequin.motion.kind"] == "walk" and 0.5 <= float(pace) <= 1.5
        assert path.times_s[0] == 0 and path.times_s[-1] == pytest.approx(3.0)
        for start, end in pairwise(path.times_s):
            middle = 0.5 * (start + end)
            velocity, turning = path.velocity(middle), np.degrees(path.turning(middle))
            speed = float(np.linalg.norm(velocity))
            if speed > 1e-9:
                assert speed == pytest.approx(pace, rel=1e-6) and abs(turning) < 1e-6
                front = path.at(middle).turn([0.0, -1.0, 0.0])
                np.testing.assert_allclose(velocity / speed, front, atol=1e-6)
                legs.append(speed * (end - start) if end < path.times_s[-1] else 0.5)
            else:
                assert abs(abs(turning) - 180) < 1e-6 and abs(turning) * (end - start) <= 180 + 1e-6
    assert len(legs) > 24 and 0.2 - 1e-9 <= min(legs) <= max(legs) <= 1.0 + 1e-9


def test_a_straight_way_is_straight() -> None:
    speeds = []
    for index in range(8):
        scene = dg.scene_for(two_movers(MOTIONS["straight"]), index)
        for name, path in scene.paths.items():
            speed, turning = (scene.parameters[f"{name}.motion.{key}"] for key in ("speed_m_s", "turning_deg_s"))
            times = np.linspace(0, 0.79, 20)
            velocities = path.velocity(times)
            np.testing.assert_allclose(velocities, velocities[:1].repeat(20, axis=0))
            np.testing.assert_allclose(np.linalg.norm(velocities, axis=1), speed)
            np.testing.assert_allclose(np.degrees(path.turning(times)), turning, atol=1e-9)
            assert path.times_s.tolist() == [0.0, 0.8] and velocities[0, 2] == 0
            speeds.append(speed)
    assert len({*speeds}) == 16
    on_the_spot = {"kind": "straight", "speed_m_s": 0, "turning_deg_s": 90}
    path = dg.scene_for(config_of({"kind": "box", "motion": on_the_spot}), 0).paths["box"]
    assert not path.velocity(0.3).any() and path.turning(0.3) == pytest.approx(np.pi / 2) and not path.stands


def test_points_are_reached_at_their_times() -> None:
    points = [
        {"time_s": 0.2, "along": 0.3, "across": 0.4, "rotation_deg": 350},
        {"time_s": 0.5, "distance_m": 1.0, "across": 0.6},
        {"time_s": 0.7, "along": 0.5, "across": 0.5, "rotation_deg": 370},
        {"time_s": 1.2, "along": 0.5, "across": 0.4},
    ]
    box = {"kind": "box", "width_m": 0.2, "depth_m": 0.2, "height_m": 0.3}
    config = config_of({**box, "motion": {"kind": "points", "points": points}})
    for index in range(4):
        scene = dg.scene_for(config, index)
        path = scene.paths["box"]
        # What lies after the last frame is cut off.
        np.testing.assert_allclose(path.times_s, [0.2, 0.5, 0.7, 0.8])
        np.testing.assert_allclose(path.headings_deg, [350, 350, 370, 370])
        low, high = scene.hidden_bounds[:, :2]
        shares = (path.places[:, :2] - low) / (high - low)
        across = shares[:, 1] if scene.parameters["layout.turn"] == "left" else 1 - shares[:, 1]
        np.testing.assert_allclose(shares[[0, 2], 0], [0.3, 0.5])
        np.testing.assert_allclose(across, [0.4, 0.6, 0.5, 0.48])
        np.testing.assert_allclose(scene.relay_wall.center[0] - path.places[1, 0], 1.0)


def test_a_jump_has_another_free_place_in_each_frame() -> None:
    scene = dg.scene_for(two_movers(MOTIONS["jump"]), 1)
    for path in scene.paths.values():
        starts = np.arange(8) / 10
        inside = starts[:, None] + np.array([0.0, 0.05, 0.0999])
        places = path.at(inside)
        assert (places.shifts_m == places.shifts_m[:, :1]).all() and (
            places.turns_rad == places.turns_rad[:, :1]
        ).all()
        assert len(np.unique(places.shifts_m[:, 0], axis=0)) == len(np.unique(places.turns_rad[:, 0])) == 8
        assert not path.velocity(inside).any()


def test_many_movers_share_a_room() -> None:
    """One listed first does not keep the place in which it no longer is."""
    config = config_of(
        {"kind": "library", "classes": ["mannequin"], "count": 4, "motion": MOTIONS["walk"]},
        scene={"layout": {"kind": "l_corridor", "room_length_m": 4, "room_width_m": 5}},
    )  # fmt: skip
    scene = dg.scene_for(config, 0)
    assert len(scene.moving) == 4
    for time_s in np.linspace(0, 0.8, 33):
        assert_keeps_clear(scene.at(float(time_s)), CLEARANCE_M * (1 - LOST_CLEARANCE))


def test_motion_needs_a_clock() -> None:
    spec = two_movers(MOTIONS["walk"]).scene
    with pytest.raises(InputError, match=r"scene\.contents\[0\]\.motion: .* or use dg\.scene_for"):
        generate_scene(spec, 0, 0)
    with pytest.raises(InputError, match="clock = 3: Clock or NoneType needed"):
        generate_scene(spec, 0, 0, clock=3)  # type: ignore[arg-type]
    assert generate_scene(spec, 0, 0, clock=dg.Clock(8, 10)).moving == ("chair", "box")


SMALL = {"kind": "box", "width_m": 0.3, "depth_m": 0.3, "height_m": 0.5}
THROUGH = [{"time_s": 0, "along": 0.1, "across": 0.5}, {"time_s": 0.8, "along": 0.9, "across": 0.5}]
SHIELD = {"kind": "pillar", "width_m": 0.3, "along": 0.5, "across": 0.5}


@pytest.mark.parametrize(
    ("contents", "words"),
    [
        ([{**SMALL, "motion": {"kind": "straight", "speed_m_s": 100}}],
         ["(box) had no free way", "leads into a wall", "lower scene.contents[0].motion.speed_m_s (100)"]),
        ([{**SMALL, "motion": {"kind": "walk", "leg_m": 40, "speed_m_s": 60}}],
         ["motion.speed_m_s (60) and scene.contents[0].motion.leg_m (40) or sequence.frames"]),
        ([{**SMALL, "motion": {"kind": "points", "points": THROUGH}}, SHIELD],
         ["(box) had no free way", "meets another object: change scene.contents[0].motion"]),
    ],
)  # fmt: skip
def test_no_free_way_is_one_line_with_a_remedy(contents: list[dict[str, Any]], words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        dg.scene_for(config_of(*contents, scene={"max_attempts": 24}), 0)
    message = str(caught.value)
    assert "no room met the constraints in 24 attempts" in message and "\n" not in message
    for word in words:
        assert word in message


def test_a_free_way_is_one_that_close_looks_find_free() -> None:
    """`obstacle_on_way` halves times as often as it has to; here each of them is looked at every 5 mm."""
    rng, free, met = np.random.default_rng(7), 0, 0
    outline = rectangle(6.0, 5.0)
    for _ in range(40):
        space = FreeSpace(
            outline, np.array([[-3, -2.5], [3, 2.5]]), segments_of(outline), 2.5, np.zeros((0, 3, 2)), 0.05
        )
        for _ in range(int(rng.integers(0, 4))):
            footprint = regular_polygon(rng.uniform(0.2, 0.8), int(rng.integers(3, 9))) + rng.uniform(-2, 2, 2)
            space.taken.append(Occupied(footprint, 0.0, rng.uniform(0.2, 2.0)))

        def way(knots: int) -> Mover:
            solid = prism(rectangle(*rng.uniform(0.1, 0.7, 2)), 1.0)
            poses = np.column_stack([rng.uniform(-1.9, 1.9, (knots, 2)), rng.uniform(0, 360, knots)])
            return Mover(solid, 0.0, np.linspace(0, 1, knots), poses)

        mover, other = way(int(rng.integers(2, 4))), way(2)
        found = obstacle_on_way(space, mover, [other], 0.0, 1.0)
        long = np.abs(np.diff(mover.poses[:, :2], axis=0)).sum() + np.abs(np.diff(other.poses[:, :2], axis=0)).sum()
        times = np.linspace(0, 1, int(long / 0.005) + 100)
        clearance = 0.05 * ((1 - LOST_CLEARANCE) if found is None else 1.05)
        looks = [
            replace(space, clearance_m=clearance, taken=[*space.taken, other.space_taken(t)]).obstacle(
                mover.space_taken(t)
            )
            for t in times
        ]
        assert any(looks) == (found is not None)
        free, met = free + (found is None), met + (found is not None)
    assert free >= 5 and met >= 15


def test_a_mover_knows_how_far_it_reaches() -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        solid = prism(rectangle(*rng.uniform(0.1, 1, 2)), 1.0)
        times = np.array([0.0, 0.4, 1.0])
        mover = Mover(solid, 0.0, times, np.column_stack([rng.uniform(-2, 2, (3, 2)), rng.uniform(-360, 360, 3)]))
        start, end = np.sort(rng.uniform(*((0, 0.4) if rng.random() < 0.5 else (0.4, 1)), 2))
        middle = mover.space_taken(0.5 * (start + end)).footprint
        far = [
            np.linalg.norm(mover.space_taken(t).footprint - middle, axis=1).max() for t in np.linspace(start, end, 50)
        ]
        assert max(far) <= mover.reach_m(start, end) * (1 + 1e-9)
    standing = Mover(prism(rectangle(1, 1), 1.0), 0.0, np.array([0.5]), np.array([[1.0, 2.0, 30.0]]))
    assert standing.reach_m(0, 1) == 0 and standing.pose(0.2) == standing.pose(3.0) == (1.0, 2.0, 30.0)
