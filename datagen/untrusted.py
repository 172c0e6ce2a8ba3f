"""Compressed files, arrays and JSON that anybody may have written, read with a bound on the memory that they take.

A few kilobytes can claim to hold terabytes: compressed text of one repeated letter, an array whose head states a
shape that the file has no values for. Every size is compared with what the file has before memory is taken for it.
"""

from __future__ import annotations

import gzip
import io
import json
import math
import warnings
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from datagen.errors import InputError, TooLargeError, printable

MOST_BYTES = 2**31
"""Size of the largest file that is read, 2 GiB."""
MOST_TEXT_BYTES = 2**28
"""Size of the largest text that is read, decoded, 256 MiB; as Python's lists it takes up to twenty times as much."""
MOST_PACKED = 50
"""Largest ratio of decoded bytes to stored ones. Recorded histograms and tables reach 7, mostly empty ones some
30."""
DEFLATE_REACHES = 1100
"""Ratio that deflate stays below: it reaches 1032. A scan with a photon or two a pixel comes close to it as a capture
of y-tal or MATLAB, so for those it is the bound: what declares more is not in the file."""
ALWAYS_BYTES = 4 * 2**20
"""Decoded bytes that are read whatever that ratio is: they harm nobody, and a file of zeros is small."""
_MOST_HEAD_BYTES = 10_000
"""Length of the longest head of an array that numpy itself reads."""
_PIECE_BYTES = 2**18


@contextmanager
def one_line(refusal: str, remedy: str = "it is damaged, or of another kind") -> Iterator[None]:
    """Turn every error that a reader raises over a damaged file into one line: `refusal`, the reason, `remedy`."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError:
        raise
    except MemoryError:
        raise TooLargeError(f"{refusal} (does not fit into memory); cut it into smaller files") from None
    # Readers raise errors of some twenty classes for damaged files, RecursionError and struct.error among them.
    except Exception as error:
        reason = " ".join(printable(str(error)).split())[:200] or type(error).__name__
        raise InputError(f"{refusal} ({reason}); {remedy}") from None


def read_text(path: Path) -> bytearray:
    """The content of a text file, decompressed if its name ends in `.gz`.

    Raises `TooLargeError` for text of more than `MOST_TEXT_BYTES`, or `MOST_PACKED` times what the file has, and
    errors of `gzip` for a damaged file.
    """
    content = bytearray()
    with path.open("rb") as stored:
        packed = path.suffix == ".gz"
        reader: IO[bytes] = gzip.GzipFile(fileobj=stored) if packed else stored  # type: ignore[assignment]
        while piece := reader.read(_PIECE_BYTES):
            content += piece
            if len(content) > MOST_TEXT_BYTES:
                raise TooLargeError(f"{path}: more than {MOST_TEXT_BYTES} bytes of text; cut it into smaller files")
            if packed:
                _check_ratio(path, len(content), stored.tell())
    return content


def read_json(path: Path) -> Any:
    """The value of a JSON file, which may be compressed; raises as `read_text`, and errors of `json`."""
    return json.loads(read_text(path))


def read_npy(path: Path) -> NDArray[Any]:
    """The array of an `.npy` file. Raises `TooLargeError` if its head declares more than the file has, `ValueError`
    for a damaged file, and for objects, which could run code."""
    size = _size(path)
    with path.open("rb") as file:
        return _array(str(path), file, size)


def read_npz(
    path: Path, wanted: Iterable[str], always_bytes: int = ALWAYS_BYTES
) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Name → array of those `wanted` arrays that an `.npz` file has, and the names of all its arrays.

    always_bytes : decoded bytes that the caller has a use for, whatever their ratio to the stored ones is.

    Raises `TooLargeError` as `read_npy`, and for arrays of more than `MOST_PACKED` times what the file has; errors of
    `zipfile` and `ValueError` for a damaged file.
    """
    size = _size(path)
    with zipfile.ZipFile(path) as archive:
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        chosen = {name: members[name] for name in wanted if name in members}
        # Members may share their bytes, so all of them together are compared with the whole file.
        _check_ratio(path, sum(info.file_size for info in chosen.values()), size, always_bytes)
        return {name: _member(path, archive, info) for name, info in chosen.items()}, list(members)


def _member(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> NDArray[Any]:
    # Other methods take memory by what the file says of itself, before any value is decoded.
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{info.filename} is compressed by a method that numpy does not write")
    with archive.open(info) as stream:
        return _array(f"{path}: {printable(info.filename)}", stream, info.file_size)


def _array(where: str, stream: IO[bytes], size: int) -> NDArray[Any]:
    """The array that a stream of `size` bytes in numpy's format holds."""
    start = stream.read(npy.MAGIC_LEN)
    length = stream.read(2 if start[-2:-1] == b"\x01" else 4)
    head_bytes = int.from_bytes(length, "little")
    if head_bytes > _MOST_HEAD_BYTES:
        raise ValueError(f"its head has {head_bytes} bytes, at most {_MOST_HEAD_BYTES} are read")
    head = io.BytesIO(start + length + stream.read(head_bytes))
    version = npy.read_magic(head)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version} of numpy's format, 1.0 or 2.0 is needed")
    shape, by_columns, dtype = (npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0)(head)
    if dtype.hasobject or any(length < 0 for length in shape):
        raise ValueError(f"holds {dtype} {shape}, an array of numbers is needed")
    due = math.prod(shape) * dtype.itemsize
    if due > size - head.tell():
        raise TooLargeError(f"{where}: shape {shape} declared, more than the file has; write it anew")
    content = stream.read(due)
    # At the end of a stream the checksum of a compressed array is compared.
    stream.read(1)
    if len(content) < due:
        raise ValueError("ends before its values do")
    return np.frombuffer(content, dtype).reshape(shape, order="F" if by_columns else "C")


def _size(path: Path) -> int:
    size = path.stat().st_size
    if size > MOST_BYTES:
        raise TooLargeError(f"{path}: {size} bytes, at most {MOST_BYTES} are read; cut it into parts")
    return size


def _check_ratio(path: Path, decoded: int, stored: int, always_bytes: int = ALWAYS_BYTES) -> None:
    if decoded > max(always_bytes, MOST_PACKED * stored):
        raise TooLargeError(
            f"{path}: decodes to more than {MOST_PACKED} times its size; if that is meant, store it uncompressed"
        )
