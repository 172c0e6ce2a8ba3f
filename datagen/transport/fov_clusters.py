"""FoV points of pixels in trees of clusters, from which cuts draw: fresh ones for each run."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats, Ints
from datagen.transport.fields_of_view import FovPool, fov_points, place_and_slopes
from datagen.transport.geometry import get
from datagen.transport.problem import Problem

SQUARES = (16, 256)
"""Squares of a pixel with a FoV point each, powers of 4: of flat pixels where no lobe is narrow, and of others."""
NARROW = 0.2
"""Half width of a lobe, rad, below which flat pixels have as many squares as all others."""
SAGITTA = 0.1
"""Arc of the arrival times over a cluster, bins, up to which they count as linear."""
FLAT = 1e-6
"""Sine of the angle between normals, and thickness in metres, up to which points lie on one flat surface."""


class FovClusters(NamedTuple):
    """FoV points of P pixels, a pair for each of M squares, and C clusters of squares.

    position, normal, to_sensor : (2 P M, 3) metres and unit vectors; the points of a square, one for each of two
        replicates, are neighbours, and the squares of a cluster, too. part : (2 P M,) index, −1 for none.
    weight : (2 P M,) m² sr, with the air on the leg to the sensor; those of a replicate stand for the whole pixel.
    leg : (2 P M,) distance to the sensor, m.
    cluster : (P, C, 18) the pixel first, then the four quarters of cluster c at 4 c + 1 …: middle (0 … 2) and mean
        normal (3 … 5) of the points; radius (6), m; sine of the largest angle of a normal with the mean, 2 beyond
        a right angle (7); largest distance from the plane through the middle (8), m; weight of one replicate (9), m²
        sr, 0 if no point is valid; index of a valid point (10). If all points of the pixel lie on one flat surface:
        the two sides of the cluster (11 … 16), m, and the distance of its middle to the sensor (17), m; else zeros,
        but for −1 as the distance of a pixel whose points are on one flat surface or on none.
    """

    position: Floats
    normal: Floats
    to_sensor: Floats
    part: Ints
    weight: Floats
    leg: Floats
    cluster: Floats

    @classmethod
    def of(cls, problem: Problem, pixels: Ints, squares: int, rng: np.random.Generator) -> FovClusters:
        """The clusters of some pixels."""
        found, cluster = _clusters(problem, pixels, squares, len(_places(squares.bit_length() // 2)), rng)
        return cls(
            found.position.reshape(-1, 3), found.normal.reshape(-1, 3), found.to_sensor.reshape(-1, 3),
            found.part.ravel(), found.weight.ravel(), found.last_leg.ravel(), cluster,
        )  # fmt: skip


def squares_of(problem: Problem, lobe: Floats, bin_m: float, rng: np.random.Generator) -> Ints:
    """(P,) number of squares that each pixel is divided into, as a few FoV points decide that are not used again.

    lobe : (K,) half width of the narrowest lobe of each part, rad. bin_m : path of a bin, metres.
    """
    pixels = np.arange(len(problem.capture.sensor.pixels))
    root = np.concatenate(
        [
            _clusters(problem, some, SQUARES[0], 1, rng)[1][:, 0]
            for some in np.array_split(pixels, 1 + len(pixels) // 4096)
        ]
    )
    # Times over a square of a pixel that is seen from as far as the pixel is wide.
    radius = root[:, 6] / math.sqrt(SQUARES[0])
    is_small = 0.25 * radius**2 < SAGITTA * 2.0 * root[:, 6] * bin_m
    is_flat = root[:, 17] != 0.0
    return np.where(is_flat & is_small & (lobe.min() >= NARROW), SQUARES[0], SQUARES[1])


@cache
def _places(level: int) -> Floats:
    """(C, 3) clusters of a pixel with 4^level squares: u and v of the middle, and the side; those of a quarter are
    neighbours."""
    of_all = []
    for n in range(level + 1):
        number, bits = np.arange(4**n)[:, None], np.arange(n)
        column, row = ((number >> 2 * bits & 1) << bits, (number >> 2 * bits + 1 & 1) << bits)
        middles = (np.stack([column.sum(axis=1), row.sum(axis=1)], axis=1) + 0.5) / 2**n
        of_all.append(np.column_stack([middles, np.full(4**n, 0.5**n)]))
    return np.concatenate(of_all)


def _clusters(
    problem: Problem, pixels: Ints, squares: int, count: int, rng: np.random.Generator
) -> tuple[FovPool, Floats]:
    """FoV points (P, 2 squares) of some pixels, and the first `count` clusters of each pixel (P, count, 18)."""
    sensor, places = problem.capture.sensor, _places(squares.bit_length() // 2)
    side = places[-1, 2]
    uv = rng.random((len(pixels), squares, 2, 2))
    uv *= side
    uv += (places[-squares:, :2] - 0.5 * side)[:, None]
    uv = uv.reshape(len(pixels), 2 * squares, 2)
    found = fov_points(problem.caster, problem.scene, sensor, problem.cones, pixels, uv, squares)
    np.multiply(found.weight, np.exp(-problem.scene.attenuation_per_m * found.last_leg), out=found.weight)
    cluster = np.zeros((len(pixels), count, 18))
    _set_clusters(found, sensor.pixels[pixels] - sensor.position, sensor.position, places, cluster)
    return found, cluster


@compiled(allocates=False)
def _set_clusters(found, corner, sensor, places, cluster):  # type: ignore[no-untyped-def]
    """Sets the first n clusters (P, n, 18) of pixels with points `found` (P, Q).

    corner : (P, 4, 3) of the pixels, metres from the sensor, which is at `sensor` (3,). places : (C, 3) of `_places`.
    """
    points = found.part.shape[1]
    for p in range(len(cluster)):
        size, first = points, 0
        for c in range(cluster.shape[1]):
            _set_cluster(found, p, first, size, cluster[p, c])
            # The clusters of one size are followed by their quarters.
            first += size
            if first == points:
                size, first = size // 4, 0
        if not (cluster[p, 0, 7] < FLAT and cluster[p, 0, 8] < FLAT):
            continue
        q = 0
        while q < points and found.part[p, q] >= 0:
            q += 1
        if q < points:
            cluster[p, 0, 17] = -1.0
        else:
            at, n = get(found.position[p], 0, 0), get(cluster[p], 0, 3)
            height = n[0] * (at[0] - sensor[0]) + n[1] * (at[1] - sensor[1]) + n[2] * (at[2] - sensor[2])
            for c in range(cluster.shape[1]):
                _set_flat(corner, p, sensor, n, height, places[c], cluster[p, c])


@compiled(allocates=False)
def _set_cluster(found, p, first, size, row):  # type: ignore[no-untyped-def]
    """Sets the numbers of a cluster of `size` points of pixel p, from the `first` on, that are not those of flat
    pixels alone."""
    part, position, normal = found.part[p], found.position[p], found.normal[p]
    count, one, weight = 0, first, 0.0
    for q in range(first, first + size):
        if part[q] >= 0:
            one = q if count == 0 else one
            count += 1
            weight += found.weight[p, q]
            for k in range(3):
                row[k] += position[q, k]
                row[3 + k] += normal[q, k]
    length = math.sqrt(row[3] * row[3] + row[4] * row[4] + row[5] * row[5])
    for k in range(3):
        row[k] /= max(count, 1)
        row[3 + k] /= max(length, 1e-300)
    square, cosine, thick = 0.0, 1.0, 0.0
    for q in range(first, first + size):
        if part[q] >= 0:
            apart, along, toward = 0.0, 0.0, 0.0
            for k in range(3):
                d = position[q, k] - row[k]
                apart += d * d
                along += d * row[3 + k]
                toward += normal[q, k] * row[3 + k]
            square, cosine, thick = max(square, apart), min(cosine, toward), max(thick, abs(along))
            # The points of one square may lie close together by chance; what they stand for is as large as ever.
            square = max(square, found.footprint[p, q] / 2) if size == 2 else square
    # Rounding of equal normals is no angle.
    sine = 2.0 if cosine <= 0.0 else 0.0 if cosine > 1.0 - 1e-12 else math.sqrt(1.0 - cosine * cosine)
    row[6], row[7], row[8], row[9] = math.sqrt(square), sine, thick, weight / 2
    # Which point of a pixel becomes which of all.
    row[10] = p * len(part) + one


@compiled(allocates=False)
def _set_flat(corner, p, sensor, n, height, place, row):  # type: ignore[no-untyped-def]
    """Sets middle, radius, sides and distance of a cluster of pixel p, which sees a plane with normal n.

    height : of the plane above the sensor along its normal, metres. place : (3,) of `_places`.
    """
    u, v, side = place[0], place[1], place[2]
    x, xu, xv = place_and_slopes(corner, p, 0, u, v)
    y, yu, yv = place_and_slopes(corner, p, 1, u, v)
    z, zu, zv = place_and_slopes(corner, p, 2, u, v)
    # A line of sight that turns moves its point within the plane.
    facing = x * n[0] + y * n[1] + z * n[2]
    far, turn1, turn2 = height / facing, xu * n[0] + yu * n[1] + zu * n[2], xv * n[0] + yv * n[1] + zv * n[2]
    square = plus = minus = 0.0
    for k in range(3):
        w, wu, wv = (x, xu, xv) if k == 0 else (y, yu, yv) if k == 1 else (z, zu, zv)
        one, two = side * (wu - w * turn1 / facing) * far, side * (wv - w * turn2 / facing) * far
        row[k], row[11 + k], row[14 + k] = sensor[k] + w * far, one, two
        square += (w * far) ** 2
        plus += (one + two) ** 2
        minus += (one - two) ** 2
    # About the exact middle the radius of a cluster is at most the half of its diagonals.
    row[6], row[17] = 0.5 * math.sqrt(max(plus, minus)), math.sqrt(square)
