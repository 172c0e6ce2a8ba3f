"""Where an object may stand: inside, clear of walls and of each other, out of the device's sight."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scene_library.polygons import Polygon, boundary_distance, contains, convex_gap
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

    outline : the plan; zone : (2, 2) low and high corner of the part of it that may be furnished; walls : (n, 2, 2)
    vertical surfaces to keep clear of; fan : (m, 3, 2) what the device sees; clearance_m : kept to walls, to other
    objects and to the sight line.
    """

    outline: Polygon
    zone: NDArray[np.float64]
    walls: NDArray[np.float64]
    height_m: float
    fan: NDArray[np.float64]
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
            if above < self.clearance_m and convex_gap(other.footprint, candidate.footprint) < self.clearance_m:
                return "object"
        return None
