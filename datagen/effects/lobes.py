"""The Lambertian surface that stands for another when its lobe is left out."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from datagen.records import Lambertian, Material, OrenNayar, Phong, Retroreflector, SinLobe
from datagen.transport.brdf import albedo

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_COSINES, _SHARES = (_NODES + 1) / 2, _WEIGHTS / 2


def is_lambertian(material: Material) -> bool:
    """Whether the surface scatters by Lambert's law, whatever its record is called; a black one does."""
    match material:
        case Lambertian() | Phong(exponent=0) | Phong(specular=0) | Retroreflector(retro=0) | OrenNayar(sigma_rad=0):
            return True
    return material.albedo == 0


@lru_cache(maxsize=1024)
def mean_albedo(material: Material) -> float:
    """What the surface returns of even light from all sides: 2 ∫ ρ(cosθ) cosθ dcosθ, ρ the directional albedo."""
    if is_lambertian(material):
        return material.albedo
    match material:
        case SinLobe():
            return material.albedo * 2 / math.pi
        case Phong():
            return material.albedo * (1 - material.specular + material.specular * _phong_share(material.exponent))
    return float(2 * np.sum(_SHARES * _COSINES * albedo(material, _COSINES)))


def _phong_share(exponent: float) -> float:
    """What the lobe (n + 2)/(2π) cosⁿα returns of even light: 2/(3π) (π + W/(n + 2)), W = ∫ cosⁿα dα over 0 … π/2.

    As α is the angle to a mirrored direction, which is as even as the first, it is averaged over all surfaces at a
    fixed angle between the two directions instead: the mean of max(n·ω, 0) max(n·ω′, 0) over the sphere of normals n
    is (sin α + (π − α) cos α)/(6π) (Cho & Saul, NIPS 2009, Eq. 6). What is left is an integral over α by parts.
    """
    ends = math.lgamma((exponent + 1) / 2) - math.lgamma(exponent / 2 + 1)
    return 2 / (3 * math.pi) * (math.pi + math.sqrt(math.pi) / 2 * math.exp(ends) / (exponent + 2))


def lambertian_of(material: Material) -> Material:
    """The Lambertian surface of the same mean albedo; a Lambertian one as it is."""
    return material if isinstance(material, Lambertian) else Lambertian(min(mean_albedo(material), 1.0))
