"""The |sin θ| lobe (`records.SinLobe`): f = (ρ/2) |sin θ_in| |sin θ_out|. Row: albedo, axis (3)."""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats
from datagen.records.materials import SinLobe
from datagen.transport.brdf.directions import Vector, dot, sample_cosine

ALONG_SQUARED = 1e-12
"""Squared length of a projection on the surface below which its direction counts as rounding noise and the azimuth as
undefined."""


def row(material: SinLobe) -> tuple[float, ...]:
    """The numbers of a material's row that follow the albedo."""
    return material.axis


def lobe_width_rad(material: SinLobe) -> float:
    """Infinite: the lobe is as wide as the hemisphere."""
    return math.inf


def share(material: SinLobe, cosine: Floats, azimuth_rad: Floats) -> Floats:
    """Directional albedo of a material of albedo 1: |sin θ_in|."""
    return np.abs(np.sin(azimuth_rad))


@compiled()
def widen(values: Floats, span: float) -> None:
    """`models.widen` for SinLobe: nothing to widen."""


@compiled()
def azimuth_sine(axis: Vector, n: Vector, w: Vector) -> float:
    """|sin θ| of the azimuth θ of `w` about the normal, measured from the projection of `axis` on the surface."""
    # By the projections of `axis` and `w`: the sine follows from their vector product without a trigonometric
    # function.
    along_axis, along_w = dot(axis, n), dot(w, n)
    t = (axis[0] - along_axis * n[0], axis[1] - along_axis * n[1], axis[2] - along_axis * n[2])
    p = (w[0] - along_w * n[0], w[1] - along_w * n[1], w[2] - along_w * n[2])
    tt, pp = dot(t, t), dot(p, p)
    if tt < ALONG_SQUARED or pp < ALONG_SQUARED:
        # Where the azimuth is undefined, the mean over all azimuths.
        return 2.0 / math.pi
    cross = (t[1] * p[2] - t[2] * p[1], t[2] * p[0] - t[0] * p[2], t[0] * p[1] - t[1] * p[0])
    return min(abs(dot(cross, n)) / math.sqrt(tt * pp), 1.0)


@compiled()
def evaluate(values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """The BRDF, 1/sr, of directions above the surface."""
    axis = (values[1], values[2], values[3])
    return float(0.5 * values[0] * azimuth_sine(axis, n, w_in) * azimuth_sine(axis, n, w_out))


@compiled()
def at_most(
    values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float, turn: float, tilt: float
) -> float:
    """`models.evaluate_at_most` for SinLobe."""
    # An azimuth turns by the turn of its direction, over the sine of the direction's polar angle.
    axis, away = (values[1], values[2], values[3]), turn + tilt
    both = 1.0
    for w in (w_in, w_out):
        polar = math.sqrt(max(1.0 - dot(w, n) ** 2, 0.0))
        both *= min(azimuth_sine(axis, n, w) + away / max(polar, 1e-6), 1.0)
    return float(0.5 * values[0] * both)


@compiled()
def pdf(values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """Density per solid angle of what `sample` draws, 1/sr."""
    return 0.5 * cos_out * azimuth_sine((values[1], values[2], values[3]), n, w_out)


@compiled()
def sample(values: Floats, n: Vector, w_in: Vector, cos_in: float, u: float, v: float) -> Vector:
    """A direction drawn with density `pdf` from (u, v) in the unit square."""
    axis = (values[1], values[2], values[3])
    along = dot(axis, n)
    t = (axis[0] - along * n[0], axis[1] - along * n[1], axis[2] - along * n[2])
    square = dot(t, t)
    if square < ALONG_SQUARED:
        return sample_cosine(n, u, v)
    inverse = 1.0 / math.sqrt(square)
    t = (t[0] * inverse, t[1] * inverse, t[2] * inverse)
    s = (n[1] * t[2] - n[2] * t[1], n[2] * t[0] - n[0] * t[2], n[0] * t[1] - n[1] * t[0])
    # |sin θ| dθ = |d cos θ|: each half turn takes half of u, and cos θ is uniform in it.
    side = 1.0 if u < 0.5 else -1.0
    cosine = 1.0 - 2.0 * (2.0 * u if u < 0.5 else 2.0 * u - 1.0)
    sine = side * math.sqrt(max(1.0 - cosine * cosine, 0.0))
    radius, z = math.sqrt(v), math.sqrt(max(1.0 - v, 0.0))
    a, b = radius * cosine, radius * sine
    return (a * t[0] + b * s[0] + z * n[0], a * t[1] + b * s[1] + z * n[1], a * t[2] + b * s[2] + z * n[2])
