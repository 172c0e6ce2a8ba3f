"""Meshes of many small triangles: their light is right, and the cost follows their detail, not the number of
triangles."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh
from benchmarks.other_renderers import grid_points, point_capture
from benchmarks.peer_cases import path_axis
from benchmarks.problems import DEVICE, WALL, furnished_room, lump

from datagen import Accuracy, Capture, InputWarning, Lambertian, Part, simulate
from datagen.records import Transient

AT = np.array([1.6, -0.2, 1.7])
SLACK = 1.5
"""Error of a single run over what it claims, which is an estimate."""


def scan(side: int) -> Capture:
    points = grid_points(WALL, side, side)
    return point_capture(WALL, points, DEVICE, points, path_axis(512, 0.03, 0.0), confocal=True)


@cache
def with_lump(quads: int, one_in: int, seed: int = 0) -> Transient:
    scene = furnished_room(more=[lump("mesh", tuple(AT), 0.35, quads)])
    accuracy = Accuracy(target=1 / one_in, part_target=2.5 / one_in, max_bounces=3)
    return simulate(scene, scan(3), accuracy, seed, split_parts=True)


def off(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


@pytest.mark.parametrize("quads", [9, 40])
def test_a_meshes_own_light_is_within_what_is_claimed(quads: int) -> None:
    found, truth = with_lump(quads, 50), with_lump(quads, 400, 1)
    assert off(found.total, truth.total) < SLACK * found.relative_error
    assert off(found.parts["mesh"], truth.parts["mesh"]) < SLACK * found.part_errors["mesh"] < SLACK**2 * 0.05


def test_a_mesh_of_a_hundred_thousand_triangles_costs_its_detail() -> None:
    """It takes as many elements as a mesh of a hundredth of the triangles, apart from its finer detail."""
    few, many = (with_lump(quads, 50) for quads in (9, 91))
    assert many.rays["primary"] < 6 * few.rays["primary"]
    assert off(many.parts["mesh"], with_lump(40, 400, 1).parts["mesh"]) < 0.1


def test_a_flat_mesh_is_the_rectangle_that_it_covers() -> None:
    """A flat mesh of 8 192 triangles and a rectangle of two have the same light and the same shadow."""
    corners = np.array([[1.2, -0.5, 1.0], [1.4, 0.3, 0.9], [1.3, 0.4, 1.7], [1.1, -0.4, 1.8]])
    plain = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    fine = plain
    for _ in range(6):
        fine = fine.subdivide()
    scenes = (furnished_room(more=[Part("plate", mesh, Lambertian(0.6))]) for mesh in (plain, fine))
    one, other = (simulate(s, scan(3), Accuracy(target=0.02, max_bounces=3), split_parts=True) for s in scenes)
    assert off(other.total, one.total) < SLACK * np.hypot(one.relative_error, other.relative_error)
    for name in one.part_errors:
        claimed = np.hypot(one.part_errors[name], other.part_errors[name])
        assert off(other.parts[name], one.parts[name]) < SLACK * claimed


def test_an_object_that_is_hidden_is_not_chased() -> None:
    """The device stands inside a closed mesh: at most a millionth of the light leaves at its seams, and finding it
    would take any number of rays. The run ends."""
    scene = furnished_room(more=[lump("mesh", (1.6, -0.2, 1.5), 0.4, 9)])
    with pytest.warns(InputWarning, match="lies inside of the part 'mesh', which shuts its light in"):
        found = simulate(scene, scan(4), Accuracy(target=0.02, max_bounces=3), split_parts=True)
    assert found.samplers["primary"] == "cuts"
    assert found.met_target and found.rays["primary"] < 1e7
    assert found.parts["pillar"].sum() < 1e-5 * found.total.sum()
