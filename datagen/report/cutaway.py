"""A room opened like a doll's house: the surfaces to draw, and a shaded picture of them without perspective."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from datagen.labels.raster import first_hits, hidden_pixels
from datagen.labels.solids import connected_sets
from datagen.records import Scene
from datagen.records.arrays import Bools, Floats, Ints

Extent = tuple[float, float, float, float]
"""Left, right, bottom, top of a picture, metres."""

Shaded = tuple[Floats, Extent]
"""A picture (rows, columns, 4), RGBA in 0 … 1, and its extent."""

_SURVEY_PIXELS = 220
"""Longer side of the picture that decides which walls go. Halved, narrow walls are misjudged."""
_HORIZONTAL = 0.7
"""Least vertical part of the normal of floor and ceiling."""


@dataclass(frozen=True)
class Camera:
    """Parallel projection. `axes` (3, 3): unit vectors right, up, and into the scene, as rows."""

    axes: Floats

    @classmethod
    def looking(cls, azimuth_deg: float, elevation_deg: float) -> Camera:
        """A camera that looks at the scene: azimuth counted from +x towards +y, elevation above the floor."""
        a, e = np.radians([azimuth_deg, elevation_deg])
        into = -np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
        right = np.array([-np.sin(a), np.cos(a), 0.0])
        return cls(np.stack([right, np.cross(right, into), into]))

    @classmethod
    def from_above(cls) -> Camera:
        """The camera of a plan: x to the right, y up."""
        return cls(np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, -1]]))

    def project(self, points: Floats) -> Floats:
        """(..., 3) world → (..., 3): metres right, up and into the picture."""
        return points @ self.axes.T


@dataclass(frozen=True)
class Cutaway:
    """The part of a room that is drawn.

    faces : triangles to draw.
    outlines : (E, 2, 3) edges of the walls that are not drawn.
    """

    faces: Ints
    outlines: Floats


def normals_of(scene: Scene) -> Floats:
    """(F, 3) unit normals of all triangles (0 for one without area)."""
    corners = scene.corners
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return normal / np.where(length > 0, length, 1.0)


def room_faces(scene: Scene) -> tuple[Ints, Ints, Ints]:
    """Triangles of the structure: upright (walls), lying in the lower half (floor), in the upper (ceiling)."""
    structure = np.array([role == "structure" for role in scene.roles])[scene.face_part]
    lying = structure & (abs(normals_of(scene)[:, 2]) > _HORIZONTAL)
    height = scene.corners[..., 2].mean(axis=1)
    upper = height > (scene.vertices[:, 2].min() + scene.vertices[:, 2].max()) / 2
    return np.flatnonzero(structure & ~lying), np.flatnonzero(lying & ~upper), np.flatnonzero(lying & upper)


def cut_open(scene: Scene, camera: Camera) -> Cutaway:
    """The room without its ceiling and without walls that hide more than 0.2 % of the picture of the rest."""
    walls, _, ceiling = room_faces(scene)
    shown = np.setdiff1d(np.arange(len(scene.triangles)), np.concatenate([walls, ceiling]))
    if len(walls) == 0:
        return Cutaway(shown, np.empty((0, 2, 3)))
    group, edges = flat_groups(scene, walls)
    rest = shown if len(shown) else walls
    triangles, rows, columns, _ = to_pixels(scene, camera, np.concatenate([rest, walls]), _SURVEY_PIXELS)
    depth = first_hits(triangles[: len(rest)], rows, columns, -np.inf)[1]
    margin = 0.01 * float(np.ptp(triangles[..., 2]))
    hidden = np.bincount(group, hidden_pixels(triangles[len(rest) :], depth - margin))
    taken = hidden > 0.002 * rows * columns
    outlines = [edge for g, edge in enumerate(edges) if taken[g]]
    return Cutaway(
        np.concatenate([shown, walls[~taken[group]]]),
        np.concatenate(outlines) if outlines else np.empty((0, 2, 3)),
    )


def flat_groups(scene: Scene, faces: Ints) -> tuple[Ints, list[Floats]]:
    """Groups of triangles that touch in one plane: each face's group number, and each group's border (E, 2, 3)."""
    normal = normals_of(scene)[faces]
    leading = np.take_along_axis(normal, abs(normal).argmax(axis=1)[:, None], axis=1)
    normal = normal * np.where(leading < 0, -1.0, 1.0)
    corners = scene.corners[faces]
    extent = float(np.ptp(scene.vertices, axis=0).max())
    offset = (normal * (corners.mean(axis=1) - scene.vertices.mean(axis=0))).sum(axis=1) / extent
    plane = _numbered(np.round(np.column_stack([normal, offset]) * 1e3))
    place = _numbered(np.round(corners.reshape(-1, 3) / (1e-6 * extent))).reshape(-1, 3)
    # Faces and the corners of each plane are the nodes of a graph; faces that share a corner are connected.
    corner = _numbered(np.column_stack([np.repeat(plane, 3), place.ravel()]))
    count = len(faces) + int(corner.max()) + 1
    links = np.column_stack([np.repeat(np.arange(len(faces)), 3), corner + len(faces)])
    group = _numbered(connected_sets(links, count)[1][: len(faces), None])
    border = []
    for g in range(int(group.max()) + 1):
        members = group == g
        ends = corners[members][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2, 3)
        key = np.sort(place[members][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        _, first, uses = np.unique(key, axis=0, return_index=True, return_counts=True)
        border.append(ends[first[uses % 2 == 1]])
    return group, border


def _numbered(rows: NDArray[np.generic]) -> Ints:
    """Number of each row; equal rows have equal numbers."""
    return np.asarray(np.unique(rows, axis=0, return_inverse=True)[1].ravel(), np.int64)


def to_pixels(scene: Scene, camera: Camera, faces: Ints, pixels: int) -> tuple[Floats, int, int, Extent]:
    """Triangles in pixels, rows and columns of the picture (the larger about `pixels`), and its extent in metres."""
    in_view = camera.project(scene.vertices)[scene.triangles[faces]]
    low, high = in_view[..., :2].min(axis=(0, 1)), in_view[..., :2].max(axis=(0, 1))
    size = max(float((high - low).max()), 1e-9)
    low, high = low - 0.01 * size, high + 0.01 * size
    step = float((high - low).max()) / pixels
    # Even, so that a picture can be halved.
    columns, rows = (2 * int(np.ceil(n / 2)) for n in (high - low) / step)
    high = low + step * np.array([columns, rows])
    column, row = (in_view[..., 0] - low[0]) / step, (high[1] - in_view[..., 1]) / step
    extent = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
    return np.stack([column, row, in_view[..., 2]], axis=-1), rows, columns, extent


def shaded(scene: Scene, camera: Camera, faces: Ints, colors: dict[str, str], pixels: int) -> Shaded:
    """A picture of the faces in their parts' colours, transparent where there is none, and its extent."""
    if len(faces) == 0:
        return np.zeros((2, 2, 4)), (0.0, 1.0, 0.0, 1.0)
    triangles, rows, columns, extent = to_pixels(scene, camera, faces, 2 * pixels)
    hit, depth = first_hits(triangles, rows, columns, -np.inf)
    face = faces[hit]
    normal = normals_of(scene)[face]
    light = camera.axes.T @ np.array([-0.35, 0.6, -0.72])
    base = np.array([to_rgb(colors[name]) for name in scene.part_names])[scene.face_part[face]]
    color = base * (0.74 + 0.26 * abs(normal @ light))[..., None]
    color[_edges(hit, scene.face_part[face], normal, depth)] *= 0.45
    picture = np.dstack([color, hit >= 0]) * (hit >= 0)[..., None]
    small = picture.reshape(rows // 2, 2, columns // 2, 2, 4).mean(axis=(1, 3))
    small[..., :3] /= np.maximum(small[..., 3:], 1e-9)
    return np.clip(small, 0, 1), extent


def _edges(hit: Ints, part: NDArray[np.int32], normal: Floats, depth: Floats) -> Bools:
    """Pixels that carry an outline: between parts, along a sharp crease, or around everything."""
    edge = np.zeros(hit.shape, np.bool_)
    part = np.where(hit < 0, -1, part)
    for axis in (0, 1):
        here = tuple(slice(None, -1) if k == axis else slice(None) for k in (0, 1))
        there = tuple(slice(1, None) if k == axis else slice(None) for k in (0, 1))
        crease = abs((normal[here] * normal[there]).sum(axis=-1)) < 0.8
        differs = (part[here] != part[there]) | (crease & (hit[here] >= 0) & (hit[there] >= 0))
        # The nearer of the two carries the line, so that an object's outline does not grow into what is behind it.
        nearer = depth[here] <= depth[there]
        edge[here] |= differs & nearer
        edge[there] |= differs & ~nearer
    return edge & (hit >= 0)
