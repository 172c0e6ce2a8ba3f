"""Every kind of BRDF, one row each, and the materials of a scene as plain numbers for compiled loops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.records.arrays import Floats, Ints
from datagen.records.materials import (
    GGX,
    Lambertian,
    Material,
    MeasuredByAngle,
    OrenNayar,
    Phong,
    Retroreflector,
    SinLobe,
)
from datagen.transport.brdf import ggx, lambertian, measured_by_angle, oren_nayar, phong, retroreflector, sin_lobe


@dataclass(frozen=True)
class Model:
    """A kind of BRDF: what is asked of it outside of compiled loops, each by a function of its file.

    Attributes
    ----------
    record : class of its materials.
    row : the numbers of a material that follow the albedo in its row; None if that material is Lambertian.
    share : directional albedo of a material of albedo 1, for arrays of the cosine of incidence and the azimuth, rad.
    lobe_width_rad : half width of a material's narrowest lobe; infinite for none.
    """

    record: type[Material]
    row: Callable[[Any], tuple[float, ...] | None]
    share: Callable[[Any, Floats, Floats], Floats]
    lobe_width_rad: Callable[[Any], float]


# The number of a kind is its place in MODELS. A new kind goes to the end; `models.py` calls its compiled functions.
LAMBERTIAN, SIN_LOBE, PHONG, OREN_NAYAR, GGX_LOBE, RETROREFLECTOR, MEASURED_BY_ANGLE = range(7)
MODELS = (
    Model(Lambertian, lambertian.row, lambertian.share, lambertian.lobe_width_rad),
    Model(SinLobe, sin_lobe.row, sin_lobe.share, sin_lobe.lobe_width_rad),
    Model(Phong, phong.row, phong.share, phong.lobe_width_rad),
    Model(OrenNayar, oren_nayar.row, oren_nayar.share, oren_nayar.lobe_width_rad),
    Model(GGX, ggx.row, ggx.share, ggx.lobe_width_rad),
    Model(Retroreflector, retroreflector.row, retroreflector.share, retroreflector.lobe_width_rad),
    Model(MeasuredByAngle, measured_by_angle.row, measured_by_angle.share, measured_by_angle.lobe_width_rad),
)

NARROWEST_ROW = 4
"""Least number of columns of a table, enough for most models, so that kernels seldom meet another width."""


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
        described = [_kind_and_row(material) for material in materials]
        values = np.zeros((len(described), max([NARROWEST_ROW, *(len(row) for _, row in described)])))
        for place, (_, row) in zip(values, described, strict=True):
            place[: len(row)] = row
        kind = np.array([kind for kind, _ in described], np.int64)
        return cls(kind if kind.any() else kind.astype(np.uint8), values)


def model_of(material: Material) -> Model:
    """The kind of a material. Raises `InputError` for a material that the transport does not know."""
    return MODELS[_kind_of(material)]


def lobe_width(material: Material) -> float:
    """Half width of a BRDF's narrowest lobe, rad, at most 1."""
    return min(model_of(material).lobe_width_rad(material), 1.0)


def _kind_of(material: Material) -> int:
    for kind, model in enumerate(MODELS):
        if isinstance(material, model.record):
            return kind
    known = ", ".join(model.record.__name__ for model in MODELS)
    raise InputError(f"material {type(material).__name__}: the transport knows {known}")


def _kind_and_row(material: Material) -> tuple[int, tuple[float, ...]]:
    """Kind and row of a material; the docstring of each model's file gives the order of its row."""
    kind = _kind_of(material)
    numbers = MODELS[kind].row(material)
    return (LAMBERTIAN, (material.albedo,)) if numbers is None else (kind, (material.albedo, *numbers))
