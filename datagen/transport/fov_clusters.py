"""FoV points of pixels in trees of clusters, from which cuts draw: fresh ones for each run."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.records.arrays import Bools, Floats, Ints
from datagen.transport.fields_of_view import FovPool, fov_points
from datagen.transport.problem import Problem

SQUARES = (16, 256)
"""Squares of a pixel with a FoV point each, powers of 4: of flat pixels where no lobe is narrow, and of others."""
NARROW = 0.2
"""Half width of a lobe, rad, below which flat pixels have as many squares as all others."""
SAGITTA = 0.1
"""Arc of the arrival times over a cluster, bins, up to which they count as linear."""
FLAT = 1e-6
"""Sine of the angle between normals, and thickness in metres, up to which points lie on one flat surface."""

NUMBERS = 18
"""Numbers that describe a cluster: see `FovClusters`."""


class FovClusters(NamedTuple):
    """FoV points of P pixels, a pair for each of M squares, and C clusters of squares.

    position, normal, to_sensor : (2 P M, 3) metres and unit vectors; the points of a square, one for each of two
        replicates, are neighbours, and the squares of a cluster, too. part : (2 P M,) index, −1 for none.
    weight : (2 P M,) m² sr, with the air on the leg to the sensor; those of a replicate stand for the whole pixel.
    leg : (2 P M,) distance to the sensor, m.
    cluster : (P, C, 18) the pixel first, then the four quarters of cluster c at 4 c + 1 …: middle (0 … 2) and mean
        normal (3 … 5) of the points; radius (6), m; sine of the largest angle of a normal with the mean, 2 beyond
        a right angle (7); largest distance from the plane through the middle (8), m; weight of one replicate (9), m²
        sr, 0 if no point is valid; index of a valid point (10). If the pixel is flat: the two sides of the cluster
        (11 … 16), m, and the distance of its middle to the sensor (17), m; else zeros.
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
        sensor, level = problem.capture.sensor, squares.bit_length() // 2
        square = _in_morton_order(level)[None, :, None]
        place = rng.random((len(pixels), squares, 2, 2))
        uv = ((square + place) / 2**level).reshape(len(pixels), 2 * squares, 2)
        found = fov_points(problem.caster, problem.scene, sensor, problem.cones, pixels, uv, squares)
        valid = found.part >= 0
        air = np.exp(-problem.scene.attenuation_per_m * np.where(valid, found.last_leg, 0.0))
        found = found._replace(weight=found.weight * air)
        cluster = np.concatenate([_clusters(found, valid, 2 * squares >> (2 * n)) for n in range(level + 1)], axis=1)
        # The points of one square may lie close together by chance; what they stand for is as large as ever.
        half_diagonal = np.where(valid, np.sqrt(found.footprint / 2), 0.0).reshape(len(pixels), -1, 2).max(axis=2)
        cluster[:, -squares:, 6] = np.maximum(cluster[:, -squares:, 6], half_diagonal)
        flat = is_flat(cluster[:, 0]) & valid.all(axis=1)
        if flat.any():
            corners = sensor.pixels[pixels[flat]] - sensor.position
            middle, sides, leg = _exact(
                corners, found.position[flat, 0] - sensor.position, cluster[flat, 0, 3:6], level
            )
            cluster[flat, :, :3], cluster[flat, :, 11:17], cluster[flat, :, 17] = middle + sensor.position, sides, leg
            # About the exact middle the radius of a cluster is at most the half of its diagonals.
            one, two = sides[..., :3], sides[..., 3:]
            diagonals = np.linalg.norm([one + two, one - two], axis=3)
            cluster[flat, :, 6] = diagonals.max(axis=0) / 2
        # Which point of a pixel becomes which of all.
        cluster[..., 10] += 2 * squares * np.arange(len(pixels))[:, None]
        return cls(
            found.position.reshape(-1, 3), found.normal.reshape(-1, 3), found.to_sensor.reshape(-1, 3),
            found.part.ravel(), found.weight.ravel(), found.last_leg.ravel(), cluster,
        )  # fmt: skip


def is_flat(cluster: Floats) -> Bools:
    """(…) whether the points of clusters (…, 18) lie on one flat surface."""
    return np.asarray((cluster[..., 7] < FLAT) & (cluster[..., 8] < FLAT))


def squares_of(problem: Problem, lobe: Floats, bin_m: float, rng: np.random.Generator) -> Ints:
    """(P,) number of squares that each pixel is divided into, as a few FoV points decide that are not used again.

    lobe : (K,) half width of the narrowest lobe of each part, rad. bin_m : path of a bin, metres.
    """
    pixels = np.arange(len(problem.capture.sensor.pixels))
    root = np.concatenate(
        [
            FovClusters.of(problem, some, SQUARES[0], rng).cluster[:, 0]
            for some in np.array_split(pixels, 1 + len(pixels) // 4096)
        ]
    )
    # Times over a square of a pixel that is seen from as far as the pixel is wide.
    radius = root[:, 6] / math.sqrt(SQUARES[0])
    is_small = 0.25 * radius**2 < SAGITTA * 2.0 * root[:, 6] * bin_m
    return np.where(is_flat(root) & is_small & (lobe.min() >= NARROW), SQUARES[0], SQUARES[1])


def _in_morton_order(level: int) -> Floats:
    """(4**level, 2) column and row of squares, so ordered that those of a quarter are neighbours."""
    number = np.arange(4**level)
    column = sum((((number >> (2 * bit)) & 1) << bit for bit in range(level)), np.zeros_like(number))
    row = sum((((number >> (2 * bit + 1)) & 1) << bit for bit in range(level)), np.zeros_like(number))
    return np.stack([column, row], axis=1).astype(float)


def _clusters(found: FovPool, valid: Bools, size: int) -> Floats:
    """(P, n, 18) clusters of `size` neighbouring points each, those of flat pixels not yet exact."""

    def split(values: NDArray[np.float64] | Bools) -> Floats:
        return np.asarray(values.reshape(len(valid), -1, size, *values.shape[2:]), float)

    v, at, n, weight = split(valid), split(found.position), split(found.normal), split(found.weight)
    number = np.maximum(v.sum(axis=2), 1)[..., None]
    middle, axis = np.einsum("pcq,pcqk->pck", v, at) / number, np.einsum("pcq,pcqk->pck", v, n)
    axis /= np.maximum(np.linalg.norm(axis, axis=2), 1e-300)[..., None]
    apart = at - middle[:, :, None]
    cosine = np.where(v > 0, np.einsum("pcqk,pck->pcq", n, axis), 1.0).min(axis=2)
    radius = (v * np.linalg.norm(apart, axis=3)).max(axis=2)
    thick = (v * np.abs(np.einsum("pcqk,pck->pcq", apart, axis))).max(axis=2)
    sine = np.where(cosine > 0, np.sqrt(np.maximum(1 - cosine**2, 0.0)), 2.0)
    # Rounding of equal normals is no angle.
    sine[cosine > 1 - 1e-12] = 0.0
    one = v.argmax(axis=2) + np.arange(v.shape[1]) * size
    out = np.zeros((*radius.shape, NUMBERS))
    out[..., :3], out[..., 3:6], out[..., 6:9] = middle, axis, np.stack([radius, sine, thick], axis=2)
    out[..., 9], out[..., 10] = (v * weight).sum(axis=2) / 2, one
    return out


def _exact(corners: Floats, point: Floats, normal: Floats, level: int) -> tuple[Floats, Floats, Floats]:
    """Middle (P, C, 3), sides (P, C, 6) and distance to the sensor (P, C) of clusters of pixels that see one plane.

    corners : (P, 4, 3) of the pixels. point, normal : (P, 3) of the planes. All are metres from the sensor.
    """
    a, b, c, d = (corners[:, None, k] for k in range(4))
    uv = np.concatenate([(_in_morton_order(n) + 0.5) / 2**n for n in range(level + 1)])
    size = np.concatenate([np.full(4**n, 0.5**n) for n in range(level + 1)])[None, :, None]
    u, v, n = uv[None, :, :1], uv[None, :, 1:], normal[:, None]
    w = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * d + u * c)
    height, facing = np.einsum("pk,pk->p", point, normal)[:, None, None], (w * n).sum(axis=2, keepdims=True)
    middle, sides = w * height / facing, []
    # A line of sight that turns moves its point within the plane.
    for turn in ((1 - v) * (b - a) + v * (c - d), (1 - u) * (d - a) + u * (c - b)):
        sides.append(size * (turn - w * (turn * n).sum(axis=2, keepdims=True) / facing) * height / facing)
    return middle, np.concatenate(sides, axis=2), np.linalg.norm(middle, axis=2)
