"""Backprojection's sum, compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from datagen.compiled import compiled
from datagen.records.arrays import Ints

Singles = NDArray[np.float32]
BLOCK = 1024
"""Places whose distances to all laser points and pixels are kept at a time."""


@compiled(nogil=True)
def lay_out(
    signal: Singles, laser_points: Singles, pixels: Singles, laser: Ints, pixel: Ints, first: Singles,
    places: Singles, total: Singles,
) -> None:  # fmt: skip
    """Add to total (V,) Σ_r signal[r, ⌊|x − x_l| + |x − x_p| − first[r]⌋ + 1] for every place x (3, V).

    As in `Scan`, lengths in bins, points (3, L) and (3, P). The first and the last column of signal are zeros,
    for what lies before and after all bins.
    """
    last, same = np.float32(signal.shape[1] - 1), np.array_equal(laser_points, pixels)
    to_laser = np.empty((laser_points.shape[1], BLOCK), np.float32)
    to_pixel = to_laser if same else np.empty((pixels.shape[1], BLOCK), np.float32)
    for begin in range(0, len(total), BLOCK):
        x, y, z = places[0][begin : begin + BLOCK], places[1][begin : begin + BLOCK], places[2][begin : begin + BLOCK]
        _distances(laser_points, x, y, z, to_laser)
        if not same:
            _distances(pixels, x, y, z, to_pixel)
        out = total[begin : begin + BLOCK]
        for r in range(len(signal)):
            there, back, row = to_laser[laser[r]], to_pixel[pixel[r]], signal[r]
            offset = np.float32(1) - first[r]
            for k in range(len(out)):
                at = there[k] + back[k] + offset
                # Whatever else it is, huge or no number at all, is outside.
                out[k] += row[np.int32(at)] if at > 0 and at < last else row[0]


@compiled(nogil=True)
def _distances(points: Singles, x: Singles, y: Singles, z: Singles, out: Singles) -> None:
    for i in range(points.shape[1]):
        u, v, w = points[0, i], points[1, i], points[2, i]
        row = out[i]
        for k in range(len(x)):
            row[k] = np.sqrt((x[k] - u) ** 2 + (y[k] - v) ** 2 + (z[k] - w) ** 2)
