"""A proof, without a ray, that nothing stands between a point and a flat patch of wall.

The proof is one-sided: `True` is certain (up to the distance by which ray ends are lifted off their surfaces);
`False` proves nothing, and rays have to be cast. Two convex bodies do not meet if a plane separates them. The planes
that are tried are the sides of the pyramid from the point to the patch, and the planes of the triangles.
"""

from __future__ import annotations

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats


def flat_patch(position: Floats, normal: Floats, tolerance: float) -> Floats | None:
    """(4, 3) corners, metres, of a rectangle that holds all points; None if the points do not lie in one plane.

    position, normal : (n, 3) points, metres, and unit normals of their surface.
    tolerance : distance, metres, up to which a point lies in the plane, and margin of the rectangle.
    """
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
    """Height of a point above the plane through `base`, in units of the normal's length."""
    return (point[0] - base[0]) * normal[0] + (point[1] - base[1]) * normal[1] + (point[2] - base[2]) * normal[2]


@compiled(inline="always")
def _highest(triangle: Floats, base: Floats, normal: Floats) -> float:
    """Height of the highest corner of a triangle (3, 3) above the plane through `base`, as in `height`."""
    most = -np.inf
    for c in range(3):
        most = max(most, height(triangle[c], base, normal))
    return most


@compiled()
def _normal_towards(sides: Floats, i: int, p: Floats, q: Floats, inner: Floats) -> None:
    """Set row i of `sides` to p × q or to its opposite, whichever points in the direction `inner`."""
    x, y, z = p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]
    sign = -1.0 if x * inner[0] + y * inner[1] + z * inner[2] < 0.0 else 1.0
    sides[i, 0], sides[i, 1], sides[i, 2] = sign * x, sign * y, sign * z


@compiled()
def pyramids_clear(apexes: Floats, patch: Floats, corners: Floats, face_normal: Floats, tolerance: float) -> Bools:
    """(n,) whether it is proven that no triangle meets the pyramid from each apex (n, 3) to a flat patch (4, 3).

    corners, face_normal : (F, 3, 3) and (F, 3) of the triangles. tolerance : distance, metres, up to which a triangle
    only touches the pyramid.
    """
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
            # The plane of the triangle has all of the pyramid on one side, or the triangle lies behind the patch.
            low = high = height(apex, corners[f, 0], face_normal[f])
            for i in range(4):
                s = height(patch[i], corners[f, 0], face_normal[f])
                low, high = min(low, s), max(high, s)
            if low >= -tolerance or high <= tolerance or _highest(corners[f], patch[0], base) <= tolerance:
                continue
            # All of the triangle lies beyond one side of the pyramid.
            apart = False
            for i in range(4):
                apart = apart or _highest(corners[f], apex, sides[i]) < 0.0
            if not apart:
                clear[n] = False
                break
    return clear
