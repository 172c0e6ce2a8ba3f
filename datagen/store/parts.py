"""A part of a field's values: which laser points, pixels, bins; and which blocks of a chunk are decoded for it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from datagen.store import blosc_frames

Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Part:
    """A part of one scene's value.

    axes : of each axis the indices that are read, in their order; of the last a slice of step 1, since that axis is
        never cut into chunks.
    size : of the last axis, uncut.
    """

    axes: tuple[Indices, ...]
    last: slice

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the part."""
        return *map(len, self.axes), self.last.stop - self.last.start

    def of(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """The part of a whole value; a copy."""
        taken: NDArray[np.generic] = values[..., self.last][np.ix_(*self.axes)] if self.axes else values[self.last]
        return np.ascontiguousarray(taken)


@dataclass(frozen=True)
class Rows:
    """What is wanted of one chunk; a row is all that it has along the last axis.

    source : rows of the chunk. target : rows of the part, one for each.
    """

    source: Indices
    target: Indices


def rows_in(part: Part, chunk: tuple[int, ...], place: tuple[int, ...]) -> Rows:
    """What a part wants of the chunk at a place of the grid of chunks."""
    source, target = np.zeros(1, np.int64), np.zeros(1, np.int64)
    for wanted, size, at in zip(part.axes, chunk, place, strict=False):
        here = np.flatnonzero(wanted // size == at)
        source = (source[:, None] * size + (wanted[here] - at * size)).reshape(-1)
        target = (target[:, None] * len(wanted) + here).reshape(-1)
    return Rows(source, target)


@dataclass(frozen=True)
class Plan:
    """How to take rows out of a chunk: decode these blocks, one after the other, and copy these runs.

    items : that the blocks decode to.
    runs : (first row of the part, how many, where the first begins among the items decoded, items from row to row).
    """

    blocks: tuple[int, ...]
    items: int
    runs: tuple[tuple[int, int, int, int], ...]


def plan(rows: Rows, row_items: int, chunk_items: int, block_items: int) -> Plan:
    """The fewest blocks that hold the rows, and the rows in them as few runs of equal strides."""
    first, last = rows.source * row_items // block_items, ((rows.source + 1) * row_items - 1) // block_items
    needed = np.zeros(math.ceil(chunk_items / block_items), bool)
    for offset in range(int((last - first).max(initial=0)) + 1):
        needed[np.minimum(first + offset, last)] = True
    slot = np.cumsum(needed) - 1
    begins = slot[first] * block_items + rows.source * row_items - first * block_items
    blocks = np.flatnonzero(needed)
    items = len(blocks) * block_items - (0 if not needed[-1] else -chunk_items % block_items)
    return Plan(tuple(blocks.tolist()), items, tuple(_runs(begins, rows.target, row_items)))


def _runs(begins: Indices, target: Indices, row_items: int) -> Iterator[tuple[int, int, int, int]]:
    steps, neighbours = np.diff(begins), np.diff(target) == 1
    fits = neighbours & (steps > 0) & (steps % row_items == 0)
    at = 0
    while at < len(begins):
        stride, end = row_items, at + 1
        if end < len(begins) and fits[at]:
            stride = int(steps[at])
            while end < len(begins) and fits[end - 1] and steps[end - 1] == stride:
                end += 1
        yield int(target[at]), end - at, int(begins[at]), stride
        at = end


def take(
    frame: bytes, how: Plan, part: Part, row_items: int, dtype: np.dtype[np.generic], out: NDArray[np.generic]
) -> None:
    """Decode the blocks of a plan and copy its rows to `out`, (rows of the part, its last axis), cast to its dtype.

    Raises `RuntimeError` or `ValueError` where the frame cannot be decoded.
    """
    decoded = np.empty(how.items, dtype)
    whole = blosc_frames.block_bytes(frame) * len(how.blocks) >= blosc_frames.sizes(frame)[0]
    blosc_frames.decode(frame if whole else blosc_frames.only_blocks(frame, how.blocks), decoded)
    for row, count, begin, stride in how.runs:
        span = decoded[begin : begin + (count - 1) * stride + row_items].reshape(-1, row_items)
        out[row : row + count] = span[:: stride // row_items, part.last]
