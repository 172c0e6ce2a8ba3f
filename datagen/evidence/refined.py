"""An image of which not every pixel is asked: those of a coarse grid are, and the others where these disagree.

For each station (pair of laser point and pixel) by itself the image is cut into blocks. Where all label pixels of a
block look at one plane, and its four corners agree, either all dark or alike in what they bring, the pixels between
get what lies between (bilinear); any other block is halved, down to single pixels. A shadow narrower than a block
that falls between its corners is missed.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from datagen.compiled import compiled
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
    rows, columns = there.shape
    value = np.repeat(np.where(there, np.nan, 0.0)[:, :, None], stations, axis=2)
    open_blocks = _all_blocks(rows, columns, stations, step)
    while len(open_blocks):
        pixel, station = _unknown_corners(value, open_blocks, step)
        if len(pixel):
            value.reshape(-1, stations)[pixel, station] = ask(pixel, station)
        if step == 1:
            break
        open_blocks = _halved(value, open_blocks, _planes(position, normal, part, step), step)
        step //= 2
    return value


@compiled()
def _all_blocks(rows: int, columns: int, stations: int, step: int) -> Ints:
    """(n, 3) first row, first column and station of every block, at every station."""
    down, across = max(-(-(rows - 1) // step), 1), max(-(-(columns - 1) // step), 1)
    blocks = np.empty((down * across * stations, 3), np.int64)
    n = 0
    for i in range(down):
        for j in range(across):
            for s in range(stations):
                blocks[n] = i * step, j * step, s
                n += 1
    return blocks


@compiled()
def _unknown_corners(value: Floats, blocks: Ints, step: int) -> tuple[Ints, Ints]:
    """Pixel and station of what is not known yet of the corners of blocks, each once."""
    rows, columns, _ = value.shape
    pixel, station = np.empty(4 * len(blocks), np.int64), np.empty(4 * len(blocks), np.int64)
    n = 0
    for top, left, s in blocks:
        for row in (top, min(top + step, rows - 1)):
            for column in (left, min(left + step, columns - 1)):
                if np.isnan(value[row, column, s]):
                    value[row, column, s] = 0.0
                    pixel[n], station[n] = row * columns + column, s
                    n += 1
    return pixel[:n], station[:n]


@compiled()
def _halved(value: Floats, blocks: Ints, planes: Bools, step: int) -> Ints:
    """Fill what is unknown of blocks whose corners agree; the quarters of all others, as `blocks`."""
    rows, columns, _ = value.shape
    quarters = np.empty((4 * len(blocks), 3), np.int64)
    n = 0
    for top, left, s in blocks:
        bottom, right = min(top + step, rows - 1), min(left + step, columns - 1)
        a, b = value[top, left, s], value[top, right, s]
        c, d = value[bottom, left, s], value[bottom, right, s]
        least, most = min(a, b, c, d), max(a, b, c, d)
        alike = most == 0.0 or (least > 0.0 and most <= ALIKE * least)
        if not (alike and planes[top // step, left // step]):
            half = step // 2
            for row in (top, top + half):
                for column in (left, left + half):
                    if (row == top or row < bottom) and (column == left or column < right):
                        quarters[n] = row, column, s
                        n += 1
            continue
        for row in range(top, bottom + 1):
            v = (row - top) / (bottom - top)
            for column in range(left, right + 1):
                if np.isnan(value[row, column, s]):
                    u = (column - left) / (right - left)
                    value[row, column, s] = (1 - v) * ((1 - u) * a + u * b) + v * ((1 - u) * c + u * d)
    return quarters[:n]


@compiled()
def _planes(position: Floats, normal: Floats, part: Ints, step: int) -> Bools:
    """(down, across) whether all pixels of a block see one plane of one part."""
    rows, columns = part.shape
    planes = np.zeros((max(-(-(rows - 1) // step), 1), max(-(-(columns - 1) // step), 1)), np.bool_)
    for i in range(len(planes)):
        for j in range(planes.shape[1]):
            top, left = i * step, j * step
            bottom, right = min(top + step, rows - 1), min(left + step, columns - 1)
            if top < bottom and left < right:
                planes[i, j] = _in_one_plane(position, normal, part, top, bottom, left, right)
    return planes


@compiled()
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
