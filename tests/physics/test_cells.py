"""The primary by quadrature over surface elements: closed forms, numerical integrals, and laws that hold without
noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from benchmarks.other_renderers import grid_points, point_capture
from benchmarks.peer_cases import path_axis
from benchmarks.problems import DEVICE, WALL, furnished_room
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle

from datagen import Accuracy, Capture, Lambertian, Part, Scene, simulate
from datagen.errors import InputWarning
from datagen.records import Transient

FINE = Accuracy(target=0.01, part_target=0.01)


def cells(scene: Scene, capture: Capture, accuracy: Accuracy = FINE, seed: int = 0) -> Transient:
    found = simulate(scene, capture, accuracy, seed)
    assert found.samplers["primary"] == "quadrature"
    return found


def everything(found: Transient) -> float:
    return float(found.total.sum() + found.overflow.sum())


def wall_and_box(box: trimesh.Trimesh, *more: Part) -> Scene:
    wall = rectangle((0, 0, 0), (0, 1, 0), (0, 0, 1))
    parts = Part("wall", wall, Lambertian(0.8), "relay_wall"), Part("box", box, Lambertian(0.6))
    return Scene.from_parts([*parts, *more])


def crate() -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[(0.95, -0.25, -0.25), (1.45, 0.25, 0.25)])


def headless(box: trimesh.Trimesh) -> trimesh.Trimesh:
    """The box without its face towards the wall."""
    return trimesh.Trimesh(box.vertices, box.faces[box.triangles_center[:, 0] > 0.96], process=False)


def looking_at(y: float, half_side_m: float = 0.05) -> Capture:
    time = bins_of_path(200, 0.02, 0.0)
    return one_point_capture((0, -0.3, 0.1), (0, y, 0.03), half_side_m, time, (0.4, 0.1, 0.9))


@pytest.mark.filterwarnings("ignore:.*lie in one place")
def test_a_poster_takes_the_light_of_what_it_hangs_on() -> None:
    """A black poster, exactly in the plane of the box that it hangs on, acts as a hole in half of the box's face."""
    poster = Part("poster", rectangle((0.95, 0, -0.125), (0, 0.25, 0), (0, 0, 0.125)), Lambertian(0.0))
    rest = Part("rest", rectangle((0.95, 0, 0.125), (0, 0.25, 0), (0, 0, 0.125)), Lambertian(0.6))
    bare, covered = wall_and_box(crate()), wall_and_box(crate(), poster)
    hole = wall_and_box(headless(crate()), poster, rest)
    whole, seen, expected = (everything(cells(scene, looking_at(0.2))) for scene in (bare, covered, hole))
    assert seen == pytest.approx(expected, abs=0.01 * whole)
    assert 0.1 * whole < seen < 0.8 * whole


def test_arrival_times_of_a_large_pixel_are_spread() -> None:
    """A pixel of 40 cm, in bins of 2 cm, has the mean histogram of the 24 × 24 small pixels that it consists of."""
    half, n = 0.2, 24
    corners = looking_at(0.0, half).sensor.pixels[0]
    y, z = (np.linspace(corners[:, k].min(), corners[:, k].max(), n + 1) for k in (1, 2))
    small = np.array([[[0, a, c], [0, b, c], [0, b, d], [0, a, d]] for a, b in pairwise(y) for c, d in pairwise(z)])
    large, eye = cells(wall_and_box(crate()), looking_at(0.0, half), Accuracy(target=0.005)), looking_at(0.0)
    parts = cells(
        wall_and_box(crate()), replace(eye, sensor=replace(eye.sensor, pixels=small)), Accuracy(target=0.01)
    )
    summed = parts.total.sum(axis=1)
    assert np.linalg.norm(large.total[:, 0] - summed) < 0.01 * np.linalg.norm(summed)


def empty_room() -> Scene:
    """Five sides of an empty room of 4 × 3 × 2.5 m about its relay wall."""
    room = furnished_box(0.5)
    kept = [k for k, name in enumerate(room.part_names) if name not in ("box", "pillar")]
    return Scene.from_parts(
        Part(room.part_names[k], mesh_of(room, k), room.materials[k], room.roles[k]) for k in kept
    )


def mesh_of(scene: Scene, part: int) -> trimesh.Trimesh:
    return trimesh.Trimesh(scene.vertices, scene.triangles[scene.face_part == part], process=False)


def rebuilt(scene: Scene, change: Callable[[trimesh.Trimesh], trimesh.Trimesh]) -> Scene:
    parts = zip(scene.part_names, scene.materials, scene.roles, strict=True)
    return Scene.from_parts(
        Part(name, change(mesh_of(scene, k)), material, role) for k, (name, material, role) in enumerate(parts)
    )


def off_by(found: Transient, truth: Transient) -> float:
    return float(np.linalg.norm(found.total - truth.total) / np.linalg.norm(truth.total))


def cells_of(found: Transient) -> float:
    return found.rays["primary"]


def test_the_error_falls_with_the_square_of_the_cells_size() -> None:
    """In a room without occluders the error is inversely proportional to the number of elements, down to 10⁻⁴."""
    room, capture = empty_room(), one_point_capture(half_side_m=1e-4, time=bins_of_path(120, 0.1, 0.0))
    truth = cells(room, capture, Accuracy(target=1e-4))
    runs = [cells(room, capture, Accuracy(target=target)) for target in (0.1, 0.03, 0.01, 3e-3, 1e-3)]
    errors, counts = np.array([off_by(run, truth) for run in runs]), np.array([cells_of(run) for run in runs])
    slope = np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert slope < -0.9, (errors, counts)
    assert errors[-1] < 1.2e-3
    assert truth.met_target and cells_of(truth) < 1e6


def test_light_is_linear_in_the_albedo() -> None:
    """Halving all albedos leaves exactly an eighth of the light; halving one object's leaves half of that object's
    light, within the error asked."""
    room, capture = furnished_box(0.8), one_point_capture()
    whole = cells(room, capture)
    dim = cells(replace(room, materials=tuple(Lambertian(0.4) for _ in room.materials)), capture)
    np.testing.assert_array_equal(dim.total * 8, whole.total)
    grey = tuple(
        Lambertian(0.4) if name == "box" else m for name, m in zip(room.part_names, room.materials, strict=True)
    )
    box = cells(replace(room, materials=grey), capture).parts["box"]
    assert np.linalg.norm(2 * box - whole.parts["box"]) < 0.015 * np.linalg.norm(whole.parts["box"])
    assert not simulate(furnished_box(0.0), capture, FINE).total.any()
    assert everything(cells(furnished_box(1.0), capture)) == pytest.approx(everything(whole) / 0.8**3, rel=1e-3)


def test_finer_triangles_and_another_order_are_the_same_surface() -> None:
    room, capture = furnished_box(), one_point_capture(half_side_m=0.02)
    plain = cells(room, capture)
    finer = cells(rebuilt(room, lambda mesh: mesh.subdivide().subdivide()), capture)
    rng = np.random.default_rng(1)

    def mixed(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
        faces = np.array([np.roll(face, rng.integers(3)) for face in rng.permutation(mesh.faces)])
        return trimesh.Trimesh(mesh.vertices, faces, process=False)

    for other in (finer, cells(rebuilt(room, mixed), capture)):
        assert off_by(other, plain) < 0.015
        for name in ("box", "pillar"):
            apart = np.linalg.norm(other.parts[name] - plain.parts[name])
            assert apart < 0.02 * np.linalg.norm(plain.parts[name]), name
    back = Scene.from_parts(
        Part(room.part_names[k], mesh_of(room, k), room.materials[k], room.roles[k])
        for k in reversed(range(len(room.part_names)))
    )
    again = cells(back, capture)
    np.testing.assert_allclose(again.total, plain.total, rtol=1e-9, atol=1e-12 * plain.total.max())


@pytest.mark.parametrize("gap", [pytest.param(5e-4, marks=pytest.mark.nightly), 1e-6])
def test_a_laser_point_in_a_corner_needs_no_more_than_ten_times_the_cells(gap: float) -> None:
    asked = Accuracy(target=0.02)
    in_a_corner = (0, -1.5 + gap, gap)
    found = cells(furnished_box(), one_point_capture(in_a_corner, half_side_m=0.02), asked)
    plain = cells(furnished_box(), one_point_capture(half_side_m=0.02), asked)
    beside = cells(furnished_box(), one_point_capture((0, -1.5 + 2 * gap, 2 * gap), half_side_m=0.02), asked)
    assert found.met_target
    assert cells_of(found) < 10 * cells_of(plain)
    assert everything(found) == pytest.approx(everything(beside), rel=0.05)


@pytest.mark.parametrize(("attenuation_per_m", "bounces"), [(50.0, 3), (2.0, 4)])
def test_fog_needs_no_more_cells_than_clear_air(attenuation_per_m: float, bounces: int) -> None:
    """Elements are cut for the light that arrives through the fog. When they were cut for that in clear air, an
    attenuation of 2 m⁻¹ took 10 times as many as needed, and 50 m⁻¹ never ended."""
    points = grid_points(WALL, 3, 3)
    capture = point_capture(WALL, points, DEVICE, points, path_axis(256, 0.06, 0.0), confocal=True)
    clear = furnished_room()
    fog = replace(clear, attenuation_per_m=attenuation_per_m)
    accuracy = Accuracy(target=0.05, max_bounces=bounces)
    found, true = cells(fog, capture, accuracy), simulate(fog, capture, replace(accuracy, target=0.01), 7)
    assert np.linalg.norm(found.total - true.total) <= 0.05 * np.linalg.norm(true.total)
    assert found.rays["primary"] < 1.5 * cells(clear, capture, accuracy).rays["primary"]


def test_light_outside_the_window_is_not_cut_for_what_little_is_inside() -> None:
    """The window is one faint bin. In such a window with 10⁻¹⁰ of the light, which a fuzzer found, refinement never
    ended."""
    room, accuracy = furnished_box(), Accuracy(target=0.05)
    plain = cells(room, one_point_capture(half_side_m=0.02, time=bins_of_path(1500, 0.01, 0.0)), accuracy)
    light = plain.total[0, 0]
    faint = int(np.argmin(np.where(light > 1e-4 * light.sum(), light, np.inf)))
    window = bins_of_path(1, 0.01, 0.01 * faint)
    found = cells(room, one_point_capture(half_side_m=0.02, time=window), accuracy)
    assert cells_of(found) < 20 * cells_of(plain)
    assert everything(found) == pytest.approx(everything(plain), rel=0.05)


def test_a_window_that_only_coarse_cells_reach_into_is_empty() -> None:
    capture = one_point_capture(half_side_m=0.02, time=bins_of_path(1, 0.01, 9.11))
    with pytest.warns(InputWarning, match="all light arrives outside"):
        found = simulate(furnished_box(), capture, Accuracy(target=0.05), 0)
    assert not found.total.any() and found.overflow.sum() > 0
