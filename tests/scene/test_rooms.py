"""Laws of generated rooms, over settings that are random themselves."""

from __future__ import annotations

from functools import cache
from typing import get_args

import numpy as np
import pytest
from crossing_counts import crossing_counts
from many_rooms import check_rooms
from random_specs import LAYOUTS, random_scene
from room_laws import (
    assert_closed_surface,
    assert_hidden,
    assert_nothing_intersects,
    assert_seen_from_wall,
    object_names,
)
from scipy import stats

from datagen.config import config_from_mapping
from datagen.config.distributions import support
from datagen.config.scene_layouts import AnyLayout
from datagen.records import Part, Scene
from datagen.scene import generate_scene


@cache
def few_rooms(kind: str) -> list[Scene]:
    """Of random settings, with up to four objects."""
    return [random_scene(np.random.default_rng(index), kind, 4, index)[1] for index in range(6)]


def test_random_settings_are_those_of_all_layouts() -> None:
    """A layout that a list forgets would be held to no law."""
    offered = [layout for layout in get_args(get_args(AnyLayout)[0]) if layout.is_offered]
    assert {layout.model_fields["kind"].default for layout in offered} == set(LAYOUTS)


@pytest.mark.parametrize("kind", LAYOUTS)
def test_random_specs_meet_every_law(kind: str) -> None:
    """`many_rooms.py` does the same for as many settings as one has time for."""
    tally = check_rooms(kind, range(8), seed=1)
    assert tally.violations == []
    assert tally.rooms >= 6
    assert tally.objects >= 8


def test_the_laws_notice_a_violation() -> None:
    """The oracle itself: a box moved into the wall, into the pillar, into sight; a room with a hole."""
    rng = np.random.default_rng(0)
    scene = generate_scene(config_from_mapping({}).scene, 0, 0)

    def moved(to: np.ndarray) -> Scene:
        corners = scene.corners.copy()
        box = scene.faces_of("box")
        corners[box] += to - corners[box].reshape(-1, 3).mean(axis=0)
        return _rebuilt(scene, corners)

    assert_nothing_intersects(scene)
    pillar = scene.corners[scene.faces_of("pillar")].reshape(-1, 3).mean(axis=0)
    for place in (pillar, np.array([scene.relay_wall.center[0], 0.0, 1.0]), np.array([-50.0, 0.0, 1.0])):
        with pytest.raises(AssertionError):
            assert_nothing_intersects(moved(place))
    with pytest.raises(AssertionError):
        assert_hidden(moved(np.array([2.0, 0.0, 1.0])), rng)
    with pytest.raises(AssertionError):
        assert_closed_surface(_rebuilt(scene, np.delete(scene.corners, 3, axis=0), np.delete(scene.face_part, 3)))


def _rebuilt(scene: Scene, corners: np.ndarray, face_part: np.ndarray | None = None) -> Scene:
    face_part = scene.face_part if face_part is None else face_part

    class Soup:
        def __init__(self, triangles: np.ndarray) -> None:
            self.vertices = triangles.reshape(-1, 3)
            self.faces = np.arange(len(self.vertices)).reshape(-1, 3)

    parts = [
        Part(n, Soup(corners[face_part == i]), scene.materials[i], scene.roles[i])
        for i, n in enumerate(scene.part_names)
    ]
    return Scene.from_parts(
        parts, relay_wall=scene.relay_wall, device_position=scene.device_position, parameters=scene.parameters
    )


def test_same_arguments_same_scene_and_order_does_not_matter() -> None:
    spec = config_from_mapping({}).scene
    ahead = [generate_scene(spec, 5, i) for i in (0, 1, 2)]
    back = [generate_scene(spec, 5, i) for i in (2, 1, 0)][::-1]
    for a, b in zip(ahead, back, strict=True):
        assert a.parameters == b.parameters
        np.testing.assert_array_equal(a.vertices, b.vertices)
        np.testing.assert_array_equal(a.triangles, b.triangles)
    assert ahead[0].parameters != ahead[1].parameters
    assert generate_scene(spec, 6, 0).parameters != ahead[0].parameters


@pytest.mark.parametrize("kind", LAYOUTS)
def test_left_and_right_are_mirror_images(kind: str) -> None:
    left, right = (
        config_from_mapping({"scene": {"layout": {"kind": kind, "turn": turn}, "contents": []}}).scene
        for turn in ("left", "right")
    )
    for index in range(10):
        a, b = generate_scene(left, 3, index), generate_scene(right, 3, index)
        flip = np.array([1.0, -1.0, 1.0])
        structure = [i for i, r in enumerate(a.roles) if r != "object"]
        points_a = a.corners[np.isin(a.face_part, structure)].reshape(-1, 3) * flip
        points_b = b.corners[np.isin(b.face_part, structure)].reshape(-1, 3)
        assert {tuple(p) for p in points_a} == {tuple(p) for p in points_b}
        np.testing.assert_allclose(a.relay_wall.center * flip, b.relay_wall.center)
        np.testing.assert_allclose(a.hidden_view.center * flip, b.hidden_view.center)
        for room in (a, b):
            np.testing.assert_allclose(room.relay_wall.normal, [-1, 0, 0], atol=1e-12)
            np.testing.assert_allclose(room.hidden_view.normal, [-1, 0, 0], atol=1e-12)


@pytest.mark.parametrize("kind", LAYOUTS)
def test_views_and_bounds_hold_the_objects(kind: str) -> None:
    for scene in few_rooms(kind):
        low, high = scene.hidden_bounds
        for name in object_names(scene):
            corners = scene.corners[scene.faces_of(name)].reshape(-1, 3)
            assert (corners >= low - 1e-9).all()
            assert (corners <= high + 1e-9).all()
            across = (corners - scene.hidden_view.center) @ scene.hidden_view.right
            assert (np.abs(across) <= scene.hidden_view.right @ scene.hidden_view.right * (1 + 1e-9)).all()
        # Both rectangles lie in the relay wall's plane; an uneven wall lies behind it.
        wall = scene.corners[scene.faces_of("relay_wall")]
        plane = wall[..., 0].min()
        assert np.ptp(wall[..., 0]) == 0 or "relay_wall.kind" in scene.parameters
        np.testing.assert_allclose(scene.relay_wall.corners[:, 0], plane)
        np.testing.assert_allclose(scene.hidden_view.corners[:, 0], plane)


@pytest.mark.parametrize("kind", LAYOUTS)
def test_the_visible_part_is_all_that_is_visible(kind: str) -> None:
    """Just beyond each side of the rectangle, and above it, the wall is out of sight or has ended."""
    for scene in few_rooms(kind):
        wall = scene.relay_wall
        surface = scene.corners[scene.faces_of("relay_wall")]
        # Under a lintel that is out of square the rectangle ends at the lowest of the sight lines.
        above = [] if "layout.wall_0_turned_deg" in scene.parameters else [wall.up]
        for beyond in (wall.right, -wall.right, *above):
            edge = wall.center + (1 + 1e-3) * beyond
            before = edge + 1e-4 * (scene.device_position - edge)
            behind = edge - 1e-4 * (scene.device_position - edge)
            hidden = crossing_counts(scene.corners, scene.device_position[None], before[None]).any()
            ended = not crossing_counts(surface, before[None], behind[None]).any()
            assert hidden or ended


def test_parameters_lie_in_their_ranges_and_are_what_was_built() -> None:
    for trial in range(40):
        rng = np.random.default_rng([7, trial])
        spec, scene = random_scene(rng, LAYOUTS[trial % len(LAYOUTS)], 1, trial)
        p = scene.parameters
        for name, distribution in spec.layout.dimensions().items():
            low, high = support(distribution)
            assert low <= p[f"layout.{name}"] <= high
        for name, value in p.items():
            if name.endswith("_turned_deg") and value != 0:
                low, high = support(spec.layout.out_of_square_deg)
                assert low <= value <= high
        for name, material in zip(scene.part_names, scene.materials, strict=True):
            assert p[f"{name}.albedo"] == material.albedo
        np.testing.assert_allclose(np.ptp(scene.vertices[:, 2]), p["layout.height_m"], rtol=1e-12)
        for name in object_names(scene):
            corners = scene.corners[scene.faces_of(name)].reshape(-1, 3)
            np.testing.assert_allclose(np.ptp(corners[:, 2]), p[f"{name}.height_m"], rtol=1e-9)
            # Along its own axes the object is as wide and deep as was drawn, and stands where the pose says.
            turn = np.radians(p[f"{name}.rotation_deg"])
            axis = np.array([np.cos(turn), np.sin(turn)])
            for unit, size in ((axis, "width_m"), (np.array([-axis[1], axis[0]]), "depth_m")):
                reach = corners[:, :2] @ unit
                np.testing.assert_allclose(np.ptp(reach), p[f"{name}.{size}"], rtol=1e-9)
                place = unit @ [p[f"{name}.x_m"], p[f"{name}.y_m"]]
                np.testing.assert_allclose((reach.min() + reach.max()) / 2, place, atol=1e-9)


@pytest.mark.parametrize("kind", [k for k in LAYOUTS if k != "isolated_wall"])
def test_walls_stand_square_unless_turned(kind: str) -> None:
    """Angles between the walls' normals and the axes are exactly the angles drawn."""
    for angle in (0.0, 3.0):
        layout = {"kind": kind, "out_of_square_deg": {"choice": [angle, -angle]}}
        scene = generate_scene(config_from_mapping({"scene": {"layout": layout}}).scene, 1, 1)
        corners = scene.corners[scene.faces_of("walls")]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal = np.abs(normal[np.abs(normal[:, 2]) < 1e-9])
        off = np.degrees(np.arctan2(normal[:, :2].min(axis=1), normal[:, :2].max(axis=1)))
        np.testing.assert_allclose(off, angle, atol=1e-6)


@pytest.mark.parametrize("kind", LAYOUTS)
def test_floor_and_ceiling_can_be_left_out(kind: str) -> None:
    for floor in (True, False):
        for ceiling in (True, False):
            layout = {"kind": kind, "floor": floor, "ceiling": ceiling}
            scene = generate_scene(config_from_mapping({"scene": {"layout": layout}}).scene, 0, 0)
            assert ("floor" in scene.part_names) == floor
            assert ("ceiling" in scene.part_names) == ceiling


def test_objects_of_one_name_are_numbered() -> None:
    contents = [{"kind": "box", "count": 2, "width_m": 0.2, "depth_m": 0.2}, {"kind": "box", "width_m": 0.2}]
    spec = config_from_mapping({"scene": {"contents": contents}}).scene
    assert object_names(generate_scene(spec, 0, 0)) == ["box", "box_2", "box_3"]


def test_counts_are_even_over_their_range() -> None:
    contents = [{"kind": "box", "count": {"uniform": [0, 3]}, "width_m": 0.1, "depth_m": 0.1}]
    spec = config_from_mapping({"scene": {"contents": contents}}).scene
    counts = [generate_scene(spec, 1, i).parameters["objects"] for i in range(400)]
    assert stats.chisquare(np.bincount(counts, minlength=4)).pvalue > 1e-3


@pytest.mark.parametrize("scale", [0.1, 100.0])
@pytest.mark.parametrize("kind", ["l_corridor", "doorway_room", "isolated_wall"])
def test_rooms_of_every_size(kind: str, scale: float) -> None:
    """Model rooms of decimetres and halls of half a kilometre obey the same laws."""
    default = config_from_mapping({"scene": {"layout": {"kind": kind}}}).scene.layout
    layout: dict[str, object] = {"kind": kind}
    for name, distribution in default.dimensions().items():
        low, high = support(distribution)
        layout[name] = {"uniform": [low * scale, high * scale] if name.endswith("_m") else [low, high]}
    sizes = {"width_m": 0.4 * scale, "depth_m": 0.3 * scale, "height_m": 0.8 * scale}
    contents = [{"kind": "box", **sizes}, {"kind": "library", "classes": ["chair"], "height_m": 0.8 * scale}]
    scene = {"layout": layout, "contents": contents, "clearance_m": 0.02 * scale}
    spec = config_from_mapping({"scene": scene}).scene
    for index in range(4):
        drawn = generate_scene(spec, 0, index)
        assert_nothing_intersects(drawn)
        assert_hidden(drawn, np.random.default_rng(index))
        assert_seen_from_wall(drawn, np.random.default_rng(index))
        if kind != "isolated_wall":
            assert_closed_surface(drawn)
