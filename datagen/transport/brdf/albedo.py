"""Directional albedo: the share of light arriving from one direction that leaves again."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from datagen.errors import InputError
from datagen.records.arrays import Floats
from datagen.records.materials import Material
from datagen.transport.brdf.table import model_of


def albedo(material: Material, cos_in: ArrayLike, azimuth_rad: ArrayLike = math.pi / 2) -> Floats:
    """Directional-hemispherical reflectance ∫ f cosθ_out dω_out of a material, dimensionless.

    A closed form where the kind of BRDF has one, else quadrature, exact to about 10⁻⁵: `share` in the file of the
    kind says which.

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
    return material.albedo * model_of(material).share(material, cosine, azimuth)
