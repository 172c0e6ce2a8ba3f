"""The speed of light, and what follows from it: path length ↔ time."""

from __future__ import annotations

from typing import overload

import numpy as np
from numpy.typing import NDArray

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0
"""Vacuum speed of light, exact by the definition of the metre."""


@overload
def time_from_path(path_m: float) -> float: ...
@overload
def time_from_path(path_m: NDArray[np.float64]) -> NDArray[np.float64]: ...
def time_from_path(path_m: float | NDArray[np.float64]) -> float | NDArray[np.float64]:
    """Seconds that light takes for `path_m` metres."""
    return path_m / SPEED_OF_LIGHT_M_PER_S


@overload
def path_from_time(time_s: float) -> float: ...
@overload
def path_from_time(time_s: NDArray[np.float64]) -> NDArray[np.float64]: ...
def path_from_time(time_s: float | NDArray[np.float64]) -> float | NDArray[np.float64]:
    """Metres that light covers in `time_s` seconds."""
    return time_s * SPEED_OF_LIGHT_M_PER_S
