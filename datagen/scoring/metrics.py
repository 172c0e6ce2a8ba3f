"""The metrics of one scene, as functions of arrays."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from datagen.records.arrays import Bools, Floats

WINDOW, REACH = 1.5, 5
"""Standard deviation of the window of SSIM, and pixels from its middle to its end (11 × 11 in all), as published."""
K1, K2 = 0.01, 0.03
"""Constants that keep SSIM's quotients finite, as published."""


def intersection_over_union(found: Bools, true: Bools) -> float:
    """|A ∩ B| / |A ∪ B| of two sets of pixels or voxels; NaN if both are empty."""
    union = np.count_nonzero(found | true)
    return np.count_nonzero(found & true) / union if union else float("nan")


def ssim(found: Floats, true: Floats) -> float:
    """Mean structural similarity of two images (row, column) with values in 0 … 1.

    SSIM = (2 μx μy + c1)(2 σxy + c2) / ((μx² + μy² + c1)(σx² + σy² + c2)), c1 = 0.01², c2 = 0.03²,
    under a Gaussian window of 11 × 11 pixels (σ = 1.5), mirrored at the border; its mean over all pixels.
    Wang, Bovik, Sheikh, Simoncelli, IEEE Trans. Image Processing 13(4), 600 (2004), Eq. 13.
    """
    c1, c2 = K1**2, K2**2

    def mean(image: Floats) -> Floats:
        blurred: Floats = gaussian_filter(image, WINDOW, mode="reflect", radius=REACH)
        return blurred

    x, y = np.asarray(found, np.float64), np.asarray(true, np.float64)
    mx, my = mean(x), mean(y)
    vx, vy, vxy = mean(x * x) - mx**2, mean(y * y) - my**2, mean(x * y) - mx * my
    map_ = (2 * mx * my + c1) * (2 * vxy + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))
    return float(map_.mean())


def chamfer_distance(found: Floats, true: Floats) -> float:
    """Half the sum of two means: the distance from each found point to the nearest true one, and from each true point
    to the nearest found one, metres.

    Distances are not squared. Both point clouds, (N, 3) and (M, 3), must have a point.
    """
    there, _ = cKDTree(true).query(found)
    back, _ = cKDTree(found).query(true)
    return float((there.mean() + back.mean()) / 2)


def center_distances(found: Floats, true: Floats, missed_m: float) -> Floats:
    """(M,) distance of each true centre from the found centre that it is matched with, metres.

    The centres (N, 3) and (M, 3) are matched one to one so that the sum of the distances is least (the Hungarian
    method). A true centre without a match gets the distance `missed_m`.
    """
    distances = np.full(len(true), missed_m)
    apart = np.linalg.norm(true[:, None] - found[None], axis=-1)
    rows, columns = linear_sum_assignment(apart)
    distances[rows] = apart[rows, columns]
    return distances


def quantile(values: Floats, share: float) -> float:
    """A quantile of some values; NaN if there are none."""
    return float(np.quantile(values, share)) if values.size else float("nan")
