"""Find a free place for one object: anywhere, with its back to a wall, or hanging from the ceiling."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from datagen.config.distributions import Distribution, draw
from datagen.config.scene_contents import Item, Standing
from datagen.config.scene_motion import MotionPoint, Points
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

    @property
    def pose(self) -> tuple[float, float, float]:
        """x, y and the rotation."""
        return self.x_m, self.y_m, self.rotation_deg

    def space_taken(self, solid: Solid) -> Occupied:
        """What the solid takes in this pose."""
        return Occupied(solid.footprint(*self.pose), self.z_m, self.z_m + solid.top_m)


def place(
    thing: Thing, rotation_deg: float, plan: FloorPlan, wall: Rectangle, space: FreeSpace, rng: np.random.Generator
) -> Spot:
    """A free place of an object, which then is taken in `space`. Raises `Unmet` with the most frequent obstacle.

    wall : the visible part of the relay wall; `offset_m` counts from its middle.
    """
    where, obstacles = thing.where, Counter[str]()
    spots = Spots.of(thing, plan, wall, space.clearance_m)
    for _ in range(spots.tries):
        spot = spots.draw(rotation_deg, rng)
        taken = spot.space_taken(thing.solid)
        obstacle = space.obstacle(taken)
        if obstacle is None:
            space.taken.append(taken)
            return spot
        obstacles[obstacle] += 1
        if obstacle == "height":
            raise Unmet(where, "height", final=True)
    raise Unmet(where, obstacles.most_common(1)[0][0])


@dataclass(frozen=True)
class Spots:
    """Where an object may be put, free or not.

    draw : (rotation, degrees; random numbers) → a place as the object's settings want it. Raises `Unmet` if there is
        no wall that it could stand against.
    tries : after how many places that are not free one may give up.
    """

    draw: Callable[[float, np.random.Generator], Spot]
    tries: int

    @classmethod
    def of(cls, thing: Thing, plan: FloorPlan, wall: Rectangle, clearance_m: float) -> Spots:
        """The places of an object that stands; of one that moves through given points, the first of them."""
        z = height_of(thing, plan)
        if isinstance(thing.item, Standing) and thing.item.placement == "wall":
            # Places along the walls of the hidden part, the relay wall left out; none in the open.
            edges = np.delete(plan.edges, plan.relay_edge, axis=0)[: 0 if plan.open_air else None]
            stretches = WallSpots.within(edges, plan.hidden)
            # Slightly more than the clearance, so that it is kept in spite of rounding.
            gap_m = clearance_m * (1 + 1e-6) + 1e-9

            def against_a_wall(_: float, rng: np.random.Generator) -> Spot:
                pose = stretches.pose(thing.solid.hull, gap_m, rng)
                if pose is None:
                    raise Unmet(thing.where, "no_wall", final=True)
                return spot_at(plan, z, *pose)

            return cls(against_a_wall, POSITIONS_PER_OBJECT)
        given = thing.item.motion.points[0] if isinstance(thing.item.motion, Points) else thing.item
        draw_spot = partial(draw_place, given, plan, wall, z)
        return cls(draw_spot, 1 if has_one_place(given) else POSITIONS_PER_OBJECT)


def height_of(thing: Thing, plan: FloorPlan) -> float:
    """Height of an object's lowest point, metres."""
    hangs = isinstance(thing.item, Standing) and thing.item.placement == "hanging"
    return plan.height_m - thing.elevation_m - thing.solid.top_m if hangs else thing.elevation_m


def has_one_place(given: Item | MotionPoint) -> bool:
    """Whether the place that settings ask for is the same whenever it is drawn."""
    along, across = _place_keys(given)
    return isinstance(along, float) and isinstance(across, float)


def draw_place(
    given: Item | MotionPoint, plan: FloorPlan, wall: Rectangle, z: float, rotation_deg: float,
    rng: np.random.Generator,
) -> Spot:  # fmt: skip
    """A place drawn as settings ask for it: shares of the hidden part, or metres from the relay wall and from the
    middle of its visible part, `wall`."""
    along, across = (draw(key, rng) for key in _place_keys(given))
    (x0, y0), (x1, y1) = plan.hidden
    x = x0 + along * (x1 - x0) if given.distance_m is None else plan.relay_segment[0, 0] - along
    if given.offset_m is not None:
        y = wall.center[1] + across * wall.right[1] / np.linalg.norm(wall.right)
    else:
        y = y0 + across * (y1 - y0) if plan.across_from_low else y1 - across * (y1 - y0)
    if given.distance_m is None and given.offset_m is None:
        return Spot(float(x), float(y), z, rotation_deg, along, across)
    return spot_at(plan, z, float(x), float(y), rotation_deg)


def _place_keys(given: Item | MotionPoint) -> tuple[Distribution, Distribution]:
    along = given.along if given.distance_m is None else given.distance_m
    across = given.across if given.offset_m is None else given.offset_m
    assert along is not None and across is not None
    return along, across


def spot_at(plan: FloorPlan, z: float, x: float, y: float, rotation_deg: float) -> Spot:
    """The place with given coordinates."""
    low, high = plan.hidden
    along, across = (np.array([x, y]) - low) / (high - low)
    return Spot(x, y, z, rotation_deg, float(along), float(across if plan.across_from_low else 1 - across))
