"""Compressed files, arrays and JSON that anybody may have written, read with a bound on the memory that they take.

A few kilobytes can claim to hold terabytes: compressed text of one repeated letter, an array whose head states a
shape that the file has no values for, a list of empty objects. Every size is compared with what the file has before
memory is taken for it, and lists of numbers become arrays piece by piece.
"""

from __future__ import annotations

import errno
import gzip
import io
import json
import math
import os
import re
import stat
import warnings
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from datagen.errors import CheckError, InputError, TooLargeError, printable

NO_PLAIN_FILE = "is no plain file (but a folder, pipe, socket or device)"
"""What is said of what could have no end, or make its reader wait."""
MOST_BYTES = 2**31
"""Size of the largest file that is read, 2 GiB."""
MOST_TEXT_BYTES = 2**28
"""Size of the largest text that is read, decoded, 256 MiB."""
MOST_PACKED = 50
"""Largest ratio of decoded bytes to stored ones. Recorded histograms and tables reach 7, mostly empty ones some
30."""
DEFLATE_REACHES = 1100
"""Ratio that deflate stays below: it reaches 1032. An array that declares more is not in the file."""
CAPTURE_BYTES = 2**28
"""Decoded bytes of a capture of y-tal or MATLAB that are read whatever that ratio is, 256 MiB: a scan of 128 × 128
points and 4096 bins in single precision, which compresses to a thousandth with a photon or two a point."""
ALWAYS_BYTES = 4 * 2**20
"""Decoded bytes that are read whatever that ratio is: they harm nobody, and a file of zeros is small."""
_MOST_HEAD_BYTES = 10_000
"""Length of the longest head of an array that numpy itself reads."""
_PIECE_BYTES = 2**18


@contextmanager
def opened(path: Path) -> Iterator[tuple[int, io.BufferedReader]]:
    """Size and content of a plain file. Raises `OSError` if there is none (errno EINVAL for what is no plain file,
    and may have no end or make its reader wait: a folder, pipe, socket or device, or a link to one), and `CheckError`
    if this process has too many files open."""
    try:
        # Without O_NONBLOCK opening a pipe would wait for a writer.
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except ValueError:
        # No path has a null character; files from elsewhere may name such a one.
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path)) from None
    except OSError as error:
        if error.errno in (errno.EMFILE, errno.ENFILE):
            raise CheckError(f"{path}: this process has too many files open; allow more (`ulimit -n`)") from None
        if error.errno == errno.ENXIO:
            # A socket cannot be opened.
            raise OSError(errno.EINVAL, NO_PLAIN_FILE, str(path)) from None
        raise
    # Asked before Python makes a file of it: that fails for a folder, with another error, and leaves it open.
    status = os.fstat(handle)
    if not stat.S_ISREG(status.st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, NO_PLAIN_FILE, str(path))
    with open(handle, "rb") as file:
        yield status.st_size, file


def content_of(path: Path) -> bytes:
    """The content of a plain file; raises as `opened`."""
    with opened(path) as (_, file):
        return file.read()


def why_no_file(path: Path) -> str | None:
    """Words on what is in the place of a plain file; None if there is one."""
    # These of `os.path` say no to names that no file can have; pathlib's raise.
    if os.path.isfile(path):
        return None
    if os.path.isdir(path):
        return "is a directory"
    return NO_PLAIN_FILE if os.path.exists(path) else "no such file"


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
    with opened(path) as (_, stored):
        packed = path.suffix == ".gz"
        reader: IO[bytes] = gzip.GzipFile(fileobj=stored) if packed else stored  # type: ignore[assignment]
        while piece := reader.read(_PIECE_BYTES):
            content += piece
            if len(content) > MOST_TEXT_BYTES:
                raise TooLargeError(f"{path}: more than {MOST_TEXT_BYTES} bytes of text; cut it into smaller files")
            if packed:
                check_expansion(str(path), len(content), stored.tell())
    return content


def check_expansion(where: str, decoded: int, stored: int, always_bytes: int = ALWAYS_BYTES) -> None:
    """Raise `TooLargeError` where `decoded` bytes are more than `MOST_PACKED` times the `stored` ones, and more than
    `always_bytes`, which the caller has a use for whatever that ratio is."""
    if expands_too_far(decoded, stored, always_bytes):
        raise TooLargeError(
            f"{where}: decodes to {_megabytes(decoded)} or more, {_megabytes(stored)} are stored; at most "
            f"{MOST_PACKED} times as much is read beyond {_megabytes(always_bytes)}; if that is meant, store it "
            "uncompressed"
        )


def expands_too_far(decoded: int, stored: int, always_bytes: int = ALWAYS_BYTES) -> bool:
    """Whether `check_expansion` refuses these sizes."""
    return decoded > max(always_bytes, MOST_PACKED * stored)


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.3g} MB"


_STRING = rb'"(?:[^"\\]++|\\.)*+"'
_BRACKETS = re.compile(_STRING + rb"|[\[\]{}]", re.DOTALL)
_SCALAR = re.compile(_STRING + rb'|[^\s,:\[\]{}"]++', re.DOTALL)
_SPACE = re.compile(rb"[ \t\n\r]*+")
_NUMERIC = re.compile(rb"[-+0-9.eE,\[\] \t\n\r]*+")
_ROW = re.compile(rb"\[([^\[\]]*+)\]")
_TABLE = re.compile(rb"\[\s*+(?:\[[^\[\]]*+\]\s*+(?:,\s*+(?=\[)|(?=\])))++\]")
_MOST_IN_A_LIST = 2**20
"""Most numbers of one list, which Python holds at once: more than a histogram has bins."""

_MOST_OBJECTS = 2**18
"""Most objects of a list, which take half a kilobyte each beside their numbers: more than frames of a session."""


def read_records(path: Path, wanted: Sequence[str], named: str = "") -> Iterator[dict[str, NDArray[Any]]]:
    """The objects of a JSON list, which may be compressed, one after the other: those of the `wanted` keys that an
    object has, each a number, a list of numbers or a list of equally long lists of them; and the key `named`, whose
    value may be text, too.

    An array has the narrowest of some dtypes that holds its numbers exactly. Beside the text and the arrays that the
    caller keeps, memory is taken for one list of numbers at a time; what is not wanted is passed over.

    Raises as `read_text`, `TooLargeError` for more than `_MOST_OBJECTS`, and `ValueError` for other JSON.
    """
    text, count = read_text(path), 0
    at = _offset_after(
        text, len(b"\xef\xbb\xbf") if text.startswith(b"\xef\xbb\xbf") else 0, b"[", "a list of objects"
    )
    at, more = _item_follows(text, at, b"]")
    while more:
        count += 1
        if count > _MOST_OBJECTS:
            raise TooLargeError(f"{path}: has more than {_MOST_OBJECTS} frames; cut it into smaller files")
        at = _offset_after(text, at, b"{", "a list of objects")
        found = dict[str, NDArray[Any]]()
        at, inside = _item_follows(text, at, b"}")
        while inside:
            begin, end = _value(text, at)
            key = json.loads(text[begin:end])
            if not isinstance(key, str):
                raise ValueError("a key is needed where an object has something else")
            if key in found:
                raise ValueError(f"{key!r} comes twice in one object")
            begin, at = _value(text, _offset_after(text, end, b":", "a key with a value"))
            if key == named and text[begin : begin + 1] == b'"':
                found[key] = np.array(json.loads(text[begin:at]))
            elif key in (*wanted, named):
                found[key] = _numbers(text, begin, at, key)
            at, inside = _next_follows(text, at, b"}")
        yield found
        at, more = _next_follows(text, at, b"]")
    if _SPACE.fullmatch(text, at) is None:
        raise ValueError("more follows after its list")


def _offset_after(text: bytearray, at: int, sign: bytes, what: str) -> int:
    """The offset after a sign, which must come next; raises `ValueError` with what is needed."""
    at = _after_space(text, at)
    if text[at : at + 1] != sign:
        raise ValueError(f"{what} is needed")
    return at + 1


def _after_space(text: bytearray, at: int) -> int:
    found = _SPACE.match(text, at)
    return at if found is None else found.end()


def _item_follows(text: bytearray, at: int, end: bytes) -> tuple[int, bool]:
    """After an opening bracket: the offset of the first item, and True; or that after the closing one, and False."""
    at = _after_space(text, at)
    return (at + 1, False) if text[at : at + 1] == end else (at, True)


def _next_follows(text: bytearray, at: int, end: bytes) -> tuple[int, bool]:
    """After an item: the offset of the next item, and True; or that after the closing bracket, and False."""
    at = _after_space(text, at)
    sign = bytes(text[at : at + 1])
    if sign not in (b",", end) or not sign:
        raise ValueError("ends within a list, or lacks a comma")
    return at + 1, sign == b","


def _value(text: bytearray, at: int) -> tuple[int, int]:
    """(begin, end) of the value that comes next."""
    begin = _after_space(text, at)
    if bytes(text[begin : begin + 1]) not in (b"[", b"{"):
        scalar = _SCALAR.match(text, begin)
        if scalar is None:
            raise ValueError("ends where a value is needed")
        return begin, scalar.end()
    depth = 0
    for sign in _BRACKETS.finditer(text, begin):
        first = text[sign.start()]
        depth += first in b"[{"
        depth -= first in b"]}"
        if depth == 0:
            return begin, sign.end()
    raise ValueError("ends within a list")


def _numbers(text: bytearray, begin: int, end: int, key: str) -> NDArray[Any]:
    """The numbers of the value at begin … end of a text."""
    if _NUMERIC.fullmatch(text, begin, end) is None:
        raise ValueError(f"{key!r} holds more than finite numbers")
    if text[begin : begin + 1] != b"[" or text.count(b"[", begin, end) == 1:
        return _narrow(_list(text, begin, end, key))
    if _TABLE.fullmatch(text, begin, end) is None:
        raise ValueError(f"{key!r} is no list of lists of numbers")
    rows = _ROW.finditer(text, begin + 1, end)
    first = _list(text, *next(rows).span(), key)
    table = np.empty((text.count(b"[", begin, end) - 1, len(first)))
    table[0] = first
    for number, row in enumerate(rows, 1):
        values = _list(text, *row.span(), key)
        if len(values) != len(first):
            raise ValueError(f"{key!r} has lists of {len(first)} and of {len(values)} numbers")
        table[number] = values
    return _narrow(table)


def _list(text: bytearray, begin: int, end: int, key: str) -> NDArray[np.float64]:
    """The numbers of one list, or the number alone."""
    if text.count(b",", begin, end) >= _MOST_IN_A_LIST:
        raise TooLargeError(f"{key!r}: a list of more than {_MOST_IN_A_LIST} numbers; cut it into parts")
    return np.array(json.loads(text[begin:end]), np.float64)


def _narrow(values: NDArray[np.float64]) -> NDArray[Any]:
    """The values in the narrowest of some dtypes that holds them exactly."""
    for dtype in (np.uint16, np.int32, np.float32):
        with np.errstate(all="ignore"):
            narrow = values.astype(dtype)
        if np.array_equal(narrow, values):
            return narrow
    return values


def read_npy(path: Path) -> NDArray[Any]:
    """The array of an `.npy` file. Raises `TooLargeError` if its head declares more than the file has, `ValueError`
    for a damaged file, and for objects, which could run code."""
    with opened(path) as (size, file):
        _check_size(path, size)
        return _array(str(path), file, size)


def read_npz(
    path: Path, wanted: Iterable[str], always_bytes: int = ALWAYS_BYTES
) -> tuple[dict[str, NDArray[Any]], list[str]]:
    """Name → array of those `wanted` arrays that an `.npz` file has, and the names of all its arrays.

    always_bytes : decoded bytes that the caller has a use for, whatever their ratio to the stored ones is.

    Raises `TooLargeError` as `read_npy` and `check_expansion` do; errors of
    `zipfile` and `ValueError` for a damaged file.
    """
    with opened(path) as (size, file), zipfile.ZipFile(file) as archive:
        _check_size(path, size)
        members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        chosen = {name: members[name] for name in wanted if name in members}
        # Members may share their bytes, so all of them together are compared with the whole file.
        check_expansion(str(path), sum(info.file_size for info in chosen.values()), size, always_bytes)
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


def _check_size(path: Path, size: int) -> None:
    if size > MOST_BYTES:
        raise TooLargeError(f"{path}: {size} bytes, at most {MOST_BYTES} are read; cut it into parts")
