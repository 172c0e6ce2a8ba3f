"""The energy-preserving Oren–Nayar model (`records.OrenNayar`). Row: albedo, roughness r.

Portsmouth, Kutz & Hill, JCGT 14(1) (2025), for white facets:

    π f / ρ = A (1 + r s/t) + (1 − E(θ_in)) (1 − E(θ_out)) / (1 − Ē),   s = w_in·w_out − cosθ_in cosθ_out,
    t = max(cosθ_in, cosθ_out) where s > 0, else 1;   A = 1 / (1 + (1/2 − 2/(3π)) r)

E is the directional albedo of the first term, Ē its cosine-weighted mean; both have closed forms, and the second term
adds exactly the light that the first loses.
"""

from __future__ import annotations

import math

import numpy as np

from datagen.compiled import compiled
from datagen.records.arrays import Floats
from datagen.records.materials import OrenNayar
from datagen.transport.brdf.directions import Vector, around, dot, sample_cosine

LOSS = 0.5 - 2.0 / (3.0 * math.pi)
"""The coefficient of r in 1/A, a number of the model."""
MEAN_GAIN = 2.0 / 3.0 - 28.0 / (15.0 * math.pi)
"""The coefficient of r in Ē / A, a number of the model."""


def row(material: OrenNayar) -> tuple[float, ...]:
    """The numbers of a material's row that follow the albedo."""
    return (roughness(material.sigma_rad),)


def lobe_width_rad(material: OrenNayar) -> float:
    """Infinite: a matt surface has no lobe."""
    return math.inf


def share(material: OrenNayar, cosine: Floats, azimuth_rad: Floats) -> Floats:
    """Directional albedo of a material of albedo 1: 1 at every incidence."""
    return np.ones_like(cosine)


def roughness(sigma_rad: float) -> float:
    """The roughness r with which both summands of the first term have the ratio B/A of Oren & Nayar's qualitative
    model for facets whose slope angles have the standard deviation `sigma_rad`."""
    square = sigma_rad**2
    return (0.45 * square / (square + 0.09)) / (1.0 - 0.5 * square / (square + 0.33))


@compiled()
def single_albedo(r: float, cosine: float) -> float:
    """E, the directional albedo of single scattering from white facets, at a cosine of incidence."""
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    # (1 − sin³)/cos, written without this division, which is 0/0 at grazing incidence.
    rise = cosine * (1.0 + sine + sine * sine) / (1.0 + sine)
    g = sine * (math.acos(min(cosine, 1.0)) - sine * cosine) + (2.0 / 3.0) * sine * (rise - 1.0)
    return min((1.0 + r * g / math.pi) / (1.0 + LOSS * r), 1.0)


@compiled()
def evaluate(values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """The BRDF, 1/sr, of directions above the surface."""
    r = values[1]
    s = dot(w_in, w_out) - cos_in * cos_out
    single = (1.0 + r * (s / max(cos_in, cos_out) if s > 0.0 else s)) / (1.0 + LOSS * r)
    # The mean loss 1 − Ē. A smooth surface loses nothing, and 0/0 must not arise.
    lost = 1.0 - (1.0 + MEAN_GAIN * r) / (1.0 + LOSS * r)
    multiple = (1.0 - single_albedo(r, cos_in)) * (1.0 - single_albedo(r, cos_out)) / lost if lost > 1e-12 else 0.0
    return float(values[0] / math.pi * (single + multiple))


@compiled()
def at_most(
    values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float, turn: float, tilt: float
) -> float:
    """`models.evaluate_at_most` for OrenNayar, which has no lobe that could be missed."""
    return float(evaluate(values, n, w_in, w_out, cos_in, cos_out))


@compiled()
def widen(values: Floats, span: float) -> None:
    """`models.widen` for OrenNayar: nothing to widen."""


@compiled()
def _uniform_share(r: float, cos_in: float) -> float:
    """Share of directions that `sample` draws uniformly: at grazing incidence most light leaves at grazing angles,
    where cosine-distributed directions are rare."""
    return 0.5 * r * (1.0 - cos_in)


@compiled()
def pdf(values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float) -> float:
    """Density per solid angle of what `sample` draws, 1/sr."""
    share = _uniform_share(values[1], cos_in)
    return share / (2.0 * math.pi) + (1.0 - share) * cos_out / math.pi


@compiled()
def sample(values: Floats, n: Vector, w_in: Vector, cos_in: float, u: float, v: float) -> Vector:
    """A direction drawn with density `pdf` from (u, v) in the unit square."""
    share = _uniform_share(values[1], cos_in)
    if u < share:
        return around(n, 1.0 - u / share, v)
    return sample_cosine(n, (u - share) / (1.0 - share), v)
