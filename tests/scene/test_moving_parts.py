"""Paths of parts, the moves along them, and the scenes at a time."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import datagen as dg
from datagen.errors import InputError

KNOTS: dict[str, Any] = {
    "times_s": (0.5, 1.0, 1.75, 3.0),
    "places": [(1, 2, 0), (1.5, 1, 0.25), (1.5, 1, 0.25), (4, 3, 0)],
    "headings_deg": (10, 10, 200, -40),
}
PATH = dg.Path(**KNOTS)


def random_path(rng: np.random.Generator, knots: int) -> dg.Path:
    times = np.cumsum(rng.uniform(0.01, 1, knots))
    return dg.Path(times, rng.uniform(-5, 5, (knots, 3)), rng.uniform(-720, 720, knots))


def test_knots_are_met_exactly_and_between_them_the_path_is_linear() -> None:
    at = PATH.at(PATH.times_s)
    np.testing.assert_array_equal(at.shifts_m, PATH.places)
    np.testing.assert_array_equal(at.turns_rad, np.radians(PATH.headings_deg))
    rng = np.random.default_rng(0)
    for _ in range(20):
        path = random_path(rng, int(rng.integers(2, 8)))
        times = rng.uniform(-1, path.times_s[-1] + 1, (4, 50))
        found = path.at(times)
        for axis in range(3):
            due = np.interp(times, path.times_s, path.places[:, axis])
            np.testing.assert_allclose(found.shifts_m[..., axis], due, atol=1e-12)
        due = np.radians(np.interp(times, path.times_s, path.headings_deg))
        np.testing.assert_allclose(found.turns_rad, due, atol=1e-12)


def test_it_stands_before_the_first_and_after_the_last_time() -> None:
    np.testing.assert_array_equal(PATH.at([-9.0, 9.0]).shifts_m, PATH.places[[0, -1]])
    assert not PATH.velocity([-9.0, 0.4, 3.0, 9.0]).any() and not PATH.turning([0.4, 3.0]).any()
    for path in (dg.Path((2.0,), [(1, 2, 3)], 30), dg.Path((0, 2), [(1, 2, 3)] * 2, 30)):
        assert path.stands
        found = path.at(np.linspace(-1, 3, 9))
        assert (found.shifts_m == (1, 2, 3)).all() and (found.turns_rad == np.radians(30)).all()
    assert not PATH.stands and not dg.Path((0, 1), [(0, 0, 0)] * 2, (0, 360)).stands


def test_a_path_is_continuous_and_jumps_only_where_two_times_are_equal() -> None:
    rng, step = np.random.default_rng(1), 1e-6
    path = random_path(rng, 6)
    times = np.concatenate([path.times_s, rng.uniform(*path.times_s[[0, -1]], 100)])
    before, after = path.at(times - step), path.at(times + step)
    fastest = np.linalg.norm(path.velocity(path.times_s), axis=1).max()
    assert (np.linalg.norm(after.shifts_m - before.shifts_m, axis=1) <= 2.1 * step * fastest).all()
    jump = dg.Path((0, 1, 1, 2), [(0, 0, 0), (0, 0, 0), (5, 0, 0), (5, 0, 0)], (0, 0, 90, 90))
    assert jump.at([1 - 1e-9, 1.0]).shifts_m[:, 0].tolist() == [0, 5]
    assert not jump.velocity(np.linspace(0, 2, 21)).any() and not jump.stands
    assert dg.Path((1, 1), [(0, 0, 0), (5, 0, 0)]).at([0.9, 1.0]).shifts_m[:, 0].tolist() == [0, 5]


def test_velocity_and_turning_are_the_derivatives() -> None:
    rng, step = np.random.default_rng(2), 1e-6
    for _ in range(10):
        path = random_path(rng, 5)
        middles = 0.5 * (path.times_s[1:] + path.times_s[:-1])
        before, after = path.at(middles - step), path.at(middles + step)
        slope = (after.shifts_m - before.shifts_m) / (2 * step)
        np.testing.assert_allclose(path.velocity(middles), slope, rtol=1e-6, atol=1e-6)
        turning = (after.turns_rad - before.turns_rad) / (2 * step)
        np.testing.assert_allclose(path.turning(middles), turning, rtol=1e-6, atol=1e-6)
        # Of a point of the mesh, too, which turning alone moves.
        point = rng.uniform(-1, 1, 3)
        of_point = (after.apply(point) - before.apply(point)) / (2 * step)
        found = path.velocity(middles, at=path.at(middles).apply(point))
        np.testing.assert_allclose(found, of_point, rtol=1e-5, atol=1e-5)
    # At a knot it is that of the leg which begins there.
    np.testing.assert_array_equal(PATH.velocity(1.0), [0, 0, 0])
    np.testing.assert_allclose(PATH.turning(1.0), np.radians(190 / 0.75))


def test_moves_are_rigid_and_there_and_back_is_nowhere() -> None:
    rng = np.random.default_rng(3)
    path, times = random_path(rng, 6), rng.uniform(0, 4, (7, 5))
    moves, points = path.at(times), rng.uniform(-3, 3, (5, 3))
    there = moves.apply(points)
    assert there.shape == (7, 5, 3)
    np.testing.assert_allclose(moves.undo(there), np.broadcast_to(points, there.shape), atol=1e-12)
    np.testing.assert_allclose(moves.turn_back(moves.turn(points)) - points, 0, atol=1e-12)
    # Of one time: a rotation matrix about z and a shift, by which distances stay.
    move = moves[2, 3]
    c, s = np.cos(move.turns_rad), np.sin(move.turns_rad)
    matrix = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    np.testing.assert_allclose(move.apply(points), points @ matrix.T + move.shifts_m, atol=1e-12)
    np.testing.assert_allclose(move.turn(points), points @ matrix.T, atol=1e-12)
    np.testing.assert_array_equal(moves[2].apply(points)[3], move.apply(points[3]))
    vertices = rng.uniform(-1, 1, (11, 3))
    assert path.at(times[:, 0])[:, None].apply(vertices).shape == (7, 11, 3)


def test_moves_since_others_lead_from_these_to_those() -> None:
    rng = np.random.default_rng(4)
    path, points = random_path(rng, 6), rng.uniform(-3, 3, (5, 3))
    start, end = path.at(0.7), path.at(rng.uniform(0, 4, (6, 1)))
    np.testing.assert_allclose(end.since(start).apply(start.apply(points)), end.apply(points), atol=1e-12)
    nothing = start.since(start)
    np.testing.assert_array_equal(nothing.apply(points), points)


def test_equal_paths_are_equal() -> None:
    assert dg.Path(**KNOTS) == PATH and hash(dg.Path(**KNOTS)) == hash(PATH)
    for key in KNOTS:
        values = np.array(KNOTS[key], float)
        values[-1] += 0.5
        assert dg.Path(**{**KNOTS, key: values}) != PATH
    zero, minus = (dg.Path((0, 1), [(0, 0, 0), (sign * 0.0, 1, 0)]) for sign in (1, -1))
    assert zero == minus and hash(zero) == hash(minus) and zero != "a path"
    # As workers get them.
    assert pickle.loads(pickle.dumps(PATH)) == PATH
    assert dict(pickle.loads(pickle.dumps(MOVING)).paths) == {"box": PATH}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"times_s": (0, 2, 1, 3)}, "times_s[2] = 1 after 2: times must not run backward"),
        ({"times_s": (0, 1, 1, 1)}, "two equal times are a jump"),
        ({"times_s": (0, 1, np.nan, 3)}, "not finite"),
        ({"times_s": (0, 1, 2, 1e9)}, "beyond 1e+06 s"),
        ({"times_s": ()}, "n ≥ 1"),
        ({"places": [(0, 0, 0)] * 3}, "Path.places: shape (3, 3) given, (4, 3) needed"),
        ({"places": [(0, 0)] * 4}, "Path.places: shape (4, 2)"),
        ({"places": [(0, 0, np.inf)] * 4}, "NaN or infinite"),
        ({"headings_deg": (0, 0, 90)}, "Path.headings_deg: shape (3,) given, (4,) needed"),
        ({"headings_deg": (0, 0, 90, np.inf)}, "Path.headings_deg: holds numbers that are not finite"),
        ({"headings_deg": "north"}, "Path.headings_deg"),
    ],
)
def test_bad_paths_are_refused_in_one_line(changed: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as caught:
        dg.Path(**{**KNOTS, **changed})
    assert words in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(InputError, match="not finite"):
        PATH.at(np.nan)


def parts(path: dg.Path | None) -> list[dg.Part]:
    wall = trimesh.creation.box((0.1, 4, 3), trimesh.transformations.translation_matrix((0, 0, 1.5)))
    box = trimesh.creation.box((0.4, 0.3, 0.5), trimesh.transformations.translation_matrix((0, 0, 0.25)))
    ball = trimesh.creation.icosphere(1, 0.2)
    ball.apply_translation((3, 0, 1))
    return [
        dg.Part("wall", wall, dg.Lambertian(0.8), "relay_wall"),
        dg.Part("box", box, dg.Lambertian(0.5), path=path, pose=dg.Pose.upright("crate", 20)),
        dg.Part("ball", ball, dg.Lambertian(0.5)),
    ]


PARAMETERS = {"drawn": 1.0}
MOVING = dg.Scene.from_parts(parts(PATH), parameters=PARAMETERS)


@pytest.mark.parametrize("time_s", [0.0, 0.5, 0.9, 1.3, 2.9, 7.0])
def test_a_scene_at_a_time_is_the_scene_of_meshes_that_stand_there(time_s: float) -> None:
    """Beside the plain way: the mesh itself is turned and moved by a matrix."""
    standing = parts(None)
    move = PATH.at(time_s)
    matrix = trimesh.transformations.rotation_matrix(float(move.turns_rad), (0, 0, 1))
    matrix[:3, 3] = move.shifts_m
    standing[1].mesh.apply_transform(matrix)
    due = dg.Scene.from_parts(standing)
    found = MOVING.at(time_s)
    np.testing.assert_allclose(found.vertices, due.vertices, atol=1e-12)
    np.testing.assert_array_equal(found.triangles, due.triangles)
    others = found.faces_of("wall", "ball")
    np.testing.assert_array_equal(found.corners[others], due.corners[others])
    assert found.moving == () and dict(found.paths) == {} and found.parameters == PARAMETERS
    turned = np.degrees(move.turns_rad) + 20
    np.testing.assert_allclose(found.pose_of("box").axes, dg.Pose.upright("crate", turned).axes, atol=1e-12)
    assert found.pose_of("box").label == "crate"


def test_the_triangles_are_those_of_time_0() -> None:
    assert MOVING.moving == ("box",) and dict(MOVING.paths) == {"box": PATH}
    now = MOVING.at(0.0)
    np.testing.assert_array_equal(now.vertices, MOVING.vertices)
    np.testing.assert_array_equal(now.pose_of("box").axes, MOVING.pose_of("box").axes)
    box = MOVING.vertices[np.unique(MOVING.triangles[MOVING.faces_of("box")])]
    np.testing.assert_allclose(box.mean(axis=0), PATH.places[0] + [0, 0, 0.25])


def test_moves_of_a_part_lead_from_the_triangles_to_their_place_at_a_time() -> None:
    times = np.linspace(0, 4, 9)
    box, ball = (np.unique(MOVING.triangles[MOVING.faces_of(name)]) for name in ("box", "ball"))
    there = MOVING.moves("box", times)[:, None].apply(MOVING.vertices[box])
    for k, time_s in enumerate(times):
        np.testing.assert_allclose(there[k], MOVING.at(time_s).vertices[box], atol=1e-12)
    standing = MOVING.moves("ball", times)[:, None].apply(MOVING.vertices[ball])
    assert (standing == MOVING.vertices[ball]).all()
    with pytest.raises(InputError, match="this scene has wall, box, ball"):
        MOVING.moves("person", times)


def test_a_part_that_stands_on_its_path_is_a_part_without_one() -> None:
    place, heading = (1.5, 2.0, 0.0), 0.0
    standing = dg.Scene.from_parts(parts(dg.Path((0, 1), [place] * 2, heading)))
    plain = parts(None)
    plain[1].mesh.apply_translation(place)
    due = dg.Scene.from_parts(plain)
    assert standing.moving == () and standing.paths["box"].stands
    for scene in (standing, standing.at(0.7)):
        np.testing.assert_array_equal(scene.vertices, due.vertices)
    assert (standing.moves("box", [0, 0.4, 5]).turns_rad == 0).all()
    assert not standing.moves("box", [0, 0.4, 5]).shifts_m.any()


def test_paths_stay_with_their_parts() -> None:
    assert dict(MOVING.without("ball").paths) == {"box": PATH}
    assert dict(MOVING.without("box").paths) == {}
    np.testing.assert_array_equal(
        MOVING.without("ball").at(1.3).vertices,
        MOVING.at(1.3).without("ball").vertices,
    )
    black = replace(MOVING, materials=(dg.Lambertian(0.0),) * 3)
    np.testing.assert_array_equal(black.at(1.3).vertices, MOVING.at(1.3).vertices)


def test_what_cannot_move_is_refused() -> None:
    box = trimesh.creation.box((1, 1, 1))
    for role in ("relay_wall", "structure"):
        with pytest.raises(InputError, match=f"Part 'door': a path with role = '{role}': only objects move"):
            dg.Part("door", box, dg.Lambertian(0.5), role, path=PATH)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="Part 'box': path = 3: Path needed"):
        dg.Part("box", box, dg.Lambertian(0.5), path=3)  # type: ignore[arg-type]
    for paths in ({"person": PATH}, {"wall": PATH}):
        with pytest.raises(InputError, match="is no object of this scene"):
            replace(MOVING, paths=paths)
    with pytest.raises(InputError, match=r"Scene.at.time_s = nan"):
        MOVING.at(float("nan"))


def test_a_scene_that_moves_is_not_built_as_one_that_stands(tmp_path: Path) -> None:
    time = dg.TimeAxis(bins=64, width_s=4e-10, origin="wall")
    sensor = dg.Sensor.grid((3, -1, 0), (0.05, 0, 0), (0, 0.3, 0), (0, 0, 0.3), rows=1, columns=1)
    capture = dg.Capture(dg.Laser((3, -1, 0), [(0.05, 0, 0.2)]), sensor, time)
    with pytest.raises(InputError, match=r"scenes\[0\]: 'box' moves, and nothing says when frames are measured"):
        dg.build_from([MOVING], tmp_path / "x.zarr", capture, progress=False)
    assert not [*tmp_path.iterdir()]
