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

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.labels.frame import image_points
from datagen.labels.images import HiddenSurface, albedo_image, normal_image
from datagen.labels.triangles import Triangles
from datagen.records.arrays import Floats
from scene_library.sightlines import even_points

AMBIENT_RADIANCE = 0.15
"""Radiance, in units of the lamp's, of directions without the lamp."""
_PIXELS_AT_ONCE = 1 << 10
"""Pixels whose rays are traced in one call, which bounds the memory for rays to some 10 MB."""
_LIFT = 1e-5
"""Distance by which the ends of rays are lifted off their surfaces, in units of the scene's size: far above the
rounding of single precision, by which surfaces would shadow themselves."""


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
    points = image_points(surface.depth, seen, frame.half_width_m, frame.half_height_m)
    normals = normal_image(surface)[seen].astype(np.float64)
    is_occluder = np.array([role != "relay_wall" for role in scene.roles])[scene.face_part]
    occluders = Triangles(frame.to_view(scene.corners[is_occluder]))
    lamp = scene.relay_wall
    on_lamp, corners = (frame.to_view(of) for of in (even_points(lamp.center, lamp.right, lamp.up), lamp.corners))
    lamp_normal = frame.axes @ lamp.normal
    lift_m = _LIFT * float(np.ptp(scene.vertices, axis=0).max())
    lit = np.empty(len(points))
    for some in (slice(k, k + _PIXELS_AT_ONCE) for k in range(0, len(points), _PIXELS_AT_ONCE)):
        share = _visible_share(points[some], normals[some], on_lamp, lamp_normal, occluders, lift_m)
        lit[some] = form_factors(points[some], normals[some], corners) * share
    image = np.zeros(seen.shape)
    image[seen] = lit + (1 - lit) * AMBIENT_RADIANCE
    return (image * albedo_image(surface)).astype(np.float32)


def _visible_share(
    points: Floats, normals: Floats, on_lamp: Floats, lamp_normal: Floats, occluders: Triangles, lift_m: float
) -> Floats:
    """(n,) share of the lamp that each point (n, 3) sees: of the light of m points on it, cosθ cosθ′ / R² each, that
    of the points which nothing hides."""
    toward = on_lamp - points[:, None]
    leaving, arriving = np.einsum("nmk,nk->nm", toward, normals), -(toward @ lamp_normal)
    # A point behind the other one's surface sends it no light, and needs no ray.
    faces = (leaving > 0) & (arriving > 0)
    weight = np.where(faces, leaving * arriving / np.einsum("nmk,nmk->nm", toward, toward) ** 2, 0.0)
    sent = weight.sum(axis=1)
    point, lamp_point = np.nonzero(faces)
    starts = points[point] + lift_m * normals[point]
    weight[faces] *= ~occluders.blocked(starts, on_lamp[lamp_point] + lift_m * lamp_normal)
    return np.asarray(np.divide(weight.sum(axis=1), sent, out=np.zeros(len(points)), where=sent > 0))


def form_factors(points: Floats, normals: Floats, corners: Floats) -> Floats:
    """(n,) form factors from small surface elements at `points` with unit `normals` (n, 3) to a convex polygon
    `corners` (m, 3), or to its part in front of the element, by Lambert's formula

        F = |Σ Θ n·Γ| / 2π over the edges,

    with Θ the angle that an edge subtends and Γ the unit normal of the plane through the edge and the point.
    """
    start = corners - points[:, None]
    end = np.roll(start, -1, axis=1)
    height, after = (np.einsum("nmk,nk->nm", of, normals) for of in (start, end))
    # The part of the polygon behind the element is clipped (Sutherland & Hodgman), for it would count as negative:
    # an edge that crosses the element's plane ends, or begins, there.
    leaves, enters = (height > 0) & (after <= 0), (height <= 0) & (after > 0)
    crosses = leaves | enters
    share = np.divide(height, height - after, out=np.zeros_like(height), where=crosses)[..., None]
    crossing = start + (end - start) * share
    in_front = ((height > 0) | (after > 0))[..., None]
    first = np.where(enters[..., None], crossing, start) * in_front
    last = np.where(leaves[..., None], crossing, end) * in_front
    # In the element's plane one more edge closes a polygon that was cut.
    closing = [(crossing * at[..., None]).sum(axis=1, keepdims=True) for at in (leaves, enters)]
    first, last = (np.concatenate(pair, axis=1) for pair in zip((first, last), closing, strict=True))
    side = np.cross(first, last)
    length = np.linalg.norm(side, axis=-1)
    across = np.einsum("nmk,nk->nm", side, normals)
    # arctan2 keeps the digits of small angles, half of which an arc cosine would lose.
    angle = np.arctan2(length, np.einsum("nmk,nmk->nm", first, last))
    total = np.divide(angle * across, length, out=np.zeros_like(angle), where=length > 0).sum(axis=1)
    return np.asarray(abs(total) / (2 * np.pi))
