"""The shaded label: the hidden part as a camera in the relay wall would see it, lit by the visible relay wall.

The lamp is the source of light of the measurement itself: the part of the relay wall that the device sees
(`Scene.relay_wall`, the nominal rectangle without relief and clutter) is a Lambertian lamp of radiance 1. Every
direction in which a surface does not see the lamp has the radiance `AMBIENT_RADIANCE`. A surface of albedo ρ then has
the radiance

    L = ρ (F + (1 − F) · AMBIENT_RADIANCE),    F = ∫ cosθ cosθ′ V / (π R²) dA over the lamp,

F its form factor to the lamp (0 … 1) with V the visibility, so L lies in 0 … ρ. Every material counts as Lambertian
with its albedo. Without occluders F is exactly Lambert's formula for a polygon (as in Baum, Rushmeier & Winget,
SIGGRAPH 1989). A shadow removes the share of the lamp that is hidden, found by a ray from each pixel to each of the
lamp's `even_points`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.errors import InputError
from datagen.labels.frame import image_points
from datagen.labels.images import HiddenSurface, albedo_image, normal_image
from datagen.records import Rectangle
from datagen.records.arrays import Bools, Floats
from scene_library.sightlines import even_points, occlusion_test

AMBIENT_RADIANCE = 0.15
"""Radiance, in units of the lamp's, of directions without the lamp. Halved, shadows are half as bright."""
_PIXELS_AT_ONCE = 1 << 10
"""Pixels whose rays are traced in one call: 65 536 rays, 6 MB. Halved, half of that."""
_LIFT = 1e-5
"""Distance by which the ends of rays are lifted off their surfaces, in units of the scene's size. Halved, single
precision lets surfaces shadow themselves in large scenes."""


def shaded_image(surface: HiddenSurface) -> NDArray[np.float32]:
    """(rows, columns) radiance towards the relay wall in units of the lamp's, 0 … 1; 0 where no surface is seen.

    The values are linear in light; a display needs their square root, or a gamma. Raises `InputError` for a scene
    without `relay_wall`.
    """
    scene, frame = surface.scene, surface.frame
    if scene.relay_wall is None:
        raise InputError(
            "label 'shaded': this scene names no relay wall, which is its lamp; give "
            "Scene.from_parts(..., relay_wall=Rectangle.of(center, right, up)) or leave shaded out of store.fields"
        )
    seen = surface.face >= 0
    points = frame.to_world(image_points(surface.depth, seen, frame.half_width_m, frame.half_height_m))
    normals = normal_image(surface)[seen].astype(np.float64) @ frame.axes
    occluders = scene.corners[np.array([role != "relay_wall" for role in scene.roles])[scene.face_part]]
    lift = _LIFT * float(np.ptp(scene.vertices, axis=0).max())
    blocked = occlusion_test(occluders)
    lit = np.empty(len(points))
    for some in (slice(k, k + _PIXELS_AT_ONCE) for k in range(0, len(points), _PIXELS_AT_ONCE)):
        lit[some] = _lit(points[some], normals[some], scene.relay_wall, blocked, lift)
    image = np.zeros(seen.shape)
    image[seen] = lit + (1 - lit) * AMBIENT_RADIANCE
    return (image * albedo_image(surface)).astype(np.float32)


def _lit(
    points: Floats, normals: Floats, lamp: Rectangle, blocked: Callable[[Floats, Floats], Bools], lift_m: float
) -> Floats:
    """(n,) form factor of each point (n, 3) to the part of the lamp that it sees.

    It is the exact form factor to the whole lamp times the visible share of it, in which each lamp point counts by
    the light that it would send.
    """
    whole = form_factors(points, normals, lamp.corners)
    on_lamp = even_points(lamp.center, lamp.right, lamp.up)
    weight, start, end = _segments(points, normals, on_lamp, lamp.normal, lift_m)
    sent = weight.sum(axis=1)
    weight[weight > 0] *= ~blocked(start, end)
    share = np.divide(weight.sum(axis=1), sent, out=np.zeros(len(points)), where=sent > 0)
    return np.asarray(whole * share)


@compiled()
def _segments(
    points: Floats, normals: Floats, on_lamp: Floats, lamp_normal: Floats, lift_m: float
) -> tuple[Floats, Floats, Floats]:
    """(n, m) weights cosθ cosθ′ / R², up to a factor, of the light from m points of the lamp to n points; and for
    each positive weight, row by row, both ends (·, 3) of the segment between the two, lifted off their surfaces."""
    weight = np.empty((len(points), len(on_lamp)))
    start = np.empty((weight.size, 3))
    end = np.empty((weight.size, 3))
    used = 0
    for p in range(len(points)):
        for q in range(len(on_lamp)):
            square, leaving, arriving = 0.0, 0.0, 0.0
            for k in range(3):
                toward = on_lamp[q, k] - points[p, k]
                square += toward * toward
                leaving += toward * normals[p, k]
                arriving -= toward * lamp_normal[k]
            # A point behind the other one's surface sends it no light, and needs no ray.
            if leaving > 0.0 and arriving > 0.0:
                weight[p, q] = leaving * arriving / (square * square)
                for k in range(3):
                    start[used, k] = points[p, k] + lift_m * normals[p, k]
                    end[used, k] = on_lamp[q, k] + lift_m * lamp_normal[k]
                used += 1
            else:
                weight[p, q] = 0.0
    return weight, start[:used], end[:used]


@compiled()
def form_factors(points: Floats, normals: Floats, corners: Floats) -> Floats:
    """(n,) form factors from small surface elements at `points` with unit `normals` (n, 3) to a convex polygon
    `corners` (m, 3), or to its part in front of the element, by Lambert's formula

        F = |Σ Θ n·Γ| / 2π over the edges,

    with Θ the angle that an edge subtends and Γ the unit normal of the plane through the edge and the point.
    """
    count = len(corners)
    result = np.zeros(len(points))
    kept = np.empty((2 * count, 3))
    offset = np.empty((count, 3))
    height = np.empty(count)
    for p in range(len(points)):
        # Corners relative to the element, and their heights above its plane.
        for c in range(count):
            height[c] = 0.0
            for k in range(3):
                offset[c, k] = corners[c, k] - points[p, k]
                height[c] += offset[c, k] * normals[p, k]
        # The part of the polygon behind the element is clipped (Sutherland & Hodgman), for it would count as
        # negative.
        count_kept = 0
        for c in range(count):
            after = (c + 1) % count
            if height[c] > 0.0:
                for k in range(3):
                    kept[count_kept, k] = offset[c, k]
                count_kept += 1
            if (height[c] > 0.0) != (height[after] > 0.0):
                share = height[c] / (height[c] - height[after])
                for k in range(3):
                    kept[count_kept, k] = offset[c, k] + (offset[after, k] - offset[c, k]) * share
                count_kept += 1
        total = 0.0
        for c in range(count_kept):
            after = (c + 1) % count_kept
            across, along, area = 0.0, 0.0, 0.0
            for k in range(3):
                i, j = (k + 1) % 3, (k + 2) % 3
                side = kept[c, i] * kept[after, j] - kept[c, j] * kept[after, i]
                area += side * side
                across += normals[p, k] * side
                along += kept[c, k] * kept[after, k]
            # arctan2 keeps the digits of small angles, half of which an arc cosine would lose.
            length = np.sqrt(area)
            if length > 0.0:
                total += np.arctan2(length, along) * across / length
        result[p] = abs(total) / (2 * np.pi)
    return result
