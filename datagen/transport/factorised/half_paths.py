"""The compiled loops behind `secondary.py`: half paths into and out of lookins.

A trailing 1 means at the laser point, o at the observed point, b at the lookin, 4 at the FoV point. A geometry term
is form = cosθ cosθ′ / R², 1/m². Every half path ends in a line of sight that something may hide; with the paths come
these lines as rays in embree's unit frame, ready to be sent.
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
from datagen.transport.geometry import air, get, less
from datagen.transport.visibility.raycast import lifted_and_scaled

Singles = NDArray[np.float32]


class Room(NamedTuple):
    """The scene as the loops want it.

    Attributes
    ----------
    corner : (F, 3) one corner of each triangle, m.
    normal : (F, 3) unit normals.
    part : (F,) part indices.
    kind, values : (K,), (K, n) materials, as in `MaterialTable`.
    frame : (4,) centre and half extent of embree's unit frame, m.
    offset : by how much ends of rays are lifted, m.
    per_metre : sub-bins (`convolution.py`) for each metre of path.
    start : length in sub-bins at which the window starts, to the centre of its first sub-bin.
    device_legs : 1 where device legs count for the time, else 0.
    attenuation : 1/m.
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
    """n lookins.

    Attributes
    ----------
    position, normal : (n, 3) metres, unit normal.
    part : (n,) part index.
    block : (n,) the block of FoV points each is joined to.
    displacement : (n,) of its time grid (see `convolution.py`).
    shift : (n, 2) of its observed points, in revolutions and in cos²θ.
    """

    position: Floats
    normal: Floats
    part: Ints
    block: Ints
    displacement: Floats
    shift: Floats

    def take(self, rows: slice | Bools) -> Lookins:
        """Some of them."""
        return Lookins._make(array[rows] for array in self)


class FovPoints(NamedTuple):
    """As in `FovPool`, (P, Q, …); share (P, Q): probability with which a block draws lookins from each point."""

    position: Floats
    normal: Floats
    to_sensor: Floats
    part: Ints
    weight: Floats
    last_leg: Floats
    share: Floats


class LaserVicinity(NamedTuple):
    """A laser point and the points near it that its light meets.

    Attributes
    ----------
    position, normal, to_laser : (3,) metres, unit normal, unit direction.
    part : part index.
    leg : from the laser, m.
    rays : how many were drawn.
    near_square : square of the distance within which they count, and within which lookins do not, m².
    lit_position, lit_normal : (m, 3) where they landed within that distance.
    lit_part : (m,) on which parts.
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
    """Paths from each lookin through its block of `points` FoV points into the aperture, rows (lookin, pixel).

    With them the density, per area at the lookin, with which each FoV point draws it, and origins and spans of their
    rays. Hidden ones are still in.
    """
    count, pixels = len(lookins.part), fov.weight.shape[0]
    size, found = count * pixels * points, 0
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
                if weight == 0.0:
                    continue
                x, normal_4 = get(fov.position[p], q, 0), get(fov.normal[p], q, 0)
                u = less(x, b)
                cos_b, cos_4 = dot(u, normal_b), -dot(u, normal_4)
                if cos_b <= 0.0 or cos_4 <= 0.0:
                    continue
                square = dot(u, u)
                distance = math.sqrt(square)
                form = cos_b * cos_4 / (square * square)
                part = fov.part[p, q]
                to_b = (-u[0] / distance, -u[1] / distance, -u[2] / distance)
                f4 = evaluate(kind[part], values[part], normal_4, to_b, get(fov.to_sensor[p], q, 0))
                energy[found] = f4 * weight * form * air(room.attenuation, distance + fov.last_leg[p, q])
                density[found] = fov.share[p, q] * form / math.pi
                length = distance + room.device_legs * fov.last_leg[p, q]
                position[found] = length * room.per_metre - room.start
                _send(origin, span, found, at, lifted_and_scaled(x, normal_4, room.offset, room.frame))
                found += 1
            first[n * pixels + p + 1] = found
    return Paths(first, position[:found], energy[:found]), density[:found], origin[:found], span[:found]


@compiled()
def _send(origin, span, k, at, to):  # type: ignore[no-untyped-def]
    """Note the ray of path k."""
    for axis in range(3):
        origin[k, axis] = at[axis]
        span[k, axis] = to[axis] - at[axis]


@compiled()
def observing_rays(lookins: Lookins, points: Floats, room: Room) -> tuple[Singles, Singles]:
    """Origins and directions (n · Ñ, 3) of cosine rays from each lookin through its own shift of `points` (Ñ, 2).

    A shift on the unit torus keeps each point uniform, and the first coordinate, being an angle, closes upon itself.
    """
    count, size = len(lookins.part), len(points)
    origin, direction = np.empty((count * size, 3), np.float32), np.empty((count * size, 3), np.float32)
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
            radius, height = math.sqrt(1.0 - square), math.sqrt(square)
            u, v = radius * (c * cosine[k] - s * sine[k]), radius * (s * cosine[k] + c * sine[k])
            i = n * size + k
            for axis in range(3):
                origin[i, axis] = lifted[axis]
                direction[i, axis] = u * along[axis] + v * across[axis] + height * normal[axis]
    return origin, direction


@compiled()
def _scattering(u, v, laser, normal_o, part_o, kind, values):  # type: ignore[no-untyped-def]
    """f₁ · fₒ of light that travels u from the laser point to o and v on from there."""
    normal_1, to_laser, part_1 = laser
    if kind[part_1] == LAMBERTIAN and kind[part_o] == LAMBERTIAN:
        return values[part_1, 0] * values[part_o, 0] / (math.pi * math.pi)
    r1, rb = math.sqrt(dot(u, u)), math.sqrt(dot(v, v))
    onward = (u[0] / r1, u[1] / r1, u[2] / r1)
    back = (-onward[0], -onward[1], -onward[2])
    f1 = evaluate(kind[part_1], values[part_1], normal_1, to_laser, onward)
    return f1 * evaluate(kind[part_o], values[part_o], normal_o, back, (v[0] / rb, v[1] / rb, v[2] / rb))


@compiled()
def _weight(u, v, normal_1, normal_o, normal_b, samples, near_square):  # type: ignore[no-untyped-def]
    """form₁ form_b / (expected samples per area of o and of b), for the legs u to o and v to b, by the balance
    heuristic; 0 where a surface faces away. samples : Ñ and the laser point's rays, times the density of lookins.

    Expected are Ñ density form_b/π, and rays · density form₁/π where o is near the laser point. Numerator and
    denominator are multiplied by R₁ₒ⁴ Rₒ_b⁴.
    """
    cos_1, cos_o = dot(u, normal_1), -dot(u, normal_o)
    cos_o_out, cos_b = dot(v, normal_o), -dot(v, normal_b)
    if cos_1 <= 0.0 or cos_o <= 0.0 or cos_o_out <= 0.0 or cos_b <= 0.0:
        return 0.0
    square_1, square_b = dot(u, u), dot(v, v)
    pair_1, pair_b = cos_1 * cos_o, cos_o_out * cos_b
    expected = samples[0] * pair_b * square_1 * square_1
    if square_1 < near_square:
        expected += samples[1] * pair_1 * square_b * square_b
    return pair_1 * pair_b * math.pi / expected if expected > 0.0 else 0.0


@compiled()
def _observed_point(start, face, w, room):  # type: ignore[no-untyped-def]
    """Where a ray from `start` along w meets the plane of a face, the normal there towards the ray, and whether it
    does. Embree's own distances are single precision, which is too coarse for arrival times."""
    normal = get(room.normal, face, 0)
    approach = dot(w, normal)
    distance = dot(less(get(room.corner, face, 0), start), normal) / approach if approach != 0.0 else math.inf
    o = (start[0] + distance * w[0], start[1] + distance * w[1], start[2] + distance * w[2])
    if approach > 0.0:
        normal = (-normal[0], -normal[1], -normal[2])
    return o, normal, 0.0 < distance < math.inf


@compiled()
def arriving_paths(
    lookins: Lookins, density: Floats, face: NDArray[np.int32], direction: Singles, vicinity: LaserVicinity,
    room: Room,
) -> tuple[Paths, Singles, Singles]:  # fmt: skip
    """Paths from one laser point through its observed points, and through the lit points near it, into each lookin.

    With them origins and spans of the rays that tell which of them are hidden. Lookins near the laser point are left
    out: the walk takes them.

    density : (n,) expected number of lookins per area. face, direction : (n · Ñ, …) what the lookins' rays met.
    """
    count = len(lookins.part)
    observed, lit = len(face) // count, len(vicinity.lit_part)
    size, found = count * (observed + lit), 0
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
        apart = less(b, x1)
        if dot(apart, apart) < vicinity.near_square:
            first[n + 1] = found
            continue
        samples = (density[n] * observed, density[n] * vicinity.rays)
        albedo = room.values[lookins.part[n], 0] / math.pi
        from_b = lifted_and_scaled(b, normal_b, room.offset, room.frame)
        start = (b[0] + room.offset * normal_b[0], b[1] + room.offset * normal_b[1], b[2] + room.offset * normal_b[2])
        for k in range(observed + lit):
            # The one half is known to see the lookin, and asked whether it is lit; the other the reverse.
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
            u, v = less(o, x1), less(b, o)
            value = _weight(u, v, n1, normal_o, normal_b, samples, vicinity.near_square)
            if value <= 0.0:
                continue
            value *= albedo * _scattering(u, v, laser, normal_o, part_o, room.kind, room.values)
            if value <= 0.0:
                continue
            length = math.sqrt(dot(u, u)) + math.sqrt(dot(v, v))
            energy[found] = value * air(room.attenuation, vicinity.leg + length)
            position[found] = (length + room.device_legs * vicinity.leg) * room.per_metre
            _send(origin, span, found, at, lifted_and_scaled(o, normal_o, room.offset, room.frame))
            found += 1
        first[n + 1] = found
    return Paths(first, position[:found], energy[:found]), origin[:found], span[:found]
