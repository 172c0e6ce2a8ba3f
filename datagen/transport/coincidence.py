"""Surfaces of different parts in one place: the scene in which one of them lies on the other, for every way alike.

Where two surfaces coincide, rays meet one or the other by rounding, and points drawn on either would be lit. So the
part that lies on the other is moved off it, by a hair (`LIFT`), to the side that light comes from: from then on all
rays meet this part first, and it hides the other. Objects lie on walls, floor and ceiling; of two parts of one role
the one that comes later in the scene lies on the other, as a poster hangs on a wall.

Where no light gets to, as between the bottom of a box and the floor, nothing is moved.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.records import Capture, Scene
from datagen.records.arrays import Floats, Ints, rows_of
from datagen.transport.memory import in_calls
from datagen.transport.rays import Raycaster

PLANE = 1e-6
"""Distance between two planes, relative to the scene's largest side, up to which they count as one, because rays of
single precision confuse them."""
APART = 1e-7
"""Depth of an overlap in a plane, relative to the scene's largest side, up to which triangles only touch: about the
rounding error of coordinates in single precision."""
LIFT = 3.0
"""Distance by which a part is lifted off the one that it lies on, in units of `Raycaster.offset_m`, 30 µm in a room
of 10 m: more than the ends of shadow rays are lifted, so that the part below is hidden."""
CLEAR = 100.0
"""Distance to the nearest other surface, in units of `Raycaster.offset_m`, 1 mm in a room of 10 m, under which a
place is not asked for light: rays of single precision may leak there."""
LOOKS = 16
"""Most places of a shared plane where light is looked for, most laser points that it is looked for from, and rays
from a place that meet surfaces which may pass it on: a shared surface of which a tenth is lit is found."""
MOST_LOOKED_AT = 512
"""Most triangles of a part in a plane, of those beside the other part's, that are looked at: a plane may have 10⁵."""


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
    caster : of its triangles.
    lying : (part, part that it lies on), each pair once.
    """

    scene: Scene
    caster: Raycaster
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

    def rank(part: int) -> tuple[bool, int]:
        return scene.roles[part] == "object", part

    caster, shared = Raycaster(scene), list(shared_planes(scene))
    if not shared:
        return Apart(scene, caster, ())
    sources = _sources(caster, capture)
    shared.sort(key=lambda plane: sorted((rank(plane.one), rank(plane.two)), reverse=True))
    # Each plane has rays to and from 16 places, and each place 16 rays.
    lit = [_count_lit(caster, shared[some], sources) for some in in_calls(len(shared), 8192)]
    vertices, triangles = scene.vertices, np.array(scene.triangles)
    # How often a triangle was lifted: what lies on something that lies on a third thing is lifted twice.
    level = np.zeros(len(triangles), np.int64)
    moves, lying = list[tuple[int, Ints, Floats]](), list[tuple[str, str]]()
    for plane, (front, back) in zip(shared, np.concatenate(lit), strict=True):
        if not front + back:
            continue
        of_one = rank(plane.one) > rank(plane.two)
        upper, lower = (plane.one, plane.two) if of_one else (plane.two, plane.one)
        rows, below = (plane.ones, plane.twos) if of_one else (plane.twos, plane.ones)
        height = int(level[below].max()) + 1
        level[rows] = np.maximum(level[rows], height)
        side = 1.0 if front >= back else -1.0
        moves.append((upper, rows, side * height * LIFT * caster.offset_m * plane.normal))
        pair = scene.part_names[upper], scene.part_names[lower]
        lying += [pair] if pair not in lying else []
    if not moves:
        return Apart(scene, caster, ())
    shift = np.zeros((len(vertices), 3))
    for part in sorted({part for part, _, _ in moves}):
        own = np.flatnonzero(scene.face_part == part)
        used, index = np.unique(triangles[own], return_inverse=True)
        triangles[own] = (len(vertices) + index).reshape(-1, 3)
        # Vertices of its own, as those of a part below must stay.
        vertices = np.concatenate([vertices, vertices[used]])
        shift = np.concatenate([shift, np.zeros((len(used), 3))])
    for _, rows, move in moves:
        used = np.unique(triangles[rows])
        length = float(np.linalg.norm(move))
        # A plane may have been found twice, and a corner lies in several planes.
        missing = length - shift[used] @ (move / length)
        shift[used] += np.maximum(missing, 0.0)[:, None] * (move / length)
    moved = replace(scene, vertices=vertices + shift, triangles=triangles)
    return Apart(moved, Raycaster(moved), tuple(lying))


def _sources(caster: Raycaster, capture: Capture) -> Floats:
    """(n, 3) places that light comes from or goes to: the device, and some laser points, lifted off their surface."""
    targets = capture.laser.targets
    some = targets[np.linspace(0, len(targets) - 1, min(len(targets), LOOKS)).astype(int)]
    hits = caster.closest(capture.laser.position, some - capture.laser.position)
    lifted = (hits.position + caster.offset_m * hits.normal)[hits.valid]
    return np.concatenate([lifted, capture.laser.position[None], capture.sensor.position[None]])


def _count_lit(caster: Raycaster, shared: list[Shared], sources: Floats) -> Ints:
    """(plane, side) how many lines lead from shared planes to the sources of light, directly or by one surface in
    between; the first side is that of the plane's normal."""
    some = [of.places[np.linspace(0, len(of.places) - 1, min(len(of.places), LOOKS)).astype(int)] for of in shared]
    plane = np.repeat(np.arange(len(shared)), [len(places) for places in some])
    normals = np.stack([of.normal for of in shared])[plane]
    side, up = np.concatenate([2 * plane, 2 * plane + 1]), np.concatenate([normals, -normals])
    starts = np.concatenate([*some, *some]) + 2.0 * caster.offset_m * up
    origins = np.repeat(starts, LOOKS, axis=0)
    hits = caster.closest(origins, _hemispheres(up).reshape(-1, 3))
    ways = np.where(hits.valid[:, None], hits.position - origins, np.inf)
    # Rays of a place at the very foot of another surface may begin beyond it.
    is_clear = (np.linalg.norm(ways, axis=1) > CLEAR * caster.offset_m).reshape(-1, LOOKS).all(axis=1)
    passing = np.flatnonzero(hits.valid & np.repeat(is_clear, LOOKS))
    # A point of the ray just before its hit, by far more than rounding: one lifted off the surface may be outside of
    # a solid, at its edge.
    before = origins[passing] + 0.999 * ways[passing]
    # A place looks at all sources, a ray from there at one of them: the next place's ray at the next.
    of_start, of_source = np.divmod(np.arange(is_clear.sum() * len(sources)), len(sources))
    ends = np.concatenate([sources[of_source], sources[(passing + passing // LOOKS) % len(sources)]])
    is_hidden = caster.occluded(np.concatenate([starts[is_clear][of_start], before]), ends)
    owner = np.concatenate([side[is_clear][of_start], side[passing // LOOKS]])
    return np.bincount(owner[~is_hidden], minlength=2 * len(shared)).reshape(-1, 2)


def _hemispheres(normals: Floats) -> Floats:
    """(n, LOOKS, 3) directions about normals (n, 3), evenly spread over heights and azimuths."""
    height = (np.arange(LOOKS) + 0.5) / LOOKS
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(LOOKS)
    right = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    axes = np.stack([right, np.cross(normals, right), normals], axis=1)
    across = np.sqrt(1.0 - height**2)
    return np.asarray(np.stack([across * np.cos(angle), across * np.sin(angle), height], axis=1) @ axes)


def shared_planes(scene: Scene) -> Iterator[Shared]:
    """The planes in which triangles of two parts overlap in more than an edge, for each two parts.

    A plane comes twice where its triangles are not the same in both groupings of `_in_one_plane`.
    """
    part, low, high = scene.face_part, scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    middle, extent = (low + high) / 2, float((high - low).max())
    corners = (scene.corners - middle) / extent
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # Triangles of one plane may face opposite ways: all are seen from one side, on which a direction leads that lies
    # in no plane but by chance.
    is_behind = normal @ (1.0, np.sqrt(2.0), np.sqrt(3.0)) < 0
    normal[is_behind] *= -1
    corners[is_behind] = corners[is_behind, ::-1]
    triangles = _Triangles.of(corners, normal)
    planes = np.column_stack([normal, np.einsum("nk,nk->n", normal, corners[:, 0])])
    for ones, twos in _in_one_plane(planes, part):
        beside = (_triangles_beside(triangles, *of) for of in ((ones, twos), (twos, ones)))
        few, many = sorted(beside, key=len)
        some = many[:: len(many) // MOST_LOOKED_AT + 1]
        calls = in_calls(len(some), 256 * len(few))
        found = [_common_places(rows_of(triangles, some[call]), rows_of(triangles, few)) for call in calls]
        places = np.concatenate([np.zeros((0, 3)), *found])
        if len(places):
            yield Shared(part[ones[0]], part[twos[0]], ones, twos, middle + extent * places, normal[ones[0]])


def _triangles_beside(triangles: _Triangles, ones: Ints, twos: Ints) -> Ints:
    """Numbers of those of the triangles `ones` that touch the box around all of the triangles `twos`."""
    of_twos = triangles.corners[twos].reshape(-1, 3)
    low, high = triangles.corners[ones].min(axis=1), triangles.corners[ones].max(axis=1)
    touches = (low <= of_twos.max(axis=0) + PLANE) & (high >= of_twos.min(axis=0) - PLANE)
    return np.asarray(ones[touches.all(axis=1)])


def _in_one_plane(planes: Floats, part: NDArray[np.int32]) -> Iterator[tuple[Ints, Ints]]:
    """Triangles of two parts each that lie in one of the `planes` (F, 4)."""
    seen = set[tuple[bytes, bytes]]()
    # Triangles are grouped into planes by rounding, and again by rounding half a step further on, so that no plane
    # is split both times.
    for shift in (0.0, 0.5):
        cells = np.floor(planes / PLANE + shift)
        order = np.lexsort((part, *cells.T))
        is_first = (cells[order[1:]] != cells[order[:-1]]).any(axis=1)
        is_shared = ~is_first & (part[order[1:]] != part[order[:-1]])
        group = np.append(0, np.cumsum(is_first))
        for number in np.unique(group[1:][is_shared]):
            rows = order[slice(*np.searchsorted(group, [number, number + 1]))]
            of_parts = np.split(rows, np.flatnonzero(np.diff(part[rows])) + 1)
            for ones, twos in itertools.combinations(of_parts, 2):
                if (key := (ones.tobytes(), twos.tobytes())) not in seen:
                    seen.add(key)
                    yield ones, twos


class _Triangles(NamedTuple):
    """Triangles of one plane, seen from one side. corners : (n, 3, 3), counter-clockwise. inward : (n, 3, 3) unit
    vectors across the sides, towards the inner one. offset : (n, 3) how far along them the sides lie."""

    corners: Floats
    inward: Floats
    offset: Floats

    @classmethod
    def of(cls, corners: Floats, normal: Floats) -> _Triangles:
        """Triangles from their corners and normals (n, 3)."""
        inward = np.cross(normal[:, None], _following(corners) - corners)
        inward /= np.linalg.norm(inward, axis=2, keepdims=True)
        return cls(corners, inward, np.einsum("nsk,nsk->ns", corners, inward))

    def heights(self, points: Floats) -> Floats:
        """(n, p, 3) how far inside of each side points (n, p, 3) lie."""
        return np.asarray(np.einsum("npk,nsk->nps", points, self.inward) - self.offset[:, None])


def _following(of_corners: Floats) -> Floats:
    """(n, 3, …) what belongs to the corner that follows each of a triangle's corners."""
    return np.roll(of_corners, -1, axis=1)


def _common_places(ones: _Triangles, twos: _Triangles) -> Floats:
    """(n, 3) places that lie in one of the triangles `ones` and in one of `twos`. Of each two that overlap they are
    the middle of the polygon that the two share, and the points halfway from there to its corners."""
    low, high = twos.corners.min(axis=1) - PLANE, twos.corners.max(axis=1) + PLANE
    near = (ones.corners.min(axis=1)[:, None] < high) & (ones.corners.max(axis=1)[:, None] > low)
    # Few pairs of bounding boxes touch.
    i, j = np.nonzero(near.all(axis=2))
    ones, twos = rows_of(ones, i), rows_of(twos, j)
    of_ones, of_twos = twos.heights(ones.corners), ones.heights(twos.corners)
    # The polygon's corners are those of either triangle that lie in the other, and the crossings of their sides.
    ahead = _following(of_ones)
    crosses = ((of_ones > 0) != (ahead > 0)) & ((of_twos > 0) != (_following(of_twos) > 0)).swapaxes(1, 2)
    share = np.divide(of_ones, of_ones - ahead, out=np.zeros_like(of_ones), where=crosses)[..., None]
    crossings = (1 - share) * ones.corners[:, :, None] + share * _following(ones.corners)[:, :, None]
    corners = np.concatenate([ones.corners, twos.corners, crossings.reshape(-1, 9, 3)], axis=1)
    inside = [(heights > -APART).all(axis=2) for heights in (of_ones, of_twos)]
    is_corner = np.concatenate([*inside, crosses.reshape(-1, 9)], axis=1)
    middle = np.einsum("nc,nck->nk", is_corner, corners) / np.maximum(is_corner.sum(axis=1), 1)[:, None]
    middle = middle[:, None]
    # Triangles that only touch have no middle.
    overlaps = np.minimum(ones.heights(middle), twos.heights(middle)).min(axis=2) > APART
    return np.concatenate([middle[overlaps], ((middle + corners) / 2)[is_corner & overlaps]])
