"""Rays against triangles: embree in single precision, hit points in double.

Embree computes in float32, so the scene is centred and scaled to unit size first: a room is as exact at 10 km from
the origin, or at 0.1 m across, as anywhere else. Where a ray met a triangle is then recomputed in float64 from the
triangle's plane, so that path lengths carry no float32 noise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records import Scene
from datagen.records.arrays import Bools, Floats
from datagen.transport.geometry import put, subtract
from datagen.transport.memory import in_calls

SURFACE_OFFSET = 2e-6
"""Distance, in units of the scene's half extent, by which ray ends are lifted off their surface, so that it does not
hide itself: some twenty float32 roundings at unit size, and 10 µm in a room of 10 m."""


class Hits(NamedTuple):
    """First surfaces along rays.

    face : (n,) int32 triangle index, −1 where the ray met nothing.
    position : (n, 3) metres; undefined where nothing was met.
    normal : (n, 3) unit normal of the triangle, turned to face the ray's origin.
    """

    face: NDArray[np.int32]
    position: Floats
    normal: Floats

    @property
    def valid(self) -> Bools:
        """(n,) whether anything was met."""
        return self.face >= 0


class Raycaster:
    """Closest-hit and occlusion queries against one scene; all points in the scene's metres."""

    def __init__(self, scene: Scene) -> None:
        low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
        self.center: Floats = (low + high) / 2
        self.half_extent_m = float((high - low).max()) / 2
        self.corners: Floats = scene.corners
        doubled = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        length = np.linalg.norm(doubled, axis=1)
        self.face_area_m2: Floats = length / 2
        self.face_normal: Floats = doubled / length[:, None]
        self._embree = EmbreeScene()
        TriangleMesh(self._embree, self._scaled(scene.vertices), scene.triangles.astype(np.int32))

    @property
    def offset_m(self) -> float:
        """How far ray ends are lifted off their surfaces, metres."""
        return SURFACE_OFFSET * self.half_extent_m

    @property
    def frame(self) -> tuple[float, ...]:
        """Centre and half extent of embree's unit frame, metres."""
        return (*map(float, self.center), self.half_extent_m)

    def closest(self, origins: Floats, directions: Floats) -> Hits:
        """First surface along each ray: origins (n, 3) metres, off any surface; directions (n, 3) of any length."""
        # A copy, so that `_refine` is compiled for one layout.
        origins = np.array(np.broadcast_to(origins, directions.shape), order="C")
        return self._hits(origins, origins, directions)

    def leaving(self, positions: Floats, normals: Floats, directions: Floats) -> Hits:
        """First surface along rays that leave a surface: positions (n, 3) on it, unit normals and directions (n, 3).

        Only which triangle is met is found from a little above the surface; where the ray meets the triangle's plane
        is computed from `positions` themselves. So hits have the density of rays from there, even at the foot of a
        wall that is nearer than the rays are lifted, and no light that leaves a point beside an edge is lost.
        """
        return self._hits(positions + self.offset_m * normals, positions, directions)

    def _hits(self, starts: Floats, origins: Floats, directions: Floats) -> Hits:
        """Hits from origins (n, 3), of triangles that are met from `starts`; all in metres."""
        face = np.empty(len(directions), np.int32)
        for batch in in_calls(len(directions), 8):
            face[batch] = self.closest_scaled(self._scaled(starts[batch]), directions[batch].astype(np.float32))
        position, normal = np.empty((2, len(face), 3))
        _refine(face, origins, directions, self.corners, self.face_normal, position, normal)
        return Hits(face, position, normal)

    def closest_scaled(self, origins: NDArray[np.float32], directions: NDArray[np.float32]) -> NDArray[np.int32]:
        """First triangle along rays already in embree's unit frame, −1 for none; origins, directions (n, 3)."""
        return np.asarray(self._embree.run(origins, directions, query="INTERSECT"), np.int32)

    def occluded(self, origins: Floats, targets: Floats) -> Bools:
        """(n,) whether anything stands between each origin and target, (n, 3) metres, both off their surfaces."""
        hidden = np.empty(len(targets), np.bool_)
        origins = np.broadcast_to(origins, targets.shape)
        for batch in in_calls(len(targets), 8):
            # The span is taken between the rounded ends, so that the ray ends where the target was rounded to.
            o = self._scaled(origins[batch])
            hidden[batch] = self.occluded_scaled(o, self._scaled(targets[batch]) - o)
        return hidden

    def occluded_scaled(self, origins: NDArray[np.float32], spans: NDArray[np.float32]) -> Bools:
        """(n,) whether anything stands between `origins` and `origins + spans`, (n, 3) in embree's unit frame."""
        reach = np.ones(len(origins), np.float32)
        return np.asarray(self._embree.run(origins, spans, dists=reach, query="OCCLUDED") >= 0)

    def _scaled(self, points: Floats) -> NDArray[np.float32]:
        """(n, 3) points in embree's unit frame, from metres."""
        return ((points - self.center) / self.half_extent_m).astype(np.float32)


@compiled()
def lifted_and_scaled(p, n, offset, frame):  # type: ignore[no-untyped-def]
    """The point p + offset · n, metres, in embree's unit frame; frame : its centre and half extent, metres."""
    return (
        np.float32((p[0] + offset * n[0] - frame[0]) / frame[3]),
        np.float32((p[1] + offset * n[1] - frame[1]) / frame[3]),
        np.float32((p[2] + offset * n[2] - frame[2]) / frame[3]),
    )


@compiled()
def write_shadow_ray(origin, span, k, a, b):  # type: ignore[no-untyped-def]
    """Write the ray between points a and b, lifted and scaled, to row k of origins and spans (n, 3)."""
    # The span is taken between the rounded ends, so that the ray ends where the target was rounded to.
    put(origin, k, 0, a)
    put(span, k, 0, subtract(b, a))


@compiled(allocates=False)
def _refine(
    face: NDArray[np.int32], origins: Floats, directions: Floats, corners: Floats, face_normal: Floats,
    position: Floats, normal: Floats,
) -> None:  # fmt: skip
    """Set positions and facing normals in double; a hit edge-on, where the plane gives no distance, becomes none."""
    for i in range(len(face)):
        f = face[i]
        # Zeros rather than what happens to be in memory, so that results repeat.
        if f < 0:
            for k in range(3):
                position[i, k] = normal[i, k] = 0.0
            continue
        approach = 0.0
        height = 0.0
        for k in range(3):
            approach += face_normal[f, k] * directions[i, k]
            height += face_normal[f, k] * (corners[f, 0, k] - origins[i, k])
        # Only the triangle is embree's answer; how far it is follows from its plane, in double precision.
        distance = height / approach if approach != 0.0 else -1.0
        if not 0.0 < distance < np.inf:
            face[i] = -1
            distance = 0.0
        # Surfaces have two sides: the normal is turned against the ray.
        sign = -1.0 if approach > 0.0 else 1.0
        for k in range(3):
            position[i, k] = origins[i, k] + distance * directions[i, k]
            normal[i, k] = sign * face_normal[f, k]
