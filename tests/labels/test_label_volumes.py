"""Occupancy and signed distance against shapes whose volume and distance are known."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from handmade_rooms import box_mesh, l_corridor, rectangle_mesh

from datagen.config import LabelsConfig, config_from_mapping
from datagen.errors import InputError
from datagen.labels import make_labels
from datagen.labels.solids import connected_surfaces
from datagen.labels.volumes import VoxelGrid
from datagen.records import Lambertian, Part, Rectangle, Scene

BOUNDS = np.array([[3, 1, 0], [6, 4, 2.4]])
CONFIG = LabelsConfig(voxels=(40, 36, 44))


def scene_of(*meshes: trimesh.Trimesh) -> Scene:
    wall = Rectangle.of((6, 2.5, 1.2), (0, -1.5, 0), (0, 0, 1.2))
    parts = [Part("relay_wall", rectangle_mesh(wall), Lambertian(0.8), "relay_wall")]
    parts += [Part(f"object_{k}", mesh, Lambertian(0.5)) for k, mesh in enumerate(meshes)]
    return Scene.from_parts(parts, hidden_view=wall, hidden_bounds=BOUNDS)


def ball(
    radius: float = 0.8, center: tuple[float, float, float] = (4.5, 2.4, 1.2), subdivisions: int = 4
) -> trimesh.Trimesh:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    mesh.apply_translation(center)
    return mesh


def centers(scene: Scene) -> np.ndarray:
    grid = VoxelGrid.of(scene, CONFIG.voxels)
    return grid.frame.to_world(grid.centers)


def box_distance(points: np.ndarray, size: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Exact signed distance to an axis-aligned box."""
    beyond = abs(points - center) - size / 2
    return np.linalg.norm(np.maximum(beyond, 0), axis=-1) + np.minimum(beyond.max(axis=-1), 0)


def test_a_flat_quad_occupies_the_voxels_it_touches_and_has_no_inside() -> None:
    quad = trimesh.Trimesh(
        [[4.0, 2.0, 0.5], [5.0, 2.6, 0.5], [5.0, 2.6, 1.5], [4.0, 2.0, 1.5]], [[0, 1, 2], [0, 2, 3]], process=False
    )
    scene = scene_of(quad)
    labels = make_labels(CONFIG, scene, ("occupancy", "sdf"))
    points = centers(scene) - [4.5, 2.3, 1.0]
    along = np.array([1.0, 0.6, 0.0]) / np.hypot(1, 0.6)
    beyond = np.maximum(
        np.abs([points @ along, points[..., 2]]) - np.reshape([np.hypot(1, 0.6) / 2, 0.5], (2, 1, 1, 1)), 0
    )
    distance = np.sqrt(beyond[0] ** 2 + beyond[1] ** 2 + (points @ [-along[1], along[0], 0]) ** 2)
    np.testing.assert_allclose(labels["sdf"], distance, atol=1e-5)
    voxel = VoxelGrid.of(scene, CONFIG.voxels).voxel_m
    taken = labels["occupancy"] == 1
    assert distance[taken].max() <= np.linalg.norm(voxel) / 2
    assert taken[distance < voxel.min() / 2].all()


def test_box_is_exact() -> None:
    size, center = np.array([0.9, 0.7, 1.1]), np.array([4.4, 2.6, 0.8])
    scene = scene_of(box_mesh(tuple(size), tuple(center)))
    labels = make_labels(CONFIG, scene, ("occupancy", "sdf"))
    expected = box_distance(centers(scene), size, center)
    np.testing.assert_allclose(labels["sdf"], expected, atol=1e-5)
    np.testing.assert_array_equal(labels["occupancy"], expected < 0)
    assert labels["occupancy"].dtype == np.uint8 and labels["sdf"].dtype == np.float32


def test_turned_box_with_edges_and_corners_on_planes_of_the_grid() -> None:
    mesh = trimesh.creation.box((1.2, 1.2, 1.2))
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 4, (0, 0, 1)))
    mesh.apply_translation((4.5, 2.5, 1.2))
    scene = scene_of(mesh)
    turned = centers(scene) - [4.5, 2.5, 1.2]
    diamond = abs(turned[..., 0]) + abs(turned[..., 1]) - 0.6 * np.sqrt(2)
    certain = (abs(diamond) > 1e-9) & (abs(abs(turned[..., 2]) - 0.6) > 1e-9)
    expected = (diamond < 0) & (abs(turned[..., 2]) < 0.6)
    np.testing.assert_array_equal(make_labels(CONFIG, scene, ("occupancy",))["occupancy"][certain], expected[certain])


def test_ball_has_its_distance_and_its_volume_and_nothing_is_far_from_everything() -> None:
    scene = scene_of(ball())
    labels, nothing = (make_labels(CONFIG, of, ("occupancy", "sdf")) for of in (scene, scene_of()))
    expected = np.linalg.norm(centers(scene) - [4.5, 2.4, 1.2], axis=-1) - 0.8
    assert abs(labels["sdf"] - expected).max() < 5e-3
    volume = labels["occupancy"].sum() * float(np.prod(VoxelGrid.of(scene, CONFIG.voxels).voxel_m))
    assert volume == pytest.approx(4 / 3 * np.pi * 0.8**3, rel=0.02)
    assert not nothing["occupancy"].any()
    np.testing.assert_allclose(nothing["sdf"], np.linalg.norm([3, 3, 2.4]), rtol=1e-6)


@pytest.mark.parametrize("side", [1, -1])
def test_volume_and_image_agree_about_what_is_in_front(side: int) -> None:
    """The first occupied layer of a column stands at the depth that the image shows there."""
    scene = l_corridor(side)
    config = LabelsConfig(rows=32, columns=32, voxels=(96, 32, 32))
    labels = make_labels(config, scene, ("depth", "part_id", "occupancy"))
    names = np.array([*scene.part_names, "none"])[labels["part_id"]]
    objects = (names == "pillar") | (names == "box")
    np.testing.assert_array_equal(labels["occupancy"].any(axis=0), objects)
    first = labels["occupancy"].argmax(axis=0) * 3.0 / 96
    assert abs(first - labels["depth"])[objects].max() < 2 * 3.0 / 96


def test_winding_does_not_matter() -> None:
    mesh = ball(subdivisions=2)
    flipped = trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)
    every_other = np.where(np.arange(len(mesh.faces))[:, None] % 2, mesh.faces[:, ::-1], mesh.faces)
    mixed = trimesh.Trimesh(mesh.vertices, every_other, process=False)
    soup = trimesh.Trimesh(
        mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3), process=False
    )
    reference = make_labels(CONFIG, scene_of(mesh), ("sdf",))["sdf"]
    assert (reference < 0).any()
    for other in (flipped, mixed, soup):
        np.testing.assert_allclose(make_labels(CONFIG, scene_of(other), ("sdf",))["sdf"], reference, atol=1e-6)


def test_overlapping_solids_are_united() -> None:
    one, two = ball(), ball(center=(4.0, 2.4, 1.2))
    inner = ball(radius=0.3)
    together = scene_of(trimesh.util.concatenate([one, two, inner]))
    labels = make_labels(CONFIG, together, ("occupancy", "sdf"))
    points = centers(together)
    either = np.minimum(*(np.linalg.norm(points - c, axis=-1) - 0.8 for c in ((4.5, 2.4, 1.2), (4.0, 2.4, 1.2))))
    certain = abs(either) > 5e-3
    np.testing.assert_array_equal((labels["sdf"] < 0)[certain], (either < 0)[certain])
    assert abs(labels["sdf"] - either)[either > 0].max() < 5e-3
    assert (labels["sdf"] >= either - 5e-3).all(), "deeper inside than the union can be"
    np.testing.assert_array_equal(labels["occupancy"], labels["sdf"] < 0)


@pytest.mark.parametrize(
    "other",
    [box_mesh((0.8, 0.8, 0.5), (4.4, 2.4, 1.25)), box_mesh((0.4, 0.6, 0.5), (4.2, 2.3, 1.25))],
    ids=["the same face", "part of a face"],
)
def test_boxes_that_touch_are_united(other: trimesh.Trimesh) -> None:
    """One object of two boxes with vertices and faces in common: rays cross both faces in one place."""
    one = box_mesh((0.8, 0.8, 0.5), (4.4, 2.4, 0.75))
    assert len(connected_surfaces(np.concatenate([one.triangles, other.triangles]))) == 1
    scene = scene_of(trimesh.util.concatenate([one, other]))
    labels = make_labels(CONFIG, scene, ("occupancy", "sdf"))
    points = centers(scene)
    either = np.minimum(*(box_distance(points, mesh.extents, mesh.bounds.mean(axis=0)) for mesh in (one, other)))
    certain = abs(either) > 1e-6
    np.testing.assert_array_equal(labels["occupancy"][certain], (either < 0)[certain])
    np.testing.assert_allclose(labels["sdf"][either > 0], either[either > 0], atol=1e-5)


def test_small_holes_are_bridged_and_large_ones_are_not() -> None:
    whole = ball()
    order = np.argsort(whole.triangles_center[:, 2])
    chipped = trimesh.Trimesh(whole.vertices, whole.faces[order[12:]], process=False)
    bowl = trimesh.Trimesh(whole.vertices, whole.faces[order[: len(order) // 2]], process=False)
    assert [s.closed for s in connected_surfaces(chipped.triangles)] == [True]
    assert [s.closed for s in connected_surfaces(bowl.triangles)] == [False]
    reference = make_labels(CONFIG, scene_of(whole), ("occupancy",))["occupancy"]
    mended = make_labels(CONFIG, scene_of(chipped), ("occupancy",))["occupancy"]
    assert (reference != mended).sum() < 0.01 * reference.sum()
    assert (make_labels(CONFIG, scene_of(bowl), ("sdf",))["sdf"] >= 0).all()


@pytest.mark.parametrize(("share", "closed"), [(0.03, True), (0.07, False), (0.1, False), (0.14, False)])
def test_a_ball_whose_hole_is_more_than_a_twentieth_is_open(share: float, closed: bool) -> None:
    """A cap that is cut off a ball leaves a hole of (1 − cos θ)/2 of what remains."""
    whole = ball(subdivisions=5)
    heights = (whole.triangles_center[:, 2] - 1.2) / 0.8
    open_ball = whole.triangles[heights < 1 - 2 * share]
    (found,) = connected_surfaces(open_ball)
    assert found.closed is closed
    lid = trimesh.triangles.area(found.lid).sum() if closed else share * trimesh.triangles.area(open_ball).sum()
    assert lid == pytest.approx(share * trimesh.triangles.area(open_ball).sum(), rel=0.1)


@pytest.mark.parametrize("axis", range(3))
def test_a_plate_thicker_than_the_thinnest_side_of_a_voxel_is_exact(axis: int) -> None:
    """Voxels of unequal sides: a plate that no side of a voxel spans is a solid like any other, and one that even the
    thinnest may pass is where it touches."""
    voxels = [8, 8, 8]
    # Voxels count along (depth, row, column), which here are the axes x, z, y.
    along = (0, 2, 1)[axis]
    voxels[axis] = 60
    config, side = LabelsConfig(voxels=tuple(voxels)), (BOUNDS[1] - BOUNDS[0])[along] / 60
    size, center = np.array([1.7, 1.7, 1.7]), np.array([4.37, 2.41, 1.13])
    for thickness, exact in ((1.6 * side, True), (0.6 * side, False)):
        size[along] = thickness
        scene = scene_of(box_mesh(tuple(size), tuple(center)))
        grid = VoxelGrid.of(scene, config.voxels)
        inside = box_distance(grid.frame.to_world(grid.centers), size, center) < 0
        occupied = make_labels(config, scene, ("occupancy",))["occupancy"]
        assert np.array_equal(occupied, inside) is exact
        assert (occupied >= inside).all() and occupied.any()


def test_labels_are_the_same_for_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of surfaces in one place, too: a second floor lies on the floor."""
    floor = Rectangle.of((4.5, 2.5, 0.0), (1.5, 0, 0), (0, 1.5, 0))
    objects = [Part(f"object_{k}", mesh, Lambertian(0.5)) for k, mesh in enumerate((ball(), rectangle_mesh(floor)))]
    made = []
    config = LabelsConfig(rows=16, columns=16, voxels=(20, 18, 22))
    for threads in (1, 3):
        monkeypatch.setattr("datagen.labels.triangles._THREADS", threads)
        made.append(
            make_labels(config, l_corridor(objects=objects), ("depth", "part_id", "shaded", "occupancy", "sdf"))
        )
    for field, values in made[1].items():
        np.testing.assert_array_equal(values, made[0][field], err_msg=field)


def test_missing_open3d_names_the_system_packages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(InputError, match=r"^labels: images and volumes need Open3D.*docker/system-packages\.txt"):
        make_labels(CONFIG, scene_of(ball()), ("sdf",))


def test_volumes_that_cannot_be_are_refused() -> None:
    with pytest.raises(InputError, match="at most 67108864"):
        config_from_mapping({"labels": {"voxels": [1024, 1024, 1024]}})
    bare = scene_of(ball())
    for bounds, message in ((None, "no hidden_bounds"), ([[3, 1, 0], [3, 4, 2]], "span a volume")):
        scene = replace(bare, hidden_bounds=None if bounds is None else np.array(bounds, float))
        with pytest.raises(InputError, match=message):
            make_labels(CONFIG, scene, ("occupancy",))
