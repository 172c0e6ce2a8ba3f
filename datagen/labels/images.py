"""Label images: depth, normal, albedo and part of the surfaces behind the relay wall, as if it were a window."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.labels.frame import ViewFrame, pixel_places
from datagen.labels.triangles import Triangles, plane_depths
from datagen.records import Scene
from datagen.records.arrays import Floats, Ints

_FLAT = 1e-6
"""Distance from the wall's plane, in units of the view's size, within which a wall counts as part of it: far above
rounding, and far below what anybody builds."""
_SMALLEST_DEPTH_M = 1e-6
"""Depth of a surface that touches the relay wall, as 0 means that no surface is seen."""


@dataclass(frozen=True)
class HiddenSurface:
    """The surface that each pixel of the hidden view sees first.

    scene, frame : the scene, and the frame of the view.
    face : (rows, columns) index of the triangle, −1 where the view is empty.
    depth : (rows, columns) float64 metres from the plane of the relay wall along its normal; 0 where empty.
    """

    scene: Scene
    frame: ViewFrame
    face: Ints
    depth: Floats


def hidden_surface(scene: Scene, rows: int, columns: int) -> HiddenSurface:
    """The surfaces seen from the relay wall, orthographically along the normal of `scene.hidden_view`.

    The relay wall itself is a window: parts with the role `relay_wall` are left out, and so is structure in the plane
    of the view (the rest of the wall to which the relay wall belongs). Objects are never left out; one that touches
    the wall has the depth 1 µm. Of two surfaces in one place either is seen (a dataset's scenes have none, see
    `set_apart`).
    """
    frame = ViewFrame.of(scene)
    in_view = frame.to_view(scene.vertices)[scene.triangles]
    tolerance = _FLAT * max(frame.half_width_m, frame.half_height_m)
    is_object = np.array([role == "object" for role in scene.roles])[scene.face_part]
    is_structure = np.array([role == "structure" for role in scene.roles])[scene.face_part]
    seen = np.flatnonzero(is_object | (is_structure & (in_view[:, :, 2].max(axis=1) > tolerance)))
    corners = in_view[seen]
    at = pixel_places(rows, columns, frame.half_width_m, frame.half_height_m)
    # A hair before the wall's plane, so that an object that touches the wall is met.
    start = np.concatenate([at, np.full((len(at), 1), -tolerance)], axis=-1)
    hit = Triangles(corners).first_met(start, np.array([0.0, 0.0, 1.0]))
    met = hit >= 0
    depth = np.zeros(len(at))
    depth[met] = np.maximum(plane_depths(corners, hit[met], at[met]), _SMALLEST_DEPTH_M)
    face = np.where(met, np.append(seen, -1)[hit], -1)
    return HiddenSurface(scene, frame, face.reshape(rows, columns), depth.reshape(rows, columns))


def depth_image(surface: HiddenSurface) -> NDArray[np.float32]:
    """(rows, columns) metres from the plane of the relay wall; 0 where no surface is seen.

    It is 0 and not NaN, because a masked NaN still turns every gradient into NaN (0 · NaN = NaN); `depth > 0` is the
    mask, as in the common depth data sets.
    """
    return surface.depth.astype(np.float32)


def normal_image(surface: HiddenSurface) -> NDArray[np.float32]:
    """(rows, columns, 3) unit normals as components along (right, up, normal) of the view; 0 where no surface is
    seen.

    Surfaces are two-sided. The normal is that of the visible side, so its third component is ≤ 0 (the view's normal
    points away from the relay wall): a surface parallel to the wall has (0, 0, −1).
    """
    corners = surface.scene.vertices[surface.scene.triangles[surface.face]]
    normals = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = normals @ surface.frame.axes.T
    normals = np.where(normals[..., 2:] > 0, -normals, normals)
    return np.where(surface.face[..., None] < 0, 0.0, normals).astype(np.float32)


def albedo_image(surface: HiddenSurface) -> NDArray[np.float32]:
    """(rows, columns) albedo of the surface seen; 0 where no surface is seen."""
    albedos = np.array([material.albedo for material in surface.scene.materials])
    return np.append(albedos[surface.scene.face_part], 0.0)[surface.face].astype(np.float32)


def part_image(surface: HiddenSurface) -> NDArray[np.int16]:
    """(rows, columns) index into `scene.part_names` of the surface seen; −1 where no surface is seen."""
    return np.append(surface.scene.face_part, -1)[surface.face].astype(np.int16)
