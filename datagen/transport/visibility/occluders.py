"""What may stand between two points of a scene, as few convex bodies: what the proofs of `clear_sight.py` test.

A wall with the whole scene on one side of its plane can hide nothing from anything that lies on that side, so it
needs no test: only that both ends of a connection lie on that side (the scene's *shell*). What remains are triangles,
or, where they are many, boxes about neighbouring ones.
"""

from __future__ import annotations

import numpy as np

from datagen.records.arrays import Bools, Floats
from datagen.transport.visibility.clear_sight_kernels import Bodies
from datagen.transport.visibility.raycast import Raycaster

TRIANGLES_SAMPLED = 512
"""Largest triangles whose planes are tried as walls of the shell, with as many of the others."""
WALLS_AT_MOST = 32
SAME_PLANE = 1e-9
"""Planes that agree to this share of the scene's half extent are one: far closer than ray ends are lifted."""
TRIANGLES_AT_MOST = 256
"""With more than these the larger half of them stays, and boxes stand for the others."""
BOXES = 128
MORTON_BITS = 6
TOWARDS_CORNERS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], np.float64)


def occluders(caster: Raycaster) -> Bodies:
    """The shell's walls and the bodies within: all triangles, or the largest and boxes about the others."""
    shell, in_shell = _shell(caster)
    faces = np.flatnonzero(~in_shell)
    boxes = np.empty((0, 8, 3))
    if len(faces) > TRIANGLES_AT_MOST:
        faces = faces[np.argsort(-caster.face_area_m2[faces], kind="stable")]
        faces, small = faces[: TRIANGLES_AT_MOST // 2], faces[TRIANGLES_AT_MOST // 2 :]
        boxes = _boxes(caster.corners[small])
    # Numpy picks the order of the axes by the faces' index; the kernels are compiled for one order.
    corners = np.ascontiguousarray(np.concatenate([caster.corners[faces][:, [0, 1, 2, 0, 0, 0, 0, 0]], boxes]))
    normal = np.concatenate([caster.face_normal[faces], np.zeros((len(boxes), 3))])
    count = np.repeat([3, 8], [len(faces), len(boxes)])
    level = np.einsum("nk,nk->n", corners[:, 0], normal)
    return Bodies(shell, count, corners, normal, level, corners.min(axis=1), corners.max(axis=1))


def _shell(caster: Raycaster) -> tuple[Floats, Bools]:
    """Planes that have the whole scene on one side, and which triangles (F,) lie in them."""
    points, slack = caster.corners.reshape(-1, 3), 1e-3 * caster.offset_m
    sampled = np.argsort(-caster.face_area_m2, kind="stable")
    sampled = np.union1d(sampled[:TRIANGLES_SAMPLED], sampled[:: 1 + len(sampled) // TRIANGLES_SAMPLED])
    normal, base = caster.face_normal[sampled], caster.corners[sampled, 0]
    largest = np.take_along_axis(normal, np.abs(normal).argmax(axis=1)[:, None], axis=1)
    normal = normal * np.sign(largest)
    height = np.einsum("fk,fk->f", base - caster.center, normal) / caster.half_extent_m
    keys = np.round(np.column_stack([normal, height]) / SAME_PLANE).astype(np.int64)
    first = np.unique(keys, axis=0, return_index=True)[1]
    # Most planes have points far off on both sides: a few of the outermost tell.
    outermost = points[np.unique((TOWARDS_CORNERS @ points.T).argmax(axis=1))]
    above = np.einsum("mk,pk->pm", outermost, normal[first]) - np.einsum("pk,pk->p", normal, base)[first, None]
    in_shell = np.zeros(len(caster.corners), np.bool_)
    walls = []
    for k in first[(above.min(axis=1) >= -slack) | (above.max(axis=1) <= slack)][:WALLS_AT_MOST]:
        level = float(normal[k] @ base[k])
        heights = points @ normal[k]
        above, below = heights.min() >= level - slack, heights.max() <= level + slack
        if above or below:
            in_shell |= (np.abs(heights - level).reshape(-1, 3) <= slack).all(axis=1)
        walls += [np.append(sign * normal[k], sign * level) for sign, is_one in ((1, above), (-1, below)) if is_one]
    return np.array(walls).reshape(-1, 4), in_shell


def _boxes(corners: Floats) -> Floats:
    """Corners (B, 8, 3) of boxes about groups of neighbouring triangles (F, 3, 3): runs along a Morton curve."""
    middles = corners.mean(axis=1)
    low = middles.min(axis=0)
    place = ((middles - low) / (np.ptp(middles, axis=0).max() + 1e-300) * (2**MORTON_BITS - 1)).astype(np.int64)
    code = np.zeros(len(corners), np.int64)
    for bit in range(MORTON_BITS):
        for axis in range(3):
            code |= (place[:, axis] >> bit & 1) << (3 * bit + axis)
    ordered = corners[np.argsort(code, kind="stable")].reshape(-1, 3)
    starts = 3 * np.unique(np.linspace(0, len(corners), BOXES, endpoint=False).astype(np.int64))
    ends = np.stack([np.minimum.reduceat(ordered, starts), np.maximum.reduceat(ordered, starts)], axis=1)
    pick = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    return np.asarray(ends[:, pick, np.arange(3)], np.float64)
