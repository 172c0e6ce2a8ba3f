"""A pixel's patch of wall as a tree: the whole, its quarters, theirs, each by the point in its middle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from datagen.records import Scene, Sensor
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.fov import PixelCones, fov_points
from datagen.transport.raycast import Raycaster

BENT = 0.02
"""1 − cosine between the normals of a patch and its quarters from which its middle does not stand for it."""
LEAST_SIZE = 1e-9


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
    uneven : (P, Q) whether its quarters lie on other surfaces than its middle.
    quarters : (Q, 4) patches, −1 for the finest.
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

    @classmethod
    def of(
        cls, caster: Raycaster, scene: Scene, sensor: Sensor, cones: PixelCones, pixels: Ints, levels: int
    ) -> Patches:
        """Those of some pixels, quartered `levels` times at most."""
        found = []
        for level in range(levels + 1):
            side = 1 << level
            knots = (np.arange(side) + 0.5) / side
            uv = np.stack([np.tile(knots, side), np.repeat(knots, side)], axis=1)
            uv = np.ascontiguousarray(np.broadcast_to(uv, (len(pixels), side * side, 2)))
            found.append(fov_points(caster, scene, sensor, cones, pixels, uv, side * side))
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
        # A patch that is even but whose quarters are not, is not.
        for q in inner[::-1]:
            uneven[:, q] |= uneven[:, quarters[q]].any(axis=1)
        return cls(position, normal, to_sensor, part, weight, footprint, leg, size, uneven, quarters)


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
