"""The modified Phong lobe (`records.Phong`). Row: albedo, exponent, specular share."""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats
from datagen.records.materials import Phong
from datagen.transport.brdf.directions import (
    Vector,
    around,
    dot,
    positive_part_over_azimuth,
    sample_cosine,
    unit_gauss,
)


def row(material: Phong) -> tuple[float, ...] | None:
    """The numbers of a material's row that follow the albedo; None for exponent 0, which is Lambert's law."""
    return (material.exponent, material.specular) if material.exponent > 0 else None


def lobe_width_rad(material: Phong) -> float:
    """Half width at half maximum of the lobe; infinite without one."""
    if material.exponent == 0 or material.specular == 0:
        return math.inf
    return math.sqrt(2 * math.log(2) / material.exponent)


def share(material: Phong, cosine: Floats, azimuth_rad: Floats) -> Floats:
    """Directional albedo of a material of albedo 1: a closed form in azimuth, and quadrature from the lobe's axis."""
    return material.specular * _lobe_share(material.exponent, cosine) + 1 - material.specular


def _lobe_share(exponent: float, cosine: Floats) -> Floats:
    """Albedo (n + 2)/(2π) ∫ cosⁿα cosθ dω of a Phong lobe at some cosines of incidence.

    The integral over α is split at the angle from which part of the lobe lies below the surface.
    """
    nodes, weights = unit_gauss(96)
    sine = np.sqrt(1 - cosine**2)
    # The lobe is constant in p = cos^(n+1) α. Easing moves nodes towards the ends of both pieces, where the integrand
    # begins like a square root.
    bend = sine ** (exponent + 1)
    total = np.zeros_like(cosine)
    for x, weight in zip(nodes, weights, strict=True):
        eased, slope = x * x * (3 - 2 * x), 6 * x * (1 - x)
        for p, share in ((bend + (1 - bend) * eased, (1 - bend) * slope), (bend * eased, bend * slope)):
            from_mirror = p ** (1 / (exponent + 1))
            across = np.sqrt(np.maximum(1 - from_mirror**2, 0.0))
            total += weight * share * positive_part_over_azimuth(from_mirror * cosine, across * sine)
    return (exponent + 2) / (exponent + 1) / (2 * np.pi) * total


@compiled()
def widen(values: Floats, span: float) -> None:
    """`models.widen` for Phong: a lower exponent."""
    values[1] = min(values[1], 1.0 / (span * span))


@compiled()
def evaluate(values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """The BRDF, 1/sr, of directions above the surface."""
    exponent, specular = values[1], values[2]
    # Cosine between `w_out` and the mirror direction 2 cosθ_in n − w_in, which need not be computed for it.
    from_mirror = 2.0 * cos_in * cos_out - dot(w_in, w_out)
    lobe = (exponent + 2.0) / (2.0 * math.pi) * from_mirror**exponent if from_mirror > 0.0 else 0.0
    return float(values[0] * (specular * lobe + (1.0 - specular) / math.pi))


@compiled()
def at_most(
    values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float, turn: float, tilt: float
) -> float:
    """`models.evaluate_at_most` for Phong: the mirror direction turns twice as far as the normal."""
    exponent, specular = values[1], values[2]
    from_mirror = 2.0 * cos_in * cos_out - dot(w_in, w_out)
    angle = math.acos(min(max(from_mirror, -1.0), 1.0)) - turn - 2.0 * tilt
    lobe = (exponent + 2.0) / (2.0 * math.pi)
    if angle > 0.0:
        lobe *= math.cos(angle) ** exponent if angle < 0.5 * math.pi else 0.0
    return float(values[0] * (specular * lobe + (1.0 - specular) / math.pi))


@compiled()
def pdf(values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """Density per solid angle of what `sample` draws, 1/sr."""
    exponent, specular = values[1], values[2]
    from_mirror = 2.0 * cos_in * cos_out - dot(w_in, w_out)
    lobe = (exponent + 1.0) / (2.0 * math.pi) * from_mirror**exponent if from_mirror > 0.0 else 0.0
    return float(specular * lobe + (1.0 - specular) * cos_out / math.pi)


@compiled()
def sample(values: Floats, n: Vector, w_in: Vector, cos_in: float, u: float, v: float) -> Vector:
    """A direction drawn with density `pdf` from (u, v) in the unit square."""
    exponent, specular = values[1], values[2]
    if u >= specular and specular < 1.0:
        return sample_cosine(n, (u - specular) / (1.0 - specular), v)
    twice = 2.0 * dot(n, w_in)
    mirror = (twice * n[0] - w_in[0], twice * n[1] - w_in[1], twice * n[2] - w_in[2])
    # cos α = u^(1/(n+1)), taken as 1 − cos α, which keeps its digits in a narrow lobe.
    return around(mirror, -math.expm1(math.log(max(u / specular, 1e-300)) / (exponent + 1.0)), v)
