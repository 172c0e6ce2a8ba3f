"""Floor plans from dimensions: each function draws one kind of room (see `rooms.py` for the conventions)."""

from __future__ import annotations

import numpy as np

from scene_library.rooms import Plan, RoomDoesNotClose

MINIMUM_APPROACH_M = 0.1
"""At least this much corridor lies between the device and the corner that hides the rest."""


def l_corridor(
    *,
    relay_distance_m: float,
    corridor_width_m: float,
    corridor_behind_m: float,
    room_length_m: float,
    room_width_m: float,
    height_m: float,
    device_height_m: float,
    device_offset: float,
) -> Plan:
    """A corridor along +x that ends at the relay wall; before the end a room opens to the side.

    The room reaches `room_length_m` back from the relay wall and `room_width_m` away from the corridor. The inner
    corner at (relay_distance − room_length, corridor side) hides it. `device_offset` is where the device stands
    across the corridor: 0 at the closed side, 1 at the side of the room.
    """
    end, corner = relay_distance_m, relay_distance_m - room_length_m
    closed, opening = -corridor_width_m * device_offset, corridor_width_m * (1 - device_offset)
    _check_device(corner, device_height_m, height_m, "room_length_m")
    outline = np.array(
        [
            [-corridor_behind_m, closed],
            [end, closed],
            [end, opening + room_width_m],
            [corner, opening + room_width_m],
            [corner, opening],
            [-corridor_behind_m, opening],
        ]
    )
    return Plan(
        outline=outline,
        relay_edge=1,
        height_m=height_m,
        device=np.array([0.0, 0.0, device_height_m]),
        hidden=np.array([[corner, opening], [end, opening + room_width_m]]),
    )


def _check_device(corner_m: float, device_height_m: float, height_m: float, key: str) -> None:
    if corner_m < MINIMUM_APPROACH_M:
        raise RoomDoesNotClose(
            f"the inner corner lies {-corner_m:.2f} m behind the device: raise relay_distance_m or lower {key}"
            if corner_m < 0
            else f"the inner corner lies within {MINIMUM_APPROACH_M} m of the device: "
            f"raise relay_distance_m or lower {key}"
        )
    if device_height_m >= height_m:
        raise RoomDoesNotClose("the device is above the ceiling: lower device_height_m or raise height_m")
