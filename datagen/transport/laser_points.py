"""Laser points: where the laser's rays first meet a surface.

A beam that states the cells of its laser points (`Laser.cells`) lights all of each cell evenly. Paths have a laser
point anywhere in the cell, each its own. Cuts and blocks, which light many hidden points from a few laser points,
draw one in each of some equal parts of a cell, anew for each replicate: the mean is the integral over the beam, and
replicates tell what so few points leave of an error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from datagen.records import Laser, Scene
from datagen.records.arrays import Floats, Ints
from datagen.transport.rays import Raycaster

LOOKED_FROM = 16
"""Along each side of a beam's cell, rays that tell whether it meets the scene where its middle does not."""


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

    @classmethod
    def in_cells(
        cls, caster: Raycaster, scene: Scene, laser: Laser, sides: int, rng: np.random.Generator
    ) -> LaserPoints:  # fmt: skip
        """Laser points (sides² · L) of a beam that states its cells: a random one in each of sides × sides equal
        parts of each cell; those of all cells in their first part come first."""
        assert laser.cells is not None
        row, column = np.divmod(np.arange(sides * sides)[:, None], sides)
        uv = (np.stack([column, row], axis=-1) + rng.random((sides * sides, len(laser.cells), 2))) / sides
        targets = targets_in_cells(laser, np.arange(len(laser.cells)), uv)
        return cls.of(caster, scene, Laser(laser.position, targets.reshape(-1, 3)))

    def take(self, lasers: Ints) -> LaserPoints:
        """The laser points with the given indices, which may repeat."""
        return LaserPoints._make(values[lasers] for values in self)


def targets_in_cells(laser: Laser, number: Ints, uv: Floats) -> Floats:
    """(…, 3) targets, metres, at coordinates uv (…, 2) of the cells of some laser points (…), by number."""
    assert laser.cells is not None
    a, b, _, d = (laser.cells[number, k] for k in range(4))
    return np.asarray(a + uv[..., :1] * (b - a) + uv[..., 1:] * (d - a))


def parts_lit(points: LaserPoints, caster: Raycaster, scene: Scene, laser: Laser) -> Ints:
    """(L,) indices of the parts that the laser's rays meet, at its `points`, −1 for none; of a beam that states its
    cells the part that most rays of a cell meet, where its middle meets none."""
    part = points.part.copy()
    if laser.cells is not None and (part < 0).any():
        several = LaserPoints.in_cells(caster, scene, laser, LOOKED_FROM, np.random.default_rng(0)).part
        for k in np.flatnonzero(part < 0):
            met = several[k :: len(part)]
            part[k] = np.bincount(met[met >= 0]).argmax() if (met >= 0).any() else -1
    return part
