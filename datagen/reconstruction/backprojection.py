"""Filtered backprojection: each count is added to all places that it may have come from.

The arrival time of a count gives the length of its path. For laser point l and pixel p the place of its reflection
lies on an ellipsoid with these as foci (a sphere, if they coincide). The sum over the scan of the counts n at the
arrival time of a place x,

    B(x) = Σ_lp n_lp((|x − x_l| + |x − x_p|) / c),

is filtered by the Laplacian of a Gaussian, which keeps structures as thin as a surface (Velten et al., Nature
Communications 3, 745 (2012)).
"""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_laplace

from datagen.compiled import compiled
from datagen.labels.frame import ViewFrame
from datagen.labels.volumes import VoxelGrid
from datagen.records import Rectangle, TimeAxis
from datagen.records.arrays import Bools, Floats, Ints
from datagen.units import time_from_path

GEOMETRY = ("hidden_view", "hidden_bounds", "laser_points", "sensor_points", "laser_position", "sensor_position")
"""Fields that state where a measurement was made, and where the hidden part is."""
LASERS_OF_A_FLOOD = 16
"""Laser points that represent the points of a flood, all of which are lit at once: the time grows with them."""


@dataclass(frozen=True)
class Scan:
    """The input of backprojection.

    signal : (pair, bin) whitened counts; row r is that of pixel `pixel[r]` and laser point `laser[r]`.
    laser_points, pixels : (L, 3) and (P, 3) laser points, and what each pixel looks at, label frame, metres.
    laser, pixel : (pair,) indices into `laser_points` and `pixels`.
    first : (pair,) time from the reflection at the laser point to the start of the first bin, without the way from
        the pixel to the sensor, in bins.
    bin_m : length of the path that light travels in one bin, metres.
    """

    signal: Floats
    laser_points: Floats
    pixels: Floats
    laser: Ints
    pixel: Ints
    first: Floats
    bin_m: float


def scan_of(
    counts: NDArray[np.generic],
    geometry: Mapping[str, Floats],
    capture: Mapping[str, Any],
    time: TimeAxis,
    mean: Floats | None = None,
) -> Scan:
    """The scan of a stored scene, confocal, exhaustive or a flood. Pairs with an unknown point (NaN) are left out.

    counts : (laser, pixel, bin). geometry : the fields `GEOMETRY` of the scene. capture : the section `capture` of
    the configuration. time : the bins of `counts`. mean : (laser, pixel, bin) what is taken off the counts, such as
    their mean over the frames of a sequence; left out: their mean over the scan.
    """
    to_frame = ViewFrame.about(Rectangle(*geometry["hidden_view"])).to_view
    lasers, pixels = to_frame(geometry["laser_points"]), to_frame(geometry["sensor_points"])
    signal: Floats = counts.astype(np.float64)
    if mean is not None:
        # In units of the noise of the counts; where hardly any are expected, of one count in the scan.
        signal = (signal - mean) / np.sqrt(mean + 1 / max(signal.shape[0] * signal.shape[1], 1))
    if capture["pairing"] == "confocal":
        laser = pixel = np.arange(len(lasers))
        signal = signal[:, 0]
        if np.allclose(lasers, pixels, rtol=0, atol=1e-9):
            pixels = lasers
    elif capture.get("illumination") == "flood":
        some = np.unique(np.linspace(0, len(lasers) - 1, LASERS_OF_A_FLOOD).round().astype(int))
        laser, pixel = (grid.ravel() for grid in np.meshgrid(some, np.arange(len(pixels)), indexing="ij"))
        signal = signal[0][pixel]
    else:
        laser, pixel = (grid.ravel() for grid in np.indices((len(lasers), len(pixels))))
        signal = signal.reshape(len(laser), -1)
    outside = np.zeros(len(laser))
    if time.origin == "source":
        laser_at, sensor_at = to_frame(geometry["laser_position"]), to_frame(geometry["sensor_position"])
        out, home = np.linalg.norm(lasers - laser_at, axis=1), np.linalg.norm(pixels - sensor_at, axis=1)
        outside = out[laser] + home[pixel]
    first = time.start_s / time.width_s - outside * time_from_path(1.0) / time.width_s
    known: Bools = np.isfinite(lasers[laser] + pixels[pixel]).all(axis=1) & np.isfinite(first)
    signal, laser, pixel, first = signal[known], laser[known], pixel[known], first[known]
    signal = whitened(signal) if mean is None else signal
    return Scan(signal, lasers, pixels, laser, pixel, first, time.width_s / time_from_path(1.0))


def whitened(counts: Floats) -> Floats:
    """(pair, bin) counts minus the mean over the scan in each bin, divided by the root of that mean. This removes
    light that is the same for the whole scan, such as that of other walls, and gives all bins the same noise."""
    if not len(counts):
        return counts
    mean = counts.mean(axis=0)
    flat: Floats = (counts - mean) / np.sqrt(mean + 1 / len(counts))
    return flat


def backprojected(scan: Scan, places: Floats) -> Floats:
    """(V,) the sum B at places (V, 3) of the label frame."""
    total = np.zeros(len(places), np.float32)
    add_to_places(
        np.pad(scan.signal, ((0, 0), (1, 1))).astype(np.float32), _in_bins(scan.laser_points, scan),
        _in_bins(scan.pixels, scan), np.ascontiguousarray(scan.laser), np.ascontiguousarray(scan.pixel),
        scan.first.astype(np.float32), _in_bins(places, scan), total,
    )  # fmt: skip
    return total.astype(np.float64)


def _in_bins(points: Floats, scan: Scan) -> NDArray[np.float32]:
    """(3, N) coordinates of points (N, 3), in lengths of `bin_m`."""
    return np.ascontiguousarray((points / scan.bin_m).T, np.float32)


def backprojected_volume(scan: Scan, grid: VoxelGrid) -> Floats:
    """(depth, row, column) the sum B on a grid, divided by the root of the number of histograms, so that noise alone
    has a standard deviation of about 1."""
    total = backprojected(scan, grid.centers.reshape(-1, 3)).reshape(grid.shape)
    return np.asarray(total / np.sqrt(max(len(scan.signal), 1)))


def volumes_of_frames(
    counts: NDArray[np.generic], geometry: Mapping[str, Floats], framed: Container[str], capture: Mapping[str, Any],
    time: TimeAxis, grid: VoxelGrid, mean: Floats | None = None,
) -> Iterator[Floats]:  # fmt: skip
    """`backprojected_volume` of each frame of a sequence, one after the other, or of the one scan of a scene; the
    other parameters are those of `scan_of`.

    counts : (frame, laser, pixel, bin) of a sequence, (laser, pixel, bin) of a scene. framed : names of the fields of
    `geometry` that have the axis of frames, too.
    """
    for frame in np.ndindex(counts.shape[:-3]):
        there = {name: of[frame] if name in framed else of for name, of in geometry.items()}
        yield backprojected_volume(scan_of(counts[frame], there, capture, time, mean), grid)


def reconstructed(scan: Scan, grid: VoxelGrid) -> Floats:
    """(depth, row, column) filtered backprojection on a grid: minus the Laplacian of a Gaussian of one voxel,
    negative values set to 0."""
    return np.asarray(np.maximum(-gaussian_laplace(backprojected_volume(scan, grid), 1.0), 0.0))


Singles = NDArray[np.float32]
BLOCK = 1024
"""Places whose distances to all laser points and pixels are computed together: as many distances as fit into a core's
cache."""


@compiled(nogil=True)
def add_to_places(
    signal: Singles, laser_points: Singles, pixels: Singles, laser: Ints, pixel: Ints, first: Singles,
    places: Singles, total: Singles,
) -> None:  # fmt: skip
    """Add Σ_r signal[r, ⌊|x − x_l| + |x − x_p| − first[r]⌋ + 1] to `total` (V,), for every place x (3, V).

    Arguments are those of `Scan`, with lengths in bins and points as (3, L) and (3, P). The first and the last column
    of `signal` are zeros, for arrival times before and after all bins.
    """
    last, same = np.float32(signal.shape[1] - 1), np.array_equal(laser_points, pixels)
    to_laser = np.empty((laser_points.shape[1], BLOCK), np.float32)
    to_pixel = to_laser if same else np.empty((pixels.shape[1], BLOCK), np.float32)
    for begin in range(0, len(total), BLOCK):
        # A distance depends on one laser point or pixel, and not on the pair: computing it here saves a root for each
        # of the many pairs.
        x, y, z = places[0][begin : begin + BLOCK], places[1][begin : begin + BLOCK], places[2][begin : begin + BLOCK]
        _distances(laser_points, x, y, z, to_laser)
        if not same:
            _distances(pixels, x, y, z, to_pixel)
        out = total[begin : begin + BLOCK]
        for r in range(len(signal)):
            there, back, row = to_laser[laser[r]], to_pixel[pixel[r]], signal[r]
            # Plus 1 for the column of zeros before the first bin.
            offset = np.float32(1) - first[r]
            for k in range(len(out)):
                at = there[k] + back[k] + offset
                # Times outside of all bins, and NaN, take the column of zeros: such a place adds nothing.
                out[k] += row[np.int32(at)] if at > 0 and at < last else row[0]


@compiled(nogil=True)
def _distances(points: Singles, x: Singles, y: Singles, z: Singles, out: Singles) -> None:
    for i in range(points.shape[1]):
        u, v, w = points[0, i], points[1, i], points[2, i]
        row = out[i]
        for k in range(len(x)):
            row[k] = np.sqrt((x[k] - u) ** 2 + (y[k] - v) ** 2 + (z[k] - w) ** 2)
