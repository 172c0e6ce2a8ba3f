"""A field's file of one shard, encoded one scene after the other as they are made.

Format: Zarr 3.0, codecs `blosc` and `crc32c`, and where a field is sharded `sharding_indexed` with its index at the
end, as `arrays` declares them. Zarr itself writes the same bytes (by test; chunks of one scene in another order) in
two to three times the time, with copies, and a task and a thread for every chunk.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from datagen.store import blosc_frames
from datagen.store.arrays import chunk_grid, fill_of, shuffle_of
from datagen.store.record import FileRecord
from datagen.store.schema import Field

MISSING = 2**64 - 1
"""Offset and size, in a shard's index, of a chunk that is not there."""


class FieldFile:
    """The values of a field for the scenes of one shard, held as they are compressed; those of small fields as they
    are.

    scenes : how many the shard holds; fewer than `scenes_per_shard` in the last one.
    """

    def __init__(self, field: Field, scenes: int, scenes_per_shard: int) -> None:
        self._field, self._scenes, self._rows = field, scenes, scenes_per_shard
        self._frames: dict[int, list[bytes]] = {}
        self._small = np.full((0 if field.sharded else scenes_per_shard, *field.shape), fill_of(field), field.dtype)

    def add(self, row: int, value: NDArray[np.generic]) -> None:
        """Scene `row` of the shard, in the field's shape and dtype. One that is never given has the fill value."""
        if self._field.sharded:
            self._frames[row] = [self._frame(chunk) for chunk in self._chunks(value)]
        else:
            self._small[row] = value

    def pieces(self) -> list[bytes]:
        """What the file holds, one after the other."""
        if not self._field.sharded:
            return [self._frame(self._small)]
        pieces, end = list[bytes](), 0
        index = np.full((self._rows, *chunk_grid(self._field), 2), MISSING, "<u8")
        # Nothing but scenes that the dataset does not have is left out: it would read as fill values when it is lost.
        for row in range(self._scenes):
            if row not in self._frames:
                self.add(row, np.full(self._field.shape, fill_of(self._field), self._field.dtype))
            frames = self._frames[row]
            sizes = [len(frame) for frame in frames]
            index[row] = np.transpose([end + np.cumsum([0, *sizes[:-1]]), sizes]).reshape(index[row].shape)
            end += sum(sizes)
            pieces += frames
        return [*pieces, _summed(index.tobytes())]

    def _chunks(self, value: NDArray[np.generic]) -> Iterator[NDArray[np.generic]]:
        """In the order of the index; those at the end of an axis are filled up."""
        shape = self._field.chunk
        for place in product(*map(range, chunk_grid(self._field))):
            chunk = value[tuple(slice(p * c, (p + 1) * c) for p, c in zip(place, shape, strict=True))]
            if chunk.shape != shape:
                chunk = np.pad(
                    chunk, [(0, due - n) for due, n in zip(shape, chunk.shape, strict=True)],
                    constant_values=fill_of(self._field),
                )  # fmt: skip
            yield chunk

    def _frame(self, chunk: NDArray[np.generic]) -> bytes:
        plain = np.ascontiguousarray(chunk, np.dtype(self._field.dtype).newbyteorder("<"))
        return _summed(blosc_frames.encode(plain, shuffle_of(self._field)))


def write_new(path: Path, pieces: Sequence[bytes]) -> FileRecord:
    """Write a file, which must not be there, and have the disk hold it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    whole = hashlib.sha256()
    with path.open("xb") as file:
        for piece in pieces:
            file.write(piece)
            whole.update(piece)
        file.flush()
        os.fsync(file.fileno())
    return FileRecord(whole.hexdigest(), sum(map(len, pieces)))


def _summed(body: bytes) -> bytes:
    """With its checksum, as the codec `crc32c` has it."""
    return body + int(google_crc32c.value(body)).to_bytes(4, "little")
