"""Laser points: where the laser's rays first meet a surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from datagen.records import Laser, Scene
from datagen.records.arrays import Floats, Ints
from datagen.transport.rays import Raycaster


class LaserPoints(NamedTuple):
    """Where each of L laser rays first meets a surface.

    position, normal, to_laser : (L, 3) metres; unit normal facing the laser; unit direction to it. NaN without a hit.
    part : (L,) part index, −1 without a hit. leg : (L,) distance to the laser, m.
    """

    position: Floats
    normal: Floats
    to_laser: Floats
    part: Ints
    leg: Floats

    @classmethod
    def of(cls, caster: Raycaster, scene: Scene, laser: Laser) -> LaserPoints:
        """The laser points of the rays from the laser toward its targets."""
        span = laser.targets - laser.position
        hits = caster.closest(laser.position, span)
        part = np.where(hits.valid, scene.face_part[hits.face], -1).astype(np.int64)
        position = np.where(hits.valid[:, None], hits.position, np.nan)
        to_laser = -span / np.linalg.norm(span, axis=1, keepdims=True)
        return cls(position, hits.normal, to_laser, part, np.linalg.norm(position - laser.position, axis=1))

    def take(self, lasers: Ints) -> LaserPoints:
        """The laser points with the given indices, which may repeat."""
        return LaserPoints._make(values[lasers] for values in self)
