"""Half paths from the laser into lookins, for `radiometric.py`, and the laser points from which they start.

The light of the secondary goes from the laser point (names that end in 1) by a first hidden vertex, the *observed
point* (o), and a second one, the *lookin* (b), to the field of view; both words are the paper's (`convolution.py`).
The geometry term of two points is form = cosθ cosθ′ / R², 1/m². All surfaces are Lambertian.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.paper.convolution import Paths
from datagen.records.arrays import Bools, Floats
from datagen.transport.brdf import dot
from datagen.transport.geometry import get, subtract, transmittance
from datagen.transport.rays import lifted_and_scaled
from datagen.transport.scene_numbers import SceneNumbers

Singles = NDArray[np.float32]


class Points(NamedTuple):
    """n points on surfaces: (n, 3) metres, (n, 3) unit normals, (n,) albedos, 0 where a ray met no surface."""

    position: Floats
    normal: Floats
    albedo: Floats

    def take(self, rows: Bools) -> Points:
        """The points of the rows that are True."""
        return Points._make(values[rows] for values in self)


@compiled()
def _send(origin, span, k, at, to):  # type: ignore[no-untyped-def]
    """Write the shadow ray of path k, from `at` to `to`, both in embree's frame, into `origin` and `span`."""
    # A span that is not normalised ends the ray at `to`.
    for axis in range(3):
        origin[k, axis] = at[axis]
        span[k, axis] = to[axis] - at[axis]


@compiled()
def arriving_paths(
    laser: Points,
    leg: float,
    lookins: Points,
    density: Floats,
    seen: Points,
    lit: Points,
    scene: SceneNumbers,
    per_metre: float,
) -> tuple[Paths, Singles, Singles]:
    """Half paths from one laser point by an observed point into each lookin, a row for each lookin.

    Observed points are those that a lookin's own rays met and those that rays from the laser point met. Returns the
    paths, and origins and spans (n, 3) of the shadow rays that decide which of them are hidden.

    laser : its first is the laser point; leg : its distance to the laser, m. density : (n,) expected number of
    lookins per area, 1/m². seen, lit : what rays from each lookin, and for it from the laser point, met, equally many
    for each lookin. per_metre : sub-bins (`convolution.py`) for each metre of path.
    """
    count = len(lookins.albedo)
    own, lasers = len(seen.albedo) // count, len(lit.albedo) // count
    size, filled = count * (own + lasers), 0
    first, position, energy = np.zeros(count + 1, np.int64), np.empty(size), np.empty(size)
    origin, span = np.empty((size, 3), np.float32), np.empty((size, 3), np.float32)
    x1, normal_1 = get(laser.position, 0, 0), get(laser.normal, 0, 0)
    from_1 = lifted_and_scaled(x1, normal_1, scene.offset, scene.frame)
    for n in range(count):
        b, normal_b = get(lookins.position, n, 0), get(lookins.normal, n, 0)
        from_b = lifted_and_scaled(b, normal_b, scene.offset, scene.frame)
        # The BRDFs ρ/π of laser point and lookin; that of the observed point and a factor π follow.
        albedos = laser.albedo[0] * lookins.albedo[n] / (math.pi * math.pi)
        for k in range(own + lasers):
            # Rays from the lookin found points that see the lookin: whether the laser point lights them is open. Rays
            # from the laser point found points that are lit: whether the lookin sees them is open.
            points, i, at = (seen, n * own + k, from_1) if k < own else (lit, n * lasers + k - own, from_b)
            if points.albedo[i] == 0.0:
                continue
            o, normal_o = get(points.position, i, 0), get(points.normal, i, 0)
            u, v = subtract(o, x1), subtract(b, o)
            cos_1, cos_o = dot(u, normal_1), -dot(u, normal_o)
            cos_o_out, cos_b = dot(v, normal_o), -dot(v, normal_b)
            if cos_1 <= 0.0 or cos_o <= 0.0 or cos_o_out <= 0.0 or cos_b <= 0.0:
                continue
            # form₁ form_b over the number of points per area that both ways together are expected to draw at o (the
            # balance heuristic): (own form_b + lasers form₁)/π. Cosines still carry their distances: numerator and
            # denominator are both multiplied by R₁ₒ⁴ Rₒ_b⁴, so that nothing is divided by a distance, which may be 0
            # where surfaces touch.
            square_1, square_b = dot(u, u), dot(v, v)
            pair_1, pair_b = cos_1 * cos_o, cos_o_out * cos_b
            expected = own * pair_b * square_1 * square_1 + lasers * pair_1 * square_b * square_b
            value = pair_1 * pair_b * albedos * points.albedo[i] / (density[n] * expected)
            # `not … > 0` leaves out NaN as well, which `<= 0` would let pass.
            if not 0.0 < value < math.inf:
                continue
            # The leg from the laser always attenuates, but counts for the time only with the time origin `source`.
            length = math.sqrt(square_1) + math.sqrt(square_b)
            energy[filled] = value * transmittance(scene.air, leg + length)
            position[filled] = (length + scene.from_source * leg) * per_metre
            _send(origin, span, filled, at, lifted_and_scaled(o, normal_o, scene.offset, scene.frame))
            filled += 1
        first[n + 1] = filled
    return Paths(first, position[:filled], energy[:filled]), origin[:filled], span[:filled]
