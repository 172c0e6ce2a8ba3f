"""What a point of a floor plan can see: the test behind "hidden from laser and sensor".

All walls of a plan run from floor to ceiling, so whatever the plane hides is hidden in space. (A lintel over a
doorway hides more than the plane says: the answer then errs on the safe side.)
"""

from __future__ import annotations

import numpy as np

from scene_library.arrays import Floats
from scene_library.polygons import Polygon, cross
from scene_library.separation import stays_clear

_NUDGE_RAD = 1e-7
"""Rays pass each corner on both sides by this angle: 1 µm at 10 m, far below any clearance asked for."""


def visible_fan(walls: Floats, eye: Floats) -> Floats:
    """(n, 3, 2) triangles (eye, b, c) that together cover everything `eye` (2,) sees between `walls` (m, 2, 2).

    The walls must surround the eye; they may be the edges of a plan and screens that stand free in it.
    """
    toward = walls.reshape(-1, 2) - eye
    angles = np.arctan2(toward[:, 1], toward[:, 0])
    angles = np.unique(np.concatenate([angles - _NUDGE_RAD, angles, angles + _NUDGE_RAD]))
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ends = eye + directions * first_hit(walls, eye, directions)[:, None]
    nexts = np.roll(ends, -1, axis=0)
    width = np.roll(angles, -1) - angles
    width[-1] += 2 * np.pi
    wide = width > 2 * _NUDGE_RAD
    return np.stack([np.broadcast_to(eye, (int(wide.sum()), 2)), ends[wide], nexts[wide]], axis=1)


def first_hit(walls: Floats, eye: Floats, directions: Floats) -> Floats:
    """(n,) distance from `eye` along unit `directions` (n, 2) to the first of `walls`; inf where there is none."""
    along = walls[:, 1] - walls[:, 0]
    denominator = cross(directions[:, None], along[None])
    safe = np.where(np.abs(denominator) < 1e-300, 1.0, denominator)
    offset = walls[:, 0] - eye
    distance = cross(offset, along)[None] / safe
    where = cross(offset[None], directions[:, None]) / safe
    hit = (np.abs(denominator) > 1e-300) & (distance > 0) & (where >= -1e-12) & (where <= 1 + 1e-12)
    return np.asarray(np.where(hit, distance, np.inf).min(axis=1))


def is_hidden(footprint: Polygon, fan: Floats, margin_m: float) -> bool:
    """Whether a convex footprint stays at least `margin_m` clear of everything that is seen."""
    return bool(stays_clear(np.ascontiguousarray(footprint), np.ascontiguousarray(fan), margin_m))


def visible_interval(fan: Floats, start: Floats, end: Floats) -> tuple[float, float] | None:
    """The longest stretch of the wall `start` → `end` (each (2,)) that is seen, as metres from `start`; or None."""
    along = end - start
    long = float(np.linalg.norm(along))
    unit = along / long
    offset = np.abs(cross(unit, fan[:, 1:] - start))
    position = np.sort((fan[:, 1:] - start) @ unit, axis=1)
    pieces = sorted(
        (max(0.0, float(low)), min(long, float(high)))
        for (low, high), off in zip(position, offset.max(axis=1), strict=True)
        if off < 1e-6 * (1 + long) and high > 0 and low < long
    )
    # Triangles leave gaps of 2 nudges at every corner's direction: microns in a room, and they grow with it.
    gap = 100 * _NUDGE_RAD * float(np.abs(fan - fan[0, 0]).max())
    merged: list[tuple[float, float]] = []
    for low, high in pieces:
        if merged and low <= merged[-1][1] + gap:
            merged[-1] = (merged[-1][0], max(high, merged[-1][1]))
        else:
            merged.append((low, high))
    return max(merged, key=lambda piece: piece[1] - piece[0], default=None)
