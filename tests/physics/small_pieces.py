"""A triangle as many small pieces, each of which has one value of what is linear between its corners."""

from __future__ import annotations

import numpy as np


def small_pieces(corners: tuple[float, ...], n: int) -> np.ndarray:
    """(n²,) values in the middles of n² equal pieces of a triangle, of a quantity that is linear between the three
    `corners`."""
    i, j = (k.ravel() for k in np.indices((n, n)))
    upright, turned = i + j < n, i + j < n - 1
    u = np.concatenate([i[upright] + 1 / 3, i[turned] + 2 / 3]) / n
    v = np.concatenate([j[upright] + 1 / 3, j[turned] + 2 / 3]) / n
    return np.asarray(corners[0] * (1 - u - v) + corners[1] * u + corners[2] * v)
