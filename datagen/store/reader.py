"""The reader of a dataset: from its files to values, for every field and size.

A file must exist, have the size that the commit record states, and match its checksums; decoded values must have the
digest that the record states. A missing chunk is an error, never a fill value. The files are Zarr 3.0. zarr's own
reader gives the same values (a test compares them), but takes about three times as long, and returns fill values for
missing chunks. This reader is faster because it keeps the index of a shard in memory, reads a chunk by one `pread`,
and lets blosc decode it into the result.
"""

from __future__ import annotations

import math
import multiprocessing
import struct
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import product

import google_crc32c
import numpy as np
from numcodecs import blosc
from numpy.typing import NDArray

from datagen.errors import CheckError
from datagen.records.arrays import Bools, Ints
from datagen.store.arrays import chunk_grid, shard_file
from datagen.store.environment import cores
from datagen.store.location import Location, read_range, size_of
from datagen.store.manifest import Manifest
from datagen.store.record import GROWTH, read_record
from datagen.store.schema import Field
from datagen.store.shard import digest

MEMORY_BYTES = 256 * 2**20
"""Memory of a reader for indices of shards, small fields, and large fields that need a quarter of it at most."""
MOST_THREADS = 8
"""Threads that decode the scenes of a batch side by side, if there are as many cores."""
WORTH_BYTES = 2**21
"""Decoded bytes of a read below which starting threads takes longer than it saves."""
_MISSING = 2**64 - 1
"""Offset and size of a missing chunk in a shard's index (Zarr's `sharding_indexed`)."""
_MADE, _NOT_MADE, _STATED_BYTES = b"\x01", bytes(33), 33
"""What comes before the digest of a scene; what stands for one that could not be made; and their length."""
_CRC_BYTES = 4
_HEADER_BYTES = 16
_PLAIN, _UNSPLIT = 2, 16
"""Flags in the third byte of a blosc frame: its content is not compressed; its blocks are not split into streams."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part of one scene's value.

    axes : the indices to read along each axis except the last, in this order.
    last : a slice of step 1 along the last axis, which is never cut into chunks; of a small field also indices.
    """

    axes: tuple[Ints, ...]
    last: slice | Ints

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the part."""
        last = self.last.stop - self.last.start if isinstance(self.last, slice) else len(self.last)
        return *map(len, self.axes), last

    def cut(self, values: NDArray[np.generic]) -> NDArray[np.generic]:
        """A copy of this part of a whole value."""
        taken: NDArray[np.generic] = values[..., self.last][np.ix_(*self.axes)] if self.axes else values[self.last]
        return np.ascontiguousarray(taken)


class DatasetReader:
    """Reads the values of a dataset. Several threads must not share a reader; a forked process may use it.

    fields : names of the fields that will be read.
    check : compare every value with its digest when it is first read, and file sizes with the commit record. Without
        it missing and damaged files are still found, by their checksums, but not files that were exchanged.
    seen : field → (scenes,) whether the digest was checked already. Processes that share it check each value once.
    """

    def __init__(
        self, root: Location, manifest: Manifest, fields: Iterable[str], check: bool = True,
        seen: Mapping[str, Bools] | None = None,
    ) -> None:  # fmt: skip
        self._root, self._manifest, self._schema = root, manifest, manifest.schema
        self._fields = {name: self._schema.by_name[name] for name in fields}
        self._check = check
        self._seen = seen or {name: np.zeros(self._schema.scenes, bool) for name in self._fields}
        # Shard → field → size of its file, digests of its scenes. The whole records of a large dataset would not fit
        # into memory.
        self._records: dict[int, dict[str, tuple[int, bytes]]] = {}
        self._kept: OrderedDict[tuple[object, ...], NDArray[np.generic]] = OrderedDict()
        self._kept_bytes = 0
        self._lock = threading.Lock()

    def read(
        self, name: str, scenes: Sequence[int], part: Part | Sequence[Part] | None = None,
        out: NDArray[np.generic] | None = None,
    ) -> NDArray[np.generic]:  # fmt: skip
        """The values of scenes in the field's dtype, (len(scenes), *field.shape), or (len(scenes), *part.shape).

        part : what to read of each scene, or of each scene a part of its own, all of one shape; None: all.
        out : array of this shape for the result. Each scene is cast to its dtype as it is decoded, which moves less
            memory than casting all of them afterwards.

        Raises `CheckError`, with file, scene and remedy, for values that are missing, damaged or not as written.
        """
        field = self._fields[name]
        parts = [part] * len(scenes) if part is None or isinstance(part, Part) else part
        shape = next((of.shape for of in parts if of is not None), field.shape)
        if out is None:
            out = np.empty((len(scenes), *shape), _stored_dtype(field))
        value_bytes = math.prod(shape) * np.dtype(field.dtype).itemsize
        is_kept = 4 * self._schema.scenes * value_bytes <= MEMORY_BYTES

        def read_into(row: int) -> None:
            scene, part = scenes[row], parts[row]
            if not field.sharded:
                value = self._small(field, scene)
                out[row] = value if part is None else part.cut(value)
            elif is_kept:
                out[row] = self._keep((name, scene, part), lambda: self._value(field, scene, part))
            else:
                self._decode(field, scene, part, out[row])

        def into(row: int) -> None:
            try:
                read_into(row)
            except CheckError:
                # The shard may have been replaced since its index or record was read: its dataset has grown.
                self._forget(field, self._shard(scenes[row]))
                read_into(row)

        threads = min(cores(), len(scenes), MOST_THREADS)
        # In a worker of a loader no threads are started: the other workers use the other cores.
        if threads < 2 or is_kept or out.nbytes < WORTH_BYTES or multiprocessing.parent_process() is not None:
            for row in range(len(scenes)):
                into(row)
            return out
        # The threads end before the call returns, because a loader may fork later. `map` raises the first error.
        with ThreadPoolExecutor(threads, "datagen-decode") as pool:
            for _ in pool.map(into, range(len(scenes))):
                pass
        return out

    def _keep(self, key: tuple[object, ...], make: Callable[[], NDArray[np.generic]]) -> NDArray[np.generic]:
        """The array in memory under a key, made if it is not there; the oldest are dropped when memory is full."""
        kept = self._kept.get(key)
        if kept is None:
            kept = make()
            with self._lock:
                if key not in self._kept:
                    self._kept[key] = kept
                    self._kept_bytes += kept.nbytes
                while self._kept_bytes > MEMORY_BYTES:
                    self._kept_bytes -= self._kept.popitem(last=False)[1].nbytes
        return kept

    def _forget(self, field: Field, shard: int) -> None:
        """Drop what is in memory of a shard, so that it is read anew."""
        with self._lock:
            self._records.pop(shard, None)
            for what in ("index", "values"):
                kept = self._kept.pop((field.name, what, shard), None)
                self._kept_bytes -= 0 if kept is None else kept.nbytes

    def _small(self, field: Field, scene: int) -> NDArray[np.generic]:
        """One scene's value of a small field, whose file is one chunk with all scenes of a shard."""
        shard, within = divmod(scene, self._schema.scenes_per_shard)

        def decode() -> NDArray[np.generic]:
            values = np.empty((self._schema.scenes_per_shard, *field.shape), _stored_dtype(field))
            frame = self._frame(field, shard, None, 0, self._size(field, shard), values.nbytes)
            return self._decoded(field, shard, None, frame, values)

        value: NDArray[np.generic] = self._keep((field.name, "values", shard), decode)[within, ...]
        self._check_digest(field, scene, value)
        return value

    def _value(self, field: Field, scene: int, part: Part | None) -> NDArray[np.generic]:
        out = np.empty((part or field).shape, _stored_dtype(field))
        self._decode(field, scene, part, out)
        return out

    def _decode(self, field: Field, scene: int, part: Part | None, out: NDArray[np.generic]) -> None:
        """Decode one scene of a sharded field, or a part of it, into `out`, cast to its dtype. If the digest is still
        to be checked, the whole scene is decoded, because the digest is that of all its values."""
        whole = self._check and not self._seen[field.name][scene]
        if part is not None and not whole:
            self._decode_part(field, scene, part, out)
        elif part is not None or out.dtype != _stored_dtype(field):
            value = self._value(field, scene, None)
            out[...] = value if part is None else part.cut(value)
        else:
            for place in product(*map(range, chunk_grid(field))):
                frame = self._chunk(field, scene, place)
                target = out[tuple(slice(p * c, (p + 1) * c) for p, c in zip(place, field.chunk, strict=True))]
                fits = target.shape == field.chunk and target.flags.c_contiguous
                chunk = target if fits else np.empty(field.chunk, out.dtype)
                self._decoded(field, self._shard(scene), scene, frame, chunk)
                if not fits:
                    target[...] = chunk[tuple(slice(n) for n in target.shape)]
            self._check_digest(field, scene, out)

    def _decode_part(self, field: Field, scene: int, part: Part, out: NDArray[np.generic]) -> None:
        """Decode a part of one scene of a sharded field into `out`. In a chunk, only the blocks between the first row
        of the part and the last are decoded; a row is all that a chunk has along the last axis."""
        row_bytes = field.shape[-1] * np.dtype(field.dtype).itemsize
        for place in product(*map(range, chunk_grid(field))):
            here = [
                np.flatnonzero(wanted // size == at)
                for wanted, size, at in zip(part.axes, field.chunk, place, strict=False)
            ]
            if not all(map(len, here)):
                continue
            within = [wanted[found] % size for wanted, found, size in zip(part.axes, here, field.chunk, strict=False)]
            rows = np.ravel_multi_index(np.ix_(*within), field.chunk[:-1])
            first, stop = int(rows.min()) * row_bytes, (int(rows.max()) + 1) * row_bytes
            frame, begin = self._chunk(field, scene, place), 0
            if (block := _block_bytes(frame)) < _sizes(frame)[0]:
                begin = first // block * block
                try:
                    frame = _some_blocks(frame, first // block, -(-stop // block))
                except ValueError as error:
                    raise self._fault(field, self._shard(scene), scene, f"cannot be decoded ({error})") from None
            raw = self._decoded(field, self._shard(scene), scene, frame, np.empty(_sizes(frame)[0], np.uint8))
            values = raw[first - begin : stop - begin].view(_stored_dtype(field)).reshape(-1, field.shape[-1])
            out[np.ix_(*here)] = values[rows - first // row_bytes, part.last]

    def _shard(self, scene: int) -> int:
        return scene // self._schema.scenes_per_shard

    def _chunk(self, field: Field, scene: int, place: tuple[int, ...]) -> bytes:
        """The compressed chunk at index `place` of the grid of chunks, of one scene of a sharded field."""
        shard, within = divmod(scene, self._schema.scenes_per_shard)
        index = self._keep((field.name, "index", shard), lambda: self._index(field, shard))
        offset, size = (int(n) for n in index[(within, *place)])
        if offset == _MISSING:
            raise self._fault(field, shard, scene, "the chunk is missing from its shard")
        return self._frame(field, shard, scene, offset, size, math.prod(field.chunk) * _stored_dtype(field).itemsize)

    def _frame(self, field: Field, shard: int, scene: int | None, offset: int, size: int, due_bytes: int) -> bytes:
        """A blosc frame, after a check of its checksum and of its decoded size, which must be `due_bytes`."""
        # Sizes in a hostile file may ask for any amount of memory, so they are bounded before anything is read.
        possible = size <= due_bytes + _HEADER_BYTES + _CRC_BYTES and offset < 2**63 - size
        stored = self._bytes(field, shard, offset, size) if possible else b""
        body, checksum = stored[:-_CRC_BYTES], int.from_bytes(stored[-_CRC_BYTES:], "little")
        if len(body) < _HEADER_BYTES or google_crc32c.value(body) != checksum:
            raise self._fault(field, shard, scene, "the checksum does not match")
        decoded_bytes, stored_bytes = _sizes(body)
        if (decoded_bytes, stored_bytes) != (due_bytes, len(body)):
            raise self._fault(field, shard, scene, f"holds {decoded_bytes} bytes where {due_bytes} belong")
        return body

    def _decoded(
        self, field: Field, shard: int, scene: int | None, frame: bytes, out: NDArray[np.generic]
    ) -> NDArray[np.generic]:
        try:
            blosc.decompress(frame, out)
        except (RuntimeError, ValueError) as error:
            raise self._fault(field, shard, scene, f"cannot be decoded ({error})") from None
        return out

    def _index(self, field: Field, shard: int) -> NDArray[np.generic]:
        """(scene, *chunks, 2) offset and size of every chunk of a shard. The index lies at the end of the file."""
        shape = (self._schema.scenes_per_shard, *chunk_grid(field), 2)
        size = math.prod(shape) * 8
        stored = self._bytes(field, shard, max(self._size(field, shard) - size - _CRC_BYTES, 0), size + _CRC_BYTES)
        checksum = int.from_bytes(stored[-_CRC_BYTES:], "little")
        if len(stored) != size + _CRC_BYTES or google_crc32c.value(stored[:-_CRC_BYTES]) != checksum:
            raise self._fault(field, shard, None, "the shard's index is damaged")
        return np.frombuffer(stored, "<u8", count=size // 8).reshape(shape)

    def _size(self, field: Field, shard: int) -> int:
        """Bytes of a shard's file, which must be those of the commit record unless all scenes were checked before."""
        try:
            size = size_of(self._root / shard_file(field, shard))
        except OSError as error:
            raise self._fault(field, shard, None, f"cannot be opened ({error.strerror})") from None
        scenes = self._schema.scenes_of(shard)
        if self._check and not self._seen[field.name][scenes.start : scenes.stop].all():
            due, _ = self._record(shard)[field.name]
            if size != due and size != self._size_when_grown(field, shard):
                raise self._fault(field, shard, None, f"{size} bytes, {due} were written")
        return size

    def _size_when_grown(self, field: Field, shard: int) -> int | None:
        """Bytes of a shard's file in the larger dataset, whose files take their places one after the other before the
        record does; None without a growth. The values of all scenes that both have are the same."""
        with suppress(CheckError):
            record = read_record(self._root / GROWTH, shard)
            file = record.files.get(shard_file(field, shard)) if record else None
            return file.bytes if file else None
        return None

    def _bytes(self, field: Field, shard: int, offset: int, size: int) -> bytes:
        try:
            return read_range(self._root / shard_file(field, shard), offset, size)
        except OSError as error:
            raise self._fault(field, shard, None, f"cannot be opened ({error.strerror})") from None

    def _check_digest(self, field: Field, scene: int, value: NDArray[np.generic]) -> None:
        """Compare a scene's value with the digest in its record, unless that was done before."""
        seen = self._seen[field.name]
        if not self._check or seen[scene]:
            return
        shard, within = divmod(scene, self._schema.scenes_per_shard)
        due = self._record(shard)[field.name][1][_STATED_BYTES * within :][:_STATED_BYTES]
        if due != _NOT_MADE and _MADE + bytes.fromhex(digest(field, value)) != due:
            raise self._fault(field, shard, scene, f"field {field.name} decodes to other values than were written")
        seen[scene] = True

    def _record(self, shard: int) -> dict[str, tuple[int, bytes]]:
        """Field → size of its file, and digests of the scenes, end to end, as the record of a shard states them."""
        if shard not in self._records:
            stated = self._stated(shard)
            # Copies that are made when the record is gone, which took megabytes: what stays would else lie behind
            # them, and the system would not get them back.
            self._records[shard] = {name: (size, bytes(digests)) for name, (size, digests) in stated.items()}
        return self._records[shard]

    def _stated(self, shard: int) -> dict[str, tuple[int, bytearray]]:
        """What `_record` returns, read from the record's file."""
        record = read_record(self._root, shard)
        due = self._schema, self._manifest.fingerprint
        wrong = record.mismatch(*due, extent="any") if record else "is not committed"
        if record is None or wrong:
            raise CheckError(f"{self._root}: shard {shard} {wrong}; run the same `datagen build` again")
        return {
            name: (
                record.files[shard_file(field, shard)].bytes,
                bytearray().join(
                    _NOT_MADE if scene.failure is not None else _MADE + bytes.fromhex(scene.digests[name])
                    for scene in record.scenes
                ),
            )
            for name, field in self._fields.items()
        }

    def _fault(self, field: Field, shard: int, scene: int | None, what: str) -> CheckError:
        scenes = self._schema.scenes_of(shard)
        where = f"scenes {scenes.start}-{scenes.stop - 1}" if scene is None else f"scene {scene}"
        path = self._root / shard_file(field, shard)
        return CheckError(f"{path}, {where}: {what}; run the same `datagen build` again to make shard {shard} anew")


def _stored_dtype(field: Field) -> np.dtype[np.generic]:
    """The dtype of a field's values in its files."""
    return np.dtype(field.dtype).newbyteorder("<")


# A blosc frame (c-blosc 1, README_CHUNK_FORMAT) is a header, the offset of each block, and the blocks. numcodecs
# decodes whole frames only. But each block is compressed and shuffled by itself, so some of the blocks under a new
# header are a frame, too. With this, reading 16 × 16 of 64 × 64 laser points takes less than half of the time.


def _sizes(frame: bytes) -> tuple[int, int]:
    """Decoded size and compressed size of a frame in bytes, as its header states them."""
    decoded, stored = struct.unpack_from("<4xI4xI", frame)
    return decoded, stored


def _block_bytes(frame: bytes) -> int:
    """Decoded size of a block in bytes; that of the whole frame if its blocks cannot be decoded one by one."""
    decoded, block = struct.unpack_from("<4xII", frame)
    apart = frame[2] & _UNSPLIT and not frame[2] & _PLAIN and 0 < block < decoded
    return int(block if apart else decoded)


def _some_blocks(frame: bytes, first: int, stop: int) -> bytes:
    """A frame with the blocks first … stop − 1 of `frame`. Raises `ValueError` if a block lies outside of `frame`."""
    decoded, block, stored = struct.unpack_from("<4xIII", frame)
    count = -(-decoded // block)
    if len(frame) < _HEADER_BYTES + 4 * count:
        raise ValueError("a table of blocks that is cut short")
    begins = np.frombuffer(frame, "<i4", count, _HEADER_BYTES)
    if begins.min() < _HEADER_BYTES + 4 * count or begins.max() >= stored:
        raise ValueError("blocks outside of it")
    # If several threads compressed the blocks, these lie in the order in which they were finished.
    ordered = np.sort(begins)
    ends = np.append(ordered[1:], stored)[np.searchsorted(ordered, begins)]
    pieces = [frame[begins[one] : ends[one]] for one in range(first, stop)]
    starts = np.cumsum([_HEADER_BYTES + 4 * len(pieces), *map(len, pieces)])
    size = min(stop * block, decoded) - first * block
    header = frame[:4] + struct.pack("<III", size, min(block, size), int(starts[-1]))
    return b"".join([header, starts[:-1].astype("<i4").tobytes(), *pieces])
