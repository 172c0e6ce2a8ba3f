"""Objects in front of the relay wall: before the scan as a whole, hidden from the device, labels over the scan."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from datagen.capture import capture_for
from datagen.config import DatasetConfig, config_from_mapping, load_config
from datagen.errors import InputError
from datagen.labels.frame import ViewFrame, pixel_places, scan_place
from datagen.records import Rectangle, Scene
from datagen.scene import generate_scene
from datagen.transport.laser_points import LaserPoints
from datagen.transport.rays import Raycaster
from scene_library.sightlines import first_faces


def bench(contents: list[dict[str, Any]], **layout: Any) -> DatasetConfig:
    return config_from_mapping(
        {
            "scene": {"layout": {"kind": "isolated_wall", "place": "in_front", **layout}, "contents": contents},
            "capture": {"scan": {"rows": 6, "columns": 6}, "time": {"bins": 64, "bin_width_ps": 300}},
        }
    )


def objects_of(scene: Scene) -> dict[str, np.ndarray[Any, Any]]:
    """Name → the object's vertices."""
    wanted = {name: scene.part_names.index(name) for name in scene.objects}
    return {name: scene.corners[scene.face_part == part].reshape(-1, 3) for name, part in wanted.items()}


def check_before_the_wall(config: DatasetConfig, scene: Scene, index: int) -> None:
    assert scene.relay_wall is not None and scene.hidden_view is not None
    capture = capture_for(config, scene, config.seed, index)
    points = LaserPoints.of(Raycaster(scene), scene, capture.laser)
    # Every laser ray meets the wall first, on its front.
    assert (points.part == scene.part_names.index("relay_wall")).all()
    assert np.allclose(points.position, capture.laser.targets, atol=1e-5)
    frame = ViewFrame.of(scene)
    for name, vertices in objects_of(scene).items():
        right, up, depth = frame.to_view(vertices).T
        assert np.abs(right).max() < frame.half_width_m and np.abs(up).max() < frame.half_height_m + 1e-9
        assert depth.min() > 0.02
        # The device sees none of it: the screen is in between.
        face = first_faces(scene.corners, capture.laser.position, vertices[::7])
        seen = scene.face_part[face[face >= 0]] == scene.part_names.index(name)
        assert len(face) and not seen.any()
    found = scan_place(scene.hidden_view, points.position)
    assert found is not None and np.abs(found).max() < 1e-6


def test_ready_configuration_has_its_objects_inside_the_scan() -> None:
    """And its scan points are the middles of the label pixels."""
    config = load_config("configs/open_space_meshes.yaml")
    for index in range(4):
        scene = generate_scene(config.scene, config.seed, index)
        check_before_the_wall(config, scene, index)
        frame = ViewFrame.of(scene)
        targets = frame.to_view(capture_for(config, scene, config.seed, index).laser.targets)[:, :2]
        for vertices in objects_of(scene).values():
            across = frame.to_view(vertices)[:, :2]
            assert (across.min(axis=0) > targets.min(axis=0)).all()
            assert (across.max(axis=0) < targets.max(axis=0)).all()
        middles = pixel_places(config.labels.rows, config.labels.columns, frame.half_width_m, frame.half_height_m)
        assert np.allclose(targets, middles, atol=1e-9)


@pytest.mark.parametrize("turn", ["left", "right"])
def test_any_contents_stand_before_the_wall(turn: str) -> None:
    items = [{"kind": "pillar", "width_m": 0.2}, {"kind": "box", "height_m": 0.4, "count": 2}, {"kind": "library"}]
    config = bench(items, turn=turn)
    for index in range(3):
        check_before_the_wall(config, generate_scene(config.scene, 5, index), index)


@pytest.mark.parametrize("turn", ["left", "right"])
@pytest.mark.parametrize("layout", ["isolated_wall", "l_corridor"])
def test_distances_and_offsets_are_those_asked_for(layout: str, turn: str) -> None:
    """Metres from the relay wall, and to the right of the middle of what the device sees of it."""
    front = layout == "isolated_wall"
    item = {"kind": "box", "width_m": 0.2, "depth_m": 0.2, "height_m": 0.3, "distance_m": {"uniform": [0.7, 1.3]}}
    item |= {"offset_m": {"uniform": [-0.5, 0.5]}} if front else {}
    walls = {"kind": layout, "turn": turn} | ({"place": "in_front"} if front else {})
    config = config_from_mapping({"scene": {"layout": walls, "contents": [item]}})
    found = []
    for index in range(10):
        scene = generate_scene(config.scene, 3, index)
        wall = scene.relay_wall
        assert wall is not None
        frame = ViewFrame.about(Rectangle(wall.center, wall.right, wall.up))
        vertices = objects_of(scene)["box"]
        right, _, depth = frame.to_view((vertices.min(axis=0) + vertices.max(axis=0)) / 2)
        found.append((right, depth))
        x, y = scene.parameters["box.x_m"], scene.parameters["box.y_m"]
        assert frame.to_view(np.array([x, y, 0.0]))[[0, 2]] == pytest.approx([right, depth], abs=1e-9)
        # Its place as shares of the hidden part stands beside it as ever.
        assert 0 <= float(scene.parameters["box.along"]) <= 1
    offsets, depths = np.array(found).T
    assert (depths >= 0.7).all() and (depths <= 1.3).all() and np.ptp(depths) > 0.3
    assert not front or (np.abs(offsets).max() <= 0.5 and offsets.min() < -0.2 and offsets.max() > 0.2)


@pytest.mark.parametrize("place", ["beside", "in_front"])
def test_a_stored_configuration_of_either_place_is_read_again(place: str) -> None:
    """It has every key, those of the other place with their default values, too."""
    item = {"kind": "box", "distance_m": 1.5}
    config = config_from_mapping({"scene": {"layout": {"kind": "isolated_wall", "place": place}, "contents": [item]}})
    stored = config.model_dump(mode="json")
    assert {"beside_m", "screen_offset_m"} <= set(stored["scene"]["layout"])
    again = config_from_mapping(stored)
    assert again == config and again.fingerprint() == config.fingerprint()


@pytest.mark.parametrize(
    ("layout", "item", "says"),
    [
        ({"screen_offset_m": 0.2}, {}, "screen_offset_m with place = 'in_front': has no meaning there"),
        ({"place": "beside", "beside_m": 1.0}, {}, "beside_m with place = 'beside'"),
        ({"place": "behind"}, {}, "scene.layout.place = 'behind': input should be 'beside' or 'in_front'"),
        ({}, {"distance_m": 1.0, "along": 0.3}, "along and distance_m are both given"),
        ({}, {"offset_m": 1.0, "across": 0.3}, "across and offset_m are both given"),
        ({}, {"distance_m": 0.0}, "contents[0].distance_m: 0 given; must be > 0"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(layout: dict[str, Any], item: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError) as caught:
        bench([{"kind": "box", **item}], **layout)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
