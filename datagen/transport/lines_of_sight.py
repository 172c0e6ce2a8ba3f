"""What pixels see along a few fixed lines of sight, their corners included.

A corner of a pixel often lies where the wall ends or meets another wall, and there rounding decides which triangle a
single-precision ray meets. So the ray of each line of sight is cast a little inside its pixel, and the line itself is
then intersected, in double precision, with the plane of the surface that the ray met.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datagen.records import Laser, OnSurfaces, Sensor
from datagen.records.arrays import Bools, Floats
from datagen.transport.rays import Hits, Raycaster

INWARD = 1e-3
"""Share of the way to its pixel's middle by which the ray of a line of sight is moved there, so that rays at corners
meet the wall that the pixel sees."""
INWARD_AT_LEAST_RAD = 2e-6
"""Least angle, rad, by which that ray is moved: some twenty roundings in single precision."""


@dataclass(frozen=True)
class LinesOfSight:
    """A grid of n × n lines of sight over each of P pixels, pixel edges included.

    Attributes
    ----------
    position : (P, n², 3) where each line meets the plane of the surface that it sees, m; undefined without a surface.
    inner : (P, n², 3) directions of the rays, a little inside the pixel, that met this surface; not of unit length.
    met : P · n² hits of these rays.
    """

    position: Floats
    inner: Floats
    met: Hits

    @property
    def valid(self) -> Bools:
        """(P, n²) whether a line of sight meets a surface."""
        return self.met.valid.reshape(self.inner.shape[:2])

    @property
    def normal(self) -> Floats:
        """(P, n², 3) unit normals that face the sensor."""
        return self.met.normal.reshape(self.inner.shape)


def lines_of_sight(caster: Raycaster, sensor: Sensor, along: int) -> LinesOfSight:
    """The `along` × `along` lines of sight of each pixel, row by row from its first corner; `along` ≥ 2."""
    knots = np.linspace(0.0, 1.0, along)
    u, v = np.tile(knots, along)[:, None], np.repeat(knots, along)[:, None]
    a, b, c, d = ((sensor.pixels - sensor.position)[:, None, k] for k in range(4))
    exact = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
    to_middle = 0.5 * (0.5 * a + 0.5 * b) + 0.5 * (0.5 * d + 0.5 * c) - exact
    # The middle line of a grid with an odd number of lines is not moved: its infinite fraction is clipped.
    with np.errstate(divide="ignore"):
        least = INWARD_AT_LEAST_RAD * _length(exact) / _length(to_middle)
    inner = exact + np.clip(least, INWARD, 1.0)[..., None] * to_middle
    met = caster.closest(sensor.position, inner.reshape(-1, 3))
    normal, found = met.normal.reshape(inner.shape), met.position.reshape(inner.shape)
    # Along a direction v, the plane is met at `sensor.position + reach · v`.
    height = np.einsum("pqk,pqk->pq", normal, found - sensor.position)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = height / np.einsum("pqk,pqk->pq", normal, exact)
        inner_reach = height / np.einsum("pqk,pqk->pq", normal, inner)
    # A line that meets the plane behind the sensor does not see it. One that meets it at twice the distance of its
    # ray or more only grazes it: the point that the ray met stands for it.
    ahead = (reach > 0) & (reach < 2.0 * inner_reach)
    position = np.where(ahead[..., None], sensor.position + np.where(ahead, reach, 0.0)[..., None] * exact, found)
    return LinesOfSight(position, inner, met)


def seen_points(caster: Raycaster, sensor: Sensor) -> OnSurfaces:
    """What each pixel's middle looks at: the first surface along the ray from the sensor to the mean of its four
    corners."""
    return _first_surfaces(caster, sensor.position, sensor.pixels.mean(axis=1))


def lit_points(caster: Raycaster, laser: Laser) -> OnSurfaces:
    """The laser points: the first surface along the ray from the laser to each of its targets."""
    return _first_surfaces(caster, laser.position, laser.targets)


def _first_surfaces(caster: Raycaster, origin: Floats, towards: Floats) -> OnSurfaces:
    met = caster.closest(origin, towards - origin)
    found = met.valid[:, None]
    return OnSurfaces(np.where(found, met.position, np.nan), np.where(found, met.normal, np.nan))


def _length(vectors: Floats) -> Floats:
    return np.asarray(np.linalg.norm(vectors, axis=-1), np.float64)
