"""The light of an unoccluded plate on a confocal scan, by quadrature, bin by bin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def plate_by_quadrature(
    points: Floats, center: Floats, right: Floats, up: Floats, n: int, bins: int, start_m: float, width_m: float
) -> Floats:
    """(P, bins) ∫ cos²θ cos²θ′ / r⁴ dA by path length, from n × n points of a plate, for confocal points on x = 0."""
    u, v = (side.ravel() for side in np.meshgrid(*2 * [(np.arange(n) + 0.5) / n * 2 - 1]))
    plate = center + u[:, None] * right + v[:, None] * up
    normal = np.cross(right, up)
    area = 4 * np.linalg.norm(normal) / n**2
    rows = [
        _from_one_point(plate - point, normal / np.linalg.norm(normal), bins, start_m, width_m) for point in points
    ]
    return area * np.array(rows)


def _from_one_point(d: Floats, normal: Floats, bins: int, start_m: float, width_m: float) -> Floats:
    square = (d * d).sum(axis=1)
    position = ((2 * np.sqrt(square) - start_m) / width_m).astype(int)
    return np.bincount(position, (d[:, 0] * (d @ normal)) ** 2 / square**4, bins)
