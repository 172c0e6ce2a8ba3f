"""f-k migration: reconstruction from a confocal grid, by resampling the spectrum of its histograms.

The root of the light that returns to each point of the wall is treated as a wave field Ψ(x, y, z = 0, t) that left
all surfaces at time 0 and travels at half of the speed of light. In free space a wave with the wave number
(k_x, k_y, k_z), in cycles per metre, has the frequency f = (c/2) √(k_x² + k_y² + k_z²). So the field at time 0 has
the spectrum (Stolt, Geophysics 43, 23 (1978); Lindell, Wetzstein & O'Toole, ACM Transactions on Graphics 38, 116
(2019))

    Ψ(k_x, k_y, k_z; t = 0) = (c/2) k_z / √(k_x² + k_y² + k_z²) · Ψ(k_x, k_y, f).
"""

from __future__ import annotations

import math

import numpy as np
from scipy import fft

from datagen.errors import InputError
from datagen.records import TimeAxis
from datagen.records.arrays import Floats
from datagen.units import path_from_time


def migrated(counts: Floats, width_m: float, height_m: float, time: TimeAxis) -> tuple[Floats, Floats]:
    """Brightness (depth, row, column) in front of a confocal grid, and the depth of each layer (depth,), metres.

    counts : (row, column, bin) counts or transient at each point of the grid, row 0 at the top.
    width_m, height_m : distance from the first column to the last, and from the first row to the last.
    time : the time bins; its origin must be the wall.

    Each column of voxels lies in front of a point of the grid, so the volume is as wide as the grid.

    Raises
    ------
    InputError : a time axis that counts from the laser, or less than two rows or columns.
    """
    rows, columns, bins = counts.shape
    if time.origin != "wall" or time.start_s < 0:
        raise InputError(
            f"time: origin = {time.origin!r}, start_s = {time.start_s:g}: f-k migration counts from the wall; set "
            "capture.time.origin to wall, or take the ways of the devices off"
        )
    if min(rows, columns) < 2:
        raise InputError(f"counts: a grid of {rows} × {columns} points; f-k migration needs two and more each way")
    bin_m = float(path_from_time(time.width_s))
    before = round(time.start_s / time.width_s)
    total = fft.next_fast_len(before + bins, real=False)
    amplitude = np.zeros((2 * total, 2 * rows, 2 * columns), np.complex64)
    # The factor t² compensates the distance: light of a diffuse surface falls off with its fourth power, the root of
    # the light with the square.
    middle = (np.arange(bins) + before + 0.5) * bin_m
    amplitude[before : before + bins, :rows, :columns] = np.moveaxis(
        np.sqrt(np.maximum(counts, 0.0)) * np.square(middle / middle[-1]), 2, 0
    )
    spectrum = fft.fftn(amplitude, overwrite_x=True)
    step_m = bin_m / 2
    depth = np.fft.fftfreq(2 * total, step_m)
    up, right = np.fft.fftfreq(2 * rows, height_m / (rows - 1)), np.fft.fftfreq(2 * columns, width_m / (columns - 1))
    found = np.zeros_like(spectrum)
    # Only waves that come from the hidden side, which have k_z > 0.
    forward = np.flatnonzero(depth > 0)
    for i, k_up in enumerate(up):
        across = np.square(k_up) + np.square(right)
        number = np.sqrt(np.square(depth[forward, None]) + across)
        place = number * (2 * total * step_m)
        below = place.astype(np.int64)
        share = (place - below).astype(np.float32)
        inside = below < total - 1
        below = np.where(inside, below, 0)
        column = np.arange(len(right))
        wave = (1 - share) * spectrum[below, i, column] + share * spectrum[below + 1, i, column]
        found[forward, i] = np.where(inside, wave * (depth[forward, None] / number), 0)
    volume = np.abs(fft.ifftn(found, overwrite_x=True)[:total, :rows, :columns]) ** 2
    # Layer i lies at the path of the middle of bin i, the mean arrival time of the bin's light.
    return np.asarray(volume, np.float64), (np.arange(total) + 0.5) * step_m


def depth_of_brightest(volume: Floats, depths: Floats) -> Floats:
    """(row, column) depth of the brightest voxel in front of each point, metres; a parabola through it and its
    neighbours interpolates between layers."""
    best = volume.argmax(axis=0).clip(1, len(depths) - 2)
    low, top, high = (np.take_along_axis(volume, best[None] + k, axis=0)[0] for k in (-1, 0, 1))
    bend = low - 2 * top + high
    shift = np.where(bend < 0, 0.5 * (low - high) / np.where(bend < 0, bend, 1.0), 0.0).clip(-0.5, 0.5)
    return np.asarray(depths[best] + shift * math.fabs(depths[1] - depths[0]))
