"""What may stand between two points of a scene, as few convex bodies: what the proofs of `clear_sight.py` test.

A wall with the whole scene on one side of its plane can hide nothing from anything that lies on that side, so it
needs no test: only that both ends of a connection lie on that side (the scene's *shell*). What remains are triangles,
or, where they are many, boxes about neighbouring ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datagen.transport.clear_sight_kernels import Bodies
from datagen.transport.raycast import Raycaster

PLANES_TRIED = 64
"""Planes, by the area that lies in them, that are tried as walls of the shell."""
SAME_PLANE = 1e-9
"""Planes that agree to this share of the scene's half extent are one: far closer than ray ends are lifted."""
TRIANGLES_AT_MOST = 256
"""With more than these the larger half of them stays, and boxes stand for the others."""
BOXES = 128


def occluders(caster: Raycaster) -> Bodies:
    """The shell's walls and the bodies within: all triangles, or the largest and boxes about the others."""
    shell, in_shell = _shell(caster)
    faces = np.flatnonzero(~in_shell)
    boxes = np.empty((0, 8, 3))
    if len(faces) > TRIANGLES_AT_MOST:
        faces = faces[np.argsort(-caster.face_area_m2[faces], kind="stable")]
        faces, small = faces[: TRIANGLES_AT_MOST // 2], faces[TRIANGLES_AT_MOST // 2 :]
        boxes = _boxes(caster.corners[small])
    corners = np.concatenate([caster.corners[faces][:, [0, 1, 2, 0, 0, 0, 0, 0]], boxes])
    normal = np.concatenate([caster.face_normal[faces], np.zeros((len(boxes), 3))])
    count = np.repeat([3, 8], [len(faces), len(boxes)])
    return Bodies(shell, count, corners, normal, corners.min(axis=1), corners.max(axis=1))


def _shell(caster: Raycaster) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Planes that have the whole scene on one side, and which triangles (F,) lie in them."""
    normal, points = caster.face_normal, caster.corners.reshape(-1, 3)
    largest = np.take_along_axis(normal, np.abs(normal).argmax(axis=1)[:, None], axis=1)
    normal = normal * np.sign(largest)
    height = np.einsum("fk,fk->f", caster.corners[:, 0] - caster.center, normal)
    keys = np.round(np.column_stack([normal, height / caster.half_extent_m]) / SAME_PLANE).astype(np.int64)
    # One word a plane sorts far quicker than four; planes that share a word by chance are told apart below.
    words = keys.astype(np.uint64) @ np.array(
        [0x9E3779B97F4A7C15, 0xD6E8FEB86659FD93, 0xC2B2AE3D27D4EB4F, 1], np.uint64
    )
    first, plane = np.unique(words, return_index=True, return_inverse=True)[1:]
    plane = plane.reshape(-1)
    in_shell = np.zeros(len(normal), np.bool_)
    walls = []
    slack = 1e-3 * caster.offset_m
    area = np.bincount(plane, caster.face_area_m2)
    for k in np.argsort(-area, kind="stable")[:PLANES_TRIED]:
        axis, level = normal[first[k]], float(normal[first[k]] @ caster.corners[first[k], 0])
        above = points @ axis - level
        own = plane == k
        if np.abs(above.reshape(-1, 3)[own]).max() > slack:
            continue
        for sign in (1.0, -1.0):
            if (sign * above).min() >= -slack:
                walls.append(np.append(sign * axis, sign * level))
                in_shell |= own
    return np.array(walls).reshape(-1, 4), in_shell


def _boxes(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners (B, 8, 3) of boxes about groups of neighbouring triangles (F, 3, 3), halved across their longest side
    over and over."""
    # Padded with the last triangle, so that all groups are as large.
    group = np.minimum(np.arange(-(-len(corners) // BOXES) * BOXES), len(corners) - 1)[None]
    middles = corners.mean(axis=1)
    while len(group) < BOXES:
        axis = np.ptp(middles[group], axis=1).argmax(axis=1)
        half = group.shape[1] // 2
        rank = np.argpartition(middles[group, axis[:, None]], half, axis=1)
        group = np.take_along_axis(group, rank, axis=1).reshape(2 * len(group), half)
    ends = np.stack([corners[group].min(axis=(1, 2)), corners[group].max(axis=(1, 2))], axis=1)
    pick = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    return np.asarray(ends[:, pick, np.arange(3)], np.float64)
