"""What pixels see along a few fixed lines of sight, their corners included, the same on every processor.

A corner of a pixel often lies where the wall ends or meets another, and there it is rounding that decides which
triangle a single-precision ray meets. So each line of sight is asked for a little inside its pixel, and is then met
exactly, in double precision, with the plane of the surface found there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from datagen.records import Sensor
from datagen.records.arrays import Bools, Floats
from datagen.transport.visibility.raycast import Hits, Raycaster

INWARD = 1e-3
"""How far a line of sight is moved towards its pixel's middle, as a share of the way there, to find its surface."""
INWARD_AT_LEAST_RAD = 2e-6
"""The least angle that it is moved by: some twenty roundings in single precision."""
LONGEST_REACH = 2.0
"""Distance to the plane, relative to the inner line's, beyond which a line grazes it and the inner one counts."""


@dataclass(frozen=True)
class LinesOfSight:
    """A grid of n × n lines of sight over each of P pixels, pixel edges included.

    Attributes
    ----------
    position : (P, n², 3) where each line meets the plane of the surface that it sees, m; undefined without a surface.
    inner : (P, n², 3) directions a little inside the pixel, along which that surface was found; not of unit length.
    met : what those met, P · n² hits.
    """

    position: Floats
    inner: Floats
    met: Hits

    @property
    def valid(self) -> Bools:
        """(P, n²) whether there is a surface."""
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
    with np.errstate(divide="ignore"):
        least = INWARD_AT_LEAST_RAD * _length(exact) / _length(to_middle)
    inner = exact + np.clip(least, INWARD, 1.0)[..., None] * to_middle
    met = caster.closest(sensor.position, inner.reshape(-1, 3))
    normal, found = met.normal.reshape(inner.shape), met.position.reshape(inner.shape)
    height = np.einsum("pqk,pqk->pq", normal, found - sensor.position)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = height / np.einsum("pqk,pqk->pq", normal, exact)
        inner_reach = height / np.einsum("pqk,pqk->pq", normal, inner)
    ahead = (reach > 0) & (reach < LONGEST_REACH * inner_reach)
    position = np.where(ahead[..., None], sensor.position + np.where(ahead, reach, 0.0)[..., None] * exact, found)
    return LinesOfSight(position, inner, met)


def _length(vectors: Floats) -> Floats:
    return np.asarray(np.linalg.norm(vectors, axis=-1), np.float64)
