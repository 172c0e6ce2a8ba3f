"""Label images against scenes whose depth, normal, albedo and part are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from handmade_rooms import DISTANCE_M, HEIGHT_M, box_mesh, l_corridor, rectangle_mesh, wall_view

from datagen.config import LabelsConfig
from datagen.errors import InputError
from datagen.labels import ViewFrame, make_labels
from datagen.labels.frame import pixel_places
from datagen.records import Lambertian, Part, Rectangle, Scene, Sensor

CONFIG = LabelsConfig(rows=50, columns=60)
IMAGE_FIELDS = ("depth", "normal", "albedo", "part_id")
"""The images that need no lamp; `test_shading.py` tests the other one."""


def free_space(*objects: Part, view: Rectangle | None = None) -> Scene:
    """A relay wall that covers the view, so that a label which does not look through it sees nothing else."""
    wall = Rectangle.of((DISTANCE_M, 1.5, HEIGHT_M / 2), (0, -3, 0), (0, 0, HEIGHT_M / 2))
    parts = [Part("relay_wall", rectangle_mesh(wall), Lambertian(0.8), "relay_wall"), *objects]
    return Scene.from_parts(parts, hidden_view=wall_view() if view is None else view)


def pixel_centers(config: LabelsConfig = CONFIG, side: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """World y and z of the pixel centres of `wall_view`: column 0 at −right, which is the larger y."""
    y = side * 2.5 + 1.5 - 3.0 * (np.arange(config.columns) + 0.5) / config.columns
    z = HEIGHT_M - HEIGHT_M * (np.arange(config.rows) + 0.5) / config.rows
    return np.meshgrid(y, z)


def test_box_has_its_front_depth_where_it_stands_and_zero_elsewhere() -> None:
    scene = free_space(Part("box", box_mesh((0.6, 0.5, 0.8), (4.6, 3.2, 1.0)), Lambertian(0.4)))
    labels = make_labels(CONFIG, scene, IMAGE_FIELDS)
    y, z = pixel_centers()
    covered = (abs(y - 3.2) < 0.25) & (abs(z - 1.0) < 0.4)
    assert 0 < covered.sum() < covered.size
    np.testing.assert_allclose(labels["depth"], np.where(covered, DISTANCE_M - 4.9, 0), rtol=1e-6)
    np.testing.assert_array_equal(labels["part_id"], np.where(covered, 1, -1))
    np.testing.assert_allclose(labels["albedo"], np.where(covered, 0.4, 0), rtol=1e-6)
    np.testing.assert_allclose(labels["normal"], np.where(covered[..., None], [0, 0, -1.0], 0), atol=1e-7)
    assert [labels[f].dtype for f in IMAGE_FIELDS] == [np.float32, np.float32, np.float32, np.int16]


def test_tilted_plane_is_exact_at_every_pixel_centre() -> None:
    plane = Rectangle.of((4.0, 2.5, 1.25), (0.8, -3, 0), (0.5, 0.2 * 0.8 / 1.2, 2.0))
    plane = Rectangle.of(plane.center, plane.right, np.cross(plane.normal, plane.right))
    labels = make_labels(CONFIG, free_space(Part("plane", rectangle_mesh(plane), Lambertian(1.0))), IMAGE_FIELDS)
    y, z = pixel_centers()
    n = plane.normal
    x = plane.center[0] - (n[1] * (y - plane.center[1]) + n[2] * (z - plane.center[2])) / n[0]
    np.testing.assert_allclose(labels["depth"], DISTANCE_M - x, rtol=1e-6)
    towards_wall = n if n[0] > 0 else -n
    np.testing.assert_allclose(
        labels["normal"],
        np.broadcast_to([-towards_wall[1], towards_wall[2], -towards_wall[0]], (50, 60, 3)),
        atol=1e-6,
    )


def test_structure_that_begins_in_the_plane_of_the_wall_is_seen_as_an_object_there_is() -> None:
    """A ramp from the wall into the room, by its depth at every pixel centre; structure wholly in the wall's plane is
    the rest of the wall, which is left out."""
    corners = [(DISTANCE_M, 4.0, 0.5), (DISTANCE_M, 1.0, 0.5), (4.0, 1.0, 2.0), (4.0, 4.0, 2.0)]
    ramp = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)
    rest = rectangle_mesh(Rectangle.of((DISTANCE_M, 2.5, 1.0), (0, -1.5, 0), (0, 0, 1.0)))
    seen = {
        role: make_labels(CONFIG, free_space(Part("ramp", ramp, Lambertian(0.5), role)), IMAGE_FIELDS)
        for role in ("structure", "object")
    }
    z = pixel_centers()[1]
    covered = (z > 0.5) & (z < 2.0)
    due = np.where(covered, (DISTANCE_M - 4.0) * (z - 0.5) / 1.5, 0.0)
    for labels in seen.values():
        np.testing.assert_allclose(labels["depth"], due, rtol=1e-5, atol=1e-9)
        np.testing.assert_array_equal(labels["part_id"], np.where(covered, 1, -1))
    flush = make_labels(CONFIG, free_space(Part("rest", rest, Lambertian(0.5), "structure")), IMAGE_FIELDS)
    assert not flush["depth"].any() and (flush["part_id"] == -1).all()


@pytest.mark.parametrize("side", [1, -1])
def test_pixels_lie_over_those_of_a_sensor_grid(side: int) -> None:
    scene = l_corridor(side)
    view = scene.hidden_view
    assert view is not None
    sensor = Sensor.grid((0, 0, 1), view.center, view.right, view.up, rows=5, columns=7)
    frame = ViewFrame.of(scene)
    places = pixel_places(5, 7, frame.half_width_m, frame.half_height_m)
    np.testing.assert_allclose(frame.to_view(sensor.pixels.mean(axis=1))[:, :2], places, atol=1e-12)


def test_rooms_are_watertight_and_mirrored_ones_give_mirrored_images() -> None:
    left, right = (make_labels(CONFIG, l_corridor(side), IMAGE_FIELDS) for side in (1, -1))
    assert (left["part_id"] > 0).all(), "a ray slipped between triangles or saw the relay wall"
    assert left["depth"].max() == pytest.approx(3.0, rel=1e-6) and (left["depth"] > 0).all()
    np.testing.assert_allclose(left["depth"], right["depth"][:, ::-1], rtol=1e-6)
    np.testing.assert_array_equal(left["part_id"], right["part_id"][:, ::-1])
    flipped = right["normal"][:, ::-1] * np.array([-1, 1, 1], np.float32)
    np.testing.assert_allclose(left["normal"], flipped, atol=1e-6)


def test_moving_and_turning_everything_changes_nothing() -> None:
    turn = trimesh.transformations.rotation_matrix(0.7, (1, 2, 3))[:3, :3]
    away = np.array([8e3, -6e3, 10.0])
    scene = l_corridor()
    view = scene.hidden_view
    assert view is not None
    moved = replace(
        scene,
        vertices=scene.vertices @ turn.T + away,
        hidden_view=Rectangle(turn @ view.center + away, turn @ view.right, turn @ view.up),
        relay_wall=None, hidden_bounds=None, device_position=None,
    )  # fmt: skip
    here, there = (make_labels(CONFIG, s, IMAGE_FIELDS) for s in (scene, moved))
    np.testing.assert_array_equal(here["part_id"], there["part_id"])
    np.testing.assert_allclose(here["depth"], there["depth"], rtol=1e-6)
    np.testing.assert_allclose(here["normal"], there["normal"], atol=1e-6)


def test_an_object_that_touches_the_wall_is_seen_and_nothing_is_zero() -> None:
    box = Part("box", box_mesh((1.0, 0.5, 0.5), (DISTANCE_M - 0.5, 2.5, 1.25)), Lambertian(0.5))
    touching, empty = (make_labels(CONFIG, of, IMAGE_FIELDS) for of in (free_space(box), free_space()))
    hit = touching["part_id"] == 1
    assert hit.any() and ((touching["depth"] > 0) == hit).all()
    assert touching["depth"].max() < 1e-5
    assert all(not empty[f].any() for f in ("depth", "normal", "albedo"))
    assert (empty["part_id"] == -1).all()


def test_bad_requests_are_refused() -> None:
    with pytest.raises(InputError, match="'shade' is no label; known are depth"):
        make_labels(CONFIG, l_corridor(), ("shade",))
    wall = Part("wall", rectangle_mesh(wall_view()), Lambertian(0.5))
    with pytest.raises(InputError, match="hidden_view"):
        make_labels(CONFIG, Scene.from_parts([wall]), ("depth",))
    with pytest.raises(InputError, match="neither of them 0"):
        Rectangle.of((6, 0, 0), (0, 0, 0), (0, 0, 1))
    flat = Rectangle(np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 1.0]))
    with pytest.raises(InputError, match="positive and finite"):
        make_labels(CONFIG, Scene.from_parts([wall], hidden_view=flat), ("depth",))
