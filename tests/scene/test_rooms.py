"""Laws of generated rooms, over settings that are random themselves."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from benchmarks.many_rooms import check_rooms
from random_specs import CLOSED
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
from datagen.records import Scene
from datagen.scene import generate_scene
from scene_library.layouts import LAYOUTS


def test_the_library_and_the_configuration_have_the_same_layouts() -> None:
    """All laws below take the library's."""
    offered = [layout for layout in get_args(get_args(AnyLayout)[0]) if layout.is_offered]
    assert {layout.model_fields["kind"].default for layout in offered} == set(LAYOUTS)


@pytest.mark.parametrize("kind", LAYOUTS)
def test_random_specs_meet_every_law(kind: str) -> None:
    """`benchmarks/many_rooms.py` does the same for as many settings as one has time for."""
    tally = check_rooms(kind, range(8), seed=1)
    assert tally.violations == []
    assert tally.rooms >= 6
    assert tally.objects >= 8


def test_the_laws_notice_a_violation() -> None:
    """The oracle itself: a box moved into the wall, into the pillar, into sight; a room with a hole."""
    rng = np.random.default_rng(0)
    scene = generate_scene(config_from_mapping({}).scene, 0, 0)
    box = np.unique(scene.triangles[scene.faces_of("box")])

    def moved(to: np.ndarray) -> Scene:
        vertices = scene.vertices.copy()
        vertices[box] += to - vertices[box].mean(axis=0)
        return replace(scene, vertices=vertices)

    assert_nothing_intersects(scene)
    pillar = scene.corners[scene.faces_of("pillar")].reshape(-1, 3).mean(axis=0)
    for place in (pillar, np.array([scene.relay_wall.center[0], 0.0, 1.0]), np.array([-50.0, 0.0, 1.0])):
        with pytest.raises(AssertionError):
            assert_nothing_intersects(moved(place))
    with pytest.raises(AssertionError):
        assert_hidden(moved(np.array([2.0, 0.0, 1.0])), rng)
    holed = {name: np.delete(getattr(scene, name), 3, axis=0) for name in ("triangles", "face_part")}
    with pytest.raises(AssertionError):
        assert_closed_surface(replace(scene, **holed))


def test_same_arguments_same_scene_and_order_does_not_matter() -> None:
    spec = config_from_mapping({}).scene
    ahead = [generate_scene(spec, 5, i) for i in (0, 1, 2)]
    back = [generate_scene(spec, 5, i) for i in (2, 1, 0)][::-1]
    for a, b in zip(ahead, back, strict=True):
        assert a.parameters == b.parameters
        np.testing.assert_array_equal(a.corners, b.corners)
    assert ahead[0].parameters != ahead[1].parameters
    assert generate_scene(spec, 6, 0).parameters != ahead[0].parameters


@pytest.mark.parametrize("kind", LAYOUTS)
def test_left_and_right_are_mirror_images(kind: str) -> None:
    left, right = (
        config_from_mapping({"scene": {"layout": {"kind": kind, "turn": turn}, "contents": []}}).scene
        for turn in ("left", "right")
    )
    flip = np.array([1.0, -1.0, 1.0])
    for index in range(3):
        a, b = generate_scene(left, 3, index), generate_scene(right, 3, index)
        mirrored, there = ((of.corners.reshape(-1, 3) * by) for of, by in ((a, flip), (b, 1)))
        assert {tuple(p) for p in mirrored} == {tuple(p) for p in there}
        np.testing.assert_allclose(a.relay_wall.center * flip, b.relay_wall.center)
        np.testing.assert_allclose(a.hidden_view.center * flip, b.hidden_view.center)


def test_walls_stand_square_unless_turned() -> None:
    """Angles between the walls' normals and the axes are exactly the angles drawn."""
    for kind in LAYOUTS:
        for angle in (0.0, 3.0) if kind in CLOSED else ():
            layout = {"kind": kind, "out_of_square_deg": {"choice": [angle, -angle]}}
            scene = generate_scene(config_from_mapping({"scene": {"layout": layout}}).scene, 1, 1)
            corners = scene.corners[scene.faces_of("walls")]
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            normal = np.abs(normal[np.abs(normal[:, 2]) < 1e-9])
            off = np.degrees(np.arctan2(normal[:, :2].min(axis=1), normal[:, :2].max(axis=1)))
            np.testing.assert_allclose(off, angle, atol=1e-6, err_msg=kind)


def test_objects_of_one_name_are_numbered() -> None:
    contents = [{"kind": "box", "count": 2, "width_m": 0.2, "depth_m": 0.2}, {"kind": "box", "width_m": 0.2}]
    spec = config_from_mapping({"scene": {"contents": contents}}).scene
    assert object_names(generate_scene(spec, 0, 0)) == ["box", "box_2", "box_3"]


def test_counts_are_even_over_their_range() -> None:
    contents = [{"kind": "box", "count": {"uniform": [0, 3]}, "width_m": 0.1, "depth_m": 0.1}]
    spec = config_from_mapping({"scene": {"contents": contents}}).scene
    counts = [generate_scene(spec, 1, i).parameters["objects"] for i in range(100)]
    assert stats.chisquare(np.bincount(counts, minlength=4)).pvalue > 1e-3


@pytest.mark.parametrize("turn", ["left", "right"])
def test_objects_stand_beside_the_screen_where_the_space_reaches_back(turn: str) -> None:
    """Behind the device, too, which sees none of them; without the key rooms are what they were."""
    layout = {"kind": "isolated_wall", "turn": turn, "relay_distance_m": 2.0, "screen_to_wall_m": 1.8}
    box = {"kind": "box", "width_m": 0.2, "depth_m": 0.2, "height_m": 0.4, "distance_m": {"uniform": [2.3, 2.7]}}
    spec = config_from_mapping({"scene": {"layout": layout | {"space_back_m": 1.0}, "contents": [box]}}).scene
    for index in range(4):
        scene = generate_scene(spec, 2, index)
        assert scene.parameters["box.x_m"] < 0 and scene.parameters["layout.space_back_m"] == 1.0
        rng = np.random.default_rng(index)
        assert_nothing_intersects(scene)
        assert_hidden(scene, rng)
        assert_seen_from_wall(scene, rng)
        assert scene.hidden_bounds is not None
        assert scene.hidden_bounds[0, 0] == pytest.approx(0.2 - 1.0)
    near = {"scene": {"layout": layout, "contents": [box | {"distance_m": 1.0}]}}
    assert "layout.space_back_m" not in generate_scene(config_from_mapping(near).scene, 2, 0).parameters


@pytest.mark.parametrize("scale", [0.1, 100.0])
@pytest.mark.parametrize("kind", LAYOUTS)
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
    drawn = generate_scene(config_from_mapping({"scene": scene}).scene, 0, 0)
    assert_nothing_intersects(drawn)
    assert_hidden(drawn, np.random.default_rng(0))
    assert_seen_from_wall(drawn, np.random.default_rng(0))
    if kind in CLOSED:
        assert_closed_surface(drawn)
