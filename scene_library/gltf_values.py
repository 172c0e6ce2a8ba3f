"""The JSON of a GLB file (glTF 2.0), and the numbers that its accessors name.

Sizes are compared with what the file has before memory is taken for them, and nothing but the file itself is opened.
"""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
from numpy.typing import NDArray

from scene_library.mesh_file import BadMesh

Ints = NDArray[np.int64]
Json = dict[str, Any]

MOST_JSON_BYTES = 2**25
"""Size of the largest JSON part, 32 MiB, which may take 1 GB as Python's dictionaries. A model of 100 000 nodes has
some 20 MiB."""
COMPRESSED = {
    "KHR_draco_mesh_compression": "export it without mesh compression (Draco)",
    "EXT_meshopt_compression": "export it without mesh compression (meshopt; gltfpack: without -c)",
    "KHR_meshopt_compression": "export it without mesh compression (meshopt; gltfpack: without -c)",
}
"""Extension that packs numbers → what to do about it. A file may have the numbers unpacked beside it."""
BYTE, UNSIGNED_BYTE, SHORT, UNSIGNED_SHORT, UNSIGNED_INT, FLOAT = 5120, 5121, 5122, 5123, 5125, 5126
INDICES = (UNSIGNED_BYTE, UNSIGNED_SHORT, UNSIGNED_INT)
SMALL_OR_FLOAT = (BYTE, UNSIGNED_BYTE, SHORT, UNSIGNED_SHORT, FLOAT)
"""Types of positions, with KHR_mesh_quantization, of rotations and of weights."""
_TYPES = {BYTE: "<i1", UNSIGNED_BYTE: "<u1", SHORT: "<i2", UNSIGNED_SHORT: "<u2", UNSIGNED_INT: "<u4", FLOAT: "<f4"}
_AXES = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def not_read(extension: str) -> BadMesh:
    """The refusal of a file that needs an extension."""
    remedy = COMPRESSED.get(extension, "export it without, or convert it to .obj or .ply")
    return BadMesh(f"needs the glTF extension {extension[:60]}, which is not read; {remedy}")


def whole(of: Json, key: str, default: int | None = None) -> int:
    """A number of things, or of bytes. Raises `ValueError` for what is no whole number from 0 on."""
    value = of.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value < 0 or value % 1:
        raise ValueError(f"{key} = {str(value)[:40]}")
    return int(value)


def extension(of: Json, name: str) -> Json:
    """The content of an extension; empty where there is none."""
    found = of.get("extensions", {}).get(name, {})
    return found if isinstance(found, dict) else {}


@dataclass(frozen=True)
class Values:
    """The values of an accessor, as they lie in the file.

    Attributes
    ----------
    base : (n, axes) in the file's type.
    places, others : (k,), rising, and (k, axes): rows that take the place of those of `base`.
    is_scaled : whether the largest integer stands for 1; otherwise numbers stand for themselves.
    """

    base: NDArray[Any]
    places: Ints
    others: NDArray[Any]
    is_scaled: bool

    def __len__(self) -> int:
        return len(self.base)

    @property
    def largest(self) -> int:
        """The largest integer of the type."""
        return int(np.iinfo(self.base.dtype).max)

    def rows(self, which: Ints | None = None, of: type[np.generic] = np.float64) -> NDArray[Any]:
        """(m, axes) values of some rows, or of all, as another type."""
        found = self.base.astype(of) if which is None else self.base[which].astype(of)
        if len(self.places):
            numbers = np.arange(len(self.base)) if which is None else which
            at = np.minimum(np.searchsorted(self.places, numbers), len(self.places) - 1)
            is_other = self.places[at] == numbers
            found[is_other] = self.others[at[is_other]]
        # Of signed integers the two lowest stand for −1.
        return np.maximum(found / self.largest, -1.0) if self.is_scaled else found


@dataclass
class Gltf:
    """A GLB file: its JSON, and its binary part."""

    tree: Json
    binary: memoryview
    _unpacked: dict[int, memoryview] = field(default_factory=dict)

    def all(self, kind: str) -> list[Json]:
        """All things of a kind, such as `nodes`."""
        found = self.tree.get(kind, [])
        if not isinstance(found, list) or not all(isinstance(one, dict) for one in found):
            raise ValueError(f"{kind} is no list of objects")
        return found

    def one(self, kind: str, number: Any) -> Json:
        """One thing of a kind. Raises `ValueError` if there is none of that number."""
        things = self.tree.get(kind, [])
        if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < len(things):
            raise ValueError(f"{kind}[{str(number)[:20]}] is named and not there")
        thing: Json = things[number]
        return thing

    def values(self, number: int, kind: str, types: tuple[int, ...]) -> Values:
        """The values of an accessor of a kind, such as `VEC3`, in one of some types. Raises `BadMesh` for values that
        are packed or lie in another file, and `ValueError` for fewer bytes than there should be."""
        of = self.one("accessors", number)
        count, component = whole(of, "count"), whole(of, "componentType")
        if of.get("type") != kind or component not in types:
            raise ValueError(f"accessor {number} has the type {of.get('type')} of {component}")
        axes, of_type = _AXES[kind], np.dtype(_TYPES[component])
        if "bufferView" in of:
            base = self._table(of, count, axes, of_type)
        else:
            base = np.broadcast_to(np.zeros((), of_type), (count, axes))
        places, others = np.empty(0, np.int64), np.empty((0, axes))
        if "sparse" in of:
            some = whole(of["sparse"], "count")
            index_type = whole(of["sparse"]["indices"], "componentType")
            if index_type not in INDICES:
                raise ValueError(f"accessor {number} has sparse indices of the type {index_type}")
            found = self._table(of["sparse"]["indices"], some, 1, np.dtype(_TYPES[index_type]))
            places = found[:, 0].astype(np.int64)
            if (np.diff(places) <= 0).any() or (places >= count).any():
                raise ValueError(f"accessor {number} has sparse indices that do not rise, or that it does not have")
            others = self._table(of["sparse"]["values"], some, axes, of_type)
        return Values(base, places, others, bool(of.get("normalized", False)) and component != FLOAT)

    def _table(self, of: Json, count: int, axes: int, of_type: np.dtype[Any]) -> NDArray[Any]:
        """(count, axes) numbers where they lie in the file."""
        view = self.one("bufferViews", of.get("bufferView"))
        size = axes * of_type.itemsize
        step = whole(view, "byteStride", 0) or size
        content = self._buffer(view)
        begin, length = whole(view, "byteOffset", 0), whole(view, "byteLength")
        offset = whole(of, "byteOffset", 0)
        if step < size or begin + length > len(content) or (count and offset + step * (count - 1) + size > length):
            raise ValueError(
                f"{count} values of {size} bytes are named, and the file has not that many bytes there; it is cut "
                "short or damaged"
            )
        if not count:
            return np.empty((0, axes), of_type)
        return np.ndarray((count, axes), of_type, content, begin + offset, (step, of_type.itemsize))

    def _buffer(self, view: Json) -> memoryview:
        """The bytes of the buffer of a view."""
        number: Any = view.get("buffer")
        buffer = self.one("buffers", number)
        if "uri" in buffer:
            if number not in self._unpacked:
                # `check_buffers` has seen that it stands here.
                head, _, text = buffer["uri"].partition(",")
                is_packed = head.lower().endswith(";base64")
                unpacked = base64.b64decode(text, validate=True) if is_packed else unquote_to_bytes(text)
                self._unpacked[number] = memoryview(unpacked)
            content = self._unpacked[number]
        elif number == 0 and len(self.binary):
            content = self.binary
        else:
            for name in COMPRESSED:
                if extension(view, name) or extension(buffer, name):
                    raise not_read(name)
            raise ValueError(f"buffer {number} has no bytes in this file")
        if whole(buffer, "byteLength") > len(content):
            raise ValueError(f"buffer {number} is cut short")
        return content[: whole(buffer, "byteLength")]

    def check_buffers(self) -> None:
        """Raise `BadMesh` for a buffer in another file, which is not opened."""
        for number, buffer in enumerate(self.all("buffers")):
            uri = buffer.get("uri", "data:,")
            if not (isinstance(uri, str) and uri[:5].lower() == "data:"):
                raise BadMesh(
                    f"has its numbers (buffer {number}) in another file, {str(uri)[:60]!r}, and no other file is "
                    "opened; export it as one .glb"
                )


def read_gltf(content: bytes) -> Gltf:
    """The JSON and the binary part of a GLB file. Raises `BadMesh` for another format or a file that is cut short,
    and errors of `json`."""
    if content[:4] != b"glTF":
        raise BadMesh("cannot be parsed as GLB (it does not begin with glTF); export it as binary glTF 2.0")
    version, length = (int.from_bytes(content[k : k + 4], "little") for k in (4, 8))
    if version != 2:
        raise BadMesh(f"is binary glTF of version {version}, and 2 is read; export it as glTF 2.0")
    if length > len(content):
        raise BadMesh(f"is cut short: its header says {length} bytes, and it has {len(content)}; export it again")
    parts: dict[bytes, memoryview] = {}
    start = 12
    while start + 8 <= length:
        size, kind = int.from_bytes(content[start : start + 4], "little"), content[start + 4 : start + 8]
        if start + 8 + size > length:
            raise BadMesh(f"is cut short: a part of {size} bytes goes beyond its end; export it again")
        parts.setdefault(kind, memoryview(content)[start + 8 : start + 8 + size])
        start += 8 + size
    text = parts.get(b"JSON", memoryview(b""))
    if len(text) > MOST_JSON_BYTES:
        raise BadMesh(f"has {len(text)} bytes of JSON, and at most {MOST_JSON_BYTES} are read; join its nodes")
    tree = json.loads(bytes(text).rstrip(b" \0"))
    if not isinstance(tree, dict):
        raise ValueError("its JSON is no object")
    gltf = Gltf(tree, parts.get(b"BIN\0", memoryview(b"")))
    gltf.check_buffers()
    return gltf
