"""Proofs that nothing stands between two points, so that no shadow ray need be sent.

Both proofs are one-sided: a `True` is certain (to the distance ray ends are lifted off their surface), a `False` only
means that a ray has to tell. Two convex bodies that a plane separates do not meet; the planes tried are the faces of
both bodies.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats
from datagen.transport.visibility.raycast import Raycaster

CELLS = 64
"""Cells along each edge of a direction cube: 1.4° wide at the centre of a face."""
PLANE_TOLERANCE = 1e-6
"""Planes that agree to this share of the scene's half extent count as one plane."""
UNKNOWN, EMPTY = -1, -2


class LightBuffer(NamedTuple):
    """What a point sees in each cell of a cube of directions about it, after Haines & Greenberg, "The light buffer",
    IEEE Computer Graphics and Applications 6(9) (1986).

    cells : (6, C, C) the one plane whose triangles can be met through the cell; −1 for several, −2 for none.
        Empty where no buffer was made: then every point has to be asked by a ray.
    face_plane : (F,) plane of each triangle.
    """

    cells: NDArray[np.int32]
    face_plane: NDArray[np.int32]


def plane_of_faces(caster: Raycaster) -> NDArray[np.int32]:
    """(F,) number of the plane each triangle lies in; triangles of one wall share it."""
    normal = caster.face_normal
    largest = np.take_along_axis(normal, np.abs(normal).argmax(axis=1)[:, None], axis=1)
    normal = normal * np.sign(largest)
    height = np.einsum("fk,fk->f", caster.corners[:, 0] - caster.center, normal) / caster.half_extent_m
    keys = np.round(np.column_stack([normal, height]) / PLANE_TOLERANCE).astype(np.int64)
    return np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int32)


def light_buffer(caster: Raycaster, face_plane: NDArray[np.int32], point: Floats, normal: Floats) -> LightBuffer:
    """The buffer of a point (3,) on a surface with unit normal (3,): only what lies above that surface is entered."""
    relative = caster.corners - point
    above = (relative @ normal > caster.offset_m).any(axis=1)
    cells = np.full((6, CELLS, CELLS), EMPTY, np.int32)
    _enter(relative[above], face_plane[above], cells)
    return LightBuffer(cells, face_plane)


def no_light_buffer() -> LightBuffer:
    """One that proves nothing."""
    return LightBuffer(np.empty((0, 0, 0), np.int32), np.empty(0, np.int32))


@compiled()
def _enter(corners: Floats, plane: NDArray[np.int32], cells: NDArray[np.int32]) -> None:
    n = cells.shape[1]
    # Cells are entered a little larger than they are, so that rounding in a look-up cannot leave its cell.
    margin = 1e-3
    edge = np.empty((3, 3))
    local = np.empty((3, 3))
    for t in range(len(corners)):
        for side in range(6):
            axis = side >> 1
            sign = 1.0 - 2.0 * (side & 1)
            low_u, high_u, low_v, high_v = 0, n - 1, 0, n - 1
            ahead, all_ahead = False, True
            for i in range(3):
                local[i, 0] = sign * corners[t, i, axis]
                local[i, 1] = corners[t, i, (axis + 1) % 3]
                local[i, 2] = corners[t, i, (axis + 2) % 3]
                ahead |= local[i, 0] > 0.0
                all_ahead &= local[i, 0] > 0.0
            if not ahead:
                continue
            if all_ahead:
                u0, u1, v0, v1 = np.inf, -np.inf, np.inf, -np.inf
                for i in range(3):
                    u, v = local[i, 1] / local[i, 0], local[i, 2] / local[i, 0]
                    u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
                if u0 > 1.01 or u1 < -1.01 or v0 > 1.01 or v1 < -1.01:
                    continue
                low_u = max(0, int(np.floor((max(u0, -1.01) + 1.0) * n / 2 - margin)))
                high_u = min(n - 1, int(np.floor((min(u1, 1.01) + 1.0) * n / 2 + margin)))
                low_v = max(0, int(np.floor((max(v0, -1.01) + 1.0) * n / 2 - margin)))
                high_v = min(n - 1, int(np.floor((min(v1, 1.01) + 1.0) * n / 2 + margin)))
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                edge[i, 0] = local[i, 1] * local[j, 2] - local[i, 2] * local[j, 1]
                edge[i, 1] = local[i, 2] * local[j, 0] - local[i, 0] * local[j, 2]
                edge[i, 2] = local[i, 0] * local[j, 1] - local[i, 1] * local[j, 0]
                if edge[i, 0] * local[k, 0] + edge[i, 1] * local[k, 1] + edge[i, 2] * local[k, 2] < 0.0:
                    edge[i, 0], edge[i, 1], edge[i, 2] = -edge[i, 0], -edge[i, 1], -edge[i, 2]
            for a in range(low_u, high_u + 1):
                for b in range(low_v, high_v + 1):
                    u0, u1 = 2 * (a - margin) / n - 1, 2 * (a + 1 + margin) / n - 1
                    v0, v1 = 2 * (b - margin) / n - 1, 2 * (b + 1 + margin) / n - 1
                    if _meets(local, edge, u0, u1, v0, v1) and cells[side, a, b] != plane[t]:
                        cells[side, a, b] = plane[t] if cells[side, a, b] == EMPTY else UNKNOWN


@compiled(inline="always")
def _meets(local: Floats, edge: Floats, u0: float, u1: float, v0: float, v1: float) -> bool:
    """Whether no side plane of the cell, and no plane through an edge of the triangle, separates the two."""
    left, right, below, over = True, True, True, True
    for i in range(3):
        left &= local[i, 1] < u0 * local[i, 0]
        right &= local[i, 1] > u1 * local[i, 0]
        below &= local[i, 2] < v0 * local[i, 0]
        over &= local[i, 2] > v1 * local[i, 0]
    if left or right or below or over:
        return False
    for i in range(3):
        most = edge[i, 0] + max(edge[i, 1] * u0, edge[i, 1] * u1) + max(edge[i, 2] * v0, edge[i, 2] * v1)
        if most < 0.0:
            return False
    return True


@compiled()
def lit_for_certain(
    cells: NDArray[np.int32], face_plane: NDArray[np.int32], face: int, x: float, y: float, z: float
) -> bool:
    """Whether the point at (x, y, z) from the light buffer's own point, on triangle `face`, is seen from there."""
    n = cells.shape[1]
    if n == 0:
        return False
    ax, ay, az = abs(x), abs(y), abs(z)
    if ax >= ay and ax >= az:
        side, ahead, u, v = (0 if x > 0.0 else 1), ax, y, z
    elif ay >= az:
        side, ahead, u, v = (2 if y > 0.0 else 3), ay, z, x
    else:
        side, ahead, u, v = (4 if z > 0.0 else 5), az, x, y
    if ahead == 0.0:
        return False
    scale = 0.5 * n / ahead
    a, b = min(int(u * scale + 0.5 * n), n - 1), min(int(v * scale + 0.5 * n), n - 1)
    return bool(cells[side, a, b] == face_plane[face])


def flat_patch(position: Floats, normal: Floats, tolerance: float) -> Floats | None:
    """Corners (4, 3) of a rectangle that holds all points (n, 3), or None where they do not lie in one plane."""
    if len(position) == 0:
        return None
    axis = normal[0]
    height = (position - position[0]) @ axis
    if np.abs(height).max() > tolerance or (normal @ axis).min() < 1.0 - 1e-9:
        return None
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    across /= np.linalg.norm(across)
    frame = np.stack([across, np.cross(axis, across)])
    local = (position - position[0]) @ frame.T
    low, high = local.min(axis=0) - tolerance, local.max(axis=0) + tolerance
    corners = np.array([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    return np.asarray(position[0] + corners @ frame, np.float64)


@compiled(inline="always")
def height(point, base, normal):  # type: ignore[no-untyped-def]
    """Of a point above the plane through `base`, in units of the normal's length."""
    return (point[0] - base[0]) * normal[0] + (point[1] - base[1]) * normal[1] + (point[2] - base[2]) * normal[2]


@compiled(inline="always")
def _highest(triangle: Floats, base: Floats, normal: Floats) -> float:
    most = -np.inf
    for c in range(3):
        most = max(most, height(triangle[c], base, normal))
    return most


@compiled()
def _normal_towards(sides: Floats, i: int, p: Floats, q: Floats, inner: Floats) -> None:
    """Side i: p × q, or its opposite, whichever points the way of `inner`."""
    x, y, z = p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]
    sign = -1.0 if x * inner[0] + y * inner[1] + z * inner[2] < 0.0 else 1.0
    sides[i, 0], sides[i, 1], sides[i, 2] = sign * x, sign * y, sign * z


@compiled()
def pyramids_clear(apexes: Floats, patch: Floats, corners: Floats, face_normal: Floats, tolerance: float) -> Bools:
    """Whether the pyramid from each apex (n, 3) to a flat patch (4, 3) is free of triangles (F, 3, 3)."""
    clear = np.ones(len(apexes), np.bool_)
    sides, span, edge = np.empty((5, 3)), np.empty((4, 3)), np.empty((2, 3))
    base, middle, inner, upward = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for k in range(3):
        middle[k] = (patch[0, k] + patch[1, k] + patch[2, k] + patch[3, k]) / 4
        edge[0, k], edge[1, k] = patch[1, k] - patch[0, k], patch[3, k] - patch[0, k]
    for n in range(len(apexes)):
        apex = apexes[n]
        for k in range(3):
            inner[k], upward[k] = middle[k] - apex[k], apex[k] - middle[k]
            for i in range(4):
                span[i, k] = patch[i, k] - apex[k]
        for i in range(4):
            _normal_towards(sides, i, span[i], span[(i + 1) % 4], inner)
        # The base, too, faces inwards: towards the apex.
        _normal_towards(sides, len(span), edge[0], edge[1], upward)
        length = np.sqrt(sides[4, 0] * sides[4, 0] + sides[4, 1] * sides[4, 1] + sides[4, 2] * sides[4, 2])
        for k in range(3):
            base[k] = sides[4, k] / length
        for f in range(len(corners)):
            low = high = height(apex, corners[f, 0], face_normal[f])
            for i in range(4):
                s = height(patch[i], corners[f, 0], face_normal[f])
                low, high = min(low, s), max(high, s)
            if low >= -tolerance or high <= tolerance or _highest(corners[f], patch[0], base) <= tolerance:
                continue
            apart = False
            for i in range(4):
                apart = apart or _highest(corners[f], apex, sides[i]) < 0.0
            if not apart:
                clear[n] = False
                break
    return clear
