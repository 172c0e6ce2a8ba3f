"""BRDFs, each with evaluate, sample and pdf, compiled for the transport kernels.

A scene's materials become one table (`MaterialTable`): a kind and up to four numbers for each part. Directions are
unit vectors that point away from the surface; `n` is the unit normal on the side of the incoming light; a direction
below the surface receives nothing (no transmission).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.records import Lambertian, Material

LAMBERTIAN = 0


@dataclass(frozen=True)
class MaterialTable:
    """kind : (K,) int64; values : (K, 4) float64, the albedo first. K parts."""

    kind: NDArray[np.int64]
    values: NDArray[np.float64]

    @classmethod
    def of(cls, materials: tuple[Material, ...]) -> MaterialTable:
        """Raises `InputError` for a material the transport does not know."""
        kind = np.empty(len(materials), np.int64)
        values = np.zeros((len(materials), 4))
        for row, material in enumerate(materials):
            if not isinstance(material, Lambertian):
                raise InputError(f"material {type(material).__name__}: the transport knows Lambertian")
            kind[row] = LAMBERTIAN
            values[row, 0] = material.albedo
        return cls(kind, values)


Vector = tuple[float, float, float]


@njit(cache=True, inline="always")
def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True)
def evaluate(kind: int, values: NDArray[np.float64], n: Vector, w_in: Vector, w_out: Vector) -> float:
    """BRDF in 1/sr for light that comes from `w_in` and leaves along `w_out`; 0 where either is below the surface."""
    if dot(n, w_in) <= 0.0 or dot(n, w_out) <= 0.0:
        return 0.0
    return values[0] / math.pi


@njit(cache=True)
def pdf(kind: int, values: NDArray[np.float64], n: Vector, w_in: Vector, w_out: Vector) -> float:
    """Density per solid angle with which `sample` draws `w_out` given `w_in`, 1/sr."""
    return max(dot(n, w_out), 0.0) / math.pi


@njit(cache=True)
def sample(kind: int, values: NDArray[np.float64], n: Vector, w_in: Vector, u: float, v: float) -> Vector:
    """Draw `w_out` with density `pdf` from a point (u, v) of the unit square."""
    return sample_cosine(n, u, v)


@njit(cache=True)
def sample_cosine(n: Vector, u: float, v: float) -> Vector:
    """Direction about `n` with density cosθ/π, by Malley's projection of Shirley's concentric disk map."""
    a, b = 2.0 * u - 1.0, 2.0 * v - 1.0
    if abs(a) > abs(b):
        radius, angle = a, (math.pi / 4.0) * (b / a)
    else:
        radius, angle = b, math.pi / 2.0 - (math.pi / 4.0) * (a / b if b != 0.0 else 0.0)
    z = math.sqrt(max(1.0 - radius * radius, 0.0))
    return in_frame_of(n, radius * math.cos(angle), radius * math.sin(angle), z)


@njit(cache=True)
def in_frame_of(n: Vector, x: float, y: float, z: float) -> Vector:
    """The vector with components x, y, z in a right-handed frame whose third axis is the unit vector `n`."""
    # Without a branch on n's largest component: Duff et al., JCGT 6(1) (2017).
    sign = 1.0 if n[2] >= 0.0 else -1.0
    p = -1.0 / (sign + n[2])
    q = n[0] * n[1] * p
    return (
        x * (1.0 + sign * n[0] * n[0] * p) + y * q + z * n[0],
        x * sign * q + y * (sign + n[1] * n[1] * p) + z * n[1],
        -x * sign * n[0] - y * n[1] + z * n[2],
    )


@njit(cache=True)
def cosine_directions(normals: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) directions about (n, 3) normals from (n, ≥ 2) points, of which the first two coordinates are used."""
    out = np.empty((len(points), 3))
    for i in range(len(points)):
        n = (normals[i, 0], normals[i, 1], normals[i, 2])
        out[i, 0], out[i, 1], out[i, 2] = sample_cosine(n, points[i, 0], points[i, 1])
    return out
