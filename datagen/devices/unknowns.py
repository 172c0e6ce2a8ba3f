"""What the light before a sensor is not linear in: places of sensor and mesh, and the device itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from datagen.capture.device_optics import zone_boxes
from datagen.devices.model import Device
from datagen.devices.surfaces import Pieces
from datagen.records.arrays import Floats

Placed = Literal["hand", "mesh", "zones"]
PLACED: tuple[Placed, ...] = ("hand", "mesh", "zones")
"""Groups of numbers that the light is not linear in."""
TURN_STEP_RAD, SHIFT_STEP_M = 6e-3, 8e-4
"""Steps of the differences of turns and shifts. In smaller ones the noise of rays that pass an edge is larger."""


@dataclass(frozen=True)
class State:
    """A device, the turn (rotation vector) and shift, metres, of hand (in the sensor's frame) and mesh, and what the
    light is divided into."""

    device: Device
    hand: Floats
    mesh: Floats
    pieces: Pieces


@dataclass(frozen=True)
class Unknown:
    """A number that is fitted: its value now, its prior's mean and standard deviation, the step of its differences,
    and the factor to the unit of its name."""

    name: str
    value: float
    prior: float
    deviation: float
    step: float
    shown: float = 1.0


def _placing(which: str, turn_rad: float, shift_m: float) -> Callable[[State], list[Unknown]]:
    """What gives the six numbers of the placing `which`, with the standard deviations of turns and shifts."""

    def unknowns(state: State) -> list[Unknown]:
        values = getattr(state, which)
        turns = [
            Unknown(f"{which}: turn {axis} (degrees)", values[k], 0.0, turn_rad, TURN_STEP_RAD, 180 / np.pi)
            for k, axis in enumerate("xyz")
        ]
        shifts = [
            Unknown(f"{which}: shift {axis} (mm)", values[3 + k], 0.0, shift_m, SHIFT_STEP_M, 1e3)
            for k, axis in enumerate("xyz")
        ]
        return [*turns, *shifts]

    return unknowns


def _of_zones(state: State) -> list[Unknown]:
    """The numbers of the device, each with itself as the mean of its prior, in the order of `_with_zones`."""
    zones, light = state.device.zones, state.device.light
    count, boxes = zones.count, zone_boxes(zones)
    gains = np.array(zones.gains or [1.0] * count)
    delays = np.array(zones.delays_ps or [0.0] * count)
    unknowns = [
        Unknown(f"zones: {axis} of zone {z} (tangent)", boxes[z, k], boxes[z, k], 0.03, 0.004)
        for k, axis in enumerate(("right", "up"))
        for z in range(count)
    ]
    unknowns += [Unknown(f"zones: ln gain of zone {z}", np.log(g), np.log(g), 1.0, 0.03) for z, g in enumerate(gains)]
    unknowns += [Unknown(f"zones: delay of zone {z} (ps)", d, d, 50.0, 4.0) for z, d in enumerate(delays)]
    unknowns += [Unknown(f"zones: ln {side} scale", 0.0, 0.0, 0.2, 0.03) for side in ("width", "height")]
    unknowns.append(Unknown("zones: ln blur", np.log(max(zones.blur, 1e-3)), np.log(0.02), 0.7, 0.1))
    unknowns.append(Unknown("zones: ln crosstalk", np.log(max(zones.crosstalk, 1e-4)), np.log(0.01), 0.5, 0.1))
    unknowns.append(Unknown("light: ln spread", np.log(light.spread or 0.5), np.log(0.3), 0.7, 0.05))
    return unknowns


UNKNOWNS: dict[Placed, Callable[[State], list[Unknown]]] = {
    "hand": _placing("hand", 0.05, 0.02),
    "mesh": _placing("mesh", 0.02, 0.005),
    "zones": _of_zones,
}


def state_with(state: State, groups: Sequence[Placed], values: Floats) -> State:
    """The state with the numbers of groups, in the order of their unknowns."""
    for group in groups:
        if group == "zones":
            mine, values = values, values[:0]
            state = replace(state, device=_with_zones(state.device, mine))
        else:
            placed, values = values[:6], values[6:]
            state = replace(state, hand=placed) if group == "hand" else replace(state, mesh=placed)
    return state


def _with_zones(sensor: Device, values: Floats) -> Device:
    """The device with other numbers (4 zones + 5,)."""
    count = sensor.zones.count
    right, up, gains, delays, rest = np.split(values, [count, 2 * count, 3 * count, 4 * count])
    width, height, blur, crosstalk, spread = np.exp(rest)
    boxes = zone_boxes(sensor.zones) * [1, 1, width, height]
    boxes[:, 0], boxes[:, 1] = right, up
    zones = sensor.zones.model_copy(update={
        "boxes": tuple(tuple(map(float, box)) for box in boxes), "field_deg": None, "rows": 1, "columns": 1,
        "gains": tuple(map(float, np.exp(gains))), "delays_ps": tuple(map(float, delays)), "blur": float(blur),
        "crosstalk": float(min(crosstalk, 0.5)),
    })  # fmt: skip
    light = sensor.light.model_copy(update={"spread": float(spread)})
    return sensor.model_copy(update={"zones": zones, "light": light})
