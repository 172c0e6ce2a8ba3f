"""Vectors as tuples: scalar product, frames about a normal, cosine-distributed directions; integrals over angles."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats

Vector = tuple[float, float, float]

GRAZING = 1e-9
"""Least cosine of incidence where a closed form divides by the cosine."""


@compiled(inline="always")
def dot(a: Vector, b: Vector) -> float:
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled()
def sample_cosine(n: Vector, u: float, v: float) -> Vector:
    """Unit direction about `n` with density cosθ/π, from a point (u, v) of the unit square.

    Malley's projection of a disk onto the hemisphere, after Shirley's concentric map from the square onto the disk.
    """
    # Concentric squares become concentric circles, so that points spread evenly on the square stay so on the disk.
    a, b = 2.0 * u - 1.0, 2.0 * v - 1.0
    if abs(a) > abs(b):
        radius, angle = a, (math.pi / 4.0) * (b / a)
    else:
        radius, angle = b, math.pi / 2.0 - (math.pi / 4.0) * (a / b if b != 0.0 else 0.0)
    z = math.sqrt(max(1.0 - radius * radius, 0.0))
    return in_frame_of(n, radius * math.cos(angle), radius * math.sin(angle), z)


@compiled()
def in_frame_of(n: Vector, x: float, y: float, z: float) -> Vector:
    """The vector with components x, y, z in a right-handed frame whose third axis is the unit vector `n`."""
    # Duff et al., JCGT 6(1) (2017), which needs no branch on the largest component of n.
    sign = 1.0 if n[2] >= 0.0 else -1.0
    p = -1.0 / (sign + n[2])
    q = n[0] * n[1] * p
    return (
        x * (1.0 + sign * n[0] * n[0] * p) + y * q + z * n[0],
        x * sign * q + y * (sign + n[1] * n[1] * p) + z * n[1],
        -x * sign * n[0] - y * n[1] + z * n[2],
    )


@compiled()
def around(axis: Vector, one_minus_cos: float, revolutions: float) -> Vector:
    """The unit direction at the angle arccos(1 − `one_minus_cos`) from `axis`, and at azimuth 2π · `revolutions`."""
    # 1 − cos rather than cos: close to the axis the sine would lose its digits.
    cosine, azimuth = 1.0 - one_minus_cos, 2.0 * math.pi * revolutions
    sine = math.sqrt(max(one_minus_cos * (1.0 + cosine), 0.0))
    return in_frame_of(axis, sine * math.cos(azimuth), sine * math.sin(azimuth), cosine)


@compiled()
def cosine_directions(normals: Floats, points: Floats) -> Floats:
    """(n, 3) cosine-distributed unit directions about normals (n, 3), from two numbers of each row of `points`."""
    out = np.empty((len(points), 3))
    for i in range(len(points)):
        n = (normals[i, 0], normals[i, 1], normals[i, 2])
        out[i, 0], out[i, 1], out[i, 2] = sample_cosine(n, points[i, 0], points[i, 1])
    return out


@lru_cache(maxsize=16)
def unit_gauss(count: int) -> Floats:
    """(2, count): Gauss–Legendre nodes on 0 … 1 and weights that sum to 1."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    gauss = np.stack([0.5 * (nodes + 1), 0.5 * weights])
    gauss.flags.writeable = False
    return gauss


def positive_part_over_azimuth(a: Floats, b: Floats) -> Floats:
    """The integral ∫ max(a + b cosφ, 0) dφ over a full turn, for arrays a and b ≥ 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        edge = np.arccos(np.clip(np.where(b > 0, -a / b, np.where(a > 0, -1.0, 1.0)), -1.0, 1.0))
    return np.asarray(2 * (a * edge + b * np.sin(edge)))
