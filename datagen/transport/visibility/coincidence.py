"""Surfaces of different parts in one place: the scene in which one of them lies on the other, for every way alike.

Where two surfaces coincide, rays meet one or the other by rounding, and surface elements of both would be lit. So the
part that lies on the other is moved off it, by a hair (`LIFT`), to the side that light comes from: from then on it is
met first by all rays, and hides the other from all elements. Objects lie on walls, floor and ceiling; of two parts of
one role that comes later in the scene lies on the other, as a poster hangs on a wall.

Where no light gets to, as between the bottom of a box and the floor, nothing is moved.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from datagen.records import Capture, Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.memory import VALUES_AT_ONCE
from datagen.transport.visibility.raycast import Raycaster

PLANE, APART = 1e-6, 1e-7
"""Distance between two planes up to which they count as one, and depth of an overlap in the plane up to which
triangles only touch; both relative to the scene's largest side. Rays of single precision confuse such planes."""
LIFT = 3.0
"""Distance by which a part is lifted off the one that it lies on, in units of `Raycaster.offset_m`, 30 µm in a room
of 10 m: more than the ends of shadow rays are lifted, so that the part below is hidden."""
CLEAR = 100.0
"""Distance to the nearest other surface, in units of `Raycaster.offset_m`, 1 mm in a room of 10 m, under which a
place is not asked for light: rays of single precision may leak there."""
SHORT_OF = 1e-3
"""Share of a ray before its hit where the surface met is taken to be: far above rounding, and as near as makes no
difference to what is seen from there."""
PAIRS, PLACES, LOOKED_FROM, RAYS = 64, 16, 16, 16
"""Most pairs of triangles of two parts that are tried in a plane, most places where light is looked for in it, most
laser points that it is looked for from, and rays from each place that meet surfaces which may pass it on. They decide
about places that are lit at all; a shared surface of which a tenth is lit is still found with half of each."""


@dataclass(frozen=True)
class Shared:
    """A plane in which triangles of two parts overlap.

    Attributes
    ----------
    one, two : the parts' indices. ones, twos : their triangles in the plane.
    places : (n, 3) places within both, metres. normal : (3,) unit normal of the plane.
    """

    one: int
    two: int
    ones: Ints
    twos: Ints
    places: Floats
    normal: Floats


@dataclass(frozen=True)
class Apart:
    """A scene whose parts do not coincide where light gets to.

    Attributes
    ----------
    scene : the scene, the given one if nothing was moved.
    lying : (part, part that it lies on), each pair once.
    """

    scene: Scene
    lying: tuple[tuple[str, str], ...]

    @property
    def warning(self) -> str:
        """A line for users; "" if nothing coincides."""
        if not self.lying:
            return ""
        upper, lower = self.lying[0]
        more = f" (and {len(self.lying) - 1} more pairs of parts)" if len(self.lying) > 1 else ""
        return (
            f"parts {upper!r} and {lower!r} lie in one place{more}: {upper!r} is taken to lie on {lower!r}; move "
            "them apart by a millimetre, or cut one out of the other, if it is meant otherwise"
        )


def set_apart(scene: Scene, capture: Capture) -> Apart:
    """The scene of a capture, its parts moved off the parts that they coincide with, where light gets to."""
    shared = list(shared_planes(scene))
    if not shared:
        return Apart(scene, ())
    caster = Raycaster(scene)
    sources = _sources(caster, capture)
    vertices, triangles = scene.vertices, np.array(scene.triangles)
    # How often a triangle was lifted: what lies on something that lies on a third thing is lifted twice.
    level, moves, lying = (
        np.zeros(len(triangles), np.int64),
        list[tuple[int, Ints, Floats]](),
        list[tuple[str, str]](),
    )

    def rank(part: int) -> tuple[bool, int]:
        return scene.roles[part] == "object", part

    in_order = sorted(shared, key=lambda plane: sorted((rank(plane.one), rank(plane.two)), reverse=True))
    for plane in in_order:
        of_one = rank(plane.one) > rank(plane.two)
        upper, lower = (plane.one, plane.two) if of_one else (plane.two, plane.one)
        rows, below = (plane.ones, plane.twos) if of_one else (plane.twos, plane.ones)
        lit = [_lit(caster, plane, side, sources) for side in (1.0, -1.0)]
        if not any(lit):
            continue
        height = int(level[below].max()) + 1
        level[rows] = np.maximum(level[rows], height)
        side = 1.0 if lit[0] >= lit[1] else -1.0
        moves.append((upper, rows, side * height * LIFT * caster.offset_m * plane.normal))
        pair = scene.part_names[upper], scene.part_names[lower]
        lying += [pair] if pair not in lying else []
    if not moves:
        return Apart(scene, ())
    shift = np.zeros((len(vertices), 3))
    for part in sorted({part for part, _, _ in moves}):
        own = np.flatnonzero(scene.face_part == part)
        used, index = np.unique(triangles[own], return_inverse=True)
        triangles[own] = (len(vertices) + index).reshape(-1, 3)
        # Vertices of its own, as those of a part below must stay.
        vertices, shift = (
            np.concatenate([vertices, vertices[used]]),
            np.concatenate([shift, np.zeros((len(used), 3))]),
        )
    for _, rows, move in moves:
        moved = np.unique(triangles[rows])
        length = float(np.linalg.norm(move))
        # A plane may have been found twice, and a corner lies in several planes.
        missing = length - shift[moved] @ (move / length)
        shift[moved] += np.maximum(missing, 0.0)[:, None] * (move / length)
    return Apart(replace(scene, vertices=vertices + shift, triangles=triangles), tuple(lying))


def _sources(caster: Raycaster, capture: Capture) -> Floats:
    """(n, 3) places that light comes from or goes to: the device, and some laser points, lifted off their surface."""
    targets = capture.laser.targets
    some = targets[np.linspace(0, len(targets) - 1, min(len(targets), LOOKED_FROM)).astype(int)]
    hits = caster.closest(capture.laser.position, some - capture.laser.position)
    lifted = (hits.position + caster.offset_m * hits.normal)[hits.valid]
    return np.concatenate([lifted, capture.laser.position[None], capture.sensor.position[None]])


def _lit(caster: Raycaster, plane: Shared, side: float, sources: Floats) -> int:
    """How many lines lead from a side of a plane to the sources of light, directly or by one surface in between."""
    places = plane.places[np.linspace(0, len(plane.places) - 1, min(len(plane.places), PLACES)).astype(int)]
    starts = places + 2.0 * side * caster.offset_m * plane.normal
    origins = np.repeat(starts, RAYS, axis=0)
    hits = caster.closest(origins, np.tile(_hemisphere(side * plane.normal), (len(starts), 1)))
    ways = np.where(hits.valid[:, None], hits.position - origins, np.inf)
    # Rays of a place at the very foot of another surface may begin beyond it.
    is_clear = (np.linalg.norm(ways, axis=1) > CLEAR * caster.offset_m).reshape(-1, RAYS).all(axis=1)
    of_clear = hits.valid & np.repeat(is_clear, RAYS)
    # A point of the ray just before its hit: one lifted off the surface may be outside of a solid, at its edge.
    before = origins[of_clear] + (1.0 - SHORT_OF) * ways[of_clear]
    return _seen(caster, starts[is_clear], sources) + _seen(caster, before, sources)


def _seen(caster: Raycaster, places: Floats, sources: Floats) -> int:
    """How many pairs of a place (n, 3) and a source (m, 3) see each other."""
    starts = np.repeat(places, len(sources), axis=0)
    return int(np.count_nonzero(~caster.occluded(starts, np.tile(sources, (len(places), 1)))))


def _hemisphere(normal: Floats) -> Floats:
    """(RAYS, 3) directions about a normal, evenly spread over heights and azimuths."""
    height = (np.arange(RAYS) + 0.5) / RAYS
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(RAYS)
    right = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
    right /= np.linalg.norm(right)
    across = np.cos(angle)[:, None] * right + np.sin(angle)[:, None] * np.cross(normal, right)
    return np.asarray(height[:, None] * normal + np.sqrt(1.0 - height**2)[:, None] * across)


def shared_planes(scene: Scene) -> Iterator[Shared]:
    """The planes in which triangles of two parts overlap in more than an edge, for each two parts.

    At most `PAIRS` pairs of triangles of each two parts are tried in each plane; each pair gives four or more places.
    A plane may come twice.
    """
    corners, part = scene.corners, scene.face_part.astype(np.int64)
    low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    extent = float((high - low).max())
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # Triangles of one plane may face opposite ways: the largest component of their normals is made positive.
    axis = np.abs(normal).argmax(axis=1)
    normal *= np.sign(normal[np.arange(len(axis)), axis])[:, None]
    offset = np.einsum("nk,nk->n", normal, corners[:, 0] - (low + high) / 2) / extent
    plane = np.column_stack([normal, offset]) / PLANE
    # Triangles are grouped into planes by rounding, and again by rounding half a step further on, so that no plane
    # is split both times.
    for shift in (0.0, 0.5):
        for rows in _of_several_parts(np.floor(plane + shift).astype(np.int64), part):
            # Along the axis that the plane faces most, its triangles are projected without becoming needles.
            flat = np.delete(corners[rows], axis[rows[0]], axis=2) / extent
            for one, two in itertools.combinations(np.unique(part[rows]), 2):
                ones, twos = np.flatnonzero(part[rows] == one), np.flatnonzero(part[rows] == two)
                places = [
                    _common(corners[rows[ones[i]]], corners[rows[twos[j]]], normal[rows[ones[i]]])
                    for i, j in _overlapping(flat[ones], flat[twos])
                ]
                found = np.concatenate([np.zeros((0, 3)), *places])
                if len(found):
                    yield Shared(int(one), int(two), rows[ones], rows[twos], found, normal[rows[0]])


def _of_several_parts(planes: Ints, part: Ints) -> Iterator[Ints]:
    """The triangles of each of the `planes` (F, 4) in which triangles of more than one part lie."""
    order = np.lexsort((part, *planes.T))
    same_plane = (planes[order[1:]] == planes[order[:-1]]).all(axis=1)
    group = np.append(0, np.cumsum(~same_plane))
    several = np.unique(group[1:][same_plane & (part[order[1:]] != part[order[:-1]])])
    for number in several:
        first, last = np.searchsorted(group, [number, number + 1])
        yield np.sort(order[first:last])


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
