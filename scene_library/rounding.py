"""Arithmetic that rounds alike on every x86-64, so that a seed gives the same room to the last bit.

Sines of doubles, in numpy and in the C library, and the matrix products of BLAS are chosen by what the processor can
do, and differ in the last bit. Sums of products in a fixed order do not, nor do the functions of long doubles, whose
64 bits of mantissa are then rounded to 53.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def cos(angle_rad: ArrayLike) -> Floats:
    """Cosine, of the shape of the angles."""
    return np.cos(np.asarray(angle_rad, np.longdouble)).astype(np.float64)


def sin(angle_rad: ArrayLike) -> Floats:
    """Sine, of the shape of the angles."""
    return np.sin(np.asarray(angle_rad, np.longdouble)).astype(np.float64)


def arctan2(y: ArrayLike, x: ArrayLike) -> Floats:
    """Angle of (x, y), −π … π, of their shape."""
    return np.arctan2(np.asarray(y, np.longdouble), np.asarray(x, np.longdouble)).astype(np.float64)


def length(vectors: ArrayLike) -> Floats:
    """(…) Euclidean lengths of (…, n) vectors."""
    v = np.asarray(vectors, np.float64)
    return np.asarray(np.sqrt((v * v).sum(axis=-1)))


def product(rows: NDArray[np.float64], matrix: ArrayLike) -> Floats:
    """(…, m): rows (…, k) times a matrix (k, m), or (…) times a vector (k,), the terms added up in their order."""
    by = np.asarray(matrix, np.float64)
    terms = [rows[..., k] * by[k] if by.ndim == 1 else rows[..., k, None] * by[k] for k in range(len(by))]
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return np.asarray(total)
