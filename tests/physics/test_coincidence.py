"""Parts that lie in one place are found in any plane that light reaches; neighbours that share an edge are not
reported."""

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

import datagen as dg
from datagen.transport.visibility.coincidence import lit_in_one_place, places_shared
from datagen.transport.visibility.raycast import Raycaster
from tests.rooms import furnished_box, rectangle


def scene_of(*meshes: trimesh.Trimesh) -> dg.Scene:
    return dg.Scene.from_parts([dg.Part(f"part {k}", mesh, dg.Lambertian(0.5)) for k, mesh in enumerate(meshes)])


def in_one_place(scene: dg.Scene, light: tuple[float, float, float] = (3.0, 0.5, 1.5)) -> bool:
    return lit_in_one_place(scene, Raycaster(scene), np.array([light]))


def turned(mesh: trimesh.Trimesh, turn: NDArray[np.float64]) -> trimesh.Trimesh:
    return mesh.copy().apply_transform(turn)


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.1])
def test_a_poster_lies_on_its_wall_and_a_neighbour_does_not(angle: float) -> None:
    turn = trimesh.transformations.rotation_matrix(angle, (0.3, 1.0, 0.2), (0.1, 0.2, 0.3))
    wall = turned(rectangle((0, 0, 1), (0, 1, 0), (0, 0, 1)), turn)
    poster = turned(rectangle((0, 0.2, 1.1), (0, 0.2, 0), (0, 0, 0.3)), turn)
    beside = turned(rectangle((0, 1.5, 1), (0, 0.5, 0), (0, 0, 1)), turn)
    before = turned(rectangle((0.001, 0.2, 1.1), (0, 0.2, 0), (0, 0, 0.3)), turn)
    assert in_one_place(scene_of(wall, poster))
    assert in_one_place(scene_of(poster, wall, beside))
    assert not in_one_place(scene_of(wall, beside))
    assert not in_one_place(scene_of(wall, before))
    assert not in_one_place(scene_of(trimesh.util.concatenate([wall, poster]), beside))


def test_shared_places_lie_in_both() -> None:
    places, normals = places_shared(
        scene_of(rectangle((0, 0, 1), (0, 1, 0), (0, 0, 1)), rectangle((0, 0.9, 1.1), (0, 0.3, 0), (0, 0, 0.3)))
    )
    assert len(places) >= 4
    np.testing.assert_allclose(np.abs(normals), [(1, 0, 0)] * len(places), atol=1e-12)
    assert np.abs(places[:, 0]).max() < 1e-12
    assert ((places[:, 1] > 0.6) & (places[:, 1] < 1.0) & (places[:, 2] > 0.8) & (places[:, 2] < 1.4)).all()


def test_a_mesh_that_came_twice_is_found_and_what_stands_on_the_floor_is_not() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    assert in_one_place(scene_of(ball, ball.copy()))
    assert not in_one_place(scene_of(ball, ball.copy().apply_translation((0.7, 0, 0))))
    assert len(places_shared(furnished_box())[0]) > 0
    assert not in_one_place(furnished_box(), (0.1, 0.2, 1.2))
