"""Blosc's frames: a header, where each block begins, the blocks. Of these a part of a frame needs only some.

Format: c-blosc 1, README_CHUNK_FORMAT. Blocks are compressed, and their bits shuffled, each by itself; they need not
lie in order. So any of them make a shorter frame, which blosc decodes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Literal

import numpy as np
from numcodecs import blosc
from numpy.typing import NDArray

BLOCK_BYTES = 2**18
"""Decoded bytes of a block, which fits into a core's cache, and is the least that is decoded."""
CODEC: Literal["zstd"] = "zstd"
LEVEL = 1
"""Higher levels mostly gain by longer blocks: with these, level 5 spares 3 % for five times the time."""
Shuffle = Literal["shuffle", "bitshuffle"]

HEADER_BYTES = 16
_SHUFFLED, _PLAIN, _BITS_SHUFFLED, _UNSPLIT = 1, 2, 4, 16
"""Flags of the third byte: bytes shuffled, stored as it is, bits shuffled, blocks not split into streams."""


def sizes(frame: bytes) -> tuple[int, int]:
    """Bytes that a frame decodes to, and its own, as its header states them."""
    decoded, stored = struct.unpack_from("<4xI4xI", frame)
    return decoded, stored


def block_bytes(frame: bytes) -> int:
    """Decoded bytes of a block; those of the whole frame where its blocks cannot be had apart."""
    decoded, block = struct.unpack_from("<4xII", frame)
    apart = frame[2] & _UNSPLIT and not frame[2] & _PLAIN and 0 < block < decoded
    return int(block if apart else decoded)


def only_blocks(frame: bytes, chosen: Sequence[int]) -> bytes:
    """A frame of some blocks of one, ascending. Raises `ValueError` where these are not where it says."""
    decoded, block, stored = struct.unpack_from("<4xIII", frame)
    count = -(-decoded // block)
    if len(frame) < HEADER_BYTES + 4 * count:
        raise ValueError("a table of blocks that is cut short")
    begins = np.frombuffer(frame, "<i4", count, HEADER_BYTES)
    if begins.min() < HEADER_BYTES + 4 * count or begins.max() >= stored:
        raise ValueError("blocks outside of it")
    # Those that were compressed by several threads lie in the order in which these got ready.
    ordered = np.sort(begins)
    ends = np.append(ordered[1:], stored)[np.searchsorted(ordered, begins)]
    pieces = [frame[begins[one] : ends[one]] for one in chosen]
    head = HEADER_BYTES + 4 * len(pieces)
    places = np.cumsum([head, *map(len, pieces)])
    size = block * (len(pieces) - 1) + min(block, decoded - block * chosen[-1])
    header = frame[:4] + struct.pack("<III", size, min(block, size), int(places[-1]))
    return b"".join([header, places[:-1].astype("<i4").tobytes(), *pieces])


def encode(values: NDArray[np.generic], shuffle: Shuffle) -> bytes:
    """A frame of a contiguous array."""
    how = blosc.SHUFFLE if shuffle == "shuffle" else blosc.BITSHUFFLE
    before = blosc.use_threads
    # Several threads write blocks in the order in which they get ready.
    blosc.use_threads = False
    try:
        return bytes(blosc.compress(values, CODEC.encode(), LEVEL, how, BLOCK_BYTES, values.dtype.itemsize))
    finally:
        blosc.use_threads = before


def decode(frame: bytes, out: NDArray[np.generic]) -> None:
    """Decode a frame into a contiguous array of its size. Raises `RuntimeError` or `ValueError` where that fails."""
    blosc.decompress(frame, out)
