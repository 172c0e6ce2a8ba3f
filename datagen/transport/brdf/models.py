"""Which model answers: evaluate, pdf and sample by the kind of a material. Lambert's law comes first and alone.

Loops in which a call to another model merely stands, never made, run at half the speed and take longer to compile. So
the type of `kind` tells the compiler what it may meet: `MaterialTable` gives a scene of Lambertian parts 8-bit kinds,
and its loops are compiled without the other models.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit, types
from numba.extending import overload
from numpy.typing import NDArray

from datagen.transport.brdf import ggx, oren_nayar, phong, retroreflector, sin_lobe
from datagen.transport.brdf.directions import Vector, dot, sample_cosine
from datagen.transport.brdf.table import GGX_LOBE, LAMBERTIAN, OREN_NAYAR, PHONG, SIN_LOBE


@njit(cache=True, inline="always")
def evaluate(kind: int, values: NDArray[np.float64], n: Vector, w_in: Vector, w_out: Vector) -> float:
    """BRDF in 1/sr for light that comes from `w_in` and leaves along `w_out`; 0 where either is below the surface."""
    cos_in, cos_out = dot(n, w_in), dot(n, w_out)
    if cos_in <= 0.0 or cos_out <= 0.0:
        return 0.0
    if kind == LAMBERTIAN:
        return float(values[0] / math.pi)
    return _other_brdf(kind, values, n, w_in, w_out, cos_in, cos_out)


@njit(cache=True, inline="always")
def pdf(kind: int, values: NDArray[np.float64], n: Vector, w_in: Vector, w_out: Vector) -> float:
    """Density per solid angle with which `sample` draws `w_out` given `w_in`, 1/sr; 0 below the surface.

    The integral over the hemisphere is less than 1 by the share of draws that `sample` loses below the surface.
    """
    cos_out = dot(n, w_out)
    if cos_out <= 0.0:
        return 0.0
    if kind == LAMBERTIAN:
        return cos_out / math.pi
    return _other_pdf(kind, values, n, w_in, w_out, dot(n, w_in), cos_out)


@njit(cache=True)
def sample(kind: int, values: NDArray[np.float64], n: Vector, w_in: Vector, u: float, v: float) -> Vector:
    """Draw `w_out` with density `pdf` from a point (u, v) of the unit square; it may lie below the surface, where
    `evaluate` is 0."""
    if kind == LAMBERTIAN:
        return sample_cosine(n, u, v)
    return _other_sample(kind, values, n, w_in, dot(n, w_in), u, v)


@njit(cache=True)
def _evaluate_other(
    kind: int, values: NDArray[np.float64], n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float
) -> float:
    if kind == SIN_LOBE:
        return sin_lobe.evaluate(values, n, w_in, w_out)
    if kind == PHONG:
        return phong.evaluate(values, w_in, w_out, cos_in, cos_out)
    if kind == OREN_NAYAR:
        return oren_nayar.evaluate(values, w_in, w_out, cos_in, cos_out)
    if kind == GGX_LOBE:
        return ggx.evaluate(values, w_in, w_out, cos_in, cos_out)
    return retroreflector.evaluate(values, w_in, w_out, cos_in, cos_out)


@njit(cache=True)
def _pdf_other(
    kind: int, values: NDArray[np.float64], n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float
) -> float:
    # Light edge-on by rounding: nothing is reflected, and `sample` answers likewise.
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
    return retroreflector.pdf(values, w_in, w_out, cos_out)


@njit(cache=True)
def _sample_other(
    kind: int, values: NDArray[np.float64], n: Vector, w_in: Vector, cos_in: float, u: float, v: float
) -> Vector:
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
    return retroreflector.sample(values, n, w_in, u, v)


def _other_brdf(
    kind: int, values: NDArray[np.float64], n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float
) -> float:
    """`_evaluate_other`, or 0 where `kind` is of the type that says there is no other model."""
    raise NotImplementedError("compiled code only")


def _other_pdf(
    kind: int, values: NDArray[np.float64], n: Vector, w_in: Vector, w_out: Vector, cos_in: float, cos_out: float
) -> float:
    raise NotImplementedError("compiled code only")


def _other_sample(
    kind: int, values: NDArray[np.float64], n: Vector, w_in: Vector, cos_in: float, u: float, v: float
) -> Vector:
    raise NotImplementedError("compiled code only")


def _is_lambertian_type(kind: Any) -> bool:
    return bool(kind == types.uint8)


@overload(_other_brdf, strict=False)
def _choose_brdf(
    kind: Any, values: Any, n: Any, w_in: Any, w_out: Any, cos_in: Any, cos_out: Any
) -> Callable[..., Any]:
    if _is_lambertian_type(kind):
        return lambda kind, values, n, w_in, w_out, cos_in, cos_out: 0.0
    return lambda kind, values, n, w_in, w_out, cos_in, cos_out: _evaluate_other(
        kind, values, n, w_in, w_out, cos_in, cos_out
    )


@overload(_other_pdf, strict=False)
def _choose_pdf(
    kind: Any, values: Any, n: Any, w_in: Any, w_out: Any, cos_in: Any, cos_out: Any
) -> Callable[..., Any]:
    if _is_lambertian_type(kind):
        return lambda kind, values, n, w_in, w_out, cos_in, cos_out: 0.0
    return lambda kind, values, n, w_in, w_out, cos_in, cos_out: _pdf_other(
        kind, values, n, w_in, w_out, cos_in, cos_out
    )


@overload(_other_sample, strict=False)
def _choose_sample(kind: Any, values: Any, n: Any, w_in: Any, cos_in: Any, u: Any, v: Any) -> Callable[..., Any]:
    if _is_lambertian_type(kind):
        return lambda kind, values, n, w_in, cos_in, u, v: n
    return lambda kind, values, n, w_in, cos_in, u, v: _sample_other(kind, values, n, w_in, cos_in, u, v)
