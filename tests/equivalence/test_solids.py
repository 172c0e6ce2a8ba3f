"""Which surfaces count as solids, against what algebra says of all pairs of their triangles."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from trimesh.creation import box

from datagen import Lambertian, Part, Scene
from datagen.transport.visibility.bvh import Hierarchy
from datagen.transport.visibility.closed_surfaces import NONE, SEVERAL
from scene_library.plates import union_plate


def tree_of(*meshes: trimesh.Trimesh) -> Hierarchy:
    """That of a scene in which each mesh is a part."""
    return Hierarchy.of(Scene.from_parts([Part(f"part {k}", mesh, Lambertian(0.5)) for k, mesh in enumerate(meshes)]))


def ball(radius: float = 1.0, at: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> trimesh.Trimesh:
    found = trimesh.creation.icosphere(subdivisions=1, radius=radius)
    found.apply_translation(at)
    return found


def of(vertices: np.ndarray, triangles: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, triangles, process=False)


def joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(meshes)


def turned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return of(mesh.vertices, mesh.faces[:, ::-1])


def letter() -> trimesh.Trimesh:
    """An H of three bars, whose sides meet several others on their way."""
    bars = [
        ((0.0, 0.0), (0.2, 0.0), (0.2, 1.0), (0.0, 1.0)), ((0.6, 0.0), (0.8, 0.0), (0.8, 1.0), (0.6, 1.0)),
        ((0.1, 0.4), (0.7, 0.4), (0.7, 0.6), (0.1, 0.6)),
    ]  # fmt: skip
    vertices, triangles = union_plate([np.array(bar) for bar in bars], 0.1)
    return of(np.asarray(vertices, np.float64), np.asarray(triangles))


def flipped() -> trimesh.Trimesh:
    """A ball of which one triangle is turned."""
    mesh = ball()
    faces = mesh.faces.copy()
    faces[0] = faces[0, ::-1]
    return of(mesh.vertices, faces)


def at_a_corner() -> trimesh.Trimesh:
    """Two boxes with one vertex in common, the other's triangles turned inwards."""
    one, other = box(), turned(box().apply_translation((1, 1, 1)))
    found = joined(one, other)
    found.merge_vertices()
    assert len(found.vertices) == 15
    return of(found.vertices, found.faces)


def dented(depth: float) -> trimesh.Trimesh:
    """A ball of which one vertex is moved inwards, or through the other side."""
    mesh = ball()
    vertices = mesh.vertices.copy()
    vertices[0] *= 1.0 - depth
    return of(vertices, mesh.faces)


def sheet() -> trimesh.Trimesh:
    """A square with two sides, closed but empty."""
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], np.float64)
    return of(corners, np.array([(0, 1, 2), (0, 2, 3), (2, 1, 0), (3, 2, 0)]))


def loose(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same with each triangle's vertices its own."""
    return of(np.asarray(mesh.triangles).reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))


SOLIDS = {
    "ball": (ball(), 1, 1), "turned inside out": (turned(ball()), 1, 1), "loose": (loose(ball()), 1, 1),
    "ring": (trimesh.creation.torus(1.0, 0.3, 12, 8), 1, 0), "dented": (dented(0.7), 1, 0),
    "two apart": (joined(ball(), ball(0.5, (3, 0, 0))), 2, 2),
    "two in each other": (joined(ball(), ball(0.8, (1, 0.1, 0.2))), 2, 2),
    "one in the other": (joined(ball(), turned(ball(0.5))), 2, 2),
    "two that share a face": (joined(box(), box().apply_translation((1, 0, 0))), 2, 2),
    "letter": (letter(), 1, 0), "two that share a corner, one turned": (at_a_corner(), 2, 2),
    "pierced": (dented(2.5), 0, 0), "folded flat": (sheet(), 0, 0), "one triangle turned": (flipped(), 0, 0),
    "open": (of(ball().vertices, ball().faces[1:]), 0, 0),
    "one of them open": (joined(ball(), of(ball(0.5, (3, 0, 0)).vertices, ball().faces[1:])), 1, 1),
}  # fmt: skip


@pytest.mark.parametrize("case", SOLIDS)
def test_what_is_a_solid(case: str) -> None:
    """How many, how many of them convex, and the volumes that outward normals give."""
    mesh, count, convex = SOLIDS[case]
    tree = tree_of(mesh)
    found = np.unique(tree.solid[tree.solid >= 0])
    assert len(found) == count
    assert tree.convex[found].sum() == convex
    for s in found:
        a, b, c = np.moveaxis(tree.corners[tree.solid == s], 1, 0)
        assert (a * tree.normal[tree.solid == s]).sum(axis=1) @ np.diff(tree.area)[tree.solid == s] > 0
        np.testing.assert_array_less(tree.solid_box[s, :3], np.minimum(np.minimum(a, b), c).min(axis=0))
        np.testing.assert_array_less(np.maximum(np.maximum(a, b), c).max(axis=0), tree.solid_box[s, 3:])


def test_boxes_say_whose_triangles_they_hold() -> None:
    """A box is of a solid if all in it is, of none if nothing in it is, else of several."""
    tree = tree_of(joined(ball(), ball(0.8, (1, 0.1, 0.2)), sheet().apply_translation((0.0, 3.0, 0.0))), sheet())
    for k, (first, last) in enumerate(tree.span):
        own = np.unique(tree.solid[first:last])
        assert tree.of_box[k] == (own[0] if len(own) == 1 else SEVERAL)
    assert {NONE, SEVERAL, 0, 1} <= set(tree.of_box.tolist())


def crossing(mesh: trimesh.Trimesh) -> bool:
    """Whether a side of any triangle crosses another triangle that has neither of its ends, in plain algebra."""
    corners, faces = np.asarray(mesh.triangles), mesh.faces
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    a, d = mesh.vertices[ends[:, 0]][:, None], (mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]])[:, None]
    b, c, s = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], a - corners[:, 0]
    p, q = np.cross(d, c), np.cross(s, b)
    own = (ends[:, None, :, None] == faces[None, :, None, :]).any(axis=(2, 3))
    with np.errstate(all="ignore"):
        u, v, t = np.array([(s * p).sum(axis=2), (d * q).sum(axis=2), (c * q).sum(axis=2)]) / (b * p).sum(axis=2)
        return bool(((u > 0) & (v > 0) & (u + v < 1) & (t > 0) & (t < 1) & ~own).any())


def test_what_pierces_itself_is_none() -> None:
    """Balls whose vertices are moved at random, by little or by much."""
    rng, pierced = np.random.default_rng(5), []
    for amount in np.repeat([0.0, 0.1, 0.2, 0.3, 0.4, 0.6], 6):
        mesh = ball()
        mesh = of(mesh.vertices + amount * rng.normal(size=mesh.vertices.shape), mesh.faces)
        pierced.append(crossing(mesh))
        assert (tree_of(mesh).solid == NONE).all() == pierced[-1], amount
    assert 6 < sum(pierced) < 30
