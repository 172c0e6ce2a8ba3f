"""Meshes as clusters: moments against plain sums, one cell for many triangles, and their number without weight."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh

from datagen import Accuracy, Capture, Lambertian, Part, Scene, simulate
from datagen.bench.other_renderers import grid_points, point_capture
from datagen.bench.peer_cases import path_axis
from datagen.bench.problems import DEVICE, WALL, furnished_room, lump
from datagen.records import Transient
from datagen.transport.geometry import ball
from datagen.transport.quadrature.clusters import as_one
from datagen.transport.visibility.bvh import CLUSTER, Hierarchy
from datagen.transport.visibility.closed_surfaces import side_turned

AT = np.array([1.6, -0.2, 1.7])


def bumpy(quads: int = 12) -> tuple[Scene, Hierarchy]:
    scene = Scene.from_parts([lump("mesh", tuple(AT), 0.35, quads)])
    return scene, Hierarchy.of(scene)


def quadrature(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (3 n, 3) and areas that integrate what is of second degree over triangles (n, 3, 3) exactly."""
    middles = (corners + np.roll(corners, 1, axis=1)) / 2
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    return middles.reshape(-1, 3), np.repeat(area / 3, 3)


def test_moments_are_the_sums_over_all_that_a_box_holds() -> None:
    _, tree = bumpy(6)
    i, j = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
    many = np.flatnonzero(tree.cluster >= 0)
    assert (np.diff(tree.span[many], axis=1) > CLUSTER).all() and len(many) > 100
    # All of a closed mesh has no mean normal.
    for k in many[many > 0][::7]:
        first, last = tree.span[k]
        points, area = quadrature(tree.corners[first:last])
        normal, share = np.repeat(tree.normal[first:last], 3, axis=0), area / area.sum()
        centroid = share @ points
        away, mean = points - centroid, share @ normal
        direction = mean / np.linalg.norm(mean)
        expected = np.concatenate([
            centroid, share @ (away[:, i] * away[:, j]), share @ (normal[:, i] * normal[:, j]), direction,
            [(normal @ direction).min(), 1 - mean @ mean],
            *(share @ (normal[:, i] * normal[:, j] * away[:, axis, None]) for axis in range(3)),
        ])  # fmt: skip
        np.testing.assert_allclose(tree.moment[tree.cluster[k]], expected, rtol=1e-9, atol=1e-10)


def of_each(tree: Hierarchy, k: int, x: np.ndarray, z: np.ndarray) -> tuple[float, float, float]:
    """Diffuse light of all that a box holds, by plain quadrature; its mean path; and the variance of that."""
    first, last = tree.span[k]
    # Sixteen small triangles for each.
    corners = tree.corners[first:last]
    for _ in range(2):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        d, e, f = (a + b) / 2, (b + c) / 2, (c + a) / 2
        corners = np.stack([np.stack(s, 1) for s in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))], 1).reshape(
            -1, 3, 3
        )
    points, area = quadrature(corners)
    normal = np.repeat(tree.normal[first:last], 48, axis=0)
    d1, d3 = points - x, points - z
    r1, r3 = np.linalg.norm(d1, axis=1), np.linalg.norm(d3, axis=1)
    facing = (d1 * normal).sum(axis=1) * (d3 * normal).sum(axis=1)
    light = area * np.maximum(facing, 0.0) * np.abs(d1[:, 0] * d3[:, 0]) / (r1 * r3) ** 4
    mean, path = light.mean() or 1.0, r1 + r3
    middle = (light * path).mean() / mean
    return float(light.sum()), float(middle), float((light * (path - middle) ** 2).mean() / mean)


def sides_turned(tree: Hierarchy, k: int, x: np.ndarray, z: np.ndarray) -> int:
    """1 where all of a cluster turns one side to both, −1 where another to each, 0 where that is not certain."""
    (middle, radius), row = ball(tree.box, k), int(tree.cluster[k])
    cosine = float(tree.moment[row, 18])
    cone = radius, tuple(tree.moment[row, 15:18]), cosine, max(1 - cosine**2, 0.0) ** 0.5
    return side_turned(tuple(x - middle), *cone) * side_turned(tuple(z - middle), *cone)


def of_cluster(tree: Hierarchy, k: int, x: np.ndarray, z: np.ndarray) -> tuple[float, float, float, float, float]:
    """The same from its moments, with the error that these are given and the size relative to the distance."""
    row = int(tree.cluster[k])
    sides = sides_turned(tree, k, x, z)
    place, n, tilt, unlike, h, longer, apart = as_one(tree.moment, row, tuple(x), tuple(z), sides, True, 0.8, 1e-3)
    d1, d3 = np.array(place) - x, np.array(place) - z
    r1, r3 = np.linalg.norm(d1), np.linalg.norm(d3)
    first, last = tree.span[k]
    area = tree.area[last] - tree.area[first]
    light = area * tilt * (d1 @ n) * (d3 @ n) * abs(d1[0] * d3[0]) / (r1 * r3) ** 4
    return light, r1 + r3 + longer, apart**2 / 6, unlike, h / min(r1, r3)


def test_one_cell_for_a_cluster_is_right_to_second_order() -> None:
    """Light, mean arrival and its spread, from two points of a wall, for clusters of all sizes."""
    _, tree = bumpy(24)
    x, z = np.array([0.0, -0.4, 1.2]), np.array([0.0, 0.3, 1.9])
    rows = []
    for k in np.flatnonzero(tree.cluster >= 0):
        if sides_turned(tree, k, x, z) == 1:
            (light, path, variance), found = of_each(tree, k, x, z), of_cluster(tree, k, x, z)
            rows.append((found[0] / light - 1, found[1] - path, found[2] / variance - 1, found[3], found[4], light))
    wrong, late, wide, unlike, size, light = np.array(rows).T
    assert len(rows) > 500 and size.max() > 0.1
    # A triangle's cell of that size is given an error of size² for each of its two legs; what is seen from its edge,
    # and dim, changes by more.
    assert (np.abs(wrong) <= size**2).mean() > 0.95
    assert (np.abs(wrong) <= unlike + 2 * size**2 + size).all()
    for low, high in ((0.03, 0.06), (0.06, 0.12), (0.12, 0.3)):
        some = (size >= low) & (size < high)
        square = light[some] @ size[some] ** 2
        assert light[some] @ np.abs(wrong[some]) < 0.4 * square
        assert light[some] @ np.abs(late[some]) < 0.8 * square
    assert np.median(np.abs(wide)) < 0.1


@pytest.mark.parametrize("z", [(0.0, 1.4, 0.2), (2.9, 1.4, 0.2)])
def test_of_a_cluster_with_two_outlines_the_light_is_bounded(z: tuple[float, float, float]) -> None:
    """Faces that turn one side to the laser point and the other to the pixel bring nothing: what may be missing or
    too much is within what is said, but for a share of second order of what it would bring if it faced both."""
    _, tree = bumpy(12)
    x, to = np.array([0.0, -1.4, 1.2]), np.array(z)
    checked = 0
    for k in np.flatnonzero(tree.cluster >= 0):
        light, found = of_each(tree, k, x, to)[0], of_cluster(tree, k, x, to)
        if sides_turned(tree, k, x, to) == 0 and found[0] > 0:
            checked += 1
            first, last = tree.span[k]
            d1, d3 = AT - x, AT - to
            faced = (tree.area[last] - tree.area[first]) * abs(d1[0] * d3[0]) / np.linalg.norm(d1) ** 3
            faced /= np.linalg.norm(d3) ** 3
            assert abs(found[0] - light) <= found[3] * found[0] + found[4] ** 2 * faced
    assert checked > 50


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
    assert off(found.total, truth.total) < found.relative_error
    assert off(found.parts["mesh"], truth.parts["mesh"]) < found.part_errors["mesh"] < 0.05


def test_a_mesh_of_a_hundred_thousand_triangles_costs_its_detail() -> None:
    """As many cells as for a hundredth of them, but for the detail that these have."""
    few, many = (with_lump(quads, 50) for quads in (9, 91))
    assert few.spend is not None and many.spend is not None
    assert many.spend.lookins["primary"] < 6 * few.spend.lookins["primary"]
    assert off(many.parts["mesh"], with_lump(40, 400, 1).parts["mesh"]) < 0.1


def test_a_flat_mesh_is_the_rectangle_that_it_covers() -> None:
    """Of 8 192 triangles and of two: light and shadow."""
    corners = np.array([[1.2, -0.5, 1.0], [1.4, 0.3, 0.9], [1.3, 0.4, 1.7], [1.1, -0.4, 1.8]])
    plain = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    fine = plain
    for _ in range(6):
        fine = fine.subdivide()
    scenes = (furnished_room(more=[Part("plate", mesh, Lambertian(0.6))]) for mesh in (plain, fine))
    one, other = (simulate(s, scan(3), Accuracy(target=0.02, max_bounces=3), split_parts=True) for s in scenes)
    assert off(other.total, one.total) < one.relative_error + other.relative_error
    for name in one.part_errors:
        assert off(other.parts[name], one.parts[name]) < one.part_errors[name] + other.part_errors[name]


def test_an_object_that_is_nearly_hidden_is_told_and_not_chased() -> None:
    """The device stands in a closed mesh: what comes out at its seams is a millionth of the light, and would take any
    number of rays to find."""
    scene = furnished_room(more=[lump("mesh", (1.6, -0.2, 1.5), 0.4, 9)])
    found = simulate(scene, scan(4), Accuracy(target=0.02, max_bounces=3), split_parts=True)
    assert found.spend is not None and found.spend.way["primary"] == "cells"
    assert found.met_target is False and "but for an object" in found.spend.outcome
    assert found.relative_error < 0.02 and found.part_errors["mesh"] < 0.05 < found.part_errors["pillar"]
    assert found.parts["pillar"].sum() < 1e-5 * found.total.sum()
