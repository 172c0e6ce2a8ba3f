"""Closed solids from a few numbers, and what placing one needs to know: its footprint and its height.

A solid stands on z = 0 with its axis on x = y = 0 until it is placed. Where it has a front, that looks along −y, so
that its back, at +y, can stand against a wall.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scene_library.arrays import Floats
from scene_library.polygons import Polygon, convex_hull, rotation, triangulate

Surface = tuple[Floats, NDArray[np.int64]]
"""Vertices (V, 3) in metres and triangles (F, 3)."""


@dataclass(frozen=True)
class Solid:
    """One object.

    Attributes
    ----------
    vertices : (V, 3) metres.
    triangles : (F, 3) indices into `vertices`.
    hull : (n, 2) convex hull of the vertices in plan, counter-clockwise.
    top_m : height of the highest vertex; the lowest is at 0.
    """

    vertices: Floats
    triangles: NDArray[np.int64]
    hull: Polygon
    top_m: float

    @classmethod
    def of(cls, vertices: Floats, triangles: NDArray[np.int64]) -> Solid:
        """A solid that already stands on z = 0."""
        return cls(vertices, triangles, convex_hull(vertices[:, :2]), float(vertices[:, 2].max()))

    @classmethod
    def compound(cls, pieces: Iterable[Surface]) -> Solid:
        """Several surfaces as one object, moved to stand on z = 0 with its plan's bounding box about the origin."""
        vertices, triangles = joined(list(pieces))
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        return cls.of(vertices - [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]], triangles)

    def scaled(self, factor: float) -> Solid:
        """The solid `factor` times as large, still standing on z = 0."""
        return Solid(self.vertices * factor, self.triangles, self.hull * factor, self.top_m * factor)

    def footprint(self, x: float, y: float, rotation_deg: float) -> Polygon:
        """The hull in plan when the solid is rotated about z and moved to (x, y)."""
        return _turned(self.hull, x, y, rotation_deg)

    def placed(self, x: float, y: float, z: float, rotation_deg: float) -> Floats:
        """(V, 3) vertices of the solid rotated about z, then moved to (x, y, z)."""
        plan = _turned(self.vertices[:, :2], x, y, rotation_deg)
        return np.column_stack([plan, self.vertices[:, 2] + z])


def _turned(plan: Polygon, x: float, y: float, rotation_deg: float) -> Polygon:
    turned = plan @ rotation(np.radians(rotation_deg)).T
    turned += [x, y]
    return turned


def joined(pieces: Sequence[Surface]) -> Surface:
    """Several surfaces as one."""
    offsets = np.cumsum([0] + [len(v) for v, _ in pieces])
    faces = [f + o for (_, f), o in zip(pieces, offsets, strict=False)]
    return np.concatenate([v for v, _ in pieces]), np.concatenate(faces)


def moved(surface: Surface, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Surface:
    """The surface moved by (x, y, z) metres."""
    return surface[0] + np.array([x, y, z]), surface[1]


def rotated(surface: Surface, axis: str, angle_deg: float) -> Surface:
    """The surface rotated counter-clockwise about an axis through the origin."""
    c, s = float(np.cos(np.radians(angle_deg))), float(np.sin(np.radians(angle_deg)))
    matrix = {
        "x": [[1, 0, 0], [0, c, -s], [0, s, c]],
        "y": [[c, 0, s], [0, 1, 0], [-s, 0, c]],
        "z": [[c, -s, 0], [s, c, 0], [0, 0, 1]],
    }[axis]
    return surface[0] @ np.array(matrix).T, surface[1]


def extruded(base: Polygon, height_m: float) -> Surface:
    """A closed prism over a simple counter-clockwise polygon, outward triangles."""
    n = len(base)
    low = np.column_stack([base, np.zeros(n)])
    high = np.column_stack([base, np.full(n, height_m)])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    sides = np.concatenate([np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)])
    caps = triangulate(base)
    return np.concatenate([low, high]), np.concatenate([sides, caps[:, ::-1], caps + n])


def prism(base: Polygon, height_m: float) -> Solid:
    """A prism as an object."""
    return Solid.of(*extruded(base, height_m))


def rectangle(width_m: float, depth_m: float) -> Polygon:
    """width along x, depth along y, about the origin."""
    return np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * [width_m / 2, depth_m / 2]


def regular_polygon(diameter_m: float, sides: int) -> Polygon:
    """Corners on a circle of `diameter_m`."""
    angle = 2 * np.pi * np.arange(sides) / sides
    return 0.5 * diameter_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def block(width_m: float, depth_m: float, height_m: float, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Surface:
    """A cuboid whose bottom is centred at (x, y, z)."""
    return moved(extruded(rectangle(width_m, depth_m), height_m), x, y, z)


def cylinder(
    diameter_m: float, height_m: float, x: float = 0.0, y: float = 0.0, z: float = 0.0, sides: int = 20
) -> Surface:
    """An upright cylinder whose bottom is centred at (x, y, z)."""
    return moved(extruded(regular_polygon(diameter_m, sides), height_m), x, y, z)


def lathed(profile: ArrayLike, sides: int = 20) -> Surface:
    """A closed solid of revolution about z: (n, 2) points (radius, height), both ends on the axis (radius 0).

    The profile runs from the lower end outside up to the upper end, so that the triangles look outwards.
    """
    p = np.asarray(profile, np.float64)
    inner = p[1:-1]
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    middle = np.concatenate([np.column_stack([r * ring, np.full(sides, z)]) for r, z in inner])
    vertices = np.concatenate([[[0.0, 0.0, p[0, 1]]], middle, [[0.0, 0.0, p[-1, 1]]]])
    i, j = np.arange(sides), (np.arange(sides) + 1) % sides
    last = len(vertices) - 1
    faces = [np.stack([np.zeros(sides, int), 1 + j, 1 + i], 1)]
    for k in range(len(inner) - 1):
        low, high = 1 + k * sides, 1 + (k + 1) * sides
        faces += [np.stack([low + i, low + j, high + j], 1), np.stack([low + i, high + j, high + i], 1)]
    top = 1 + (len(inner) - 1) * sides
    faces.append(np.stack([top + i, top + j, np.full(sides, last)], 1))
    return vertices, np.concatenate(faces)


def ellipsoid(radii: ArrayLike, center: ArrayLike = (0.0, 0.0, 0.0), sides: int = 20) -> Surface:
    """An ellipsoid with semi-axes `radii` (3,)."""
    latitude = np.linspace(-np.pi / 2, np.pi / 2, sides // 2 + 1)
    profile = np.stack([np.cos(latitude), np.sin(latitude)], axis=1)
    profile[[0, -1], 0] = 0.0
    vertices, faces = lathed(profile, sides)
    return vertices * np.asarray(radii, np.float64) + np.asarray(center, np.float64), faces


def limb(start: ArrayLike, end: ArrayLike, start_radius_m: float, end_radius_m: float, sides: int = 10) -> Surface:
    """A frustum between two points, for arms and legs, bars and branches."""
    a, b = np.asarray(start, np.float64), np.asarray(end, np.float64)
    long = float(np.linalg.norm(b - a))
    vertices, faces = lathed([(0, 0), (start_radius_m, 0), (end_radius_m, long), (0, long)], sides)
    w = (b - a) / long
    u = np.cross(w, [0.0, 1.0, 0.0] if abs(w[1]) < 0.9 else [1.0, 0.0, 0.0])
    u /= np.linalg.norm(u)
    return vertices @ np.stack([u, np.cross(w, u), w]) + a, faces


def torus(ring_radius_m: float, tube_radius_m: float, sides: int = 24, tube_sides: int = 10) -> Surface:
    """A ring about z, centred at the origin."""
    a, b = np.meshgrid(
        2 * np.pi * np.arange(sides) / sides, 2 * np.pi * np.arange(tube_sides) / tube_sides, indexing="ij"
    )
    radius = ring_radius_m + tube_radius_m * np.cos(b)
    vertices = np.stack([radius * np.cos(a), radius * np.sin(a), tube_radius_m * np.sin(b)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(sides), np.arange(tube_sides), indexing="ij")
    p, q = i * tube_sides + j, (i + 1) % sides * tube_sides + j
    r, t = (i + 1) % sides * tube_sides + (j + 1) % tube_sides, i * tube_sides + (j + 1) % tube_sides
    faces = np.concatenate([np.stack([p, q, r], -1).reshape(-1, 3), np.stack([p, r, t], -1).reshape(-1, 3)])
    return vertices, faces


def hollow(diameter_m: float, height_m: float, wall_m: float, top_diameter_m: float | None = None) -> Surface:
    """An open vessel: outside up, over the rim, inside down."""
    r = diameter_m / 2
    top = (top_diameter_m or diameter_m) / 2
    return lathed([(0, 0), (r, 0), (top, height_m), (top - wall_m, height_m), (r - wall_m, wall_m), (0, wall_m)])
