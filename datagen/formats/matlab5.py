"""A reader of the arrays of numbers in MATLAB files of versions 5 to 7.

The format is MathWorks' *MAT-File Format* (2019), chapter 1. `scipy.io.loadmat` ends the process on some damaged
files; this reader checks sizes before it uses them.
"""

from __future__ import annotations

import math
import mmap
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from datagen.errors import InputError
from datagen.untrusted import CAPTURE_BYTES, DEFLATE_REACHES, check_expansion, opened

_HEAD = 4096
"""First bytes of a variable, which must contain its name and sizes."""
_PACKED_BYTES, _PIECE_BYTES = 2**16, 2**20
"""Bytes that are decompressed at once, before and after."""
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED = 1, 5, 6, 14, 15
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_STRUCTURE = 2
_NO_NUMBERS = {1: "cell array", 2: "structure", 3: "object", 4: "text", 5: "sparse array"}
_NUMBERS = range(6, 16)
_IS_COMPLEX = 0x0800
_MOST_AXES = 32


@dataclass(frozen=True)
class Variable:
    """The head of a variable.

    kind : MATLAB's number of its class. at : offset of the numbers within the element. bytes : length of the numbers
    as they are stored, which may be in a narrower type than MATLAB has.
    """

    name: str
    kind: int
    is_complex: bool
    shape: tuple[int, ...]
    at: int
    bytes: int

    @property
    def is_structure(self) -> bool:
        """Whether it has fields, which are variables themselves."""
        return self.kind == _STRUCTURE


def read_matlab5(
    path: Path, wanted: Mapping[str, int]
) -> tuple[Mapping[str, NDArray[Any]], dict[str, tuple[int, ...] | None]]:
    """Name → array of the wanted variables, axes in MATLAB's order, and name → shape of all variables, None of
    what holds no numbers.

    wanted : name → the most numbers that a variable of this name has. `structure.field` names a field of a structure.

    The dtype is that of the file, which may store whole numbers in a narrower type than MATLAB has. Raises
    `InputError` or `ValueError` for wanted variables that are damaged, no array of real numbers, have more numbers
    than is wanted, or are together more than `check_expansion` lets pass; no value has been read then.
    """
    arrays, shapes = dict[str, NDArray[Any]](), dict[str, tuple[int, ...] | None]()
    structures = {name.partition(".")[0] for name in wanted if "." in name}
    chosen, declared, stored = list[tuple[bool, int, int, Variable]](), 0, 0
    with opened(path) as (_, file), mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if content[124:128] != b"\x00\x01IM":
            raise InputError(f"{path}: is no MATLAB file of version 5 or 7.3; save it with -v7 or -v7.3")
        for kind, begin, end in _elements(content):
            compressed = kind == _COMPRESSED
            if not compressed and kind != _MATRIX:
                continue
            head = content[begin : min(end, begin + _HEAD)]
            found = _variable(_unpacked(head, _HEAD)[8:] if compressed else memoryview(head))
            shapes[found.name] = found.shape if found.kind in _NUMBERS else None
            if found.is_structure and found.name in structures:
                # All of it is read, since where a field begins is told by those before it.
                size = _size_of(head) if compressed else end - begin
                if size > DEFLATE_REACHES * (end - begin):
                    raise InputError(f"{path}: {found.name}: {size} bytes declared, more than the file can hold")
                found = replace(found, bytes=size)
            elif found.name in wanted:
                _check(path, found, wanted[found.name], end - begin)
            else:
                continue
            chosen.append((compressed, begin, end, found))
            declared, stored = declared + found.bytes, stored + end - begin
        check_expansion(str(path), declared, stored, CAPTURE_BYTES)
        for compressed, begin, end, found in chosen:
            packed = content[begin:end]
            matrix = _unpacked(packed, 8 + _HEAD + found.bytes)[8:] if compressed else memoryview(packed)
            if found.is_structure:
                arrays |= _fields(path, matrix, found, wanted)
            else:
                arrays[found.name] = _numbers(matrix, found)
    return arrays, shapes


def _size_of(head: bytes) -> int:
    """Bytes of the matrix in a compressed element that begins with `head`, as its tag states them."""
    (size,) = struct.unpack("<I", zlib.decompressobj().decompress(head, 8)[4:8])
    return int(size)


def _fields(path: Path, matrix: memoryview, found: Variable, wanted: Mapping[str, int]) -> dict[str, NDArray[Any]]:
    """`structure.field` → array of the wanted fields of a structure. Raises as `read_matlab5`."""
    if math.prod(found.shape) != 1:
        raise InputError(f"{path}: {found.name}: shape {found.shape}; a single structure is read")
    # Where the numbers of an array begin, a structure has the length of its names, and then the names.
    kind, length, at = _element(matrix, found.at)
    named, text, at = _element(matrix, at)
    if (
        (kind, named) != (_INT32, _INT8)
        or len(length) != 4
        or not 0 < (width := struct.unpack("<i", length)[0]) <= 64
    ):
        raise ValueError(f"{found.name} has no names of its fields")
    arrays = dict[str, NDArray[Any]]()
    for begin in range(0, len(text), width):
        kind, content, at = _element(matrix, at)
        name = f"{found.name}.{bytes(text[begin : begin + width]).split(bytes(1))[0].decode('latin-1')}"
        if name in wanted and kind == _MATRIX and len(content):
            field = _variable(content)
            _check(path, replace(field, name=name), wanted[name], len(content))
            arrays[name] = _numbers(content, replace(field, name=name))
    return arrays


def _elements(content: mmap.mmap) -> Iterator[tuple[int, int, int]]:
    """(type, begin, end) of the data elements of a file."""
    at = 128
    while at + 8 <= len(content):
        kind, size = struct.unpack("<II", content[at : at + 8])
        if at + 8 + size > len(content):
            raise ValueError("ends before its last variable does")
        yield kind, at + 8, at + 8 + size
        at += 8 + size


def _unpacked(packed: bytes, most: int) -> memoryview:
    """The first `most` bytes of a compressed element: the tag of the matrix (8 bytes), then the matrix. Slices of a
    view are no copies, and a variable may fill half of the memory."""
    # Into one buffer piece by piece: zlib itself joins its pieces in the end, which takes the memory twice.
    found, size, reader = memoryview(bytearray(most)), 0, zlib.decompressobj()
    for begin in range(0, len(packed), _PACKED_BYTES):
        rest = packed[begin : begin + _PACKED_BYTES]
        # Also without input, to fetch what the decompressor still holds.
        while size < most and (piece := reader.decompress(rest, min(_PIECE_BYTES, most - size))):
            found[size : size + len(piece)] = piece
            size, rest = size + len(piece), reader.unconsumed_tail
    if size < 8 or struct.unpack("<I", found[:4])[0] != _MATRIX:
        raise ValueError("holds a compressed element that is no array")
    return found[:size]


def _element(matrix: memoryview, at: int) -> tuple[int, memoryview, int]:
    """(type, content, offset of the next) of the element at an offset of a matrix."""
    kind, size = struct.unpack("<II", matrix[at : at + 8])
    if kind >> 16:
        # The tag itself contains up to four bytes.
        return kind & 0xFFFF, matrix[at + 4 : at + 4 + min(kind >> 16, 4)], at + 8
    if at + 8 + size > len(matrix):
        raise ValueError("an array ends before its numbers do")
    return kind, matrix[at + 8 : at + 8 + size], at + 8 + -(-size // 8) * 8


def _variable(head: memoryview) -> Variable:
    kind, flags, at = _element(head, 0)
    sized, dims, at = _element(head, at)
    named, name, at = _element(head, at)
    if (kind, sized, named) != (_UINT32, _INT32, _INT8) or len(flags) != 8 or len(dims) % 4:
        raise ValueError("an array has no head")
    shape = struct.unpack(f"<{len(dims) // 4}i", dims)
    if not 2 <= len(shape) <= _MOST_AXES or min(shape) < 0:
        raise ValueError(f"an array of the shape {shape}")
    (flag,) = struct.unpack("<I", flags[:4])
    # The tag of the numbers, which may be cut off from what is no array of numbers.
    tag, size = struct.unpack("<II", head[at : at + 8]) if at + 8 <= len(head) else (0, 0)
    stored = tag >> 16 or size
    return Variable(bytes(name).decode("latin-1"), flag & 0xFF, bool(flag & _IS_COMPLEX), shape, at, stored)


def _check(path: Path, found: Variable, most: int, stored_bytes: int) -> None:
    """Refuse a variable that is no array of real numbers, or has more numbers than `most`, or than `stored_bytes`
    can hold."""
    count = math.prod(found.shape)
    if found.kind not in _NUMBERS or found.is_complex:
        kind = "complex array" if found.is_complex else _NO_NUMBERS.get(found.kind, "thing of no known kind")
        raise InputError(f"{path}: {found.name}: is a {kind}, an array of real numbers is needed")
    if count > most:
        raise InputError(f"{path}: {found.name}: shape {found.shape}; at most {most} numbers are read")
    if max(count, found.bytes) > DEFLATE_REACHES * stored_bytes:
        raise InputError(f"{path}: {found.name}: shape {found.shape} declared, more than the file can hold")


def _numbers(matrix: memoryview, found: Variable) -> NDArray[Any]:
    kind, content, _ = _element(matrix, found.at)
    dtype = np.dtype("<" + _TYPES[kind]) if kind in _TYPES else None
    if dtype is None or len(content) != math.prod(found.shape) * dtype.itemsize:
        raise ValueError(f"{found.name} is not as long as its shape {found.shape} says")
    return np.frombuffer(content, dtype).reshape(found.shape, order="F")
