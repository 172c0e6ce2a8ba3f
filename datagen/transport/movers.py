"""Parts that move, as rays and compiled loops see them: meshes that stay, with a pose for each frame and laser point.

A sequence never builds its scene anew. The static room has one tree and one ray caster, each mover one of its own; a
ray that is to meet a mover is carried to where the mover's mesh stands, by the inverse of the mover's pose.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records import Moves, Scene
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.geometry import get, put
from datagen.transport.rays import Raycaster

STANDS = np.array([1.0, 0.0, 0.0, 0.0, 0.0])
"""The pose of what stands."""
Floats32 = NDArray[np.float32]


class Mover(NamedTuple):
    """A part that moves.

    name, part : its name, and its number in the scene of all parts. vertices, triangles : (V, 3), (T, 3) its mesh, as
    it stands at time 0. pose : (S, F, L, 5) at S instants of each frame's and laser point's exposure: cosine and
    sine of the turn, and the shift, metres, that take the mesh to where it is then. embree : the mesh, in the frame
    of the static room.
    """

    name: str
    part: int
    vertices: Floats
    triangles: Ints
    pose: Floats
    embree: EmbreeScene

    def hides(self, origin: Floats32, span: Floats32) -> Bools:
        """(n,) whether the mesh, where it stands at time 0, is between `origin` and `origin + span`, (n, 3) in
        embree's frame."""
        reach = np.ones(len(origin), np.float32)
        return np.asarray(self.embree.run(origin, span, dists=reach, query="OCCLUDED") >= 0)


def pose_of(moves: Moves) -> Floats:
    """(…, 5) cosine and sine of the turn, and the shift, of some moves."""
    turn = np.stack([np.cos(moves.turns_rad), np.sin(moves.turns_rad)], axis=-1)
    return np.concatenate([turn, moves.shifts_m], axis=-1)


def movers_of(scene: Scene, caster: Raycaster, instants: Floats, first: int) -> list[Mover]:
    """The parts of a scene that move, at instants (S, F, L).

    caster : of the static room. first : the number of the first of them in the scene of all parts.
    """
    found = []
    for number, name in enumerate(scene.moving):
        used, triangles = np.unique(scene.triangles[scene.faces_of(name)], return_inverse=True)
        vertices, triangles = scene.vertices[used], triangles.reshape(-1, 3)
        embree = EmbreeScene()
        TriangleMesh(embree, caster._scaled(vertices), triangles.astype(np.int32))
        pose = pose_of(scene.moves(name, instants))
        found.append(Mover(name, first + number, vertices, triangles.astype(np.int64), pose, embree))
    return found


def movers_last(scene: Scene, static: Scene) -> Scene:
    """The parts of `static` with the movers of `scene` behind them, so that triangles and parts of both keep the
    numbers that they have in `static`."""
    gone = [name for name in scene.part_names if name not in scene.moving]
    movers = scene.without(*gone)
    k, v = len(static.part_names), len(static.vertices)
    return replace(
        static, vertices=np.concatenate([static.vertices, movers.vertices]),
        triangles=np.concatenate([static.triangles, movers.triangles + np.int32(v)]).astype(np.int32),
        face_part=np.concatenate([static.face_part, movers.face_part + np.int32(k)]).astype(np.int32),
        part_names=static.part_names + movers.part_names, materials=(*static.materials, *movers.materials),
        roles=static.roles + movers.roles, poses={}, paths={},
    )  # fmt: skip


@compiled(forceinline=True, allocates=False)
def place_after(pose, p):  # type: ignore[no-untyped-def]
    """The point p after the move of a pose (5,)."""
    return (pose[0] * p[0] - pose[1] * p[1] + pose[2], pose[1] * p[0] + pose[0] * p[1] + pose[3], p[2] + pose[4])


@compiled(forceinline=True, allocates=False)
def direction_before(pose, v):  # type: ignore[no-untyped-def]
    """The direction v before the turn of a pose."""
    return (pose[0] * v[0] + pose[1] * v[1], pose[0] * v[1] - pose[1] * v[0], v[2])


@compiled(forceinline=True, allocates=False)
def place_before(pose, p):  # type: ignore[no-untyped-def]
    """The point p before the move of a pose."""
    return direction_before(pose, (p[0] - pose[2], p[1] - pose[3], p[2] - pose[4]))


@compiled(allocates=False)
def _set_before(pose, values, out, is_place):  # type: ignore[no-untyped-def]
    """Sets out (n, 3) to places or directions (n, 3) before the moves of poses (n, 5)."""
    for k in range(len(out)):
        v = get(values, k, 0)
        put(out, k, 0, place_before(pose[k], v) if is_place else direction_before(pose[k], v))


def places_before(pose: Floats, places: Floats) -> Floats:
    """(n, 3) places before the moves of poses (n, 5), from those after them."""
    out = np.empty(places.shape)
    _set_before(pose, places, out, True)
    return out


def directions_before(pose: Floats, directions: Floats) -> Floats:
    """(n, 3) directions before the turns of poses (n, 5), from those after them."""
    out = np.empty(directions.shape)
    _set_before(pose, directions, out, False)
    return out
