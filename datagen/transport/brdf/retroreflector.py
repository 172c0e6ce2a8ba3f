"""A lobe back towards the light (`records.Retroreflector`). Row: albedo, concentration κ, share in the lobe."""

from __future__ import annotations

import math

from datagen.compiled import compiled
from datagen.records.arrays import Floats
from datagen.transport.brdf.directions import Vector, around, dot, sample_cosine


def concentration(half_width_rad: float) -> float:
    """κ for which exp(κ (cos w − 1)) = 1/2 at the half width w."""
    return math.log(2.0) / (2.0 * math.sin(half_width_rad / 2.0) ** 2)


@compiled()
def density(kappa: float, w_in: Vector, w_out: Vector) -> float:
    """The von Mises–Fisher density on the sphere about `w_in`, 1/sr."""
    # 1 − cos of the angle is |w_in − w_out|²/2, which keeps its digits in a narrow lobe.
    d = (w_in[0] - w_out[0], w_in[1] - w_out[1], w_in[2] - w_out[2])
    one_minus_cos = 0.5 * (d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    return kappa / (2.0 * math.pi * -math.expm1(-2.0 * kappa)) * math.exp(-kappa * one_minus_cos)


@compiled()
def evaluate(values: Floats, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """The BRDF, 1/sr, of directions above the surface."""
    retro = values[2]
    lobe = density(values[1], w_in, w_out) / max(cos_in, cos_out)
    return float(values[0] * (retro * lobe + (1.0 - retro) / math.pi))


@compiled()
def at_most(values: Floats, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float, turn: float) -> float:
    """`models.evaluate_at_most` for retroreflectors: the lobe does not depend on the normal."""
    kappa, retro = values[1], values[2]
    angle = max(math.acos(min(max(dot(w_in, w_out), -1.0), 1.0)) - turn, 0.0)
    lobe = kappa / (2.0 * math.pi * -math.expm1(-2.0 * kappa)) * math.exp(-2.0 * kappa * math.sin(0.5 * angle) ** 2)
    return float(values[0] * (retro * lobe / max(cos_in, cos_out) + (1.0 - retro) / math.pi))


@compiled()
def pdf(values: Floats, w_in: Vector, w_out: Vector, cos_out: float) -> float:
    """Density per solid angle of what `sample` draws, 1/sr."""
    retro = values[2]
    return float(retro * density(values[1], w_in, w_out) + (1.0 - retro) * cos_out / math.pi)


@compiled()
def sample(values: Floats, n: Vector, w_in: Vector, u: float, v: float) -> Vector:
    """A direction drawn with density `pdf` from (u, v) in the unit square."""
    kappa, retro = values[1], values[2]
    if u >= retro and retro < 1.0:
        return sample_cosine(n, (u - retro) / (1.0 - retro), v)
    return around(w_in, min(-math.log1p(u / retro * math.expm1(-2.0 * kappa)) / kappa, 2.0), v)
