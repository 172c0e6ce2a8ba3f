"""A pixel's patch of wall as a tree: the whole, its quarters, theirs, each by the point in its middle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from datagen.records import Scene, Sensor
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.fov import FovPool, PixelCones, fov_points
from datagen.transport.raycast import Raycaster

BENT = 0.02
"""1 − cosine between the normals of a patch and its quarters from which its middle does not stand for it."""
LEAST_SIZE = 1e-9
INSET = 1e-3
"""How far within a patch its corners are looked at, relative to its sides: a pixel may end where its wall does."""


class Patches(NamedTuple):
    """Q = 1 + 4 + 16 + … patches for each of P pixels.

    Attributes
    ----------
    position, normal, to_sensor : (P, Q, 3) of the middle: metres, unit normal and unit direction towards the sensor.
    part : (P, Q) part index, −1 where the line of sight meets nothing.
    weight : (P, Q) effective aperture × solid angle, m² sr.
    footprint : (P, Q) its area, m².
    leg : (P, Q) distance to the sensor, m.
    size : (P, Q) how far it reaches, m.
    uneven : (P, Q) whether its quarters or corners lie on other surfaces than its middle.
    quarters : (Q, 4) patches, −1 for the finest.
    missed : whether a whole pixel of which a corner lies on a surface is seen by none of its finest patches.
    """

    position: Floats
    normal: Floats
    to_sensor: Floats
    part: Ints
    weight: Floats
    footprint: Floats
    leg: Floats
    size: Floats
    uneven: Bools
    quarters: Ints
    missed: bool

    @classmethod
    def of(
        cls, caster: Raycaster, scene: Scene, sensor: Sensor, cones: PixelCones, pixels: Ints, levels: int
    ) -> Patches:
        """Those of some pixels, quartered `levels` times at most."""

        def seen(row: Floats, each: int) -> FovPool:
            uv = np.stack([np.tile(row, len(row)), np.repeat(row, len(row))], axis=1)
            uv = np.ascontiguousarray(np.broadcast_to(uv, (len(pixels), len(uv), 2)))
            return fov_points(caster, scene, sensor, cones, pixels, uv, each)

        found = [seen((np.arange(1 << level) + 0.5) / (1 << level), 4**level) for level in range(levels + 1)]
        side = 1 << levels
        corners = seen((np.arange(side)[:, None] + [INSET, 1 - INSET]).reshape(-1) / side, 4 * side * side)
        quarters = _quarters(levels)
        position, normal, to_sensor, part, weight, footprint, leg = (
            np.concatenate([getattr(pool, name) for pool in found], axis=1)
            for name in ("position", "normal", "to_sensor", "part", "weight", "footprint", "last_leg")
        )
        inner = np.flatnonzero(quarters[:, 0] >= 0)
        below = quarters[inner]
        size = np.sqrt(2.0 * footprint)
        apart = np.linalg.norm(position[:, below] - position[:, inner, None], axis=3).max(axis=2)
        size[:, inner] = np.maximum(size[:, inner], 4.0 * apart)
        size = np.where(part >= 0, np.maximum(size, LEAST_SIZE), 0.0)
        uneven = np.zeros(part.shape, np.bool_)
        cosine = np.einsum("pqik,pqk->pqi", normal[:, below], normal[:, inner])
        other = (part[:, below] != part[:, inner, None]) | ((cosine < 1 - BENT) & (part[:, below] >= 0))
        uneven[:, inner] = other.any(axis=2)
        last = np.arange(len(quarters) - side * side, len(quarters))
        around = (4 * side * (last - last[0] >> levels) + 2 * (last - last[0] & side - 1))[:, None]
        around = around + np.array([0, 1, 2 * side, 2 * side + 1])
        cosine = np.einsum("pqik,pqk->pqi", corners.normal[:, around], normal[:, last])
        other = (corners.part[:, around] != part[:, last, None]) | ((cosine < 1 - BENT) & (part[:, last, None] >= 0))
        uneven[:, last] = other.any(axis=2)
        nothing = (part[:, last] < 0).all(axis=1)
        missed = bool((nothing & (corners.part[:, around] >= 0).any(axis=(1, 2))).any())
        # A patch that is even but whose quarters are not, is not.
        for q in inner[::-1]:
            uneven[:, q] |= uneven[:, quarters[q]].any(axis=1)
        return cls(position, normal, to_sensor, part, weight, footprint, leg, size, uneven, quarters, missed)


def _quarters(levels: int) -> Ints:
    """(Q, 4) the four patches of the next level within each, row by row; −1 at the last."""
    first = [(4**level - 1) // 3 for level in range(levels + 2)]
    quarters = np.full((first[-1], 4), -1)
    for level in range(levels):
        side = 1 << level
        row, column = np.divmod(np.arange(side * side), side)
        for k, (down, right) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
            quarters[first[level] : first[level + 1], k] = (
                first[level + 1] + (2 * row + down) * 2 * side + 2 * column + right
            )
    return quarters
