"""The speed of light, and the conversion between path length and time."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

SPEED_OF_LIGHT_M_PER_S = 299_792_458.0
"""Vacuum speed of light, exact by the definition of the metre."""
Quantity = TypeVar("Quantity", float, NDArray[np.float64])


def time_from_path(path_m: Quantity) -> Quantity:
    """Seconds that light takes for `path_m` metres."""
    return path_m / SPEED_OF_LIGHT_M_PER_S


def path_from_time(time_s: Quantity) -> Quantity:
    """Metres that light covers in `time_s` seconds."""
    return time_s * SPEED_OF_LIGHT_M_PER_S
