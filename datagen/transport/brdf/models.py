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
from datagen.transport.brdf.directions import Vector, dot, sample_cosine
from datagen.transport.brdf.table import LAMBERTIAN, MODELS

P = ParamSpec("P")
R = TypeVar("R")

UNKNOWN = "a kind of BRDF that the table of models does not have"


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


def _or(kind: int, own: Callable[..., R], others: Callable[..., R]) -> Callable[..., R]:
    """A function for compiled code: `own` for the kind of that number, `others` for every other kind."""

    @compiled(forceinline=True)
    def of_kind(asked: int, *arguments: Any) -> R:
        return own(*arguments) if asked == kind else others(asked, *arguments)

    return of_kind


def _or_error(kind: int, own: Callable[..., R]) -> Callable[..., R]:
    """A function for compiled code: `own` for the kind of that number, and an error for every other kind."""

    @compiled(forceinline=True)
    def of_kind(asked: int, *arguments: Any) -> R:
        if asked == kind:
            return own(*arguments)
        raise ValueError(UNKNOWN)

    return of_kind


def _by_kind(name: str) -> Callable[..., Any]:
    """A function for compiled code that has the kind as its first argument, which is not Lambert's law: the function
    of that name in the file of the kind, for the other arguments."""
    (last, own), *others = [
        (kind, getattr(model.physics, name)) for kind, model in reversed([*enumerate(MODELS)]) if kind != LAMBERTIAN
    ]
    function = _or_error(last, own)
    for kind, own in others:
        function = _or(kind, own, function)
    return function


_evaluate: Callable[..., float] = _by_kind("evaluate")
_at_most: Callable[..., float] = _by_kind("at_most")
_pdf: Callable[..., float] = _by_kind("pdf")
_sample: Callable[..., Vector] = _by_kind("sample")
_widen: Callable[..., None] = _by_kind("widen")


@compiled()
def _evaluate_other(
    kind: int, values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float
) -> float:
    return _evaluate(kind, values, n, w_in, w_out, cos_in, cos_out)


@compiled()
def _other_evaluated_at_most(
    kind: int, values: Floats, n: Vector, w_in: Vector, w_out: Vector, turn: float, tilt: float
) -> float:
    cos_in, cos_out = dot(n, w_in), dot(n, w_out)
    if cos_in <= 0.0 or cos_out <= 0.0:
        return 0.0
    return _at_most(kind, values, n, w_in, w_out, cos_in, cos_out, turn, tilt)


@compiled()
def _pdf_other(
    kind: int, values: Floats, n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float
) -> float:
    # Rounding may put the light below the surface, for which the models have no density: `evaluate` is then 0, and
    # `_sample_other` draws by the cosine, too.
    if cos_in <= 0.0:
        return cos_out / math.pi
    return _pdf(kind, values, n, w_in, w_out, cos_in, cos_out)


@compiled()
def _sample_other(kind: int, values: Floats, n: Vector, w_in: Vector, cos_in: float, u: float, v: float) -> Vector:
    if cos_in <= 0.0:
        return sample_cosine(n, u, v)
    return _sample(kind, values, n, w_in, cos_in, u, v)


@compiled()
def _widen_other(kind: int, values: Floats, span: float) -> None:
    _widen(kind, values, span)


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
