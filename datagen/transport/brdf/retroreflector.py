"""A lobe back towards the light (`records.Retroreflector`). Row: albedo, concentration κ, share in the lobe."""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats
from datagen.records.materials import Retroreflector
from datagen.transport.brdf.directions import (
    GRAZING,
    Vector,
    around,
    dot,
    positive_part_over_azimuth,
    sample_cosine,
    unit_gauss,
)


def row(material: Retroreflector) -> tuple[float, ...]:
    """The numbers of a material's row that follow the albedo."""
    return concentration(material.half_width_rad), material.retro


def lobe_width_rad(material: Retroreflector) -> float:
    """Half width at half maximum of the lobe; infinite without one."""
    return float(material.half_width_rad) if material.retro > 0 else math.inf


def share(material: Retroreflector, cosine: Floats, azimuth_rad: Floats) -> Floats:
    """Directional albedo of a material of albedo 1: a closed form in azimuth, and quadrature from the lobe's axis."""
    return material.retro * _lobe_share(material.half_width_rad, cosine) + 1 - material.retro


def _lobe_share(half_width_rad: float, cosine: Floats) -> Floats:
    """Albedo ∫ D min(1, cosθ_out / cosθ_in) dω of a retroreflector's lobe at some cosines of incidence.

    The minimum is the difference of two positive parts, max(cosθ_out, 0) and max(cosθ_out − cosθ_in, 0).
    """
    kappa = concentration(half_width_rad)
    cosine = np.maximum(cosine, GRAZING)
    sine = np.sqrt(1 - cosine**2)
    total = np.zeros_like(cosine)
    for u, weight in zip(*unit_gauss(512), strict=True):
        one_minus_cos = -np.log1p(u * np.expm1(-2 * kappa)) / kappa
        along, across = (1 - one_minus_cos) * cosine, np.sqrt(one_minus_cos * (2 - one_minus_cos)) * sine
        reached = positive_part_over_azimuth(along, across)
        excess = positive_part_over_azimuth(along - cosine, across)
        total += weight * (reached - excess) / (2 * np.pi * cosine)
    return total


def concentration(half_width_rad: float) -> float:
    """κ for which exp(κ (cos w − 1)) = 1/2 at the half width w."""
    return math.log(2.0) / (2.0 * math.sin(half_width_rad / 2.0) ** 2)


@compiled()
def widen(values: Floats, span: float) -> None:
    """`models.widen` for retroreflectors: a lower concentration."""
    values[1] = min(values[1], 1.0 / (span * span))


@compiled()
def density(kappa: float, w_in: Vector, w_out: Vector) -> float:
    """The von Mises–Fisher density on the sphere about `w_in`, 1/sr."""
    # 1 − cos of the angle is |w_in − w_out|²/2, which keeps its digits in a narrow lobe.
    d = (w_in[0] - w_out[0], w_in[1] - w_out[1], w_in[2] - w_out[2])
    one_minus_cos = 0.5 * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    return kappa / (2.0 * math.pi * -math.expm1(-2.0 * kappa)) * math.exp(-kappa * one_minus_cos)


@compiled()
def evaluate(values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """The BRDF, 1/sr, of directions above the surface."""
    retro = values[2]
    lobe = density(values[1], w_in, w_out) / max(cos_in, cos_out)
    return float(values[0] * (retro * lobe + (1.0 - retro) / math.pi))


@compiled()
def at_most(
    values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float, turn: float, tilt: float
) -> float:
    """`models.evaluate_at_most` for retroreflectors: the lobe does not depend on the normal."""
    kappa, retro = values[1], values[2]
    angle = max(math.acos(min(max(dot(w_in, w_out), -1.0), 1.0)) - turn, 0.0)
    lobe = kappa / (2.0 * math.pi * -math.expm1(-2.0 * kappa)) * math.exp(-2.0 * kappa * math.sin(0.5 * angle) ** 2)
    return float(values[0] * (retro * lobe / max(cos_in, cos_out) + (1.0 - retro) / math.pi))


@compiled()
def pdf(values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """Density per solid angle of what `sample` draws, 1/sr."""
    retro = values[2]
    return float(retro * density(values[1], w_in, w_out) + (1.0 - retro) * cos_out / math.pi)


@compiled()
def sample(values: Floats, n: Vector, w_in: Vector, cos_in: float, u: float, v: float) -> Vector:
    """A direction drawn with density `pdf` from (u, v) in the unit square."""
    kappa, retro = values[1], values[2]
    if u >= retro and retro < 1.0:
        return sample_cosine(n, (u - retro) / (1.0 - retro), v)
    return around(w_in, min(-math.log1p(u / retro * math.expm1(-2.0 * kappa)) / kappa, 2.0), v)
