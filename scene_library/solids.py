"""Closed solids from a few numbers, and what placing one needs to know: its footprint and its height.

A solid stands on z = 0 with its axis on x = y = 0 until it is placed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scene_library.polygons import Polygon, convex_hull, rotation, triangulate


@dataclass(frozen=True)
class Solid:
    """One object.

    Attributes
    ----------
    vertices : (V, 3) metres. triangles : (F, 3) indices.
    hull : (n, 2) convex hull of the vertices in plan, counter-clockwise.
    top_m : height of the highest vertex; the lowest is at 0.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]
    hull: Polygon
    top_m: float

    @classmethod
    def of(cls, vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> Solid:
        return cls(vertices, triangles, convex_hull(vertices[:, :2]), float(vertices[:, 2].max()))

    def scaled(self, factor: float) -> Solid:
        return Solid(self.vertices * factor, self.triangles, self.hull * factor, self.top_m * factor)

    def footprint(self, x: float, y: float, rotation_deg: float) -> Polygon:
        """The hull in plan when the solid is turned about z and moved to (x, y)."""
        return self.hull @ rotation(np.radians(rotation_deg)).T + [x, y]

    def placed(self, x: float, y: float, z: float, rotation_deg: float) -> NDArray[np.float64]:
        """(V, 3) vertices of the solid turned about z, then moved to (x, y, z)."""
        plan = self.vertices[:, :2] @ rotation(np.radians(rotation_deg)).T + [x, y]
        return np.column_stack([plan, self.vertices[:, 2] + z])


def prism(base: Polygon, height_m: float) -> Solid:
    """A closed prism over a simple counter-clockwise polygon, outward triangles."""
    n = len(base)
    low = np.column_stack([base, np.zeros(n)])
    high = np.column_stack([base, np.full(n, height_m)])
    i, j = np.arange(n), (np.arange(n) + 1) % n
    sides = np.concatenate([np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)])
    caps = triangulate(base)
    return Solid.of(np.concatenate([low, high]), np.concatenate([sides, caps[:, ::-1], caps + n]))


def rectangle(width_m: float, depth_m: float) -> Polygon:
    """width along x, depth along y, about the origin."""
    return np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * [width_m / 2, depth_m / 2]


def regular_polygon(diameter_m: float, sides: int) -> Polygon:
    """Corners on a circle of `diameter_m`."""
    angle = 2 * np.pi * np.arange(sides) / sides
    return 0.5 * diameter_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
