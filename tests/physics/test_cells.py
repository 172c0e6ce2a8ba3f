"""The primary by quadrature over surface elements: closed forms, numerical integrals, and laws that hold without
noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from rooms import bins_of_path, furnished_box, one_point_capture, rectangle
from sphere_chords import BINS, QUAD, SPOT, WIDTH_M, stored, unit_ball

from datagen import Accuracy, Capture, Lambertian, Laser, Part, Scene, Sensor, simulate
from datagen.bench.other_renderers import grid_points, point_capture
from datagen.bench.peer_cases import path_axis
from datagen.bench.problems import DEVICE, WALL, furnished_room
from datagen.errors import InputWarning
from datagen.records import Transient
from datagen.transport.fields_of_view import PixelCones
from datagen.units import SPEED_OF_LIGHT_M_PER_S as C

FINE = Accuracy(target=0.01, part_target=0.01)


def cells(scene: Scene, capture: Capture, accuracy: Accuracy = FINE, seed: int = 0) -> Transient:
    found = simulate(scene, capture, accuracy, seed)
    assert found.spend is not None and found.spend.way["primary"] == "cells"
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


def test_triangles_that_lie_on_each_other_count_once() -> None:
    box = crate()
    twice = trimesh.Trimesh(box.vertices, np.concatenate([box.faces, box.faces[:7, ::-1]]), process=False)
    finer = Accuracy(target=0.005, part_target=0.005)
    once, doubled = (cells(wall_and_box(mesh), looking_at(0.2), finer) for mesh in (box, twice))
    assert np.linalg.norm(doubled.total - once.total) < 0.01 * np.linalg.norm(once.total)
    assert everything(doubled) == pytest.approx(everything(once), rel=2e-3)


def test_a_poster_takes_the_light_of_what_it_hangs_on() -> None:
    """A black poster, exactly in the plane of the box that it hangs on, acts as a hole in half of the box's face."""
    poster = Part("poster", rectangle((0.95, 0, -0.125), (0, 0.25, 0), (0, 0, 0.125)), Lambertian(0.0))
    rest = Part("rest", rectangle((0.95, 0, 0.125), (0, 0.25, 0), (0, 0, 0.125)), Lambertian(0.6))
    bare, covered = wall_and_box(crate()), wall_and_box(crate(), poster)
    hole = wall_and_box(headless(crate()), poster, rest)
    whole, seen, expected = (everything(cells(scene, looking_at(0.2))) for scene in (bare, covered, hole))
    assert seen == pytest.approx(expected, abs=0.01 * whole)
    assert 0.1 * whole < seen < 0.8 * whole


@pytest.mark.parametrize("reach", [0.2, 0.6])
def test_a_pixel_that_reaches_over_the_edge_of_the_wall_keeps_its_light(reach: float) -> None:
    """The part of the pixel that lies on the wall, taken as a pixel of its own, sees the same light within both
    errors asked."""
    half, own = 0.2, looking_at(0.0)
    over = cells(wall_and_box(crate()), looking_at(1 - 2 * half * reach + half, half))
    corners = np.array(
        [[0, 1 - 2 * half * reach, -0.17], [0, 1, -0.17], [0, 1, 0.23], [0, 1 - 2 * half * reach, 0.23]]
    )
    inside = cells(wall_and_box(crate()), replace(own, sensor=replace(own.sensor, pixels=corners[None])))
    assert everything(over) > 0
    assert off_by(over, inside) < 0.015


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
    assert found.spend is not None
    return found.spend.lookins["primary"]


@pytest.mark.parametrize("origin", ["wall", "source"])
def test_a_small_patch_amplitude_and_arrival(origin: str) -> None:
    """A small patch brings L = (ρ₁/π) cosθ₁cosθ₂ a/R₁₂² · (ρ₂/π) cosθ₂′cosθ₃/R₂₃² · (ρ₃/π) A Ω, at one time."""
    side, h = 1e-3, 5e-4
    x2 = np.array([1.2, 0.5, -0.3])
    x1, x3, device = np.array([0, -0.4, 0.2]), np.array([0, 0.9, 0.1]), np.array([2.0, -1.0, 0.4])
    scene = wall_and_box(rectangle(x2, (0, side / 2, 0), (0, 0, side / 2)))
    time = bins_of_path(400, 0.01, 0.0 if origin == "wall" else 4.0, origin)
    found = cells(scene, one_point_capture(x1, x3, h, time, device))
    r12, r23, r3s = (np.linalg.norm(d) for d in (x2 - x1, x3 - x2, device - x3))
    patch = 0.8 / np.pi * (1.2 / r12) ** 2 / r12**2 * side**2
    omega = (2 * h) ** 2 * (device - x3)[0] / r3s**3
    expected = patch * 0.6 / np.pi * (1.2 / r23) ** 2 / r23**2 * 0.8 / np.pi * np.pi * 0.02**2 * omega
    assert found.total.sum() == pytest.approx(expected, rel=1e-5)
    path = r12 + r23 + (r3s + np.linalg.norm(device - x1) if origin == "source" else 0.0)
    assert (found.total[0, 0] * found.time.centers_s).sum() / found.total.sum() == pytest.approx(
        path / C, abs=5e-3 / C
    )
    assert np.count_nonzero(found.total) <= 2


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


@pytest.mark.nightly
def test_the_inside_of_a_sphere() -> None:
    """The energy is L = ρ³/π · A Ω / (4π r²), and arrival times are distributed as two chords that meet in a uniform
    point."""
    scene = Scene.from_parts([Part("sphere", unit_ball(5), Lambertian(0.8), "structure")])
    capture = Capture(Laser((0, 0, 0.0), [SPOT]), Sensor((0, 0, 0.0), QUAD), bins_of_path(BINS, WIDTH_M, 0.0))
    found = cells(scene, capture, Accuracy(target=0.02))
    whole = 0.8**3 / np.pi / (4 * np.pi) * np.pi * 0.02**2 * PixelCones.of(capture.sensor).solid_angle[0]
    assert everything(found) == pytest.approx(whole, rel=5e-3)
    share, _ = stored().of(3)
    assert np.abs(found.total[0, 0] - whole * share).sum() < 0.03 * whole


def test_swapping_laser_point_and_pixel_changes_nothing() -> None:
    """Reciprocity, apart from the device legs and the pixel's solid angle; the pixel is so small that both are
    points."""
    a, b, device, h = np.array([0, -0.8, 1.4]), np.array([0, 0.5, 0.9]), np.array([1.5, 0.1, 1.3]), 1e-3
    there, back = (
        cells(furnished_box(), one_point_capture(p, q, h, device=device)).total
        * np.linalg.norm(device - q) ** 3 for p, q in ((a, b), (b, a))
    )  # fmt: skip
    assert np.linalg.norm(there - back) < 0.02 * np.linalg.norm(there)
    assert there.sum() == pytest.approx(back.sum(), rel=3e-3)


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


@pytest.mark.parametrize("gap", [5e-4, 1e-6])
def test_a_laser_point_in_a_corner_needs_no_more_than_ten_times_the_cells(gap: float) -> None:
    asked = Accuracy(target=0.02)
    in_a_corner = (0, -1.5 + gap, gap)
    found = cells(furnished_box(), one_point_capture(in_a_corner, half_side_m=0.02), asked)
    plain = cells(furnished_box(), one_point_capture(half_side_m=0.02), asked)
    beside = cells(furnished_box(), one_point_capture((0, -1.5 + 2 * gap, 2 * gap), half_side_m=0.02), asked)
    assert found.met_target
    assert cells_of(found) < 10 * cells_of(plain)
    assert everything(found) == pytest.approx(everything(beside), rel=0.05)


@pytest.mark.parametrize(
    ("attenuation_per_m", "bounces"), [(0.5, 3), (2.0, 3), (10.0, 3), (50.0, 3), (0.5, 4), (2.0, 4)]
)
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
    spent, usual = found.spend, cells(clear, capture, accuracy).spend
    assert spent is not None and usual is not None and spent.cost < 1.5 * usual.cost


def test_one_bin_and_a_hundred_thousand() -> None:
    """Narrow bins add up to wide ones, and all light is in a bin or in the overflow."""

    def seen(bins: int, width_m: float, start_m: float, accuracy: Accuracy = FINE) -> Transient:
        time = bins_of_path(bins, width_m, start_m)
        return cells(furnished_box(), one_point_capture(half_side_m=0.02, time=time), accuracy)

    plain, late = seen(200, 0.1, 0.0), seen(20, 0.1, 4.0)
    for bins, width_m in ((1, 20.0), (100_000, 3e-4)):
        found = seen(bins, width_m, 0.0, Accuracy(target=0.02))
        assert everything(found) == pytest.approx(everything(plain), rel=0.02)
        assert found.overflow.sum() == 0
    # The two time axes lead to two cuttings, each with an error of 2 %.
    assert everything(late) == pytest.approx(everything(plain), rel=0.01)
    assert np.linalg.norm(late.total - plain.total[..., 40:60]) < 0.015 * np.linalg.norm(plain.total[..., 40:60])


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


@pytest.mark.parametrize("start_m", [8.98, 9.11])
def test_a_window_that_only_coarse_cells_reach_into_is_empty(start_m: float) -> None:
    capture = one_point_capture(half_side_m=0.02, time=bins_of_path(1, 0.01, start_m))
    with pytest.warns(InputWarning, match="all light arrives outside"):
        found = simulate(furnished_box(), capture, Accuracy(target=0.05), 0)
    assert not found.total.any() and found.overflow.sum() > 0
