"""Filtered backprojection: each count is laid out over all places that it may have come from.

A histogram says when light came back, so where from: for laser point l and pixel p an ellipsoid with both as foci (a
sphere, where they are one). The sum over the scan of the counts n at the arrival time of every place x,

    B(x) = Σ_lp n_lp((|x − x_l| + |x − x_p|) / c),

is filtered by the Laplacian of a Gaussian, which leaves what is as thin as a surface (Velten et al., Nature
Communications 3, 745 (2012)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_laplace
from scipy.spatial.distance import cdist

from datagen.baselines.grid import HiddenGrid, label_frame
from datagen.records.arrays import Floats, Ints
from datagen.store.scenes import SceneContent
from datagen.units import time_from_path

LASERS_OF_A_FLOOD = 16
"""Points that stand for all of a flood's, which are lit at once."""


@dataclass(frozen=True)
class Scan:
    """What backprojection needs of a measurement.

    Attributes
    ----------
    signal : (pair, bin); row r is pixel `pixel[r]` under laser point `laser[r]`.
    laser_points, pixels : (L, 3) and (P, 3) on the relay wall, label frame, metres.
    laser, pixel : (pair,) indices.
    first : (pair,) start of the first bin after the light left the laser point for the hidden part, in bins.
    bin_m : path of one bin, metres.
    """

    signal: Floats
    laser_points: Floats
    pixels: Floats
    laser: Ints
    pixel: Ints
    first: Floats
    bin_m: float


def scan_of(scene: SceneContent) -> Scan:
    """A stored scene's scan: confocal, exhaustive or flooded."""
    arrays, capture = scene.arrays, scene.manifest.config["capture"]
    to_frame = label_frame(arrays["hidden_view"])
    lasers, pixels = to_frame(arrays["laser_points"]), to_frame(arrays["sensor_pixels"].mean(axis=1))
    laser_at, sensor_at = to_frame(arrays["laser_position"]), to_frame(arrays["sensor_position"])
    counts = arrays["histogram"].astype(np.float64)
    if capture["pairing"] == "confocal":
        laser = pixel = np.arange(len(lasers))
        counts = counts[:, 0]
    elif capture.get("illumination") == "flood":
        some = np.unique(np.linspace(0, len(lasers) - 1, LASERS_OF_A_FLOOD).round().astype(int))
        laser, pixel = (grid.ravel() for grid in np.meshgrid(some, np.arange(len(pixels)), indexing="ij"))
        counts = counts[0][pixel]
    else:
        laser, pixel = (grid.ravel() for grid in np.indices((len(lasers), len(pixels))))
        counts = counts.reshape(len(laser), -1)
    outside = np.zeros(len(laser))
    if scene.time.origin == "source":
        ways = np.linalg.norm(lasers - laser_at, axis=1), np.linalg.norm(pixels - sensor_at, axis=1)
        outside = ways[0][laser] + ways[1][pixel]
    width_s = scene.time.width_s
    first = scene.time.start_s / width_s - outside * time_from_path(1.0) / width_s
    return Scan(whitened(counts), lasers, pixels, laser, pixel, first, width_s / time_from_path(1.0))


def whitened(counts: Floats) -> Floats:
    """(pair, bin) counts less the mean over the scan in each bin, over its root: light that is alike all over the
    wall, such as that of walls around, is taken away, and noise is the same everywhere.
    """
    mean = counts.mean(axis=0)
    flat: Floats = (counts - mean) / np.sqrt(mean + 1 / len(counts))
    return flat


def backprojected(scan: Scan, places: Floats) -> Floats:
    """(V,) B at places (V, 3) of the label frame."""
    to_laser = _bins_to(scan.laser_points, scan.laser, places, scan.bin_m)
    to_pixel = _bins_to(scan.pixels, scan.pixel, places, scan.bin_m)
    total = np.zeros(len(places))
    # What comes before the first bin or after the last falls on a 0 at either end.
    for values, first, laser, pixel in zip(
        np.pad(scan.signal, ((0, 0), (1, 1))), scan.first.astype(np.float32), scan.laser, scan.pixel, strict=True
    ):
        bins = to_laser[int(laser)] + (to_pixel[int(pixel)] + (1 - first))
        total += values.take(bins.astype(np.int32), mode="clip")
    return total


def _bins_to(points: Floats, used: Ints, places: Floats, bin_m: float) -> dict[int, NDArray[np.float32]]:
    """Index of a point that is used → (V,) bins that light takes from there to every place."""
    several = np.unique(used)
    bins = (cdist(points[several], places) / bin_m).astype(np.float32)
    return dict(zip(several.tolist(), bins, strict=True))


def filtered(volume: Floats, spread: float = 1.0) -> Floats:
    """(depth, row, column): minus the Laplacian of a Gaussian of so many voxels, what is negative cut off."""
    return np.asarray(np.maximum(-gaussian_laplace(volume, spread), 0.0))


def reconstructed(scan: Scan, grid: HiddenGrid) -> Floats:
    """(depth, row, column) filtered backprojection on a grid."""
    return filtered(backprojected(scan, grid.centers.reshape(-1, 3)).reshape(grid.shape))
