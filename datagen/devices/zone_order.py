"""The order in which a file lists the zones of a sensor, and how it is turned into that of the device.

Drivers list zones by rows or by columns and from any corner, and some exchange neighbours. A file of frames says so
by `zone_order`: one of `ORDERS`, as the sensor sees the scene, or the device's number of each zone listed.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from datagen.capture.device_optics import zone_boxes
from datagen.config.base import near_hint
from datagen.config.device import Zones
from datagen.devices.frames import Frames
from datagen.errors import InputError, shown
from datagen.records.arrays import Floats, Ints

EXCHANGED = ", pairs exchanged"
"""End of the name of an order in which the columns 0 and 1, 2 and 3, … of every row have changed places."""
ORDERS = tuple(
    f"{along} from {vertical} {side}{end}"
    for end, along, vertical, side in itertools.product(
        ("", EXCHANGED), ("rows", "columns"), ("top", "bottom"), ("left", "right")
    )
)


def in_device_order(frames: Frames, zones: Zones) -> Frames:
    """Frames without a reference channel, with their zones in the order of the device.

    Raises `InputError` for an order that is none, and for a named one where the zones form no grid.
    """
    if frames.zone_order is None:
        return frames
    listed = zones_listed(frames.source, frames.zone_order, zones, frames.histograms.shape[1])
    return replace(frames, histograms=frames.histograms[:, np.argsort(listed)], zone_order=None)


def zones_listed(source: str, order: str | Sequence[int], zones: Zones, count: int) -> Ints:
    """(count,) the device's number of each zone, in the order in which a file lists them. Raises as
    `in_device_order`, with the name of the `source`."""
    if not isinstance(order, str):
        # Compared as they are: as numbers of 64 bits fractions would be cut, and larger ones cannot be held.
        listed = tuple(order) if isinstance(order, Sequence | np.ndarray) else ()
        if len(listed) != count or any(number not in listed for number in range(count)):
            raise InputError(
                f"{source}: zone_order lists {shown(order)}; give each of the device's zones 0 … {count - 1} "
                f"once, or a text such as {ORDERS[0]!r}"
            )
        return np.array(listed, np.int64)
    if order not in ORDERS:
        there = (
            "there are rows or columns from top or bottom left or right, as the sensor sees the scene, and the same "
            f"with {EXCHANGED!r} at the end; or the device's number of each zone"
        )
        raise InputError(f"{source}: zone_order = {shown(order)}: {near_hint(order, ORDERS, there)}")
    grid = grid_of(zones)
    if grid is None or grid.size != count:
        raise InputError(
            f"{source}: zone_order = {order!r}: the device's {count} histograms form no grid of zones; list the "
            "number of each instead"
        )
    along, _, vertical, side = order.removesuffix(EXCHANGED).split()
    if order.endswith(EXCHANGED):
        columns = np.arange(grid.shape[1])
        partners = columns ^ 1
        grid = grid[:, np.where(partners < len(columns), partners, columns)]
    grid = grid[:: 1 if vertical == "top" else -1, :: 1 if side == "left" else -1]
    return np.ravel(grid if along == "rows" else grid.T)


def grid_of(zones: Zones) -> Ints | None:
    """(rows, columns) number of the zone at each place of a grid, from the top left as the sensor sees it; None where
    the zones form none."""
    boxes = zone_boxes(zones)
    right, up = boxes[:, 0], boxes[:, 1]
    whole = [rows for rows in range(1, len(boxes) + 1) if len(boxes) % rows == 0]
    # The squarest first: zones in one line are a grid either way.
    for rows in sorted(whole, key=lambda rows: max(rows, len(boxes) // rows)):
        grid = np.argsort(-up, kind="stable").reshape(rows, -1)
        grid = np.take_along_axis(grid, np.argsort(right[grid], axis=1, kind="stable"), axis=1)
        if _are_apart(-up[grid]) and _are_apart(right[grid].T):
            return grid
    return None


def _are_apart(lines: Floats) -> bool:
    """Whether all values of each of some lines (line, n) lie before all of the next."""
    return bool((lines.max(axis=1)[:-1] < lines.min(axis=1)[1:]).all())
