"""Where an object may stand: inside, clear of walls and of each other, out of the device's sight."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from scene_library.arrays import Floats
from scene_library.polygons import Polygon, boundary_distance, contains
from scene_library.separation import gap_between
from scene_library.visibility import is_hidden

Obstacle = Literal["wall", "object", "sight", "height"]


@dataclass(frozen=True)
class Occupied:
    """What a placed object takes: a convex footprint over a range of heights."""

    footprint: Polygon
    bottom_m: float
    top_m: float


@dataclass
class FreeSpace:
    """The room left over while it is being furnished.

    Attributes
    ----------
    outline : of the floor plan.
    zone : (2, 2) low and high corner of the part of it that may be furnished.
    walls : (n, 2, 2) vertical surfaces to keep clear of.
    height_m : floor to ceiling.
    fan : (m, 3, 2) triangles of the plan that the device sees.
    clearance_m : kept to walls, to other objects and to the sight line.
    taken : what stands in it already.
    """

    outline: Polygon
    zone: Floats
    walls: Floats
    height_m: float
    fan: Floats
    clearance_m: float
    taken: list[Occupied] = field(default_factory=list)

    def obstacle(self, candidate: Occupied) -> Obstacle | None:
        """What keeps `candidate` from standing where it is, or None.

        Footprints are convex hulls: for prisms the tests are exact, for other shapes they err on the safe side.
        """
        if candidate.bottom_m < -1e-9 or candidate.top_m > self.height_m + 1e-9:
            return "height"
        if (candidate.footprint < self.zone[0]).any() or (candidate.footprint > self.zone[1]).any():
            return "wall"
        if not contains(self.outline, candidate.footprint).all():
            return "wall"
        if not is_hidden(candidate.footprint, self.fan, self.clearance_m):
            return "sight"
        if boundary_distance(candidate.footprint, self.walls) < self.clearance_m:
            return "wall"
        for other in self.taken:
            above = max(other.bottom_m - candidate.top_m, candidate.bottom_m - other.top_m)
            if above < self.clearance_m and gap_between(other.footprint, candidate.footprint) < self.clearance_m:
                return "object"
        return None


@dataclass(frozen=True)
class WallSpots:
    """Where an object may stand with its back to a wall.

    Attributes
    ----------
    starts, ends : (n, 2) stretches of wall.
    inward : (n, 2) their unit normals into the room.
    """

    starts: Floats
    ends: Floats
    inward: Floats

    @classmethod
    def within(cls, edges: Floats, zone: Floats) -> WallSpots:
        """The parts of counter-clockwise `edges` (n, 2, 2) that lie in the box `zone` (2, 2)."""
        start, along = edges[:, 0], edges[:, 1] - edges[:, 0]
        length = np.linalg.norm(along, axis=1)
        still = np.abs(along) < 1e-12
        step = np.where(still, 1.0, along)
        near, far = (zone[0] - 1e-9 - start) / step, (zone[1] + 1e-9 - start) / step
        outside = still & ((start < zone[0] - 1e-9) | (start > zone[1] + 1e-9))
        enter = np.where(still, -np.inf, np.minimum(near, far)).max(axis=1).clip(0, 1)
        leave = np.where(still, np.inf, np.maximum(near, far)).min(axis=1).clip(0, 1)
        kept = (leave > enter) & ~outside.any(axis=1)
        inward = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
        first, last = start + enter[:, None] * along, start + leave[:, None] * along
        return cls(first[kept], last[kept], inward[kept])

    def pose(self, hull: Polygon, gap_m: float, rng: np.random.Generator) -> tuple[float, float, float] | None:
        """(x, y, rotation in degrees) with the back (+y) of `hull` `gap_m` before a random stretch of wall."""
        length = np.linalg.norm(self.ends - self.starts, axis=1)
        if length.sum() == 0:
            return None
        position = rng.random() * length.sum()
        k = min(int(np.searchsorted(np.cumsum(length), position, side="right")), len(length) - 1)
        t = (position - (np.cumsum(length)[k] - length[k])) / length[k]
        foot = self.starts[k] + t * (self.ends[k] - self.starts[k])
        x, y = foot + self.inward[k] * (float(hull[:, 1].max()) + gap_m)
        back = -self.inward[k]
        return float(x), float(y), float(np.degrees(np.arctan2(back[1], back[0])) - 90.0) % 360.0
