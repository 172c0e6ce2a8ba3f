"""Reading scenes: the one way from a dataset's files to values, for every field and size.

A file must be there, have the size that the commit record states, and its checksums must match; decoded values must
have the digest that the record states. Nothing that is missing reads as a value. Sharded fields are read at random,
fast: shard index cached, one `pread` a chunk, blosc into place; equal to zarr's own reading by test. Of a part of a
value only those blocks of its chunks are decoded that hold it.
"""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import google_crc32c
import numpy as np
from numpy.typing import NDArray

from datagen.errors import CheckError
from datagen.store import blosc_frames
from datagen.store.arrays import chunk_grid, shard_file
from datagen.store.field_file import MISSING
from datagen.store.manifest import Manifest
from datagen.store.open_files import OpenFile, OpenFiles, OpenObject
from datagen.store.parts import Part, Plan, Rows, plan, rows_in, take
from datagen.store.places import Place
from datagen.store.record import FileRecord, read_record
from datagen.store.schema import Field
from datagen.store.shard import digest
from datagen.store.threads import in_turn

MEMORY_BYTES = 256 * 2**20
"""Decoded values that a reader keeps: of small fields, and of those that decode to a quarter of this in all."""
_CRC_BYTES = 4
_HASHED_AT_ONCE = 2**24


@dataclass(frozen=True)
class _Promise:
    """What a commit record states of the fields that are read: of their files; field → digest of each scene."""

    files: Mapping[str, FileRecord]
    digests: Mapping[str, Sequence[bytes | None]]


class DatasetReader:
    """The values of a dataset. Not to be shared between threads of yours; a fork may go on with it.

    Parameters
    ----------
    fields : those that will be read.
    check : compare every value with its digest when it is first read, and sizes with the commit record. Without it
        missing and damaged files are still found, by the checksums in them, but not files put in another's place.
        A digest is of a whole value: where parts are read, the shard's file is compared with its hash instead, once.
    seen : field → (scenes,) true where the digest was found right already; shared between processes, it spares
        each of them what others have checked.
    """

    def __init__(
        self, root: Place, manifest: Manifest, fields: Iterable[str], check: bool = True,
        seen: Mapping[str, NDArray[np.bool_]] | None = None,
    ) -> None:  # fmt: skip
        self._root, self._manifest, self._schema = root, manifest, manifest.schema
        self._fields = {name: self._schema.by_name[name] for name in fields}
        self._check = check
        self._seen = seen or {name: np.zeros(self._schema.scenes, bool) for name in self._fields}
        self._promises: dict[int, _Promise] = {}
        self._files = OpenFiles()
        self._kept: OrderedDict[tuple[str, int, Part | None], NDArray[np.generic]] = OrderedDict()
        self._kept_bytes = 0
        self._rows: dict[tuple[str, Part], list[tuple[tuple[int, ...], Rows]]] = {}
        self._plans: dict[tuple[str, Part, tuple[int, ...], int], Plan] = {}

    def read(
        self, name: str, scenes: Sequence[int], part: Part | None = None, out: NDArray[np.generic] | None = None
    ) -> NDArray[np.generic]:
        """(len(scenes), *field.shape): the scenes' values in the field's dtype; with `part` (len(scenes),
        *part.shape). Into `out`, where that is given, of this shape, cast to its dtype one by one, which needs less
        memory traffic than casting the whole.

        Raises `CheckError` naming file, scene and remedy for what is missing, damaged or other than was written.
        """
        field = self._fields[name]
        stored = np.dtype(field.dtype).newbyteorder("<")
        if out is None:
            out = np.empty((len(scenes), *(part or field).shape), stored)
        if not field.sharded or self._is_kept(field, part):
            for row, scene in enumerate(scenes):
                out[row] = self._kept_value(field, scene, part)
            return out

        def into(row: int) -> None:
            if part is not None:
                self._decode_part(field, scenes[row], part, out[row])
            elif out.dtype == stored:
                self._decode(field, scenes[row], out[row])
            else:
                decoded = np.empty(field.shape, stored)
                self._decode(field, scenes[row], decoded)
                out[row] = decoded

        in_turn(into, len(scenes), out.nbytes)
        return out

    def close(self) -> None:
        """Close all files; a later read opens them again."""
        self._files.close()

    def _is_kept(self, field: Field, part: Part | None) -> bool:
        value_bytes = math.prod((part or field).shape) * np.dtype(field.dtype).itemsize
        return 4 * self._schema.scenes * value_bytes <= MEMORY_BYTES

    def _kept_value(self, field: Field, scene: int, part: Part | None) -> NDArray[np.generic]:
        """One scene's value, or the part of it, from memory if it is there."""
        if not field.sharded:
            value = self._small(field, scene)
            return value if part is None else part.of(value)
        kept = self._kept.get((field.name, scene, part))
        if kept is None:
            kept = np.empty((part or field).shape, np.dtype(field.dtype).newbyteorder("<"))
            if part is None:
                self._decode(field, scene, kept)
            else:
                self._decode_part(field, scene, part, kept)
            self._keep((field.name, scene, part), kept)
        return kept

    def _small(self, field: Field, scene: int) -> NDArray[np.generic]:
        """The same of a field whose file is one chunk of all scenes of its shard."""
        shard, within = divmod(scene, self._schema.scenes_per_shard)
        values = self._kept.get((field.name, shard, None))
        if values is None:
            file = self._opened(field, shard)
            values = np.empty((self._schema.scenes_per_shard, *field.shape), np.dtype(field.dtype).newbyteorder("<"))
            self._decode_chunk(field, shard, None, file, 0, file.size, values)
            self._keep((field.name, shard, None), values)
        value: NDArray[np.generic] = values[within, ...]
        self._check_digest(field, scene, value)
        return value

    def _keep(self, key: tuple[str, int, Part | None], values: NDArray[np.generic]) -> None:
        self._kept[key] = values
        self._kept_bytes += values.nbytes
        while self._kept_bytes > MEMORY_BYTES:
            self._kept_bytes -= self._kept.popitem(last=False)[1].nbytes

    def _decode(self, field: Field, scene: int, out: NDArray[np.generic]) -> None:
        """One scene of a sharded field, chunk by chunk into `out`, checked."""
        shard, within = divmod(scene, self._schema.scenes_per_shard)
        file = self._opened(field, shard)
        for place in product(*(range(n) for n in chunk_grid(field))):
            offset, size = self._whereabouts(field, scene, file, (within, *place))
            corner = tuple(slice(p * c, (p + 1) * c) for p, c in zip(place, field.chunk, strict=True))
            target = out[corner]
            fits = target.shape == field.chunk and target.flags.c_contiguous
            chunk = target if fits else np.empty(field.chunk, out.dtype)
            self._decode_chunk(field, shard, scene, file, offset, size, chunk)
            if not fits:
                target[...] = chunk[tuple(slice(n) for n in target.shape)]
        self._check_digest(field, scene, out)

    def _decode_part(self, field: Field, scene: int, part: Part, out: NDArray[np.generic]) -> None:
        """A part of one scene of a sharded field into `out`, of its checksums and file checked."""
        shard, within = divmod(scene, self._schema.scenes_per_shard)
        file = self._opened(field, shard)
        if self._check and not self._seen[field.name][scene]:
            self._check_file(field, shard, file)
        stored, row_items = np.dtype(field.dtype).newbyteorder("<"), field.shape[-1]
        chunk_items, rows_out = math.prod(field.chunk), out.reshape(-1, out.shape[-1])
        for place, rows in self._wanted(field, part):
            offset, size = self._whereabouts(field, scene, file, (within, *place))
            frame = self._frame(field, shard, scene, file, offset, size, chunk_items * stored.itemsize)
            block = blosc_frames.block_bytes(frame) // stored.itemsize
            key = field.name, part, place, block
            if key not in self._plans:
                self._plans[key] = plan(rows, row_items, chunk_items, block)
            try:
                take(frame, self._plans[key], part, row_items, stored, rows_out)
            except (RuntimeError, ValueError) as error:
                raise self._fault(field, shard, scene, f"cannot be decoded ({error})") from None

    def _wanted(self, field: Field, part: Part) -> list[tuple[tuple[int, ...], Rows]]:
        """The chunks that hold a part, and what it wants of each."""
        key = field.name, part
        if key not in self._rows:
            chunks = [(at, rows_in(part, field.chunk, at)) for at in product(*(range(n) for n in chunk_grid(field)))]
            self._rows[key] = [(at, rows) for at, rows in chunks if len(rows.source)]
        return self._rows[key]

    def _whereabouts(
        self, field: Field, scene: int, file: OpenFile | OpenObject, place: tuple[int, ...]
    ) -> tuple[int, int]:
        """Offset and size of a chunk in its shard."""
        offset, size = (int(n) for n in file.index[place])
        if offset == MISSING:
            shard = scene // self._schema.scenes_per_shard
            raise self._fault(field, shard, scene, "the chunk is missing from its shard")
        return offset, size

    def _frame(
        self, field: Field, shard: int, scene: int | None, file: OpenFile | OpenObject, offset: int, size: int,
        due_bytes: int,
    ) -> bytes:  # fmt: skip
        """A chunk as it is compressed, its checksum right, that states to hold so many bytes."""
        # Nothing is believed of sizes: they may ask for any amount of memory.
        head = blosc_frames.HEADER_BYTES
        possible = offset + size <= file.size and size <= due_bytes + head + _CRC_BYTES
        stored = file.read(size, offset) if possible else b""
        body, checksum = stored[:-_CRC_BYTES], int.from_bytes(stored[-_CRC_BYTES:], "little")
        if len(body) < head or google_crc32c.value(body) != checksum:
            raise self._fault(field, shard, scene, "the checksum does not match")
        decoded_bytes, stored_bytes = blosc_frames.sizes(body)
        if (decoded_bytes, stored_bytes) != (due_bytes, len(body)):
            raise self._fault(field, shard, scene, f"holds {decoded_bytes} bytes where {due_bytes} belong")
        return body

    def _decode_chunk(
        self, field: Field, shard: int, scene: int | None, file: OpenFile | OpenObject, offset: int, size: int,
        out: NDArray[np.generic],
    ) -> None:  # fmt: skip
        body = self._frame(field, shard, scene, file, offset, size, out.nbytes)
        try:
            blosc_frames.decode(body, out)
        except (RuntimeError, ValueError) as error:
            raise self._fault(field, shard, scene, f"cannot be decoded ({error})") from None

    def _check_file(self, field: Field, shard: int, file: OpenFile | OpenObject) -> None:
        """Compare a shard's file with the hash in its commit record: then all in it is as it was written."""
        whole = hashlib.sha256()
        for offset in range(0, file.size, _HASHED_AT_ONCE):
            whole.update(file.read(_HASHED_AT_ONCE, offset))
        if whole.hexdigest() != self._promise(shard).files[field.name].sha256:
            raise self._fault(field, shard, None, "its bytes have changed since they were written (SHA-256 differs)")
        scenes = self._schema.scenes_of(shard)
        self._seen[field.name][scenes.start : scenes.stop] = True

    def _check_digest(self, field: Field, scene: int, value: NDArray[np.generic]) -> None:
        seen = self._seen[field.name]
        if not self._check or seen[scene]:
            return
        shard, within = divmod(scene, self._schema.scenes_per_shard)
        due = self._promise(shard).digests[field.name][within]
        # Of a scene that could not be made there is no digest, and nothing to be right or wrong.
        if due is not None and bytes.fromhex(digest(field, value)) != due:
            raise self._fault(field, shard, scene, f"field {field.name} decodes to other values than were written")
        seen[scene] = True

    def _opened(self, field: Field, shard: int) -> OpenFile | OpenObject:
        path = self._root / shard_file(field, shard)
        file = self._files.get(path)
        if file is None:
            try:
                file = self._files.open(path)
            except OSError as error:
                raise self._fault(field, shard, None, f"cannot be opened ({error.strerror})") from None
            scenes = self._schema.scenes_of(shard)
            if self._check and not self._seen[field.name][scenes.start : scenes.stop].all():
                due = self._promise(shard).files[field.name].bytes
                if file.size != due:
                    raise self._fault(field, shard, None, f"{file.size} bytes, {due} were written")
            if field.sharded:
                file.index = self._index(field, shard, file)
            self._files.keep(path, file)
        return file

    def _index(self, field: Field, shard: int, file: OpenFile | OpenObject) -> NDArray[np.uint64]:
        """(scene, *chunks, 2): offset and size of every chunk, from the end of the file."""
        shape = (self._schema.scenes_per_shard, *chunk_grid(field), 2)
        size = int(np.prod(shape)) * 8
        stored = file.read(size + _CRC_BYTES, max(file.size - size - _CRC_BYTES, 0))
        if len(stored) != size + _CRC_BYTES or google_crc32c.value(stored[:-_CRC_BYTES]) != int.from_bytes(
            stored[-_CRC_BYTES:], "little"
        ):
            raise self._fault(field, shard, None, "the shard's index is damaged")
        return np.frombuffer(stored, "<u8", count=size // 8).reshape(shape)

    def _promise(self, shard: int) -> _Promise:
        """What the commit record of a shard states, read once."""
        if shard not in self._promises:
            manifest = self._manifest
            record = read_record(self._root, shard, manifest.must_be_sealed)
            wrong = record.mismatch(self._schema, manifest.fingerprint) if record else "is not committed"
            if record is None or wrong:
                raise CheckError(f"{self._root}: shard {shard} {wrong}; run the same `datagen build` again")
            digests: dict[str, list[bytes | None]] = {name: [] for name in self._fields}
            for scene in record.scenes:
                for name, values in digests.items():
                    values.append(bytes.fromhex(scene.digests[name]) if scene.failure is None else None)
            files = {name: record.files[shard_file(field, shard)] for name, field in self._fields.items()}
            self._promises[shard] = _Promise(files, digests)
        return self._promises[shard]

    def _fault(self, field: Field, shard: int, scene: int | None, what: str) -> CheckError:
        scenes = self._schema.scenes_of(shard)
        where = f"scenes {scenes.start}-{scenes.stop - 1}" if scene is None else f"scene {scene}"
        path = self._root / shard_file(field, shard)
        return CheckError(f"{path}, {where}: {what}; run the same `datagen build` again to make shard {shard} anew")
