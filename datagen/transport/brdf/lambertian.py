"""Lambert's law (`records.Lambertian`): f = ρ/π. Row: albedo. `models.py` evaluates and samples it without a call."""

from __future__ import annotations

import math

import numpy as np

from datagen.records.arrays import Floats
from datagen.records.materials import Lambertian


def row(material: Lambertian) -> tuple[float, ...]:
    """The numbers of a material's row that follow the albedo: none."""
    return ()


def lobe_width_rad(material: Lambertian) -> float:
    """Infinite: there is no lobe."""
    return math.inf


def share(material: Lambertian, cosine: Floats, azimuth_rad: Floats) -> Floats:
    """Directional albedo of a material of albedo 1: 1 at every incidence."""
    return np.ones_like(cosine)
