"""Small rooms in which things move, and captures of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

import datagen as dg

DEVICE = (2.5, -1.8, 1.5)


def plate(x: float, half: float) -> trimesh.Trimesh:
    """A wall of ± half metres about the x axis, 3 m high."""
    corners = [(x, -half, 0), (x, half, 0), (x, half, 3), (x, -half, 3)]
    return trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)


def box(size: tuple[float, float, float] = (0.5, 0.5, 0.9)) -> trimesh.Trimesh:
    """A box that stands about its own origin."""
    return trimesh.creation.box(size)


def room(
    *movers: dg.Part, relay: dg.Material | None = None, back: dg.Material | None = None, **more: Any
) -> dg.Scene:
    """A relay wall, a wall 3 m away, and things that move between them."""
    walls = [
        dg.Part("relay_wall", plate(0, 2), relay or dg.Lambertian(0.8), "relay_wall"),
        dg.Part("back", plate(3, 2), back or dg.Lambertian(0.6), "structure"),
    ]
    return dg.Scene.from_parts([*walls, *movers], **more)


def capture(
    side: int = 3, bins: int = 256, pairing: dg.records.Pairing = "confocal", width_s: float = 1e-10, **more: Any
) -> dg.Capture:  # fmt: skip
    """side × side laser points on the relay wall, and as many pixels of 5 cm."""
    places = np.linspace(-0.6, 0.6, side)
    grid = np.array([(0, y, 1.4 + z) for z in places[::-1] for y in places])
    e = 0.025
    corners = np.array([(0, -e, -e), (0, e, -e), (0, e, e), (0, -e, e)])
    time = dg.TimeAxis(bins=bins, width_s=width_s, origin="wall")
    laser, sensor = dg.Laser(DEVICE, grid), dg.Sensor(DEVICE, grid[:, None] + corners)
    return dg.Capture(laser, sensor, time, pairing=pairing, **more)
