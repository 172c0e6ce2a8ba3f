"""STL files, binary or text: the triangles of all their solids.

Read here and not by trimesh, which leaves out the solids after a damaged one without a word.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from scene_library.arrays import Floats
from scene_library.mesh_file import BadMesh, MeshFile
from scene_library.words import numbers_of, text_of

HEADER_BYTES, TRIANGLE_BYTES = 84, 50
"""Sizes in a binary file: the header with the number of triangles, and each triangle."""
_FACET = {0: b"facet", 1: b"normal", 5: b"outer", 6: b"loop", 7: b"vertex", 11: b"vertex", 15: b"vertex",
          19: b"endloop", 20: b"endfacet"}  # fmt: skip
"""The 21 words of a triangle in text that are no numbers, by their place."""


def read_stl(path: Path) -> MeshFile:
    """The surface of an STL file. Raises `BadMesh` for one that is not whole."""
    content = path.read_bytes()
    # Binary files may begin with the word solid, too: of a text the triangles follow on the next line.
    is_text = re.match(
        rb"(\xef\xbb\xbf)?\s*solid\b[^\r\n\0]*([\r\n]\s*(facet|endsolid)\b|\s*\Z)", content[:2000].lower()
    )
    if is_text and count_by_size(content[:HEADER_BYTES], len(content)) is None:
        corners = _of_text(text_of(content).lower().lstrip())
    else:
        corners = _of_bytes(content)
    return MeshFile(corners, np.arange(len(corners)).reshape(-1, 3))


def count_by_size(header: bytes, size: int) -> int | None:
    """The number of triangles of a binary file, if header and size agree on it."""
    count = int.from_bytes(header[HEADER_BYTES - 4 : HEADER_BYTES], "little")
    return count if len(header) >= HEADER_BYTES and size == HEADER_BYTES + TRIANGLE_BYTES * count else None


def _of_bytes(content: bytes) -> Floats:
    """(3 F, 3) corners of a binary file."""
    if len(content) < HEADER_BYTES:
        raise BadMesh(f"is no STL file, or is cut short ({len(content)} bytes); export it again")
    if count_by_size(content[:HEADER_BYTES], len(content)) is None:
        count = int.from_bytes(content[HEADER_BYTES - 4 : HEADER_BYTES], "little")
        due = HEADER_BYTES + TRIANGLE_BYTES * count
        # Which of the two is wrong cannot be told: a program may write the number of an earlier state, or stop.
        how = "is cut short" if due > len(content) else "has more than that, or another number"
        raise BadMesh(
            f"is no STL text, and as a binary STL has the number {count} in its header, which takes {due} bytes, "
            f"while the file has {len(content)}: it {how}; export it again"
        )
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.frombuffer(content, record, offset=HEADER_BYTES)
    return triangles["corners"].astype(np.float64).reshape(-1, 3)


def _of_text(text: bytes) -> Floats:
    """(3 F, 3) corners of a text in lower case with one kind of line end."""
    # Names of solids may be any words, so the lines with them are where the text is divided.
    pieces = re.split(rb"^[ \t]*((?:end)?solid)\b.*$", text, flags=re.MULTILINE)
    marks, bodies = pieces[1::2], [piece.split() for piece in pieces[2::2]]
    for number, (mark, words) in enumerate(zip(marks, bodies, strict=True)):
        # Solids begin and end in turn, and nothing stands between them.
        if mark != (b"solid", b"endsolid")[number % 2] or (number % 2 and words):
            raise BadMesh(
                f"has text after its solid {number // 2 + number % 2} that belongs to none; export it again"
                if mark == b"endsolid"
                else f"has a solid {number // 2 + 1} that has no line endsolid; export it again"
            )
    if len(marks) % 2:
        raise BadMesh(f"is cut short: its solid {len(marks) // 2 + 1} has no line endsolid; export it again")
    return np.concatenate([np.empty((0, 3)), *(_solid(words, k) for k, words in enumerate(bodies[::2], 1))])


def _solid(words: list[bytes], number: int) -> Floats:
    """(3 F, 3) corners of the triangles that the words between `solid` and `endsolid` describe."""
    count = len(words) // 21
    is_whole = len(words) == 21 * count
    if not is_whole or any(words[place::21] != [word] * count for place, word in _FACET.items()):
        bad = next(
            (k for k in range(count) if any(words[21 * k + place] != word for place, word in _FACET.items())), count
        )
        raise BadMesh(f"is damaged: triangle {bad + 1} of its solid {number} is not whole; export it again")
    return np.stack(
        [numbers_of(words[corner + axis :: 21]) for corner in (8, 12, 16) for axis in range(3)], axis=1
    ).reshape(-1, 3)
