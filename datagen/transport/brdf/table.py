"""The materials of a scene as plain numbers for compiled loops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.records.arrays import Floats, Ints
from datagen.records.materials import GGX, Lambertian, Material, OrenNayar, Phong, Retroreflector, SinLobe
from datagen.transport.brdf import ggx, oren_nayar, retroreflector

LAMBERTIAN, SIN_LOBE, PHONG, OREN_NAYAR, GGX_LOBE, RETROREFLECTOR = range(6)
NARROWEST_ROW = 4
"""Least number of columns of a table, enough for most models; half of it would only make some tables narrower."""


class Materials(NamedTuple):
    """The fields of a `MaterialTable` as a tuple, which compiled loops can take."""

    kind: Ints | NDArray[np.uint8]
    values: Floats


@dataclass(frozen=True)
class MaterialTable:
    """The materials of K parts.

    kind : (K,) int64; uint8 if all parts are Lambertian, for which loops are compiled apart (see `models.py`).
    values : (K, ≥ 4) float64, the albedo first, then the parameters that the kind needs.
    """

    kind: Ints | NDArray[np.uint8]
    values: Floats

    @classmethod
    def of(cls, materials: tuple[Material, ...]) -> MaterialTable:
        """The table of some materials, one for each part.

        Raises `InputError` for a material that the transport does not know.
        """
        described = [_described(material) for material in materials]
        values = np.zeros((len(described), max([NARROWEST_ROW, *(len(row) for _, row in described)])))
        for place, (_, row) in zip(values, described, strict=True):
            place[: len(row)] = row
        kind = np.array([kind for kind, _ in described], np.int64)
        return cls(kind if kind.any() else kind.astype(np.uint8), values)

    @property
    def arrays(self) -> Materials:
        """The table for compiled loops."""
        return Materials(self.kind, self.values)


def _described(material: Material) -> tuple[int, tuple[float, ...]]:
    """Kind and row of a material; the docstring of each model's file gives the order of its row."""
    match material:
        case Lambertian() | Phong(exponent=0):
            return LAMBERTIAN, (material.albedo,)
        case SinLobe():
            return SIN_LOBE, (material.albedo, *material.axis)
        case Phong():
            return PHONG, (material.albedo, material.exponent, material.specular)
        case OrenNayar():
            return OREN_NAYAR, (material.albedo, oren_nayar.roughness(material.sigma_rad))
        case GGX():
            alpha = float(material.roughness) ** 2
            return GGX_LOBE, (material.albedo, alpha, material.f0, *ggx.white_table(alpha))
        case Retroreflector():
            kappa = retroreflector.concentration(material.half_width_rad)
            return RETROREFLECTOR, (material.albedo, kappa, material.retro)
    known = "Lambertian, SinLobe, Phong, OrenNayar, GGX, Retroreflector"
    raise InputError(f"material {type(material).__name__}: the transport knows {known}")
