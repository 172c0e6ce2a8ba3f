"""Whether something that moves stays clear of everything at all times of its way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from scene_library.arrays import Floats
from scene_library.placement import FreeSpace, Obstacle, Occupied
from scene_library.solids import Solid

LOST_CLEARANCE = 1 / 16
"""Share of the clearance that may be missing between two poses which are looked at. A smaller one costs checks where
something passes an obstacle at just the clearance, in proportion to its inverse, and nothing elsewhere."""


@dataclass(frozen=True)
class Mover:
    """A solid on its way, which is linear between poses at some times; two equal times are a jump.

    Attributes
    ----------
    times_s : (K,) ascending.
    poses : (K, 3) x and y, metres, and the rotation about the vertical, degrees.
    bottom_m : height of its lowest point.
    """

    solid: Solid
    bottom_m: float
    times_s: Floats
    poses: Floats

    def pose(self, time_s: float) -> tuple[float, float, float]:
        """x, y and rotation at a time that is no jump."""
        x, y, rotation = (float(np.interp(time_s, self.times_s, self.poses[:, axis])) for axis in range(3))
        return x, y, rotation

    def space_taken(self, time_s: float) -> Occupied:
        """What it takes at a time that is no jump."""
        return Occupied(self.solid.footprint(*self.pose(time_s)), self.bottom_m, self.bottom_m + self.solid.top_m)

    def reach_m(self, start_s: float, end_s: float) -> float:
        """How far any of its points is, at most, from where it is in the middle of a time without a jump or bend."""
        leg = int(np.searchsorted(self.times_s, 0.5 * (start_s + end_s), side="right")) - 1
        if not 0 <= leg < len(self.times_s) - 1:
            return 0.0
        x, y, rotation = self.poses[leg + 1] - self.poses[leg]
        radius = float(np.linalg.norm(self.solid.hull, axis=1).max())
        share = 0.5 * (end_s - start_s) / (self.times_s[leg + 1] - self.times_s[leg])
        return float(share * (np.hypot(x, y) + abs(np.radians(rotation)) * radius))


def obstacle_on_way(
    space: FreeSpace, mover: Mover, others: Sequence[Mover], start_s: float, end_s: float
) -> Obstacle | None:
    """What keeps a mover from its way between two times, or None.

    None holds for all times between the two, not only for some that are looked at: if, at the middle of a time, there
    is more room around a mover than it and all others cover until the time's ends, nothing can come nearer than the
    clearance within it. Otherwise the halves of the time are looked at. Of the clearance up to `LOST_CLEARANCE` may
    be missing between two poses.

    mover : jumps at neither of these times. others : movers that are already on their ways; what stands is in
        `space.taken`.
    """
    bends = np.concatenate([mover.times_s, *(other.times_s for other in others)])
    ends = np.unique([start_s, *bends[(bends > start_s) & (bends < end_s)], end_s])
    # Most ways that do not fit have an end that does not, which one check finds.
    if (found := space.obstacle(mover.space_taken(end_s))) is not None:
        return found
    pieces = list(pairwise(ends))
    while pieces:
        start, end = pieces.pop()
        middle = 0.5 * (start + end)
        reach = mover.reach_m(start, end) + max((other.reach_m(start, end) for other in others), default=0.0)
        there = replace(space, taken=[*space.taken, *(other.space_taken(middle) for other in others)])
        taken = mover.space_taken(middle)
        if _with_room(there, reach).obstacle(taken) is None:
            continue
        if (found := there.obstacle(taken)) is not None:
            return found
        if reach <= LOST_CLEARANCE * space.clearance_m:
            # The zone has no clearance that could take up what is lost.
            found = replace(_with_room(there, reach), clearance_m=space.clearance_m).obstacle(taken)
            if found is not None:
                return found
            continue
        pieces += [(start, middle), (middle, end)]
    return None


def _with_room(space: FreeSpace, room_m: float) -> FreeSpace:
    """The space with a larger clearance, to the edge of the zone, too."""
    zone = space.zone + room_m * np.array([[1.0], [-1.0]])
    return replace(space, clearance_m=space.clearance_m + room_m, zone=zone)
