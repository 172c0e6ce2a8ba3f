"""Classes, poses and boxes of objects against objects whose pose is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from handmade_rooms import DISTANCE_M, HEIGHT_M, l_corridor

import datagen as dg
from datagen.config import LabelsConfig, config_from_mapping
from datagen.errors import InputError
from datagen.evidence.own import OBJECT_EVIDENCE
from datagen.labels import OBJECT_TABLES, ObjectBoxes, ViewFrame, make_labels
from datagen.labels.frame import image_points
from datagen.records import Lambertian, Part, Pose, Scene
from datagen.store import read_manifest, verify
from scene_library.objects.classes import GROUPS

pytestmark = pytest.mark.usefixtures("builds_here")

CONFIG = LabelsConfig(rows=40, columns=60)


def boxes_of(scene: Scene, classes: tuple[str, ...] | None = None, capacity: int | None = None) -> ObjectBoxes:
    return ObjectBoxes.from_tables(make_labels(CONFIG, scene, ("objects",), classes, capacity))


@pytest.mark.parametrize("turn_deg", [0.0, 30.0, 200.0])
@pytest.mark.parametrize("side", [1, -1])
def test_box_of_known_pose(turn_deg: float, side: int) -> None:
    """World (x, y, z) is depth (6 − x), right (2.5·side − y) and up (z − middle) of the label frame."""
    size, middle = (0.3, 0.8, 0.5), np.array([4.4, side * 2.9, 0.7])
    mesh = trimesh.creation.box(size)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.radians(turn_deg), (0, 0, 1)))
    mesh.apply_translation(middle)
    part = Part("crate", mesh, Lambertian(0.5), pose=Pose.upright("box", turn_deg))
    scene = l_corridor(side, objects=[part])
    boxes = boxes_of(scene)
    assert (boxes.count, scene.part_names[boxes.part[0]]) == (1, "crate")
    np.testing.assert_allclose(boxes.size[0], size, atol=1e-6)
    in_view = [side * 2.5 - middle[1], middle[2] - HEIGHT_M / 2, DISTANCE_M - middle[0]]
    np.testing.assert_allclose(boxes.center[0], in_view, atol=1e-6)
    c, s = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    # Own width (c, s, 0), depth (−s, c, 0), height (0, 0, 1) as (right, up, depth) = (−y, z, −x).
    np.testing.assert_allclose(boxes.rotation[0], [[-s, -c, 0], [0, 0, 1], [-c, s, 0]], atol=1e-6)
    assert np.linalg.det(boxes.rotation[0]) == pytest.approx(1, abs=1e-6)
    corners = ViewFrame.of(scene).to_world(boxes.corners()[0])
    for corner in mesh.vertices:
        assert np.linalg.norm(corners - corner, axis=1).min() < 1e-6


def test_boxes_lie_over_the_images() -> None:
    """An object's pixels lie within the outline of its box, and its nearest depth is the box's for a cuboid."""
    scene = l_corridor()
    labels = make_labels(CONFIG, scene, ("depth", "part_id", "objects"))
    boxes = ObjectBoxes.from_tables(labels)
    assert boxes.count == 2
    frame = ViewFrame.of(scene)
    for corners, part in zip(boxes.corners(), boxes.part, strict=True):
        shown = labels["part_id"] == part
        points = image_points(labels["depth"], shown, frame.half_width_m, frame.half_height_m)
        assert (points >= corners.min(axis=0) - 1e-5).all() and (points <= corners.max(axis=0) + 1e-5).all()


def spec(**more: Any) -> dict[str, Any]:
    return {
        "seed": 3, "scenes": 6,
        "scene": {
            "contents": [
                {"kind": "library", "classes": ["letters", "chair"], "count": {"uniform": [0, 2]}},
                {"kind": "box", "name": "crate", "count": {"choice": [0, 1]}},
            ],
        },
        "capture": {"scan": {"rows": 1, "columns": 1}, "time": {"bins": 32}},
        "transport": {"samples": 16},
        "store": {"fields": ["objects"]}, **more,
    }  # fmt: skip


def test_generated_objects_have_their_class_and_pose() -> None:
    config = config_from_mapping(spec())
    classes = config.scene.object_classes()
    assert classes == tuple(sorted([*GROUPS["letters"], "chair", "crate"]))
    assert config.scene.most_objects() == 3
    seen = set()
    for index in range(12):
        scene = dg.generate_scene(config.scene, 3, index)
        boxes = boxes_of(scene, classes, 3)
        names = [name for name, role in zip(scene.part_names, scene.roles, strict=True) if role == "object"]
        seen.add(boxes.count)
        assert [scene.part_names[k] for k in boxes.part[: boxes.count]] == names
        to_world = ViewFrame.of(scene).to_world
        for row, name in enumerate(names):
            p = scene.parameters
            assert classes[boxes.label[row]] == p[f"{name}.class"]
            np.testing.assert_allclose(boxes.size[row, 2], p[f"{name}.height_m"], rtol=1e-5)
            # Library objects and boxes are placed by the middle of their plan.
            np.testing.assert_allclose(
                to_world(boxes.center[row])[:2], [p[f"{name}.x_m"], p[f"{name}.y_m"]], atol=1e-5
            )
            turned = np.degrees(np.arctan2(-boxes.rotation[row, 0, 0], -boxes.rotation[row, 2, 0]))
            assert abs((turned - p[f"{name}.rotation_deg"] + 180) % 360 - 180) < 1e-3
        assert (boxes.label[boxes.count :] == -1).all() and (boxes.part[boxes.count :] == -1).all()
        assert not boxes.size[boxes.count :].any() and not boxes.rotation[boxes.count :].any()
    assert len(seen) > 1


def test_stored_verified_loaded(tmp_path: Path) -> None:
    config = config_from_mapping(spec())
    dg.build(config, tmp_path / "set", progress=False)
    assert verify(tmp_path / "set").problems == ()
    data = dg.TransientDataset(tmp_path / "set", fields=("objects",))
    assert data.selected == (*OBJECT_TABLES, *OBJECT_EVIDENCE)
    assert data.classes == config.scene.object_classes()
    assert "chair" in (tmp_path / "set" / "README.md").read_text()
    for item in range(len(data)):
        scene = dg.generate_scene(config.scene, 3, item)
        made = make_labels(config.labels, scene, ("objects",), data.classes, 3)
        for name, values in made.items():
            assert torch.equal(data[item][name], torch.from_numpy(np.asarray(values)))
    batch = torch.utils.data.default_collate([data[i] for i in range(3)])
    assert batch["object_box_rotation"].shape == (3, 3, 3, 3)
    assert read_manifest(tmp_path / "set").schema.by_name["object_class"].classes == data.classes


def test_rows_for_a_configuration_without_objects() -> None:
    scene = dg.generate_scene(config_from_mapping({"scene": {"contents": []}}).scene, 0, 0)
    boxes = boxes_of(scene, (), 1)
    assert boxes.count == 0 and boxes.label.tolist() == [-1]
    assert boxes.corners().shape == (0, 8, 3)


def test_objects_that_do_not_fit_are_refused() -> None:
    scene = l_corridor()
    with pytest.raises(InputError, match="2 objects in a scene, the table has room for 1"):
        boxes_of(scene, ("pillar", "box"), 1)
    with pytest.raises(InputError, match="class 'box' is none of pillar"):
        boxes_of(scene, ("pillar",), 2)
    with pytest.raises(InputError, match="orthogonal unit vectors"):
        Pose("box", np.array([[1.0, 0, 0], [1, 1, 0], [0, 0, 1]]))
