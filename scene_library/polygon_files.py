"""OBJ and PLY files, whose faces may have any number of corners, and the triangles of such faces.

Read here and not by trimesh, which cuts every face into a fan about its first corner (a notch is filled) and refuses
binary PLY files whose faces differ in their number of corners.
"""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scene_library.arrays import Floats
from scene_library.mesh_file import BadMesh
from scene_library.polygons import triangulate
from scene_library.words import numbers_of, text_of

Ints = NDArray[np.int64]

BENT = 0.05
"""Distance of a face's corners from their mean plane, relative to the face's size, above which its two halves may
meet at more than some ten degrees, and which of them a file means is worth a warning."""
MOST_CORNERS = 4000
"""Corners of a face. Where it has notches the time goes with their square: 4000 take a second, 16 000 half a
minute."""
MOST_PAIRS = 4 * 10**8
"""Pairs of corners of one face, in all faces with notches together, which take half a minute: 25 faces of 4000
corners, or 40 000 of a hundred."""


@dataclass(frozen=True)
class Faces:
    """The surface of a file.

    Attributes
    ----------
    vertices : (V, 3).
    counts : (n,) number of corners of each face.
    corners : (Σ counts,) vertex of each corner, face after face, from 0; below 0 or from V on for a vertex that the
        file does not hold.
    """

    vertices: Floats
    counts: Ints
    corners: Ints

    def triangles(self) -> tuple[Ints, int]:
        """(F, 3) triangles that cover the faces, and the number of faces bent by more than `BENT`.

        Faces of fewer than three corners are left out. Raises `BadMesh` for a face whose outline crosses itself, and
        for more corners than can be handled.
        """
        many = self.counts > MOST_CORNERS
        if many.any():
            first_one = int(many.argmax())
            raise BadMesh(
                f"has a face ({first_one + 1}) of {self.counts[first_one]} corners, and at most {MOST_CORNERS} are "
                "handled; triangulate it in a mesh editor"
            )
        first = np.cumsum(self.counts) - self.counts
        found, bent = [np.empty((0, 3), np.int64)], 0
        held, pairs = np.append(self._can_be_measured(), False), 0
        for count in np.unique(self.counts[self.counts >= 3]):
            which = np.flatnonzero(self.counts == count)
            faces = self.corners[first[which, None] + np.arange(count)]
            if count > 3:
                # What cannot be measured stays a fan, so that the cleaning of the mesh says what is wrong with it.
                measured = held[np.where((faces >= 0) & (faces < len(self.vertices)), faces, -1)].all(axis=1)
                plan, heights, convex = _flat_faces(self.vertices[faces[measured]])
                pairs += int(count) ** 2 * int(np.count_nonzero(~convex))
                if pairs > MOST_PAIRS:
                    raise BadMesh(
                        f"has too many faces with notches, of up to {count} corners; triangulate it in a mesh editor"
                    )
                cut = _triangles_of(plan, convex, faces[measured], which[measured])
                found.append(cut)
                bent += int(np.count_nonzero(heights > BENT))
                faces = faces[~measured]
            found.append(_fans(faces))
        return np.concatenate(found), bent

    def _can_be_measured(self) -> NDArray[np.bool_]:
        return np.asarray(np.isfinite(self.vertices).all(axis=1))


def _fans(faces: Ints) -> Ints:
    """(n (k − 2), 3) triangles about the first corner of each of the faces (n, k)."""
    k = np.arange(1, faces.shape[1] - 1)
    fans = np.stack([np.broadcast_to(faces[:, :1], (len(faces), len(k))), faces[:, k], faces[:, k + 1]], axis=2)
    return np.asarray(fans.reshape(-1, 3))


def _triangles_of(plan: Floats, convex: NDArray[np.bool_], faces: Ints, numbers: Ints) -> Ints:
    """Triangles of faces (n, k) of k > 3 corners, as `_flat_faces` sees them; `numbers` are those of the faces."""
    from scene_library.ears import crosses_itself

    found = [_fans(faces[convex])]
    for row in np.flatnonzero(~convex):
        if crosses_itself(plan[row]):
            # No triangles have that outline.
            raise BadMesh(
                f"has a face that has no triangles (face {numbers[row] + 1} of {len(plan[row])} corners crosses "
                "itself); triangulate it in a mesh editor"
            )
        found.append(faces[row][triangulate(plan[row])])
    return np.concatenate(found)


def _flat_faces(corners: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Faces (n, k, 3) seen along their mean normal, counter-clockwise (n, k, 2), in units of their size; (n,)
    largest distance of a corner from the mean plane, in the same unit; (n,) whether a fan about any corner covers
    the face."""
    place = corners - corners[:, :1]
    size = np.abs(place).max(axis=(1, 2), keepdims=True)
    place = place / np.where(size > 0, size, 1.0)
    place = place - place.mean(axis=1, keepdims=True)
    # Newell's normal, twice the area long. Without area (a line, or two equal loops) any direction across will do.
    normal = np.cross(place, np.roll(place, -1, axis=1)).sum(axis=1)
    area = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(area > 1e-12, normal / np.where(area > 0, area, 1.0), 0.0)
    normal[area[:, 0] <= 1e-12] = _across(place[area[:, 0] <= 1e-12])
    least = np.eye(3)[np.abs(normal).argmin(axis=1)]
    right = np.cross(least, normal)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(normal, right)
    plan = np.stack([np.einsum("nkc,nc->nk", place, axis) for axis in (right, up)], axis=2)
    heights = np.abs(np.einsum("nkc,nc->nk", place, normal)).max(axis=1)
    edge = np.roll(plan, -1, axis=1) - plan
    after = np.roll(edge, -1, axis=1)
    bend = edge[..., 0] * after[..., 1] - edge[..., 1] * after[..., 0]
    turn = np.arctan2(bend, (edge * after).sum(axis=2))
    # All corners bend one way, and the outline goes round once: a star of five points goes round twice.
    convex = (bend > -1e-12).all(axis=1) & (np.abs(turn.sum(axis=1) - 2 * np.pi) < 1.0) & (turn > -1e-9).all(axis=1)
    return plan, heights, convex


def _across(place: Floats) -> Floats:
    """Unit normals (n, 3) of the planes that are closest to some points (n, k, 3) about the origin."""
    return np.linalg.svd(place)[2][:, 2] if len(place) else np.empty((0, 3))


_STATEMENT = rb"^[ \t]*%s(?=[ \t\\\n]|\Z)((?:[^\n#\\]+|\\[ \t]*(?:\n|\Z))*)(\\?)"
"""A line `v` or `f` up to its comment. A backslash before its end continues it on the next line; nowhere else does
it: names and comments, in which a backslash is a letter, end with their line, and no other line is read."""


def read_obj(path: Path) -> Faces:
    """The faces of a Wavefront OBJ file: its lines `v` and `f`, the latter with indices from 1, or, below 0, counted
    back from the last vertex before the line. Raises `BadMesh` for surfaces that are no polygons."""
    text = text_of(path.read_bytes())
    other = re.search(rb"^[ \t]*(surf|bzp|bsp|cdc|cdp|fo|call)[ \t]", text, re.MULTILINE)
    if other:
        raise BadMesh(
            f"has lines {other[1].decode()!r}, which bring surfaces that are no polygons of this file; convert it to "
            "polygons in a mesh editor"
        )
    places, lines = (list(re.finditer(_STATEMENT % name, text, re.MULTILINE)) for name in (b"v", b"f"))
    for found in (*places, *lines):
        if found[2] or b"_" in found[1]:
            raise ValueError(f"a backslash or _ within a line of numbers, {found[0][:40].decode('latin-1')!r}")
    vertices = [_words(place)[:3] for place in places]
    if not set(map(len, vertices)) <= {3}:
        raise ValueError("a vertex of fewer than three coordinates")
    # Of vertex/texture/normal only the first.
    faces = [_words(line) for line in lines]
    counts = np.array([len(face) for face in faces], np.int64)
    corners = np.array([corner.partition(b"/")[0] for face in faces for corner in face], np.int64)
    if (corners < 0).any():
        before = np.searchsorted([place.start() for place in places], [line.start() for line in lines])
        corners += np.where(corners < 0, np.repeat(before, counts) + 1, 0)
    return Faces(numbers_of([x for place in vertices for x in place]).reshape(-1, 3), counts, corners - 1)


def _words(statement: re.Match[bytes]) -> list[bytes]:
    return statement[1].replace(b"\\", b" ").split()


TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip


@dataclass(frozen=True)
class _Property:
    """One column of a PLY element: `type`, and, for a list, the type of the number before it."""

    name: str
    type: np.dtype[np.generic]
    count_type: np.dtype[np.generic] | None = None


def read_ply(path: Path) -> Faces:
    """The faces of a PLY file, text or binary: element `face`, and triangle strips (`tristrips`), where −1 ends a
    strip. Raises `ValueError` for a file that is cut short or has another header."""
    content = path.read_bytes()
    # A first line that ends in \r\n or \r alone says how the header's last line ends: numbers may follow it at once.
    found = re.match(rb"ply[ \t]*(\r\n|\n|\r)(?:.*?[\r\n])??end_header[ \t]*(?:\1|\r?\n)", content, re.DOTALL)
    if found is None:
        raise ValueError("no PLY header")
    header, body = text_of(found[0]), content[found.end() :]
    kind = re.search(rb"^format[ \t]+(\S+)", header, re.MULTILINE)
    order = {b"binary_little_endian": "<", b"binary_big_endian": ">", b"ascii": "text"}[kind[1] if kind else b""]
    if order == "text":
        # The numbers of a text become those of a binary file all of whose numbers are double.
        body = numbers_of(body.split()).tobytes()
    start, columns = 0, dict[str, dict[str, Floats | tuple[Ints, Ints]]]()
    for name, count, properties in _elements(header.decode("latin-1"), order):
        if name in columns:
            raise ValueError(f"two elements {name}")
        columns[name], start = _read_element(body, start, count, properties)
    if body[start:].strip(b"" if order == "text" else b" \t\r\n\0"):
        # Its header may have the number of an earlier state, so that the rest are faces, too.
        raise ValueError("the file goes on after the elements that its header counts")
    if "vertex" not in columns:
        return Faces(np.empty((0, 3)), np.empty(0, np.int64), np.empty(0, np.int64))
    vertices = np.column_stack([np.asarray(columns["vertex"][axis], np.float64) for axis in "xyz"])
    counts, corners = _list_of(columns.get("face", {}))
    strips = _strips(*_list_of(columns.get("tristrips", {})))
    counts = np.append(counts, np.full(len(strips), 3))
    return Faces(vertices, counts, np.append(corners, strips.ravel()))


def _elements(header: str, order: str) -> list[tuple[str, int, list[_Property]]]:
    """Name, number of rows and properties of each element that a header describes."""
    found: list[tuple[str, int, list[_Property]]] = []
    for words in map(str.split, header.splitlines()):
        match words:
            case ["element", name, count]:
                found.append((name, int(count), []))
            case ["property", "list", count_type, item, name]:
                found[-1][2].append(_Property(name, _type(item, order), _type(count_type, order)))
            case ["property", item, name]:
                found[-1][2].append(_Property(name, _type(item, order)))
    return found


def _type(name: str, order: str) -> np.dtype[np.generic]:
    return np.dtype("<f8" if order == "text" else order + TYPES[name])


def _read_element(
    body: bytes, start: int, count: int, properties: list[_Property]
) -> tuple[dict[str, Floats | tuple[Ints, Ints]], int]:
    """The columns of an element whose rows begin at byte `start`, and the byte after the last.

    A list is a pair: how many numbers it has in each row, and all these numbers.
    """
    lists = [p for p in properties if p.count_type is not None]
    # Nearly all files have as many numbers in every row as in the first: these are read at once.
    lengths = _lengths(body, start, properties) if lists and count else {}
    fields: list[tuple[str, np.dtype[np.generic], tuple[int, ...]]] = []
    for p in properties:
        if p.count_type is not None:
            fields += [(f"count of {p.name}", p.count_type, ()), (p.name, p.type, (lengths.get(p.name, 0),))]
        else:
            fields.append((p.name, p.type, ()))
    rows = np.dtype(fields)
    if start + count * rows.itemsize <= len(body):
        table = np.frombuffer(body, rows, count, start)
        if all((table[f"count of {p.name}"] == lengths.get(p.name, 0)).all() for p in lists):
            columns: dict[str, Floats | tuple[Ints, Ints]] = {}
            for p in properties:
                values = table[p.name]
                whole = np.full(count, lengths.get(p.name, 0), np.int64), values.astype(np.int64).ravel()
                columns[p.name] = values.astype(np.float64) if p.count_type is None else whole
            return columns, start + count * rows.itemsize
    if not lists:
        raise ValueError("the file is cut short")
    return _read_rows(body, start, count, properties)


def _lengths(body: bytes, start: int, properties: list[_Property]) -> dict[str, int]:
    """The lengths of the lists of one row."""
    found = {}
    for p in properties:
        if p.count_type is not None:
            found[p.name] = int(np.frombuffer(body, p.count_type, 1, start)[0])
            if found[p.name] < 0:
                raise ValueError(f"a list of {found[p.name]} numbers")
            start += p.count_type.itemsize + found[p.name] * p.type.itemsize
        else:
            start += p.type.itemsize
    return found


def _read_rows(
    body: bytes, start: int, count: int, properties: list[_Property]
) -> tuple[dict[str, Floats | tuple[Ints, Ints]], int]:
    """`_read_element` for an element whose lists differ in length; its other columns are left out."""
    steps = [
        (p.name, struct.Struct(_code(p.count_type)) if p.count_type is not None else None, p.type.itemsize)
        for p in properties
    ]
    begins: dict[str, list[int]] = {p.name: [] for p in properties if p.count_type is not None}
    lengths: dict[str, list[int]] = {name: [] for name in begins}
    for _ in range(count):
        for name, length_of, size in steps:
            if length_of is None:
                start += size
                continue
            length = int(length_of.unpack_from(body, start)[0])
            if length < 0:
                raise ValueError(f"a list of {length} numbers")
            start += length_of.size
            begins[name].append(start)
            lengths[name].append(length)
            start += length * size
    if start > len(body):
        raise ValueError("the file is cut short")
    columns: dict[str, Floats | tuple[Ints, Ints]] = {}
    single = np.frombuffer(body, np.uint8)
    for p in properties:
        if p.count_type is not None:
            counts = np.array(lengths[p.name], np.int64)
            within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
            at = np.repeat(np.array(begins[p.name], np.int64), counts) + within * p.type.itemsize
            numbers = single[at[:, None] + np.arange(p.type.itemsize)].view(p.type)
            columns[p.name] = counts, numbers.ravel().astype(np.int64)
    return columns, start


def _code(of: np.dtype[np.generic]) -> str:
    """`struct`'s name of a type."""
    return ("<" if of.byteorder in "|=<" else ">") + of.char.replace("l", "i").replace("L", "I")


def _list_of(element: dict[str, Floats | tuple[Ints, Ints]]) -> tuple[Ints, Ints]:
    """The list of vertices of an element's rows: by its usual names, or else the first."""
    lists = {name: column for name, column in element.items() if isinstance(column, tuple)}
    for name in ("vertex_indices", "vertex_index", *lists):
        if name in lists:
            return lists[name]
    return np.empty(0, np.int64), np.empty(0, np.int64)


def _strips(counts: Ints, corners: Ints) -> Ints:
    """(F, 3) triangles of strips, wound one way; −1 ends a strip within a list."""
    found = [np.empty((0, 3), np.int64)]
    for strip in np.split(corners, np.cumsum(counts)[:-1]) if len(counts) else ():
        for piece in np.split(strip, np.flatnonzero(strip < 0)):
            piece = piece[piece >= 0]
            if len(piece) > 2:
                triples = np.lib.stride_tricks.sliding_window_view(piece, 3)
                # Every second triangle of a strip runs the other way round.
                odd = np.arange(len(triples))[:, None] % 2 == 1
                found.append(np.where(odd, triples[:, [1, 0, 2]], triples))
    return np.concatenate(found)
