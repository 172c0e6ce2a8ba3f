"""evaluate, evaluate_at_most, pdf, sample and widen of any material, by its kind. Unknown kinds raise `ValueError`.

A loop that contains a call to a model other than Lambert's law runs at half the speed, even if it never makes the
call, and takes longer to compile. So the type of `kind` tells the compiler which models can occur: `MaterialTable`
uses 8-bit kinds for a scene of Lambertian parts alone, whose loops are compiled without the other models.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

from numba import types
from numba.extending import overload

from datagen.compiled import compiled
from datagen.records.arrays import Floats
from datagen.transport.brdf import ggx, measured_by_angle, oren_nayar, phong, retroreflector, sin_lobe
from datagen.transport.brdf.directions import Vector, dot, sample_cosine
from datagen.transport.brdf.table import (
    GGX_LOBE,
    LAMBERTIAN,
    MEASURED_BY_ANGLE,
    OREN_NAYAR,
    PHONG,
    RETROREFLECTOR,
    SIN_LOBE,
)

P = ParamSpec("P")
R = TypeVar("R")

UNKNOWN = "a kind of BRDF that models.py does not call"


@compiled(inline="always")
def evaluate(kind: int, values: Floats, n: Vector, w_in: Vector, w_out: Vector) -> float:
    """BRDF, 1/sr, for light that comes from `w_in` and leaves along `w_out`; 0 where either is below the surface."""
    # Surfaces do not transmit. Here, once for all models, which may then divide by both cosines.
    cos_in, cos_out = dot(n, w_in), dot(n, w_out)
    if cos_in <= 0.0 or cos_out <= 0.0:
        return 0.0
    # Lambert's law needs no call, which matters in the innermost loops of most scenes.
    if kind == LAMBERTIAN:
        return float(values[0] / math.pi)
    return _other_brdf(kind, values, n, w_in, w_out, cos_in, cos_out)


@compiled(inline="always")
def evaluate_at_most(
    kind: int, values: Floats, n: Vector, w_in: Vector, w_out: Vector, turn: float, tilt: float
) -> float:
    """The largest BRDF, 1/sr, that a piece of surface may have, even if its lobe lies between the directions tried.

    turn : sum of the angles by which the directions of incidence and exitance deviate from `w_in` and `w_out` over
        the piece, rad. tilt : angle by which its normals deviate from `n`, rad.

    For the lobes of Phong, retroreflectors and GGX facets it is a bound, except that their cosine factors, which vary
    slowly, are taken at `w_in` and `w_out`. For a rough matt surface, which has no lobe, it is `evaluate`. It is 0
    where either direction is below the surface.
    """
    # Lambert's law has no lobe that could be missed.
    if kind == LAMBERTIAN:
        return evaluate(kind, values, n, w_in, w_out)
    return _other_at_most(kind, values, n, w_in, w_out, turn, tilt)


@compiled(inline="always")
def pdf(kind: int, values: Floats, n: Vector, w_in: Vector, w_out: Vector) -> float:
    """Density per solid angle with which `sample` draws `w_out` given `w_in`, 1/sr; 0 below the surface.

    The integral over the hemisphere is less than 1 by the share of draws that `sample` loses below the surface.
    """
    # Such draws carry no light, so their density is never needed.
    cos_out = dot(n, w_out)
    if cos_out <= 0.0:
        return 0.0
    if kind == LAMBERTIAN:
        return cos_out / math.pi
    return _other_pdf(kind, values, n, w_in, w_out, dot(n, w_in), cos_out)


@compiled()
def sample(kind: int, values: Floats, n: Vector, w_in: Vector, u: float, v: float) -> Vector:
    """A unit direction `w_out` drawn with density `pdf` from a point (u, v) of the unit square.

    It may lie below the surface, where `evaluate` is 0.
    """
    if kind == LAMBERTIAN:
        return sample_cosine(n, u, v)
    return _other_sample(kind, values, n, w_in, dot(n, w_in), u, v)


@compiled()
def widen(kind: int, values: Floats, span: float) -> None:
    """Widen the lobe of a material, in its row, to directions that vary by the angle `span`, rad, as a lobe may miss
    the middle of a piece of surface and still be bright elsewhere on it. What has no lobe stays as it is."""
    if kind != LAMBERTIAN:
        _other_widened(kind, values, span)


@compiled()
def _evaluate_other(
    kind: int, values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float
) -> float:
    if kind == SIN_LOBE:
        return sin_lobe.evaluate(values, n, w_in, w_out)
    if kind == PHONG:
        return phong.evaluate(values, w_in, w_out, cos_in, cos_out)
    if kind == OREN_NAYAR:
        return oren_nayar.evaluate(values, w_in, w_out, cos_in, cos_out)
    if kind == GGX_LOBE:
        return ggx.evaluate(values, w_in, w_out, cos_in, cos_out)
    if kind == RETROREFLECTOR:
        return retroreflector.evaluate(values, w_in, w_out, cos_in, cos_out)
    if kind == MEASURED_BY_ANGLE:
        return measured_by_angle.evaluate(values, cos_in, cos_out)
    raise ValueError(UNKNOWN)


@compiled()
def _other_evaluated_at_most(
    kind: int, values: Floats, n: Vector, w_in: Vector, w_out: Vector, turn: float, tilt: float
) -> float:
    cos_in, cos_out = dot(n, w_in), dot(n, w_out)
    if cos_in <= 0.0 or cos_out <= 0.0:
        return 0.0
    if kind == SIN_LOBE:
        return sin_lobe.at_most(values, n, w_in, w_out, turn, tilt)
    if kind == PHONG:
        return phong.at_most(values, w_in, w_out, cos_in, cos_out, turn, tilt)
    if kind == OREN_NAYAR:
        return oren_nayar.at_most(values, w_in, w_out, cos_in, cos_out)
    if kind == GGX_LOBE:
        return ggx.at_most(values, w_in, w_out, cos_in, cos_out, turn, tilt)
    if kind == RETROREFLECTOR:
        return retroreflector.at_most(values, w_in, w_out, cos_in, cos_out, turn)
    if kind == MEASURED_BY_ANGLE:
        return measured_by_angle.at_most(values, cos_in, cos_out)
    raise ValueError(UNKNOWN)


@compiled()
def _pdf_other(
    kind: int, values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float
) -> float:
    # Rounding may put the light below the surface, for which the models have no density: `evaluate` is then 0, and
    # `_sample_other` draws by the cosine, too.
    if cos_in <= 0.0:
        return cos_out / math.pi
    if kind == SIN_LOBE:
        return sin_lobe.pdf(values, n, cos_out, w_out)
    if kind == PHONG:
        return phong.pdf(values, w_in, w_out, cos_in, cos_out)
    if kind == OREN_NAYAR:
        return oren_nayar.pdf(values, cos_in, cos_out)
    if kind == GGX_LOBE:
        return ggx.pdf(values, w_in, w_out, cos_in, cos_out)
    if kind == RETROREFLECTOR:
        return retroreflector.pdf(values, w_in, w_out, cos_out)
    if kind == MEASURED_BY_ANGLE:
        return measured_by_angle.pdf(values, cos_out)
    raise ValueError(UNKNOWN)


@compiled()
def _sample_other(kind: int, values: Floats, n: Vector, w_in: Vector, cos_in: float, u: float, v: float) -> Vector:
    if cos_in <= 0.0:
        return sample_cosine(n, u, v)
    if kind == SIN_LOBE:
        return sin_lobe.sample(values, n, u, v)
    if kind == PHONG:
        return phong.sample(values, n, w_in, u, v)
    if kind == OREN_NAYAR:
        return oren_nayar.sample(values, n, cos_in, u, v)
    if kind == GGX_LOBE:
        return ggx.sample(values, n, w_in, cos_in, u, v)
    if kind == RETROREFLECTOR:
        return retroreflector.sample(values, n, w_in, u, v)
    if kind == MEASURED_BY_ANGLE:
        return measured_by_angle.sample(values, n, u, v)
    raise ValueError(UNKNOWN)


@compiled()
def _widen_other(kind: int, values: Floats, span: float) -> None:
    if kind == SIN_LOBE:
        sin_lobe.widen(values, span)
    elif kind == PHONG:
        phong.widen(values, span)
    elif kind == OREN_NAYAR:
        oren_nayar.widen(values, span)
    elif kind == GGX_LOBE:
        ggx.widen(values, span)
    elif kind == RETROREFLECTOR:
        retroreflector.widen(values, span)
    elif kind == MEASURED_BY_ANGLE:
        measured_by_angle.widen(values, span)
    else:
        raise ValueError(UNKNOWN)


def _unless_lambertian(answer: Callable[P, R], otherwise: Callable[..., R]) -> Callable[P, R]:
    """A function for compiled code: `answer`, or `otherwise` if the type of `kind` is that of a Lambertian scene."""

    def chosen(*arguments: P.args, **_: P.kwargs) -> R:
        raise NotImplementedError("compiled code only")

    @overload(chosen, strict=False)
    def choose(kind: Any, *arguments: Any) -> Callable[..., Any]:
        return otherwise if kind == types.uint8 else lambda kind, *arguments: answer(kind, *arguments)  # type: ignore[call-arg]

    return chosen


_other_brdf = _unless_lambertian(_evaluate_other, lambda kind, *arguments: 0.0)
_other_at_most = _unless_lambertian(_other_evaluated_at_most, lambda kind, *arguments: 0.0)
_other_pdf = _unless_lambertian(_pdf_other, lambda kind, *arguments: 0.0)
_other_sample = _unless_lambertian(_sample_other, lambda kind, values, n, *arguments: n)
_other_widened = _unless_lambertian(_widen_other, lambda kind, *arguments: None)
