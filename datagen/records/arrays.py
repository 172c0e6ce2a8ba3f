"""Short names for the arrays that signatures speak of, whose shapes stand in the docstrings; and their norm."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def l2_norm(values: Floats) -> float:
    """√Σv² over an array of any shape. `numpy.linalg.norm` has a BLAS do this, whose threads, once woken for a large
    array, turn idly for milliseconds: of a scan that took as much processor time as its light."""
    flat = values.reshape(-1)
    return math.sqrt(np.einsum("i,i", flat, flat))
