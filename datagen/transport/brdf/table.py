"""Every kind of BRDF, one row each, and the materials of a scene as plain numbers for compiled loops."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

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


class Physics(Protocol):
    """The file of a kind of BRDF: what is asked of it outside of compiled loops.

    Every kind but Lambert's law also has `evaluate`, `at_most`, `pdf`, `sample` and `widen` for compiled loops, which
    `models.py` finds by their names: what they return is told there, and their arguments are the same for all kinds.
    """

    def row(self, material: Any, /) -> tuple[float, ...] | None:
        """The numbers of a material that follow the albedo in its row; None if that material is Lambertian."""

    def share(self, material: Any, cosine: Floats, azimuth_rad: Floats, /) -> Floats:
        """Directional albedo of a material of albedo 1, for arrays of the cosine of incidence and the azimuth."""

    def lobe_width_rad(self, material: Any, /) -> float:
        """Half width of a material's narrowest lobe; infinite for none."""


class Model(NamedTuple):
    """A kind of BRDF: the class of its materials, and the file of its physics."""

    record: type[Material]
    physics: Physics


# The number of a kind is its place in MODELS. A new kind goes to the end.
LAMBERTIAN = 0
MODELS = (
    Model(Lambertian, lambertian),
    Model(SinLobe, sin_lobe),
    Model(Phong, phong),
    Model(OrenNayar, oren_nayar),
    Model(GGX, ggx),
    Model(Retroreflector, retroreflector),
    Model(MeasuredByAngle, measured_by_angle),
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


def model_of(material: Material) -> Physics:
    """The physics of a material's kind. Raises `InputError` for a material that the transport does not know."""
    return MODELS[_kind_of(material)].physics


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
    numbers = MODELS[kind].physics.row(material)
    return (LAMBERTIAN, (material.albedo,)) if numbers is None else (kind, (material.albedo, *numbers))
