"""Find a free place for one object: anywhere, with its back to a wall, or hanging from the ceiling."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from datagen.config.distributions import draw
from datagen.config.scene_contents import Item, Standing
from datagen.records import Rectangle
from datagen.records.arrays import Floats
from datagen.scene.draws import Thing
from scene_library.placement import FreeSpace, Occupied, WallSpots
from scene_library.rooms import FloorPlan
from scene_library.solids import Solid

POSITIONS_PER_OBJECT = 40
"""Positions tried for one object before all objects of the room are placed anew, which takes longer."""


class Unmet(Exception):
    """An attempt to furnish a room failed: an object (`where`) met an obstacle (`what`), for the message of refusal.

    final : no other places of the objects would help.
    """

    def __init__(self, where: str, what: str, *, final: bool = False) -> None:
        super().__init__(where, what)
        self.final = final


@dataclass(frozen=True)
class Spot:
    """The pose of an object: rotated by `rotation_deg` about z, counter-clockwise, then moved to (x_m, y_m, z_m).

    along, across : its place as shares of the hidden part, 0 … 1.
    """

    x_m: float
    y_m: float
    z_m: float
    rotation_deg: float
    along: float
    across: float

    def vertices(self, solid: Solid) -> Floats:
        """(V, 3) the solid's vertices in this pose, metres."""
        return solid.placed(self.x_m, self.y_m, self.z_m, self.rotation_deg)


def place(
    thing: Thing, rotation_deg: float, plan: FloorPlan, wall: Rectangle, space: FreeSpace, rng: np.random.Generator
) -> Spot:
    """A free place of an object, which then is taken in `space`. Raises `Unmet` with the most frequent obstacle.

    wall : the visible part of the relay wall; `offset_m` counts from its middle.
    """
    where, item, solid = thing.where, thing.item, thing.solid
    placement = item.placement if isinstance(item, Standing) else "floor"
    z = plan.height_m - thing.elevation_m - solid.top_m if placement == "hanging" else thing.elevation_m
    # Places along the walls of the hidden part, the relay wall left out; none in the open.
    edges = np.delete(plan.edges, plan.relay_edge, axis=0)[: 0 if plan.open_air else None]
    spots = WallSpots.within(edges, plan.hidden) if placement == "wall" else None
    obstacles: Counter[str] = Counter()
    along = item.along if item.distance_m is None else item.distance_m
    across = item.across if item.offset_m is None else item.offset_m
    only_one = spots is None and isinstance(along, float) and isinstance(across, float)
    for _ in range(1 if only_one else POSITIONS_PER_OBJECT):
        if spots is None:
            spot = _spot(item, plan, wall, z, rotation_deg, draw(along, rng), draw(across, rng))
        else:
            # Slightly more than the clearance, so that it is kept in spite of rounding.
            pose = spots.pose(solid.hull, space.clearance_m * (1 + 1e-6) + 1e-9, rng)
            if pose is None:
                raise Unmet(where, "no_wall", final=True)
            spot = _spot_at(plan, z, *pose)
        taken = Occupied(solid.footprint(spot.x_m, spot.y_m, spot.rotation_deg), z, z + solid.top_m)
        obstacle = space.obstacle(taken)
        if obstacle is None:
            space.taken.append(taken)
            return spot
        obstacles[obstacle] += 1
        if obstacle == "height":
            raise Unmet(where, "height", final=True)
    raise Unmet(where, obstacles.most_common(1)[0][0])


def _spot(
    item: Item, plan: FloorPlan, wall: Rectangle, z: float, rotation_deg: float, along: float, across: float
) -> Spot:
    """The place of an object; `along` and `across` are metres where its settings give metres."""
    (x0, y0), (x1, y1) = plan.hidden
    x = x0 + along * (x1 - x0) if item.distance_m is None else plan.relay_segment[0, 0] - along
    if item.offset_m is not None:
        y = wall.center[1] + across * wall.right[1] / np.linalg.norm(wall.right)
    else:
        y = y0 + across * (y1 - y0) if plan.across_from_low else y1 - across * (y1 - y0)
    if item.distance_m is None and item.offset_m is None:
        return Spot(float(x), float(y), z, rotation_deg, along, across)
    return _spot_at(plan, z, float(x), float(y), rotation_deg)


def _spot_at(plan: FloorPlan, z: float, x: float, y: float, rotation_deg: float) -> Spot:
    low, high = plan.hidden
    along, across = (np.array([x, y]) - low) / (high - low)
    return Spot(x, y, z, rotation_deg, float(along), float(across if plan.across_from_low else 1 - across))
