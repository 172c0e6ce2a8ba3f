"""Parts in one place: one lies on the other, for every way the same, and a line says so; neighbours that share an
edge, and what no light gets to, stay as they are."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

import datagen as dg
from datagen.errors import InputWarning
from datagen.records import Role
from datagen.transport.brdf import MaterialTable
from datagen.transport.coincidence import LIFT, set_apart, shared_planes
from datagen.transport.paths import sample_paths
from datagen.transport.rays import Raycaster
from datagen.transport.reference import pairs_of, reference
from tests.rooms import bins_of_path, furnished_box, one_point_capture, rectangle, square_pixels

SIDEWAYS = one_point_capture((0, -0.5, 0.6), (0, 0.5, 0.6), device=(3, 0, 1.5))


def scene_of(*meshes: trimesh.Trimesh, roles: tuple[Role, ...] = ()) -> dg.Scene:
    roles = roles or ("object",) * len(meshes)
    parts = zip(meshes, roles, strict=True)
    made = [dg.Part(f"part {k}", mesh, dg.Lambertian(0.5), role) for k, (mesh, role) in enumerate(parts)]
    return dg.Scene.from_parts(made)


def seen_from(
    *targets: tuple[float, float, float], device: tuple[float, float, float] = (3.0, 0.5, 1.5)
) -> dg.Capture:
    return dg.Capture(
        dg.Laser(device, targets), dg.Sensor(device, square_pixels(targets[:1], 0.05)), bins_of_path(10, 1.0, 0.0)
    )


def turned(mesh: trimesh.Trimesh, turn: NDArray[np.float64]) -> trimesh.Trimesh:
    return mesh.copy().apply_transform(turn)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.1])
def test_a_poster_lies_on_its_wall_and_a_neighbour_does_not(angle: float) -> None:
    turn = trimesh.transformations.rotation_matrix(angle, (0.3, 1.0, 0.2), (0.1, 0.2, 0.3))
    wall = turned(rectangle((0, 0, 1), (0, 1, 0), (0, 0, 1)), turn)
    poster = turned(rectangle((0, 0.2, 1.1), (0, 0.2, 0), (0, 0, 0.3)), turn)
    beside = turned(rectangle((0, 1.5, 1), (0, 0.5, 0), (0, 0, 1)), turn)
    before = turned(rectangle((0.001, 0.2, 1.1), (0, 0.2, 0), (0, 0, 0.3)), turn)
    target = tuple(trimesh.transform_points([(0.0, 0.2, 1.0)], turn)[0])
    device = tuple(trimesh.transform_points([(3.0, 0.5, 1.5)], turn)[0])

    def lying(*meshes: trimesh.Trimesh) -> tuple[tuple[str, str], ...]:
        return set_apart(scene_of(*meshes), seen_from(target, device=device)).lying

    assert lying(wall, poster) == (("part 1", "part 0"),)
    assert lying(poster, wall, beside) == (("part 1", "part 0"),)
    assert not lying(wall, beside)
    assert not lying(wall, before)
    assert not lying(trimesh.util.concatenate([wall, poster]), beside)


def test_a_poster_is_found_on_a_wall_that_faces_two_axes_alike() -> None:
    """At 45° rounding decides which component of a normal is the largest."""
    for k in range(20):
        turn = trimesh.transformations.rotation_matrix(0.75 * np.pi, (0, 0, 1), (0.1 * k, 0.2, 0.3))
        wall, poster = (rectangle((0, 0, 1), (0, size, 0), (0, 0, size)) for size in (1.0, 0.3))
        assert list(shared_planes(scene_of(turned(wall, turn), turned(poster, turn)))), k


def test_shared_places_lie_in_both() -> None:
    planes = list(
        shared_planes(
            scene_of(rectangle((0, 0, 1), (0, 1, 0), (0, 0, 1)), rectangle((0, 0.9, 1.1), (0, 0.3, 0), (0, 0, 0.3)))
        )
    )
    assert planes
    for plane in planes:
        assert (plane.one, plane.two) == (0, 1) and len(plane.places) >= 4
        np.testing.assert_allclose(np.abs(plane.normal), (1, 0, 0), atol=1e-12)
        places = plane.places
        assert np.abs(places[:, 0]).max() < 1e-12
        assert ((places[:, 1] > 0.6) & (places[:, 1] < 1.0) & (places[:, 2] > 0.8) & (places[:, 2] < 1.4)).all()


def test_a_mesh_that_came_twice_is_found_and_what_stands_on_the_floor_is_not() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    towards = seen_from((0, 0, 0))
    assert set_apart(scene_of(ball, ball.copy()), towards).lying == (("part 1", "part 0"),)
    assert not set_apart(scene_of(ball, ball.copy().apply_translation((0.7, 0, 0))), towards).lying
    room = furnished_box()
    assert list(shared_planes(room))
    assert set_apart(room, one_point_capture()).scene is room


def test_what_lies_on_something_is_met_first_and_nothing_else_moves() -> None:
    """A rug on the floor, a sheet on the rug, in any order of parts: objects lie on the floor, later ones on earlier
    ones, each a hair higher, on the side that is lit; the floor and the relay wall stay."""
    wall = rectangle((0, 0, 1), (0, 2, 0), (0, 0, 1))
    floor, rug, sheet = (rectangle((1, 0, 0), (s, 0, 0), (0, s, 0)) for s in (1.0, 0.4, 0.2))
    roles: tuple[Role, ...] = ("relay_wall", "object", "object", "structure")
    scene = scene_of(wall, rug, sheet, floor, roles=roles)
    apart = set_apart(scene, SIDEWAYS)
    assert set(apart.lying) == {("part 1", "part 3"), ("part 2", "part 3"), ("part 2", "part 1")}
    step = LIFT * Raycaster(scene).offset_m
    heights = [
        np.unique(apart.scene.corners[apart.scene.faces_of(name)][..., 2]) for name in ("part 3", "part 1", "part 2")
    ]
    assert [len(height) for height in heights] == [1, 1, 1]
    np.testing.assert_allclose(np.ravel(heights), [0, step, 2 * step], atol=1e-12)
    np.testing.assert_array_equal(apart.scene.corners[:, :, :2], scene.corners[:, :, :2])
    np.testing.assert_array_equal(apart.scene.corners[apart.scene.faces_of("part 0")], wall.triangles)
    # Nothing is left that coincides.
    assert set_apart(apart.scene, SIDEWAYS).scene is apart.scene
    down = np.tile([[0.0, 0.0, -1.0]], (3, 1))
    hits = Raycaster(apart.scene).closest(np.array([(1.1, 0.1, 1), (1.3, 0.1, 1), (1.7, 0.3, 1)]), down)
    assert apart.scene.face_part[hits.face].tolist() == [2, 1, 3]


def plate_in_a_floor(gap_m: float = 0.0) -> dg.Scene:
    """A relay wall, a floor of albedo 0.8, and on it a plate of albedo 0.1 that takes a quarter of it."""
    wall = rectangle((0, 0, 1), (0, 1, 0), (0, 0, 1))
    floor = rectangle((1, 0, 0), (0.8, 0, 0), (0, 0.8, 0))
    plate = rectangle((0.8, 0.1, gap_m), (0.4, 0, 0), (0, 0.4, 0))
    return dg.Scene.from_parts([
        dg.Part("wall", wall, dg.Lambertian(0.7), "relay_wall"), dg.Part("plate", plate, dg.Lambertian(0.1)),
        dg.Part("floor", floor, dg.Lambertian(0.8), "structure"),
    ])  # fmt: skip


def test_light_of_a_plate_in_a_floor_is_that_of_plain_paths() -> None:
    """By elements, by path tracing and by plain paths: the floor beneath the plate is dark, and all is as if the
    plate lay a tenth of a millimetre higher."""
    inside, above = plate_in_a_floor(), plate_in_a_floor(1e-4)
    truth = reference(above, SIDEWAYS, samples=1 << 16, replicates=8, seed=1, draw=sample_paths)
    plain = reference(inside, SIDEWAYS, samples=1 << 16, replicates=8, seed=2, draw=sample_paths)
    with pytest.warns(InputWarning, match=r"simulate: parts 'plate' and 'floor' lie in one place: 'plate' is taken"):
        aimed = dg.simulate(inside, SIDEWAYS, dg.Accuracy(target=0.01), seed=3)
        counted = dg.simulate(inside, SIDEWAYS, dg.Accuracy(samples=1 << 16), seed=4)
    for name in ("plate", "floor"):
        energy = truth.parts[name].sum()
        assert energy > 0
        for light in (plain, aimed, counted):
            assert light.parts[name].sum() == pytest.approx(energy, rel=0.02, abs=0), name
    # A tenth of the light of a floor of one piece comes from where the plate is: the test tells them apart.
    whole = dg.simulate(above.without("plate"), SIDEWAYS, dg.Accuracy(target=0.01)).parts["floor"].sum()
    assert truth.parts["floor"].sum() < 0.8 * whole


def test_a_scene_without_shared_places_brings_no_line() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        dg.simulate(plate_in_a_floor(1e-4), SIDEWAYS, dg.Accuracy(samples=64))


def test_plain_paths_meet_the_same_parts_in_either_order() -> None:
    """What sampled paths meet below the plate does not change with the order in which triangles are given."""
    scene = set_apart(plate_in_a_floor(), SIDEWAYS).scene
    caster, table = Raycaster(scene), MaterialTable.of(scene.materials)
    paths = sample_paths(caster, scene, table, SIDEWAYS, pairs_of(SIDEWAYS), 1 << 12, seed=5)
    assert set(np.unique(paths.part[paths.order == 3])) == {1, 2}
