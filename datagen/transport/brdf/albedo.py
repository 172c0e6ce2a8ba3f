"""Directional albedo: the share of light arriving from one direction that leaves again."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from datagen.errors import InputError
from datagen.records.arrays import Floats
from datagen.records.materials import GGX, Lambertian, Material, OrenNayar, Phong, Retroreflector, SinLobe
from datagen.transport.brdf import ggx, retroreflector
from datagen.transport.brdf.table import MaterialTable

GRAZING = 1e-9
"""Least cosine of incidence where a closed form divides by the cosine; half of it changes nothing visible."""


def albedo(material: Material, cos_in: ArrayLike, azimuth_rad: ArrayLike = math.pi / 2) -> Floats:
    """Directional-hemispherical reflectance ∫ f cosθ_out dω_out of a material, dimensionless.

    Closed forms for Lambertian, OrenNayar (the albedo itself, at every incidence) and SinLobe; for Phong and
    Retroreflector a closed form in azimuth and quadrature in angle from the lobe's axis; for GGX quadrature over
    visible facets. Quadrature is exact to about 10⁻⁵.

    Parameters
    ----------
    material : any material record.
    cos_in : cosine of the angle of incidence, 0 … 1, any shape.
    azimuth_rad : azimuth of the light about the normal from the projected axis; only SinLobe depends on it, and
        returns most at π/2.

    Returns
    -------
    float64 array of the broadcast shape of `cos_in` and `azimuth_rad`.

    Raises
    ------
    InputError : for a cosine outside 0 … 1, or a material the transport does not know.
    """
    cosine, azimuth = np.broadcast_arrays(np.asarray(cos_in, np.float64), np.asarray(azimuth_rad, np.float64))
    if not ((cosine >= 0) & (cosine <= 1)).all():
        raise InputError(f"albedo: cos_in = {cos_in!r}; the cosine of an angle of incidence lies in 0 … 1")
    match material:
        case Lambertian() | OrenNayar() | Phong(exponent=0):
            share = np.ones_like(cosine)
        case SinLobe():
            share = np.abs(np.sin(azimuth))
        case Phong():
            share = material.specular * _phong_lobe(material.exponent, cosine) + 1 - material.specular
        case Retroreflector():
            share = material.retro * _retro_lobe(material.half_width_rad, cosine) + 1 - material.retro
        case GGX():
            share = _ggx(material, cosine)
        case _:
            MaterialTable.of((material,))
            raise InputError(f"albedo: no rule for {type(material).__name__}")
    return material.albedo * share


def _positive_part_over_azimuth(a: Floats, b: Floats) -> Floats:
    """The integral ∫ max(a + b cosφ, 0) dφ over a full turn, for arrays a and b ≥ 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        edge = np.arccos(np.clip(np.where(b > 0, -a / b, np.where(a > 0, -1.0, 1.0)), -1.0, 1.0))
    return np.asarray(2 * (a * edge + b * np.sin(edge)))


def _phong_lobe(exponent: float, cosine: Floats) -> Floats:
    """Albedo (n + 2)/(2π) ∫ cosⁿα cosθ dω of a Phong lobe at some cosines of incidence.

    The integral over α is split at the angle from which part of the lobe lies below the surface.
    """
    nodes, weights = ggx.unit_gauss(96)
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
            total += weight * share * _positive_part_over_azimuth(from_mirror * cosine, across * sine)
    return (exponent + 2) / (exponent + 1) / (2 * np.pi) * total


def _retro_lobe(half_width_rad: float, cosine: Floats) -> Floats:
    """Albedo ∫ D min(1, cosθ_out / cosθ_in) dω of a retroreflector's lobe at some cosines of incidence.

    The minimum is the difference of two positive parts, max(cosθ_out, 0) and max(cosθ_out − cosθ_in, 0).
    """
    kappa = retroreflector.concentration(half_width_rad)
    cosine = np.maximum(cosine, GRAZING)
    sine = np.sqrt(1 - cosine**2)
    total = np.zeros_like(cosine)
    for u, weight in zip(*ggx.unit_gauss(512), strict=True):
        one_minus_cos = -np.log1p(u * np.expm1(-2 * kappa)) / kappa
        along, across = (1 - one_minus_cos) * cosine, np.sqrt(one_minus_cos * (2 - one_minus_cos)) * sine
        reached = _positive_part_over_azimuth(along, across)
        excess = _positive_part_over_azimuth(along - cosine, across)
        total += weight * (reached - excess) / (2 * np.pi * cosine)
    return total


def _ggx(material: GGX, cosine: Floats) -> Floats:
    """Albedo of GGX facets at some cosines: single scattering by quadrature, multiple scattering from its table."""
    row = MaterialTable.of((material,)).values[0]
    gauss = ggx.unit_gauss(64)
    single = [ggx.single_albedo(row[1], row[2], c, gauss) for c in cosine.ravel()]
    lost = np.array([1 - ggx.tabulated(row, c) for c in cosine.ravel()])
    return (single + ggx.multiple_share(row[2], row[3]) * lost).reshape(cosine.shape)
