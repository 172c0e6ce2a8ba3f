"""Floor plans from dimensions: each function draws one kind of room (see `rooms.py` for the conventions)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from scene_library.arrays import Floats
from scene_library.rooms import Doorway, FloorPlan, RoomDoesNotClose

MINIMUM_APPROACH_M = 0.1
"""At least this much corridor lies between the device and the corner that hides the rest."""

_Point = tuple[float, float]


@dataclass(frozen=True)
class _Approach:
    """What every layout has: the device and the relay wall ahead of it.

    Attributes
    ----------
    relay_distance_m : from the device straight ahead to the relay wall.
    height_m : floor to ceiling.
    device_height_m : of the device above the floor.
    device_offset : where the device stands across the corridor (or before the wall): 0 at the side away from the
        hidden part, 1 at its side.
    """

    relay_distance_m: float
    height_m: float
    device_height_m: float
    device_offset: float

    def sides(self, width_m: float) -> _Point:
        """y of both sides of a corridor in which the device stands at y = 0; the hidden part's side last."""
        return -width_m * self.device_offset, width_m * (1 - self.device_offset)

    def corner(self, before_wall_m: float, key: str, thickness_m: float = 0.0) -> float:
        """x of the corner that hides the rest: `before_wall_m` (the dimension `key`) and a wall's thickness away."""
        corner = self.relay_distance_m - before_wall_m - thickness_m
        if corner < MINIMUM_APPROACH_M:
            where = "behind the device" if corner < 0 else f"within {MINIMUM_APPROACH_M} m of the device"
            raise RoomDoesNotClose(
                f"the corner that hides the rest lies {where}: raise relay_distance_m or lower {key}"
            )
        return corner

    @property
    def device(self) -> Floats:
        """(3,) place of the device."""
        if self.device_height_m >= self.height_m:
            raise RoomDoesNotClose("the device is above the ceiling: lower device_height_m or raise height_m")
        return np.array([0.0, 0.0, self.device_height_m])


@dataclass(frozen=True)
class _Corridor(_Approach):
    """A corridor in which the device stands, `corridor_width_m` wide, `corridor_behind_m` of it behind the device."""

    corridor_width_m: float
    corridor_behind_m: float

    @property
    def walls(self) -> _Point:
        """y of the side wall away from the hidden part, and of the one on its side."""
        return self.sides(self.corridor_width_m)

    def plan(self, beyond: list[_Point], hidden_corners: Iterable[int], relay_edge: int = 1) -> FloorPlan:
        """The corridor's near end, and counter-clockwise between its corners those `beyond` it."""
        low, high = self.walls
        outline = np.array([(-self.corridor_behind_m, low), *beyond, (-self.corridor_behind_m, high)])
        return FloorPlan(outline, relay_edge, self.height_m, self.device, tuple(hidden_corners))

    def crossing(self, corner: float, right_m: float, left_m: float) -> FloorPlan:
        """The corridor widens at x = `corner` by `right_m` and `left_m` up to the relay wall."""
        (low, high), end = self.walls, self.relay_distance_m
        beyond = [(corner, low), (corner, low - right_m)] if right_m > 0 else []
        first, relay_edge = (2, 3) if right_m > 0 else (1, 1)
        beyond += [(end, low - right_m), (end, high + left_m)]
        beyond += [(corner, high + left_m), (corner, high)] if left_m > 0 else []
        return self.plan(beyond, range(first, len(beyond) + 1), relay_edge)


def l_corridor(*, room_length_m: float, room_width_m: float, **corridor: float) -> FloorPlan:
    """A corridor along +x that ends at the relay wall; before the end a room opens to the side.

    The room reaches `room_length_m` back from the relay wall and `room_width_m` away from the corridor. The inner
    corner at (relay_distance − room_length, corridor side) hides it. Here and below, `corridor` holds what all
    corridors have (`_Corridor`), and `RoomDoesNotClose` is raised for dimensions that contradict each other.
    """
    leg = _Corridor(**corridor)
    (low, high), end = leg.walls, leg.relay_distance_m
    corner, far = leg.corner(room_length_m, "room_length_m"), high + room_width_m
    return leg.plan([(end, low), (end, far), (corner, far), (corner, high)], (2, 3, 4))


def straight_corridor(
    *, partition_distance_m: float, partition_reach: float, partition_thickness_m: float, **corridor: float
) -> FloorPlan:
    """A straight corridor with a partition that juts out from one side and hides what stands behind it.

    The partition begins `partition_distance_m` before the relay wall and covers the share `partition_reach` of the
    corridor's width.
    """
    leg = _Corridor(**corridor)
    (low, high), end = leg.walls, leg.relay_distance_m
    back = end - partition_distance_m
    front = leg.corner(partition_distance_m, "partition_distance_m", partition_thickness_m)
    tip = high - partition_reach * leg.corridor_width_m
    if tip <= 0:
        raise RoomDoesNotClose("the partition stands before the device: lower partition_reach or device_offset")
    return leg.plan([(end, low), (end, high), (back, high), (back, tip), (front, tip), (front, high)], (2, 3, 4))


def t_corridor(*, arm_width_m: float, left_arm_m: float, right_arm_m: float, **corridor: float) -> FloorPlan:
    """A corridor that meets a cross corridor; the relay wall is its far side, both arms are hidden."""
    leg = _Corridor(**corridor)
    return leg.crossing(leg.corner(arm_width_m, "arm_width_m"), right_arm_m, left_arm_m)


def corridor_room(
    *, room_length_m: float, room_width_m: float, opening_offset: float, **corridor: float
) -> FloorPlan:
    """A corridor that opens into a wider room; the relay wall is the room's far wall.

    `opening_offset` is where the corridor enters across the room: 0 puts all of the room on the hidden side.
    """
    leg = _Corridor(**corridor)
    corner, spare = leg.corner(room_length_m, "room_length_m"), room_width_m - leg.corridor_width_m
    if spare <= 0:
        raise RoomDoesNotClose("the room is narrower than the corridor: raise room_width_m or lower corridor_width_m")
    right = spare * opening_offset
    return leg.crossing(corner, right, spare - right)


def z_corridor(
    *, middle_width_m: float, middle_length_m: float, last_width_m: float, last_length_m: float, **corridor: float
) -> FloorPlan:
    """Two bends: the first leg ends at the relay wall, the middle leg goes sideways, the last goes on beyond it.

    Objects stand in the middle leg. The last leg, behind the relay wall's plane, swallows light.
    """
    leg = _Corridor(**corridor)
    (low, high), end = leg.walls, leg.relay_distance_m
    corner, far = leg.corner(middle_width_m, "middle_width_m"), high + middle_length_m
    if last_width_m >= middle_length_m:
        raise RoomDoesNotClose(
            "the last leg is wider than the middle one is long: raise middle_length_m or lower last_width_m"
        )
    near, exit_ = far - last_width_m, end + last_length_m
    return leg.plan([(end, low), (end, near), (exit_, near), (exit_, far), (corner, far), (corner, high)], (2, 5, 6))


def doorway_room(
    *,
    door_width_m: float,
    door_height_m: float,
    wall_thickness_m: float,
    hall_width_m: float,
    hall_behind_m: float,
    room_length_m: float,
    room_width_m: float,
    opening_offset: float,
    **approach: float,
) -> FloorPlan:
    """A room seen through a doorway from a hall; the relay wall is the room's far wall.

    The device stands in the hall straight before the doorway (`device_offset` across it). `opening_offset` is where
    the doorway sits across the room: 0 puts all of the room on the hidden side. `approach` : as `_Approach`.
    """
    ahead = _Approach(**approach)
    low, high = ahead.sides(door_width_m)
    end, inner = ahead.relay_distance_m, ahead.relay_distance_m - room_length_m
    outer = ahead.corner(room_length_m, "room_length_m", wall_thickness_m)
    beside, around = room_width_m - door_width_m, hall_width_m - door_width_m
    if beside <= 0 or around <= 0:
        wider = "room_width_m" if beside <= 0 else "hall_width_m"
        raise RoomDoesNotClose(f"the doorway is wider than the wall it is in: raise {wider} or lower door_width_m")
    if door_height_m >= ahead.height_m:
        raise RoomDoesNotClose("the doorway is higher than the room: lower door_height_m or raise height_m")
    if ahead.device_height_m >= door_height_m:
        raise RoomDoesNotClose("the device looks at the lintel: lower device_height_m or raise door_height_m")
    # A sliver of wall beside the doorway would only make needle-thin triangles.
    sliver = min(0.01, beside / 2)
    right = min(max(beside * opening_offset, sliver), beside - sliver)
    hall_right, hall_left = low - around / 2, high + around / 2
    room_right, room_left = low - right, high + beside - right
    hall = [(outer, high), (outer, hall_left), (-hall_behind_m, hall_left)]
    room = [(inner, low), (inner, room_right), (end, room_right), (end, room_left), (inner, room_left), (inner, high)]
    outline = np.array([(-hall_behind_m, hall_right), (outer, hall_right), (outer, low), *room, *hall])
    doorway = Doorway(2, 3, 8, 9, door_height_m)
    return FloorPlan(outline, 5, ahead.height_m, ahead.device, (4, 5, 6, 7), doorway=doorway)


def isolated_wall(
    *,
    wall_width_m: float,
    screen_to_wall_m: float,
    screen_offset_m: float,
    space_width_m: float,
    space_back_m: float = 0.0,
    **approach: float,
) -> FloorPlan:
    """The classic bench: a relay wall in free space, and a screen beside the device that hides the objects.

    The screen runs along the line of sight, `screen_offset_m` to its side, and ends `screen_to_wall_m` before the
    wall; objects stand beyond that end, up to `space_width_m` (or the wall's own end) to the side, and up to
    `space_back_m` back from that end beside the screen. Wall and screen are `height_m` high: a segment between two
    points no higher than the screen never passes above it.
    """
    ahead = _Approach(**approach)
    low, high = ahead.sides(wall_width_m)
    end, corner = ahead.relay_distance_m, ahead.corner(screen_to_wall_m, "screen_to_wall_m")
    back, right, left = corner - space_back_m, low - 0.01, max(screen_offset_m + space_width_m, high + 0.01)
    # The screen begins behind all objects, so that the device sees none of them past its near end either.
    behind = min(-0.5, back - 0.5)
    outline = [(behind, right), (end, right), (end, low), (end, high), (end, left), (back, left), (behind, left)]
    screen = np.array([(behind, screen_offset_m), (corner, screen_offset_m)])
    return FloorPlan(np.array(outline), 2, ahead.height_m, ahead.device, (4, 5), open_air=True, screen=screen)


SCREEN_BEHIND_M = 0.05
"""From the device back to the screen behind it."""


def wall_behind_objects(
    *,
    relay_distance_m: float,
    height_m: float,
    device_height_m: float,
    wall_width_m: float,
    beside_m: float,
    space_depth_m: float,
) -> FloorPlan:
    """The bench with the objects in front of the relay wall, in a box as wide and high as the wall.

    The device stands `beside_m` beside the wall's nearer end and `relay_distance_m` before its plane, nearer than any
    object, so that it sees the wall at a slant and no object is in the way. A screen right behind it, along the wall
    and no farther than to its nearer end, hides what is farther away from the device, and no part of the wall from
    the objects.
    """
    device = _Approach(relay_distance_m, height_m, device_height_m, 0.0).device
    near, far = beside_m, beside_m + wall_width_m
    back = relay_distance_m - space_depth_m
    if back > -2 * SCREEN_BEHIND_M:
        raise RoomDoesNotClose(
            "the space before the wall ends where the device stands: raise space_depth_m or lower relay_distance_m"
        )
    right, wall = -0.5, relay_distance_m
    outline = np.array([(back, right), (wall, right), (wall, near), (wall, far), (back, far)])
    screen = np.array([(-SCREEN_BEHIND_M, right / 2), (-SCREEN_BEHIND_M, near)])
    return FloorPlan(outline, 2, height_m, device, (2, 3, 4), open_air=True, screen=screen, all_in_view=True)


LAYOUTS: dict[str, Callable[..., FloorPlan]] = {
    function.__name__: function
    for function in (
        straight_corridor, l_corridor, t_corridor, z_corridor, corridor_room, doorway_room, isolated_wall
    )
}  # fmt: skip
"""Every kind of layout by name."""

PLANS = LAYOUTS | {"isolated_wall, in_front": wall_behind_objects}
"""Every floor plan by name: some layouts have several."""
