"""Whether surfaces of different parts lie in one place, so that no one can say which of them light meets.

Cells take the part that comes last in the scene, as a poster hangs on a wall; rays take either, as rounding has it.
"""

from __future__ import annotations

import itertools

import numpy as np

from datagen.records import Scene
from datagen.records.arrays import Bools, Floats
from datagen.transport.memory import VALUES_AT_ONCE
from datagen.transport.visibility.raycast import Raycaster

PLANE, APART = 1e-6, 1e-7
"""Distance between planes, and depth of an overlap in the plane, relative to the scene, that are still none."""
PAIRS, LOOKED_FROM = 64, 16
"""Pairs of triangles of two parts in a plane, and laser points, that are looked at: what a tenth of a shared surface
would show is found with half of them."""


def lit_in_one_place(scene: Scene, caster: Raycaster, laser_points: Floats) -> bool:
    """Whether surfaces of two parts lie in one place that some laser point (L, 3) lights.

    What stands on a floor lies on it, too, where nothing can be seen: that counts for nothing.
    """
    places, normals = places_shared(scene)
    some = laser_points[np.linspace(0, len(laser_points) - 1, min(len(laser_points), LOOKED_FROM)).astype(int)]
    for side in (1.0, -1.0):
        ends = np.tile(places + side * 2 * caster.offset_m * normals, (len(some), 1))
        if len(ends) and not caster.occluded(np.repeat(some, len(places), axis=0), ends).all():
            return True
    return False


def places_shared(scene: Scene) -> tuple[Floats, Floats]:
    """(n, 3) places where triangles of two parts lie in one plane and overlap in more than an edge, and its normals.

    At most `PAIRS` pairs of triangles are looked at in each plane, in four places or more each.
    """
    corners, part = scene.corners, np.asarray(scene.face_part)
    low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    extent = float((high - low).max())
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    axis = np.abs(normal).argmax(axis=1)
    normal *= np.sign(normal[np.arange(len(axis)), axis])[:, None]
    offset = np.einsum("nk,nk->n", normal, corners[:, 0] - (low + high) / 2) / extent
    plane = np.column_stack([normal, offset]) / PLANE
    found = [np.zeros((0, 3))]
    normals = [np.zeros((0, 3))]
    # Planes are told apart by rounding, and by rounding half a step further on, so that none is split both times.
    for shift in (0.0, 0.5):
        _, group = np.unique(np.floor(plane + shift).astype(np.int64), axis=0, return_inverse=True)
        order = np.argsort(group.ravel(), kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(group.ravel()[order])) + 1):
            for one, two in itertools.combinations(np.unique(part[rows]), 2):
                flat = np.delete(corners, axis[rows[0]], axis=2) / extent
                ones, twos = rows[part[rows] == one], rows[part[rows] == two]
                for i, j in _overlapping(flat[ones], flat[twos]):
                    places = _common(corners[ones[i]], corners[twos[j]], normal[ones[i]])
                    found.append(places)
                    normals.append(np.broadcast_to(normal[ones[i]], places.shape))
    return np.concatenate(found), np.concatenate(normals)


def _overlapping(ones: Floats, twos: Floats) -> list[tuple[int, int]]:
    """Which of some triangles (n, 3, 2) overlap which of others (m, 3, 2), `PAIRS` of them at most."""
    found: list[tuple[int, int]] = []
    step = max(VALUES_AT_ONCE // len(twos), 1)
    for start in range(0, len(ones), step):
        some = ones[start : start + step]
        near = (some.min(axis=1)[:, None] < twos.max(axis=1) - APART) & (
            some.max(axis=1)[:, None] > twos.min(axis=1) + APART
        )
        i, j = np.nonzero(near.all(axis=2))
        keep = _not_separated(some[i], twos[j])
        found += [(start + int(a), int(b)) for a, b in zip(i[keep], j[keep], strict=True)]
        if len(found) >= PAIRS:
            break
    return found[:PAIRS]


def _common(one: Floats, two: Floats, normal: Floats) -> Floats:
    """(n, 3) places within both of two overlapping triangles (3, 3) of one plane: the middle of what they share, and
    halfway from there to its corners."""
    polygon = list(one)
    turn = np.sign(np.cross(two[1] - two[0], two[2] - two[0]) @ normal)
    for k in range(3):
        # What lies on the inner side of each side of the other triangle stays (Sutherland & Hodgman).
        inward = turn * np.cross(normal, two[(k + 1) % 3] - two[k])
        heights = [float((place - two[k]) @ inward) for place in polygon]
        kept = []
        for m, (a, h) in enumerate(zip(polygon, heights, strict=True)):
            b, g = polygon[m - 1], heights[m - 1]
            if (g > 0) != (h > 0):
                kept.append(b + (a - b) * g / (g - h))
            if h > 0:
                kept.append(a)
        polygon = kept
    middle = np.mean(polygon, axis=0)
    return np.array([middle, *(0.5 * (middle + place) for place in polygon)]) if polygon else np.zeros((0, 3))


def _not_separated(ones: Floats, twos: Floats) -> Bools:
    """(n,) whether no side of either triangle has the two (n, 3, 2) on different sides of it."""
    overlap = np.ones(len(ones), np.bool_)
    for triangle in (ones, twos):
        for k in range(3):
            side = triangle[:, (k + 1) % 3] - triangle[:, k]
            length = np.linalg.norm(side, axis=1)
            across = np.stack([-side[:, 1], side[:, 0]], axis=1) / np.where(length > 0, length, 1.0)[:, None]
            a, b = (np.einsum("nvk,nk->nv", of, across) for of in (ones, twos))
            overlap &= np.minimum(a.max(axis=1), b.max(axis=1)) - np.maximum(a.min(axis=1), b.min(axis=1)) > APART
    return overlap
