"""The standard error of a mean over independent scramblings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def standard_error(
    means: Sequence[NDArray[np.float64]], squares: NDArray[np.float64], scramblings: int
) -> NDArray[np.float64]:
    """Standard error of the sum of `means` from the scramblings' sum of squares, which it overwrites.

    Laser point by laser point, so that no further array of a scan's full size is needed.
    """
    if scramblings == 1:
        squares.fill(np.nan)
        return squares
    for laser, row in enumerate(squares):
        mean = sum(component[laser] for component in means)
        np.sqrt(np.maximum(row / scramblings - mean**2, 0.0) / (scramblings - 1), out=row)
    return squares
