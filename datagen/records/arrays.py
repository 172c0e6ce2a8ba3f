"""Short names for types of arrays, whose shapes are in the docstrings of those who use them; the L2 norm; and rows of
records of arrays."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

R = TypeVar("R", bound=tuple)  # type: ignore[type-arg]


def l2_norm(values: Floats) -> float:
    """√Σv² over an array of any shape. `numpy.linalg.norm` calls a BLAS, whose threads spin idly for milliseconds
    after a large array: for a scan that took as much processor time as its light."""
    flat = values.reshape(-1)
    return math.sqrt(np.einsum("i,i", flat, flat))


def rows_of(record: R, which: Ints | Bools) -> R:
    """Some rows of a named tuple of arrays, by index, or those for which `which` (n,) is true."""
    rows = np.flatnonzero(which) if which.dtype == np.bool_ else which
    return type(record)(*(values.take(rows, axis=0) for values in record))


def joined_rows(*records: R) -> R:
    """The rows of named tuples of arrays, one after the other."""
    return type(records[0])(*(np.concatenate(arrays) for arrays in zip(*records, strict=True)))
