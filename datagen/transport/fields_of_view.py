"""FoV points: the points where a pixel's lines of sight first meet the scene, and the weight of each.

A FoV point drawn uniformly on the pixel's quadrilateral stands for the solid angle J = dΩ/(du dv) of the sensor, so
the photons it sends into an aperture of area A are f₃ E₃ · A J / M for M points a pixel (docs/physics.md).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.errors import InputError
from datagen.records import Scene, Sensor
from datagen.records.arrays import Floats, Ints
from datagen.transport.brdf import dot
from datagen.transport.geometry import get
from datagen.transport.rays import Raycaster


class FovPool(NamedTuple):
    """Q FoV points for each of P pixels, M of which stand for a whole pixel.

    position, normal, to_sensor : (P, Q, 3) metres; unit normal facing the sensor; unit direction to the sensor.
    part : (P, Q) part index, −1 where the line of sight meets nothing.
    weight : (P, Q) A J / M, m² sr, with A the effective area of the aperture; times the pixel's sensitivity there
        (`Sensor.footprints`).
    footprint : (P, Q) area of wall that one of M points stands for, m².
    last_leg : (P, Q) distance to the sensor, m.
    """

    position: Floats
    normal: Floats
    to_sensor: Floats
    part: Ints
    weight: Floats
    footprint: Floats
    last_leg: Floats


class PixelCones(NamedTuple):
    """P pixels as cones of directions from the sensor.

    planes : (P, 4, 3) inward normals of the four side planes; for a direction inside all four scalar products are ≥
    0. solid_angle : (P,) sr.
    """

    planes: Floats
    solid_angle: Floats

    @classmethod
    def of(cls, sensor: Sensor) -> PixelCones:
        """The cones of a sensor's pixels.

        Raises `InputError` for a pixel that, seen from the sensor, is no convex quadrilateral with an area.
        """
        w = sensor.pixels - sensor.position
        length = np.linalg.norm(w, axis=2)
        if (length == 0).any():
            pixel = int(np.argwhere(length == 0)[0][0])
            raise InputError(f"Sensor.pixels[{pixel}]: a corner equals the sensor's position; it gives no direction")
        w = w / length[:, :, None]
        signed = [_triangle_solid_angle(w[:, 0], w[:, a], w[:, b]) for a, b in ((1, 2), (2, 3))]
        solid_angle = signed[0] + signed[1]
        # Seen from a point in its own plane a pixel covers half of all directions, or none.
        inside = np.flatnonzero(np.abs(solid_angle) > 2 * np.pi * (1 - 1e-9))
        if len(inside):
            raise InputError(
                f"Sensor.pixels[{inside[0]}]: the sensor's position lies within the pixel, which gives no "
                "directions; move the corners ahead of the sensor"
            )
        orientation = np.where(solid_angle < 0, -1.0, 1.0)
        planes = orientation[:, None, None] * np.cross(w, np.roll(w, -1, axis=1))
        # Convex: each corner lies on the inner side of the two sides it does not touch.
        for side in range(4):
            for corner in ((side + 2) % 4, (side + 3) % 4):
                inner = np.einsum("pk,pk->p", planes[:, side], w[:, corner])
                bad = np.flatnonzero((inner < -1e-14) | (solid_angle == 0))
                if len(bad):
                    raise InputError(
                        f"Sensor.pixels[{bad[0]}]: seen from the sensor its four corners, in order, must outline a "
                        "convex quadrilateral with an area; reorder or move the corners"
                    )
        return cls(planes, np.abs(solid_angle))


def _triangle_solid_angle(a: Floats, b: Floats, c: Floats) -> Floats:
    """(P,) signed solid angles of triangles of unit vectors (van Oosterom & Strackee, IEEE TBME 30 (1983)), sr."""
    # The triple product of differences keeps its digits for a pixel that is far smaller than its distance.
    triple = np.einsum("pk,pk->p", a, np.cross(b - a, c - a))
    dots = 1 + sum(np.einsum("pk,pk->p", x, y) for x, y in ((a, b), (b, c), (c, a)))
    return np.asarray(2 * np.arctan2(triple, dots))


def fov_points(
    caster: Raycaster, scene: Scene, sensor: Sensor, cones: PixelCones, pixels: Ints, uv: Floats, each: int
) -> FovPool:
    """The FoV points at the coordinates uv (P, Q, 2) of the quadrilaterals of `pixels`.

    each : number M of points that together stand for a whole pixel.
    """
    direction, jacobian = np.empty((*uv.shape[:2], 3)), np.empty(uv.shape[:2])
    _set_lines_of_sight(uv, sensor.pixels[pixels] - sensor.position, direction, jacobian)
    hits = caster.closest(sensor.position, direction.reshape(-1, 3))
    if sensor.footprints is not None:
        jacobian *= sensitivity(sensor.footprints, pixels[:, None], uv)
    shape = jacobian.shape
    part = np.where(hits.valid, scene.face_part[hits.face], -1).astype(np.int64).reshape(shape)
    normal = hits.normal.reshape(*shape, 3)
    position = hits.position.reshape(*shape, 3)
    return _pool(sensor, position, normal, part, direction, jacobian, cones.solid_angle[pixels], each)


def in_pixels(
    sensor: Sensor, cones: PixelCones, pixels: Ints, position: Floats, normal: Floats, part: Ints
) -> tuple[Ints, Ints, FovPool]:
    """Points (n, 3) on surfaces that lie within some `pixels`, whether or not something hides them from the sensor.

    Returns for each of k pairs of point and pixel the row of the point and the row of the pixel, and the FoV points
    (k, 1), each of which stands for the whole solid angle of its pixel.
    """
    row, of = np.nonzero(_are_inside(cones.planes, pixels, position - sensor.position, part))
    direction = position[row] - sensor.position
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    solid_angle = cones.solid_angle[pixels[of]]
    seen = solid_angle[:, None].copy()
    if sensor.footprints is not None:
        uv = place_in_pixels(sensor, direction)[0][pixels[of], np.arange(len(of))]
        seen[:, 0] *= sensitivity(sensor.footprints, pixels[of], uv)
    found = _pool(
        sensor, position[row, None], normal[row, None], part[row, None], direction[:, None], seen, solid_angle, 1
    )  # fmt: skip
    return row, of, found


def sensitivity(footprints: Floats, pixel: Ints, uv: Floats) -> Floats:
    """(…) sensitivities of pixels at coordinates uv (…, 2) of their quadrilaterals, from footprints (P, R, C)."""
    row = np.minimum(uv[..., 1] * footprints.shape[1], footprints.shape[1] - 1).astype(np.int64)
    column = np.minimum(uv[..., 0] * footprints.shape[2], footprints.shape[2] - 1).astype(np.int64)
    return np.asarray(footprints[pixel, row, column])


def place_in_pixels(sensor: Sensor, w: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Coordinates uv (P, n, 2) of directions w (n, 3) in the sensor's pixels, which are parallelograms, and whether a
    pixel contains them (P, n).

    A direction meets the plane of a pixel with corners a, b, c, d at a + u (b − a) + v (d − a) = s w with s > 0.
    """
    a, b, _, d = (sensor.pixels[:, k] - sensor.position for k in range(4))
    # w = (u/s) (b − a) + (v/s) (d − a) + (1/s) a
    over_s = np.einsum("pij,nj->pni", np.linalg.inv(np.stack([b - a, d - a, a], axis=2)), w)
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = over_s[..., :2] / over_s[..., 2:]
    inside = (over_s[..., 2] > 0) & (uv >= 0).all(axis=2) & (uv < 1).all(axis=2)
    return np.where(inside[..., None], uv, 0.0), inside


@compiled()
def _are_inside(planes: Floats, pixels: Ints, direction: Floats, part: Ints) -> NDArray[np.bool_]:
    """(n, P) whether directions (n, 3) from the sensor, to points of parts (n,), lie in the cones of some pixels."""
    inside = np.zeros((len(part), len(pixels)), np.bool_)
    for i in range(len(part)):
        for p in range(len(pixels)):
            k = 0 if part[i] >= 0 else 5
            while k < 4 and dot(get(planes[pixels[p]], k, 0), get(direction, i, 0)) >= 0.0:
                k += 1
            inside[i, p] = k == 4
    return inside


def _pool(
    sensor: Sensor, position: Floats, normal: Floats, part: Ints, direction: Floats, jacobian: Floats,
    solid_angle: Floats, each: int,
) -> FovPool:  # fmt: skip
    """FoV points from where lines of sight met something, as `_set_seen` describes it."""
    # Each numpy function that a kernel calls is compiled with it, so arrays are made here.
    position, weight, footprint, distance = position.copy(), *np.empty((3, *part.shape))
    _set_seen(
        position, normal, part, direction, jacobian, sensor.position, solid_angle, sensor.aperture_area_m2,
        sensor.aperture_radius_m**2 if sensor.finite_aperture else 0.0, each, weight, footprint, distance,
    )  # fmt: skip
    np.negative(direction, out=direction)
    return FovPool(position, normal, direction, part, weight, footprint, distance)


@compiled(allocates=False)
def _set_lines_of_sight(uv: Floats, corner: Floats, direction: Floats, jacobian: Floats) -> None:
    """Set unit directions (P, Q, 3) from the sensor through points of the pixels, and solid angles J = dΩ/(du dv)
    (P, Q).

    uv : (P, Q, 2) coordinates of the points. corner : (P, 4, 3) corners of the pixels, relative to the sensor.
    """
    for p in range(len(uv)):
        for q in range(uv.shape[1]):
            u, v = uv[p, q, 0], uv[p, q, 1]
            # The point w(u, v) between the four corners, and its derivatives along u and v.
            x, xu, xv = place_and_slopes(corner, p, 0, u, v)
            y, yu, yv = place_and_slopes(corner, p, 1, u, v)
            z, zu, zv = place_and_slopes(corner, p, 2, u, v)
            square = x * x + y * y + z * z
            length = math.sqrt(square)
            # J = |w · (∂w/∂u × ∂w/∂v)| / |w|³: the area of the quadrilateral for each unit of uv, seen from the
            # sensor.
            volume = x * (yu * zv - zu * yv) + y * (zu * xv - xu * zv) + z * (xu * yv - yu * xv)
            jacobian[p, q] = abs(volume) / (square * length)
            direction[p, q, 0], direction[p, q, 1], direction[p, q, 2] = x / length, y / length, z / length


@compiled(allocates=False)
def place_and_slopes(corner: Floats, p: int, k: int, u: float, v: float) -> tuple[float, float, float]:
    """Coordinate k of the place (u, v) of the quadrilateral of pixel p, and its derivatives along u and v."""
    a, b, c, d = corner[p, 0, k], corner[p, 1, k], corner[p, 2, k], corner[p, 3, k]
    place = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
    return place, (1 - v) * (b - a) + v * (c - d), (1 - u) * (d - a) + u * (c - b)


@compiled(allocates=False)
def _set_seen(
    position: Floats, normal: Floats, part: Ints, direction: Floats, jacobian: Floats, sensor: Floats,
    solid_angle: Floats, aperture_area: float, aperture_square: float, points_per_vertex: int,
    weight: Floats, footprint: Floats, distance: Floats,
) -> None:  # fmt: skip
    """Set position, where nothing was met, and weight, footprint and distance of each FoV point, as in `FovPool`.

    `part` is set to −1 for surfaces that face away. The effective area A of the aperture in f₃ E₃ A dΩ is that of a
    small aperture, or of a disc of finite size that faces the point (`aperture_square` > 0). From a point at distance
    R a facing disc of radius a fills a cone of sin²α = a²/(R² + a²), over which ∫ cosθ dω = π sin²α cosθ₀ exactly:
    the small-aperture value π a²/R² becomes π a²/(R² + a²).
    """
    for p in range(len(part)):
        for q in range(part.shape[1]):
            cosine = square = 0.0
            for k in range(3):
                # The position is undefined where nothing was met, and later loops must not meet a NaN.
                if part[p, q] < 0:
                    position[p, q, k] = 0.0
                cosine -= normal[p, q, k] * direction[p, q, k]
                square += (position[p, q, k] - sensor[k]) ** 2
            distance[p, q] = math.sqrt(square)
            # Seen edge-on, a patch of wall of any size could lie behind the point's solid angle.
            if part[p, q] < 0 or cosine <= 0.0:
                part[p, q], weight[p, q], footprint[p, q] = -1, 0.0, 1.0
                continue
            effective = aperture_area * square / (square + aperture_square)
            weight[p, q] = effective * jacobian[p, q] / points_per_vertex
            footprint[p, q] = solid_angle[p] * square / (cosine * points_per_vertex)
