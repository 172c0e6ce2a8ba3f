"""Floor plans from dimensions: each function draws one kind of room (see `rooms.py` for the conventions).

Everywhere `relay_distance_m` is the way from the device straight ahead to the relay wall, and `device_offset` where
the device stands across the corridor (or before the wall): 0 at the side away from the hidden part, 1 at its side.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from scene_library.rooms import Doorway, FloorPlan, RoomDoesNotClose

MINIMUM_APPROACH_M = 0.1
"""At least this much corridor lies between the device and the corner that hides the rest."""


def l_corridor(
    *,
    relay_distance_m: float,
    height_m: float,
    device_height_m: float,
    device_offset: float,
    corridor_width_m: float,
    corridor_behind_m: float,
    room_length_m: float,
    room_width_m: float,
) -> FloorPlan:
    """A corridor along +x that ends at the relay wall; before the end a room opens to the side.

    The room reaches `room_length_m` back from the relay wall and `room_width_m` away from the corridor. The inner
    corner at (relay_distance − room_length, corridor side) hides it.
    """
    end, corner = relay_distance_m, relay_distance_m - room_length_m
    closed, opening = _sides(corridor_width_m, device_offset)
    _check_corner(corner, "room_length_m")
    outline = [
        (-corridor_behind_m, closed),
        (end, closed),
        (end, opening + room_width_m),
        (corner, opening + room_width_m),
        (corner, opening),
        (-corridor_behind_m, opening),
    ]
    return _plan(outline, 1, height_m, device_height_m, (2, 3, 4))


def straight_corridor(
    *,
    relay_distance_m: float,
    height_m: float,
    device_height_m: float,
    device_offset: float,
    corridor_width_m: float,
    corridor_behind_m: float,
    partition_distance_m: float,
    partition_reach: float,
    partition_thickness_m: float,
) -> FloorPlan:
    """A straight corridor with a partition that juts out from one side and hides what stands behind it.

    The partition begins `partition_distance_m` before the relay wall and covers the share `partition_reach` of the
    corridor's width.
    """
    end = relay_distance_m
    back = end - partition_distance_m
    front = back - partition_thickness_m
    low, high = _sides(corridor_width_m, device_offset)
    tip = high - partition_reach * corridor_width_m
    _check_corner(front, "partition_distance_m")
    if tip <= 0:
        raise RoomDoesNotClose("the partition stands before the device: lower partition_reach or device_offset")
    outline = [
        (-corridor_behind_m, low),
        (end, low),
        (end, high),
        (back, high),
        (back, tip),
        (front, tip),
        (front, high),
        (-corridor_behind_m, high),
    ]
    return _plan(outline, 1, height_m, device_height_m, (2, 3, 4))


def t_corridor(
    *,
    relay_distance_m: float,
    height_m: float,
    device_height_m: float,
    device_offset: float,
    corridor_width_m: float,
    corridor_behind_m: float,
    arm_width_m: float,
    left_arm_m: float,
    right_arm_m: float,
) -> FloorPlan:
    """A corridor that meets a cross corridor; the relay wall is its far side, both arms are hidden."""
    low, high = _sides(corridor_width_m, device_offset)
    corner = relay_distance_m - arm_width_m
    _check_corner(corner, "arm_width_m")
    return _crossing(
        relay_distance_m, corner, low, high, right_arm_m, left_arm_m, corridor_behind_m, height_m, device_height_m
    )


def corridor_room(
    *,
    relay_distance_m: float,
    height_m: float,
    device_height_m: float,
    device_offset: float,
    corridor_width_m: float,
    corridor_behind_m: float,
    room_length_m: float,
    room_width_m: float,
    opening_offset: float,
) -> FloorPlan:
    """A corridor that opens into a wider room; the relay wall is the room's far wall.

    `opening_offset` is where the corridor enters across the room: 0 puts all of the room on the hidden side.
    """
    low, high = _sides(corridor_width_m, device_offset)
    corner = relay_distance_m - room_length_m
    _check_corner(corner, "room_length_m")
    spare = room_width_m - corridor_width_m
    if spare <= 0:
        raise RoomDoesNotClose("the room is narrower than the corridor: raise room_width_m or lower corridor_width_m")
    right = spare * opening_offset
    return _crossing(
        relay_distance_m, corner, low, high, right, spare - right, corridor_behind_m, height_m, device_height_m
    )


def z_corridor(
    *,
    relay_distance_m: float,
    height_m: float,
    device_height_m: float,
    device_offset: float,
    corridor_width_m: float,
    corridor_behind_m: float,
    middle_width_m: float,
    middle_length_m: float,
    last_width_m: float,
    last_length_m: float,
) -> FloorPlan:
    """Two bends: the first leg ends at the relay wall, the middle leg goes sideways, the last goes on beyond it.

    Objects stand in the middle leg. The last leg, behind the relay wall's plane, swallows light.
    """
    end, corner = relay_distance_m, relay_distance_m - middle_width_m
    closed, opening = _sides(corridor_width_m, device_offset)
    far = opening + middle_length_m
    _check_corner(corner, "middle_width_m")
    if last_width_m >= middle_length_m:
        raise RoomDoesNotClose("the last leg is wider than the middle one is long: raise middle_length_m")
    outline = [
        (-corridor_behind_m, closed),
        (end, closed),
        (end, far - last_width_m),
        (end + last_length_m, far - last_width_m),
        (end + last_length_m, far),
        (corner, far),
        (corner, opening),
        (-corridor_behind_m, opening),
    ]
    return _plan(outline, 1, height_m, device_height_m, (2, 5, 6))


def doorway_room(
    *,
    relay_distance_m: float,
    height_m: float,
    device_height_m: float,
    device_offset: float,
    door_width_m: float,
    door_height_m: float,
    wall_thickness_m: float,
    hall_width_m: float,
    hall_behind_m: float,
    room_length_m: float,
    room_width_m: float,
    opening_offset: float,
) -> FloorPlan:
    """A room seen through a doorway from a hall; the relay wall is the room's far wall.

    The device stands in the hall straight before the doorway (`device_offset` across it). `opening_offset` is where
    the doorway sits across the room: 0 puts all of the room on the hidden side.
    """
    end, inner = relay_distance_m, relay_distance_m - room_length_m
    outer = inner - wall_thickness_m
    low, high = _sides(door_width_m, device_offset)
    _check_corner(outer, "room_length_m")
    beside, around = room_width_m - door_width_m, hall_width_m - door_width_m
    if beside <= 0 or around <= 0:
        wider = "room_width_m" if beside <= 0 else "hall_width_m"
        raise RoomDoesNotClose(f"the doorway is wider than the wall it is in: raise {wider} or lower door_width_m")
    if door_height_m >= height_m:
        raise RoomDoesNotClose("the doorway is higher than the room: lower door_height_m or raise height_m")
    if device_height_m >= door_height_m:
        raise RoomDoesNotClose("the device looks at the lintel: lower device_height_m or raise door_height_m")
    # A sliver of wall beside the doorway would only make needle-thin triangles.
    right = max(beside * opening_offset, min(0.01, beside / 2))
    right = min(right, beside - min(0.01, beside / 2))
    outline = [
        (-hall_behind_m, low - around / 2),
        (outer, low - around / 2),
        (outer, low),
        (inner, low),
        (inner, low - right),
        (end, low - right),
        (end, high + beside - right),
        (inner, high + beside - right),
        (inner, high),
        (outer, high),
        (outer, high + around / 2),
        (-hall_behind_m, high + around / 2),
    ]
    return FloorPlan(
        outline=np.array(outline),
        relay_edge=5,
        height_m=height_m,
        device=_device(device_height_m, height_m),
        hidden_corners=(4, 5, 6, 7),
        doorway=Doorway(2, 3, 8, 9, door_height_m),
    )


def isolated_wall(
    *,
    relay_distance_m: float,
    height_m: float,
    device_height_m: float,
    device_offset: float,
    wall_width_m: float,
    screen_to_wall_m: float,
    screen_offset_m: float,
    space_width_m: float,
) -> FloorPlan:
    """The classic bench: a relay wall in free space, and a screen beside the device that hides the objects.

    The screen runs along the line of sight, `screen_offset_m` to its side, and ends `screen_to_wall_m` before the
    wall; objects stand beyond that end, up to `space_width_m` (or the wall's own end) to the side. Wall and screen
    are `height_m` high: a segment between two points no higher than the screen never passes above it.
    """
    end, corner = relay_distance_m, relay_distance_m - screen_to_wall_m
    low, high = _sides(wall_width_m, device_offset)
    _check_corner(corner, "screen_to_wall_m")
    behind, right = -0.5, low - 0.01
    left = max(screen_offset_m + space_width_m, high + 0.01)
    outline = [
        (behind, right),
        (end, right),
        (end, low),
        (end, high),
        (end, left),
        (corner, left),
        (behind, left),
    ]
    return FloorPlan(
        outline=np.array(outline),
        relay_edge=2,
        height_m=height_m,
        device=_device(device_height_m, height_m),
        hidden_corners=(4, 5),
        open_air=True,
        screen=np.array([(behind, screen_offset_m), (corner, screen_offset_m)]),
    )


def _crossing(
    end: float,
    corner: float,
    low: float,
    high: float,
    right: float,
    left: float,
    behind: float,
    height_m: float,
    device_height_m: float,
) -> FloorPlan:
    """A corridor low … high that widens at x = corner by `right` and `left` metres up to the relay wall at `end`."""
    outline = [(-behind, low), (corner, low)] if right > 0 else [(-behind, low)]
    first = len(outline)
    outline += [(corner, low - right)] if right > 0 else []
    relay = len(outline)
    outline += [(end, low - right), (end, high + left)]
    outline += [(corner, high + left), (corner, high)] if left > 0 else []
    outline += [(-behind, high)]
    return _plan(outline, relay, height_m, device_height_m, tuple(range(first, len(outline) - 1)))


def _plan(
    outline: ArrayLike, relay_edge: int, height_m: float, device_height_m: float, hidden_corners: tuple[int, ...]
) -> FloorPlan:
    device = _device(device_height_m, height_m)
    return FloorPlan(np.asarray(outline, np.float64), relay_edge, height_m, device, hidden_corners)


def _device(device_height_m: float, height_m: float) -> np.ndarray:
    if device_height_m >= height_m:
        raise RoomDoesNotClose("the device is above the ceiling: lower device_height_m or raise height_m")
    return np.array([0.0, 0.0, device_height_m])


def _sides(width_m: float, device_offset: float) -> tuple[float, float]:
    """y of both sides of a corridor in which the device stands at y = 0."""
    return -width_m * device_offset, width_m * (1 - device_offset)


def _check_corner(corner_m: float, key: str) -> None:
    if corner_m < MINIMUM_APPROACH_M:
        where = (
            f"{-corner_m:.2f} m behind the device" if corner_m < 0 else f"within {MINIMUM_APPROACH_M} m of the device"
        )
        raise RoomDoesNotClose(f"the corner that hides the rest lies {where}: raise relay_distance_m or lower {key}")
