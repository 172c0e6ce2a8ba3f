"""Compiled loops for `secondary.py`: half paths from a laser point into lookins and from lookins into the aperture.

The light of the secondary goes from the laser point (names that end in 1) by a first hidden vertex, the *observed
point* (o), and a second one, the *lookin* (b), to a FoV point (4); both words are the paper's (`convolution.py`). The
geometry term of two points is form = cosθ cosθ′ / R², 1/m². One leg of every half path may be hidden by a surface.
The loops return that leg as a shadow ray in embree's unit frame (`raycast.lifted_and_scaled`) together with the path.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import LAMBERTIAN, dot, evaluate, in_frame_of
from datagen.transport.factorised.convolution import Paths
from datagen.transport.geometry import get, subtract, transmittance
from datagen.transport.visibility.raycast import lifted_and_scaled

Singles = NDArray[np.float32]


class Room(NamedTuple):
    """The scene and the time axis as plain arrays and numbers.

    Attributes
    ----------
    corner : (F, 3) one corner of each triangle, m.
    normal : (F, 3) unit normals.
    part : (F,) part indices.
    kind, values : (K,), (K, n) materials, as in `MaterialTable`.
    frame : (4,) centre and half extent of embree's unit frame, m.
    offset : height above the surface at which shadow rays begin and end, m.
    per_metre : sub-bins (`convolution.py`) for each metre of path.
    start : path length, in sub-bins, to the centre of the window's first sub-bin.
    device_legs : 1 if the legs from the laser and to the sensor count for the time, else 0.
    attenuation : of the air, 1/m.
    """

    corner: Floats
    normal: Floats
    part: NDArray[np.int32]
    kind: Ints | NDArray[np.uint8]
    values: Floats
    frame: Floats
    offset: float
    per_metre: float
    start: float
    device_legs: float
    attenuation: float


class Lookins(NamedTuple):
    """n lookins: hidden vertices from which light goes on to FoV points.

    Attributes
    ----------
    position, normal : (n, 3) metres, unit normal.
    part : (n,) part index.
    block : (n,) index of the block of FoV points that each lookin is connected with.
    displacement : (n,) displacement u of each lookin's sub-bins (see `convolution.py`).
    shift : (n, 2) by how much the net of directions to observed points is shifted: azimuth in revolutions, and cos²θ.
    """

    position: Floats
    normal: Floats
    part: Ints
    block: Ints
    displacement: Floats
    shift: Floats

    def take(self, rows: slice | Bools) -> Lookins:
        """The lookins in the given rows."""
        return Lookins._make(array[rows] for array in self)


class FovPoints(NamedTuple):
    """Q FoV points of each of P pixels; the fields are those of `FovPool`.

    share : (P, Q) probability with which a lookin of the point's block is drawn from this point.
    """

    position: Floats
    normal: Floats
    to_sensor: Floats
    part: Ints
    weight: Floats
    last_leg: Floats
    share: Floats


class LaserVicinity(NamedTuple):
    """A laser point, and points near it where rays from it land.

    Attributes
    ----------
    position, normal, to_laser : (3,) metres, unit normal, unit direction to the laser.
    part : part index.
    leg : distance to the laser, m.
    rays : number of rays drawn from the laser point.
    near_square : square of the distance that is near, m². Rays that land within it become observed points; lookins
        within it are left to path tracing.
    lit_position, lit_normal : (m, 3) points and unit normals where rays landed near.
    lit_part : (m,) indices of the parts that they landed on.
    """

    position: Floats
    normal: Floats
    to_laser: Floats
    part: int
    leg: float
    rays: int
    near_square: float
    lit_position: Floats
    lit_normal: Floats
    lit_part: Ints


@compiled()
def leaving_paths(
    lookins: Lookins, fov: FovPoints, points: int, room: Room
) -> tuple[Paths, Floats, Singles, Singles]:
    """Half paths from each lookin by each of its block's `points` FoV points into the aperture, rows (lookin, pixel).

    Returns the paths, the density (n,), 1/m², with which each path's FoV point draws its lookin, and origins and
    spans (n, 3) of the shadow rays. Hidden paths are still among them.
    """
    count, pixels = len(lookins.part), fov.weight.shape[0]
    # Room for every connection; the views that are returned leave out those that carry nothing.
    size, filled = count * pixels * points, 0
    first = np.zeros(count * pixels + 1, np.int64)
    position, energy, density = np.empty(size), np.empty(size), np.empty(size)
    origin, span = np.empty((size, 3), np.float32), np.empty((size, 3), np.float32)
    kind, values = room.kind, room.values
    for n in range(count):
        b, normal_b = get(lookins.position, n, 0), get(lookins.normal, n, 0)
        at = lifted_and_scaled(b, normal_b, room.offset, room.frame)
        for p in range(pixels):
            for q in range(lookins.block[n] * points, (lookins.block[n] + 1) * points):
                weight = fov.weight[p, q]
                # The line of sight met nothing, or a surface edge-on.
                if weight == 0.0:
                    continue
                x, normal_4 = get(fov.position[p], q, 0), get(fov.normal[p], q, 0)
                u = subtract(x, b)
                # Both carry a factor R, so that no square root is taken for surfaces that face away.
                cos_b, cos_4 = dot(u, normal_b), -dot(u, normal_4)
                if cos_b <= 0.0 or cos_4 <= 0.0:
                    continue
                square = dot(u, u)
                distance = math.sqrt(square)
                form = cos_b * cos_4 / (square * square)
                part = fov.part[p, q]
                to_b = (-u[0] / distance, -u[1] / distance, -u[2] / distance)
                # The lookin's BRDF is not among the factors: it is constant, and `arriving_paths` multiplies by it.
                f4 = evaluate(kind[part], values[part], normal_4, to_b, get(fov.to_sensor[p], q, 0))
                energy[filled] = f4 * weight * form * transmittance(room.attenuation, distance + fov.last_leg[p, q])
                # Cosine rays from the FoV point have the density cosθ₄ cosθ_b / (π R²) per area at the lookin.
                density[filled] = fov.share[p, q] * form / math.pi
                length = distance + room.device_legs * fov.last_leg[p, q]
                position[filled] = length * room.per_metre - room.start
                _send(origin, span, filled, at, lifted_and_scaled(x, normal_4, room.offset, room.frame))
                filled += 1
            first[n * pixels + p + 1] = filled
    return Paths(first, position[:filled], energy[:filled]), density[:filled], origin[:filled], span[:filled]


@compiled()
def _send(origin, span, k, at, to):  # type: ignore[no-untyped-def]
    """Write the shadow ray of path k, from `at` to `to`, both in embree's frame, into `origin` and `span`."""
    # A span that is not normalised ends the ray at `to`.
    for axis in range(3):
        origin[k, axis] = at[axis]
        span[k, axis] = to[axis] - at[axis]


@compiled()
def observing_rays(lookins: Lookins, points: Floats, room: Room) -> tuple[Singles, Singles]:
    """Origins and directions (n · Ñ, 3) of cosine-distributed rays from each lookin, Ñ of each.

    points : (Ñ, 2) uniform on the unit square: azimuth in revolutions, and cos²θ. All lookins share them, each with
        its own shift modulo 1, which keeps every point uniform and the net well spread.
    """
    count, size = len(lookins.part), len(points)
    origin, direction = np.empty((count * size, 3), np.float32), np.empty((count * size, 3), np.float32)
    # An azimuth is shifted by a rotation, so the trigonometric functions of the net are needed once, not per lookin.
    cosine, sine = np.cos(2 * math.pi * points[:, 0]), np.sin(2 * math.pi * points[:, 0])
    for n in range(count):
        normal = get(lookins.normal, n, 0)
        lifted = lifted_and_scaled(get(lookins.position, n, 0), normal, room.offset, room.frame)
        along, across = in_frame_of(normal, 1.0, 0.0, 0.0), in_frame_of(normal, 0.0, 1.0, 0.0)
        c, s = math.cos(2 * math.pi * lookins.shift[n, 0]), math.sin(2 * math.pi * lookins.shift[n, 0])
        for k in range(size):
            square = points[k, 1] + lookins.shift[n, 1]
            if square >= 1.0:
                square -= 1.0
            # Density cosθ/π: cos²θ is uniform.
            radius, height = math.sqrt(1.0 - square), math.sqrt(square)
            u, v = radius * (c * cosine[k] - s * sine[k]), radius * (s * cosine[k] + c * sine[k])
            i = n * size + k
            for axis in range(3):
                origin[i, axis] = lifted[axis]
                direction[i, axis] = u * along[axis] + v * across[axis] + height * normal[axis]
    return origin, direction


@compiled()
def _scattering(u, v, laser, normal_o, part_o, kind, values):  # type: ignore[no-untyped-def]
    """f₁ · fₒ, 1/sr², of light that goes by the vector u from the laser point to o, and on by the vector v."""
    normal_1, to_laser, part_1 = laser
    # The usual case needs no directions.
    if kind[part_1] == LAMBERTIAN and kind[part_o] == LAMBERTIAN:
        return values[part_1, 0] * values[part_o, 0] / (math.pi * math.pi)
    r1, rb = math.sqrt(dot(u, u)), math.sqrt(dot(v, v))
    onward = (u[0] / r1, u[1] / r1, u[2] / r1)
    back = (-onward[0], -onward[1], -onward[2])
    f1 = evaluate(kind[part_1], values[part_1], normal_1, to_laser, onward)
    return f1 * evaluate(kind[part_o], values[part_o], normal_o, back, (v[0] / rb, v[1] / rb, v[2] / rb))


@compiled()
def _weight(u, v, normal_1, normal_o, normal_b, samples, near_square):  # type: ignore[no-untyped-def]
    """form₁ form_b over the expected number of samples per area of o and of b; 0 where a surface faces away.

    u, v : vectors from the laser point to o and from o to the lookin b. samples : (number of observed points of a
    lookin, number of rays from the laser point), each times the density of lookins, 1/m².

    The number is that of both ways to draw o together (balance heuristic): samples₀ form_b/π for rays from b, and
    samples₁ form₁/π for rays from the laser point, which count where o is near it.
    """
    cos_1, cos_o = dot(u, normal_1), -dot(u, normal_o)
    cos_o_out, cos_b = dot(v, normal_o), -dot(v, normal_b)
    if cos_1 <= 0.0 or cos_o <= 0.0 or cos_o_out <= 0.0 or cos_b <= 0.0:
        return 0.0
    # Cosines still carry their distances: numerator and denominator are both multiplied by R₁ₒ⁴ Rₒ_b⁴, so that
    # nothing is divided by a distance, which may be 0 where surfaces touch.
    square_1, square_b = dot(u, u), dot(v, v)
    pair_1, pair_b = cos_1 * cos_o, cos_o_out * cos_b
    expected = samples[0] * pair_b * square_1 * square_1
    if square_1 < near_square:
        expected += samples[1] * pair_1 * square_b * square_b
    return pair_1 * pair_b * math.pi / expected if expected > 0.0 else 0.0


@compiled()
def _observed_point(start, face, w, room):  # type: ignore[no-untyped-def]
    """Point where a ray from `start` along w meets the plane of a face, unit normal towards `start`, and whether the
    ray meets it.

    Embree found the face; its distances are single precision, which is too coarse for arrival times.
    """
    normal = get(room.normal, face, 0)
    approach = dot(w, normal)
    distance = dot(subtract(get(room.corner, face, 0), start), normal) / approach if approach != 0.0 else math.inf
    o = (start[0] + distance * w[0], start[1] + distance * w[1], start[2] + distance * w[2])
    if approach > 0.0:
        normal = (-normal[0], -normal[1], -normal[2])
    return o, normal, 0.0 < distance < math.inf


@compiled()
def arriving_paths(
    lookins: Lookins, density: Floats, face: NDArray[np.int32], direction: Singles, vicinity: LaserVicinity,
    room: Room,
) -> tuple[Paths, Singles, Singles]:  # fmt: skip
    """Half paths from one laser point by an observed point into each lookin, a row for each lookin.

    Observed points are those that a lookin's rays met and those near the laser point that its rays met. Returns the
    paths, and origins and spans (n, 3) of the shadow rays that decide which of them are hidden. The rows of lookins
    near the laser point stay empty: path tracing finds their light (`secondary.py`).

    density : (n,) expected number of lookins per area, 1/m². face, direction : (n · Ñ,) triangles that the lookins'
    rays met (−1 for none) and (n · Ñ, 3) unit directions of these rays.
    """
    count = len(lookins.part)
    observed, lit = len(face) // count, len(vicinity.lit_part)
    size, filled = count * (observed + lit), 0
    first = np.zeros(count + 1, np.int64)
    position, energy = np.empty(size), np.empty(size)
    origin, span = np.empty((size, 3), np.float32), np.empty((size, 3), np.float32)
    position_1, normal_1, to_laser_1 = vicinity.position, vicinity.normal, vicinity.to_laser
    x1 = (position_1[0], position_1[1], position_1[2])
    n1 = (normal_1[0], normal_1[1], normal_1[2])
    laser = (n1, (to_laser_1[0], to_laser_1[1], to_laser_1[2]), vicinity.part)
    from_1 = lifted_and_scaled(x1, n1, room.offset, room.frame)
    for n in range(count):
        b, normal_b = get(lookins.position, n, 0), get(lookins.normal, n, 0)
        apart = subtract(b, x1)
        # Both ways to draw o bound the weight of a path only if its lookin keeps a distance from the laser point.
        if dot(apart, apart) < vicinity.near_square:
            first[n + 1] = filled
            continue
        samples = (density[n] * observed, density[n] * vicinity.rays)
        # The lookin's constant BRDF ρ/π.
        albedo = room.values[lookins.part[n], 0] / math.pi
        from_b = lifted_and_scaled(b, normal_b, room.offset, room.frame)
        start = (b[0] + room.offset * normal_b[0], b[1] + room.offset * normal_b[1], b[2] + room.offset * normal_b[2])
        for k in range(observed + lit):
            # Rays from the lookin found points that see the lookin: whether the laser point lights them is open. Rays
            # from the laser point found points that are lit: whether the lookin sees them is open.
            if k < observed:
                i = n * observed + k
                if face[i] < 0:
                    continue
                w = (float(direction[i, 0]), float(direction[i, 1]), float(direction[i, 2]))
                o, normal_o, met = _observed_point(start, face[i], w, room)
                if not met:
                    continue
                part_o, at = room.part[face[i]], from_1
            else:
                o, normal_o = get(vicinity.lit_position, k - observed, 0), get(vicinity.lit_normal, k - observed, 0)
                part_o, at = np.int32(vicinity.lit_part[k - observed]), from_b
            u, v = subtract(o, x1), subtract(b, o)
            value = _weight(u, v, n1, normal_o, normal_b, samples, vicinity.near_square)
            if value <= 0.0:
                continue
            value *= albedo * _scattering(u, v, laser, normal_o, part_o, room.kind, room.values)
            if value <= 0.0:
                continue
            # The leg from the laser always attenuates, but counts for the time only with the time origin `source`.
            length = math.sqrt(dot(u, u)) + math.sqrt(dot(v, v))
            energy[filled] = value * transmittance(room.attenuation, vicinity.leg + length)
            position[filled] = (length + room.device_legs * vicinity.leg) * room.per_metre
            _send(origin, span, filled, at, lifted_and_scaled(o, normal_o, room.offset, room.frame))
            filled += 1
        first[n + 1] = filled
    return Paths(first, position[:filled], energy[:filled]), origin[:filled], span[:filled]
