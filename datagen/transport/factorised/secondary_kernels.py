"""The compiled loops behind `secondary.py`: half paths into and out of lookins.

A trailing 1 means at the laser point, o at the observed point, b at the lookin, 4 at the FoV point. A geometry term
is form = cosθ cosθ′ / R², 1/m². Shadow rays are written in embree's unit frame, ready to be sent, each with the path
it belongs to; paths that are provably free have none.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.brdf import LAMBERTIAN, Vector, dot, evaluate, in_frame_of
from datagen.transport.factorised.convolution import Paths
from datagen.transport.visibility.clearance import LightBuffer, lit_for_certain
from datagen.transport.visibility.raycast import lifted_and_scaled


class Frame(NamedTuple):
    """Embree's unit frame: scaled = (point − center) / half_extent; ray ends are lifted by `offset` metres."""

    center: Floats
    half_extent: float
    offset: float


class Surfaces(NamedTuple):
    """Triangles and materials.

    Attributes
    ----------
    corner : (F, 3) one corner of each triangle, m.
    normal : (F, 3) unit normals.
    part : (F,) part indices.
    kind, values : (K,), (K, n) materials, as in `MaterialTable`.
    """

    corner: Floats
    normal: Floats
    part: NDArray[np.int32]
    kind: Ints | NDArray[np.uint8]
    values: Floats


class Pace(NamedTuple):
    """Path length → time bin and attenuation.

    Attributes
    ----------
    per_metre : sub-bins (`convolution.py`) for each metre of path.
    start : length in sub-bins at which the window starts, to the centre of its first sub-bin.
    device_legs : 1 where device legs count for the time, else 0.
    attenuation : 1/m.
    """

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
    """As in `fov.FovPool`, (P, Q, …); share (P, Q): probability with which a block draws lookins from each point."""

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


class Rays(NamedTuple):
    """origin, span (n, 3) float32 in embree's frame; path (n,)."""

    origin: NDArray[np.float32]
    span: NDArray[np.float32]
    path: Ints


@compiled()
def _vector(a, i):  # type: ignore[no-untyped-def]
    return a[i, 0], a[i, 1], a[i, 2]


@compiled()
def _send(rays, number, at, to, path):  # type: ignore[no-untyped-def]
    """Note the ray `number` from `at` to `to` for the given path."""
    origin, span, path_of = rays
    for axis in range(3):
        origin[number, axis] = at[axis]
        span[number, axis] = to[axis] - at[axis]
    path_of[number] = path


@compiled()
def leaving_paths(
    lookins: Lookins, clear: Bools, fov: FovPoints, points: int, surfaces: Surfaces, pace: Pace,
    frame: Frame,
) -> tuple[Paths, Floats, Rays]:  # fmt: skip
    """Paths from each lookin through its block of `points` FoV points into the aperture, rows (lookin, pixel).

    With them the density, per area at the lookin, with which each FoV point draws it. Hidden ones are still in.
    """
    count, pixels = len(lookins.part), fov.weight.shape[0]
    size = count * pixels * points
    first = np.zeros(count * pixels + 1, np.int64)
    position, energy, density = np.empty(size), np.empty(size), np.empty(size)
    ray_size = points * pixels * (count - clear.sum())
    origin, span = np.empty((ray_size, 3), np.float32), np.empty((ray_size, 3), np.float32)
    path = np.empty(ray_size, np.int64)
    fov_position, fov_normal, fov_to_sensor, fov_part = fov.position, fov.normal, fov.to_sensor, fov.part
    weight, last_leg, share = fov.weight, fov.last_leg, fov.share
    kind, values = surfaces.kind, surfaces.values
    attenuation, per_metre, device_legs, start = pace.attenuation, pace.per_metre, pace.device_legs, pace.start
    scale = (frame.center[0], frame.center[1], frame.center[2], frame.half_extent)
    offset = frame.offset
    found, sent = 0, 0
    for n in range(count):
        b, normal_b = _vector(lookins.position, n), _vector(lookins.normal, n)
        at = lifted_and_scaled(b, normal_b, offset, scale)
        for p in range(pixels):
            for q in range(lookins.block[n] * points, (lookins.block[n] + 1) * points):
                if weight[p, q] == 0.0:
                    continue
                x = (fov_position[p, q, 0], fov_position[p, q, 1], fov_position[p, q, 2])
                normal_4 = (fov_normal[p, q, 0], fov_normal[p, q, 1], fov_normal[p, q, 2])
                u = _difference(x, b)
                cos_b, cos_4 = dot(u, normal_b), -dot(u, normal_4)
                if cos_b <= 0.0 or cos_4 <= 0.0:
                    continue
                square = dot(u, u)
                distance = math.sqrt(square)
                form = cos_b * cos_4 / (square * square)
                part = fov_part[p, q]
                if kind[part] == LAMBERTIAN:
                    f4 = values[part, 0] / math.pi
                else:
                    to_b = (-u[0] / distance, -u[1] / distance, -u[2] / distance)
                    to_sensor = (fov_to_sensor[p, q, 0], fov_to_sensor[p, q, 1], fov_to_sensor[p, q, 2])
                    f4 = evaluate(kind[part], values[part], normal_4, to_b, to_sensor)
                energy[found] = f4 * weight[p, q] * form
                if attenuation > 0.0:
                    energy[found] *= math.exp(-attenuation * (distance + last_leg[p, q]))
                density[found] = share[p, q] * form / math.pi
                position[found] = (distance + device_legs * last_leg[p, q]) * per_metre - start
                if not clear[n]:
                    _send((origin, span, path), sent, at, lifted_and_scaled(x, normal_4, offset, scale), found)
                    sent += 1
                found += 1
            first[n * pixels + p + 1] = found
    rays = Rays(origin[:sent], span[:sent], path[:sent])
    return Paths(first, position[:found], energy[:found]), density[:found], rays


@compiled()
def drop_hidden(rays: Rays, hidden: Bools, values: Floats) -> None:
    """Clear the values of paths whose ray is hidden."""
    for k in range(len(rays.path)):
        if hidden[k]:
            values[rays.path[k]] = 0.0


@compiled()
def sum_rows(first: Ints, values: Floats, rows_together: int) -> Floats:
    """Sum of `values` over each run of `rows_together` rows."""
    out = np.zeros((len(first) - 1) // rows_together)
    for r in range(len(out)):
        for k in range(first[r * rows_together], first[(r + 1) * rows_together]):
            out[r] += values[k]
    return out


@compiled()
def observing_rays(lookins: Lookins, points: Floats, frame: Frame) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Origins and directions (n · Ñ, 3) of cosine rays from each lookin through its own shift of `points` (Ñ, 2).

    A shift on the unit torus keeps each point uniform, and the first coordinate, being an angle, closes upon itself.
    """
    count, size = len(lookins.part), len(points)
    origin, direction = np.empty((count * size, 3), np.float32), np.empty((count * size, 3), np.float32)
    cosine, sine = np.cos(2 * math.pi * points[:, 0]), np.sin(2 * math.pi * points[:, 0])
    scale = (frame.center[0], frame.center[1], frame.center[2], frame.half_extent)
    for n in range(count):
        normal = _vector(lookins.normal, n)
        lifted = lifted_and_scaled(_vector(lookins.position, n), normal, frame.offset, scale)
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
def _scattering(u, v, normal_1, to_laser, part_1, normal_o, part_o, kind, values):  # type: ignore[no-untyped-def]
    """f₁ · fₒ of light that travels u from the laser point to o and v on from there."""
    if kind[part_1] == LAMBERTIAN and kind[part_o] == LAMBERTIAN:
        return values[part_1, 0] * values[part_o, 0] / (math.pi * math.pi)
    r1, rb = math.sqrt(dot(u, u)), math.sqrt(dot(v, v))
    onward = (u[0] / r1, u[1] / r1, u[2] / r1)
    back = (-onward[0], -onward[1], -onward[2])
    f1 = evaluate(kind[part_1], values[part_1], normal_1, to_laser, onward)
    return f1 * evaluate(kind[part_o], values[part_o], normal_o, back, (v[0] / rb, v[1] / rb, v[2] / rb))


@compiled()
def _difference(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


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
def arriving_paths(
    lookins: Lookins, density: Floats, face: NDArray[np.int32], direction: NDArray[np.float32],
    vicinity: LaserVicinity, buffer: LightBuffer, surfaces: Surfaces, pace: Pace, frame: Frame,
) -> tuple[Paths, Rays]:  # fmt: skip
    """Paths from one laser point through its observed points, and through the lit points near it, into each lookin.

    Lookins near the laser point are left out: the walk takes them.

    density : (n,) expected number of lookins per area. face, direction : (n · Ñ, …) what the lookins' rays met.
    """
    count = len(lookins.part)
    observed = len(face) // count
    lit = len(vicinity.lit_part)
    size = count * (observed + lit)
    first = np.zeros(count + 1, np.int64)
    position, energy = np.empty(size), np.empty(size)
    origin, span = np.empty((size, 3), np.float32), np.empty((size, 3), np.float32)
    path = np.empty(size, np.int64)
    # Numba counts references whenever a record of arrays is handed on: what the loop needs is taken out of them here.
    x1 = (vicinity.position[0], vicinity.position[1], vicinity.position[2])
    n1 = (vicinity.normal[0], vicinity.normal[1], vicinity.normal[2])
    to_laser = (vicinity.to_laser[0], vicinity.to_laser[1], vicinity.to_laser[2])
    part_1, rays, near_square = vicinity.part, vicinity.rays, vicinity.near_square
    lit_position, lit_normal, lit_part = vicinity.lit_position, vicinity.lit_normal, vicinity.lit_part
    corner, face_normal, face_part = surfaces.corner, surfaces.normal, surfaces.part
    kind, values = surfaces.kind, surfaces.values
    cells, face_plane = buffer.cells, buffer.face_plane
    attenuation, per_metre, leg = pace.attenuation, pace.per_metre, vicinity.leg
    counted_leg = pace.device_legs * leg
    center, half_extent, offset = frame.center, frame.half_extent, frame.offset
    scale = (center[0], center[1], center[2], half_extent)
    from_1 = lifted_and_scaled(x1, n1, offset, scale)
    found, sent = 0, 0
    for n in range(count):
        b, normal_b = _vector(lookins.position, n), _vector(lookins.normal, n)
        apart = _difference(b, x1)
        if dot(apart, apart) < near_square:
            first[n + 1] = found
            continue
        samples = (density[n] * observed, density[n] * rays)
        albedo = values[lookins.part[n], 0] / math.pi
        from_b = lifted_and_scaled(b, normal_b, offset, scale)
        start = (b[0] + offset * normal_b[0], b[1] + offset * normal_b[1], b[2] + offset * normal_b[2])
        for k in range(observed + lit):
            if k < observed:
                i = n * observed + k
                f = face[i]
                if f < 0:
                    continue
                w = (float(direction[i, 0]), float(direction[i, 1]), float(direction[i, 2]))
                normal_o = _vector(face_normal, f)
                approach = dot(w, normal_o)
                if approach == 0.0:
                    continue
                distance = dot(_difference(_vector(corner, f), start), normal_o) / approach
                if not 0.0 < distance < math.inf:
                    continue
                o = (start[0] + distance * w[0], start[1] + distance * w[1], start[2] + distance * w[2])
                if approach > 0.0:
                    normal_o = (-normal_o[0], -normal_o[1], -normal_o[2])
                part_o = face_part[f]
            else:
                o, normal_o = _vector(lit_position, k - observed), _vector(lit_normal, k - observed)
                part_o = np.int32(lit_part[k - observed])
            u, v = _difference(o, x1), _difference(b, o)
            value = _weight(u, v, n1, normal_o, normal_b, samples, near_square)
            if value <= 0.0:
                continue
            value *= albedo * _scattering(u, v, n1, to_laser, part_1, normal_o, part_o, kind, values)
            if value <= 0.0:
                continue
            length = math.sqrt(dot(u, u)) + math.sqrt(dot(v, v))
            if attenuation > 0.0:
                value *= math.exp(-attenuation * (leg + length))
            energy[found], position[found] = value, (length + counted_leg) * per_metre
            if k >= observed or not lit_for_certain(cells, face_plane, f, u[0], u[1], u[2]):
                at, to = from_1 if k < observed else from_b, lifted_and_scaled(o, normal_o, offset, scale)
                _send((origin, span, path), sent, at, to, found)
                sent += 1
            found += 1
        first[n + 1] = found
    return Paths(first, position[:found], energy[:found]), Rays(origin[:sent], span[:sent], path[:sent])
