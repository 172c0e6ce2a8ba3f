"""Short names for types of arrays, whose shapes are in the docstrings of those who use them; and the L2 norm."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


def l2_norm(values: Floats) -> float:
    """√Σv² over an array of any shape. `numpy.linalg.norm` calls a BLAS, whose threads spin idly for milliseconds
    after a large array: for a scan that took as much processor time as its light."""
    flat = values.reshape(-1)
    return math.sqrt(np.einsum("i,i", flat, flat))
