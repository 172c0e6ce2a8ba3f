"""An image of which not every pixel is asked: those of a coarse grid are, and the others where these disagree.

For each station (pair of laser point and pixel) by itself the image is cut into blocks. Where all label pixels of a
block look at one plane, and its four corners agree, either all dark or alike in what they bring, the pixels between
get what lies between (bilinear); any other block is halved, down to single pixels. A shadow narrower than a block
that falls between its corners is missed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from datagen.records.arrays import Bools, Floats, Ints

NODES = 16
"""Blocks along the shorter side of an image, at least, before any is halved."""
WIDEST = 8
"""Label pixels along a block at most."""
ALIKE = 2.0
"""Ratio between what the corners of a block bring up to which it is not halved."""
FLAT = 1e-6
"""Share of a block's size by which points of one plane may stand out of it."""


def first_step(rows: int, columns: int) -> int:
    """Label pixels along a block before any is halved, a power of two."""
    step = 1
    while 2 * step <= min(min(rows, columns) // NODES, WIDEST):
        step *= 2
    return step


def refined(
    ask: Callable[[Ints, Ints], Floats], there: Bools, position: Floats, normal: Floats, part: Ints, stations: int,
    step: int,
) -> Floats:  # fmt: skip
    """(rows, columns, S) what each label pixel brings at each station.

    Parameters
    ----------
    ask : numbers of pixels, counted along the rows of the image, and of stations, (n,) each → (n,) what they bring.
    there : (rows, columns) whether a pixel sees anything; the others bring nothing.
    position, normal, part : (rows, columns, 3), (rows, columns, 3), (rows, columns) of what it sees.
    step : label pixels along a block before any is halved, a power of two; 1 asks every pixel.
    """
    unknown = np.where(there, np.nan, 0.0)
    value = np.repeat(unknown[:, :, None], stations, axis=2)
    while step >= 1:
        pixel, station = _unknown_corners(value, step)
        if len(pixel):
            value.reshape(-1, stations)[pixel, station] = ask(pixel, station)
        if step > 1:
            _settle(value, position, normal, part, step)
        step //= 2
    return value


@njit(cache=True)
def _unknown_corners(value: Floats, step: int) -> tuple[Ints, Ints]:
    """Pixel and station of the corners not known yet of blocks that hold anything unknown."""
    rows, columns, stations = value.shape
    wanted = np.zeros(value.shape, np.bool_) if step > 1 else np.isnan(value)
    count = wanted.sum()
    for top in range(0, rows - 1 if step > 1 else 0, step):
        bottom = min(top + step, rows - 1)
        for left in range(0, columns - 1, step):
            right = min(left + step, columns - 1)
            for s in range(stations):
                if not _unsettled(value, top, bottom, left, right, s):
                    continue
                for row in (top, bottom):
                    for column in (left, right):
                        if np.isnan(value[row, column, s]) and not wanted[row, column, s]:
                            wanted[row, column, s] = True
                            count += 1
    pixel, station = np.empty(count, np.int64), np.empty(count, np.int64)
    n = 0
    for row in range(rows):
        for column in range(columns):
            for s in range(stations):
                if wanted[row, column, s]:
                    pixel[n], station[n] = row * columns + column, s
                    n += 1
    return pixel, station


@njit(cache=True)
def _unsettled(value: Floats, top: int, bottom: int, left: int, right: int, s: int) -> bool:
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            if np.isnan(value[row, column, s]):
                return True
    return False


@njit(cache=True)
def _settle(value: Floats, position: Floats, normal: Floats, part: Ints, step: int) -> None:
    """Fill what is unknown in blocks whose corners agree."""
    rows, columns, stations = value.shape
    for top in range(0, rows - 1, step):
        bottom = min(top + step, rows - 1)
        for left in range(0, columns - 1, step):
            right = min(left + step, columns - 1)
            if not _in_one_plane(position, normal, part, top, bottom, left, right):
                continue
            for s in range(stations):
                a, b = value[top, left, s], value[top, right, s]
                c, d = value[bottom, left, s], value[bottom, right, s]
                least, most = min(a, b, c, d), max(a, b, c, d)
                if not (most == 0.0 or most <= ALIKE * least):
                    continue
                for row in range(top, bottom + 1):
                    v = (row - top) / (bottom - top)
                    for column in range(left, right + 1):
                        if np.isnan(value[row, column, s]):
                            u = (column - left) / (right - left)
                            value[row, column, s] = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)


@njit(cache=True)
def _in_one_plane(position: Floats, normal: Floats, part: Ints, top: int, bottom: int, left: int, right: int) -> bool:
    """Whether all pixels of a block see one plane of one part."""
    size = 0.0
    for k in range(3):
        size += abs(position[bottom, right, k] - position[top, left, k])
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            if part[row, column] < 0 or part[row, column] != part[top, left]:
                return False
            along = out = 0.0
            for k in range(3):
                along += normal[row, column, k] * normal[top, left, k]
                out += (position[row, column, k] - position[top, left, k]) * normal[top, left, k]
            if along < 1.0 - FLAT or abs(out) > FLAT * size:
                return False
    return True
