"""Whether surfaces of different parts lie in the same place, so that it is not defined which of them light meets.

Surface elements take the part that comes last in the scene, as a poster hangs on a wall; rays meet one or the other,
by rounding.
"""

from __future__ import annotations

import itertools

import numpy as np

from datagen.records import Scene
from datagen.records.arrays import Bools, Floats
from datagen.transport.memory import VALUES_AT_ONCE
from datagen.transport.visibility.raycast import Raycaster

PLANE, APART = 1e-6, 1e-7
"""Distance between two planes up to which they count as one, and depth of an overlap in the plane up to which
triangles only touch; both relative to the scene's largest side. With half of them, surfaces that rays of single
precision confuse are less surely found."""
PAIRS, LOOKED_FROM = 64, 16
"""Most pairs of triangles of two parts that are tried in a plane, and most laser points: half of them still find a
shared surface of which a tenth is lit."""


def lit_in_one_place(scene: Scene, caster: Raycaster, laser_points: Floats) -> bool:
    """Whether surfaces of two parts lie in the same place, and one of the laser points (L, 3) lights that place.

    The bottom of a box that stands on a floor lies on the floor, too, but no light gets there: this does not count.
    """
    places, normals = places_shared(scene)
    points = laser_points[np.linspace(0, len(laser_points) - 1, min(len(laser_points), LOOKED_FROM)).astype(int)]
    # Light may come from either side of the plane.
    for side in (1.0, -1.0):
        ends = np.tile(places + side * 2 * caster.offset_m * normals, (len(points), 1))
        if len(ends) and not caster.occluded(np.repeat(points, len(places), axis=0), ends).all():
            return True
    return False


def places_shared(scene: Scene) -> tuple[Floats, Floats]:
    """(n, 3) places, metres, where triangles of two parts lie in one plane and overlap in more than an edge; and
    (n, 3) unit normals of the plane there.

    At most `PAIRS` pairs of triangles of each two parts are tried in each plane; each pair gives four or more places.
    """
    corners, part = scene.corners, np.asarray(scene.face_part)
    low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    extent = float((high - low).max())
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # Triangles of one plane may face opposite ways: the largest component of their normals is made positive.
    axis = np.abs(normal).argmax(axis=1)
    normal *= np.sign(normal[np.arange(len(axis)), axis])[:, None]
    offset = np.einsum("nk,nk->n", normal, corners[:, 0] - (low + high) / 2) / extent
    plane = np.column_stack([normal, offset]) / PLANE
    places_found, normals = [np.zeros((0, 3))], [np.zeros((0, 3))]
    # Triangles are grouped into planes by rounding, and again by rounding half a step further on, so that no plane
    # is split both times.
    for shift in (0.0, 0.5):
        _, group = np.unique(np.floor(plane + shift).astype(np.int64), axis=0, return_inverse=True)
        order = np.argsort(group.ravel(), kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(group.ravel()[order])) + 1):
            for one, two in itertools.combinations(np.unique(part[rows]), 2):
                # Along the axis that the plane faces most, its triangles are projected without becoming needles.
                flat = np.delete(corners, axis[rows[0]], axis=2) / extent
                ones, twos = rows[part[rows] == one], rows[part[rows] == two]
                for i, j in _overlapping(flat[ones], flat[twos]):
                    places = _common(corners[ones[i]], corners[twos[j]], normal[ones[i]])
                    places_found.append(places)
                    normals.append(np.broadcast_to(normal[ones[i]], places.shape))
    return np.concatenate(places_found), np.concatenate(normals)


def _overlapping(ones: Floats, twos: Floats) -> list[tuple[int, int]]:
    """Index pairs of triangles `ones` (n, 3, 2) and `twos` (m, 3, 2) that overlap, at most `PAIRS` of them."""
    found: list[tuple[int, int]] = []
    step = max(VALUES_AT_ONCE // len(twos), 1)
    for start in range(0, len(ones), step):
        batch = ones[start : start + step]
        # Few pairs of bounding rectangles overlap; only for these the sides of the triangles are compared.
        near = (batch.min(axis=1)[:, None] < twos.max(axis=1) - APART) & (
            batch.max(axis=1)[:, None] > twos.min(axis=1) + APART
        )
        i, j = np.nonzero(near.all(axis=2))
        keep = _not_separated(batch[i], twos[j])
        found += [(start + int(a), int(b)) for a, b in zip(i[keep], j[keep], strict=True)]
        if len(found) >= PAIRS:
            break
    return found[:PAIRS]


def _common(one: Floats, two: Floats, normal: Floats) -> Floats:
    """(n, 3) places within both of two overlapping triangles (3, 3) of one plane: the middle of the polygon that they
    share, and the points halfway from there to the polygon's corners."""
    polygon = list(one)
    turn = np.sign(np.cross(two[1] - two[0], two[2] - two[0]) @ normal)
    for k in range(3):
        # The polygon is cut along each side of the other triangle, and the inner piece kept (Sutherland & Hodgman).
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
    """(n,) whether triangles `ones` and `twos` (n, 3, 2) overlap: no side of either separates them."""
    overlap = np.ones(len(ones), np.bool_)
    for triangle in (ones, twos):
        for k in range(3):
            side = triangle[:, (k + 1) % 3] - triangle[:, k]
            length = np.linalg.norm(side, axis=1)
            # Convex figures in a plane overlap unless their extents across some side do not.
            across = np.stack([-side[:, 1], side[:, 0]], axis=1) / np.where(length > 0, length, 1.0)[:, None]
            a, b = (np.einsum("nvk,nk->nv", of, across) for of in (ones, twos))
            overlap &= np.minimum(a.max(axis=1), b.max(axis=1)) - np.maximum(a.min(axis=1), b.min(axis=1)) > APART
    return overlap
