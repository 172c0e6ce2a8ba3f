"""Text of mesh files: one kind of line end, and numbers as formats write them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scene_library.arrays import Floats
from scene_library.mesh_file import BadMesh


def text_of(content: bytes) -> bytes:
    """The text of a file in which every line ends with a newline, without a byte order mark.

    Raises `BadMesh` for text of two bytes a letter, and for NUL bytes, which a crash leaves in place of text.
    """
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise BadMesh("is text in UTF-16; save it as plain text (UTF-8)")
    if b"\0" in content:
        raise BadMesh("is text with NUL bytes in it, so it is damaged; export it again")
    # A mark before the first line would hide it.
    return content.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def numbers_of(words: Sequence[bytes]) -> Floats:
    """The words as numbers. Raises `ValueError` for what is none, also for `1_000`, which Python would read."""
    if b"_" in b" ".join(words):
        raise ValueError(f"{next(word for word in words if b'_' in word).decode('latin-1')!r} is no number")
    return np.array(words, np.float64)
