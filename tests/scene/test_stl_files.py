"""STL files: all triangles of all solids, or a refusal that says what is wrong."""

from __future__ import annotations

import re
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from scene_library.mesh_file import BadMesh
from scene_library.meshes import read_mesh

BOXES = [trimesh.creation.box((1, 1, 1)).apply_translation((3 * k, 0, 0)) for k in range(3)]
ALL = np.concatenate([box.triangles for box in BOXES])


def text(solids: list[np.ndarray], names: tuple[str, ...] = ("a", "", "facet vertex 1 2 3")) -> str:
    lines = []
    for name, triangles in zip(names, solids, strict=False):
        lines.append(f"solid {name}".rstrip())
        for corners in triangles:
            lines += ["  facet normal 0 0 0", "    outer loop"]
            lines += [f"      vertex {x:.6e} {y:.6e} {z:.6e}" for x, y, z in corners]
            lines += ["    endloop", "  endfacet"]
        lines.append(f"endsolid {name}".rstrip())
    return "\n".join(lines) + "\n"


def binary(triangles: np.ndarray, header: bytes = b"", count: int | None = None) -> bytes:
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *corners.ravel(), 0) for corners in triangles)
    return header.ljust(80, b"\0") + struct.pack("<I", len(triangles) if count is None else count) + rows


WHOLE = text([box.triangles for box in BOXES])
READ = {
    "binary": binary(ALL),
    "binary that begins with solid": binary(ALL, b"solid a\n"),
    "binary that begins as a text does": binary(ALL, b"solid a\n  facet normal 0 0 0\n"),
    "text": WHOLE.encode(),
    "upper case": WHOLE.upper().encode(),
    "lines that end in CR LF": WHOLE.replace("\n", "\r\n").encode(),
    "lines that end in CR": WHOLE.replace("\n", "\r").encode(),
    "tabs, trailing blanks and empty lines": WHOLE.replace("    ", "\t").replace("\n", "  \n\n").encode(),
    "a byte order mark": b"\xef\xbb\xbf" + WHOLE.encode(),
    "a solid that is empty": WHOLE.replace("solid a\n", "solid none\nendsolid none\nsolid a\n", 1).encode(),
}


@pytest.mark.parametrize("kind", READ)
def test_every_triangle_is_read(tmp_path: Path, kind: str) -> None:
    (tmp_path / "a.stl").write_bytes(READ[kind])
    mesh = read_mesh(tmp_path / "a.stl")
    np.testing.assert_array_equal(mesh.vertices[mesh.triangles], ALL)


@pytest.mark.parametrize("solids", [1, 3])
def test_a_text_is_whole_or_refused(tmp_path: Path, solids: int) -> None:
    """Any word that is lost, doubled or another one, and any end: all triangles are read, or none."""
    whole = text([box.triangles[:2] for box in BOXES[:solids]])
    words = list(re.finditer(r"\S+", whole))
    damaged = [
        whole[: word.start()] + new + whole[word.end() :] for word in words for new in ("", "xyz", "1 1", "1_0")
    ]
    cut = (whole[: word.start()] for word in words[1:])
    # After a line `endsolid` the file is whole.
    damaged += [content for content in cut if not content.splitlines()[-1].startswith("endsolid")]
    path = tmp_path / "a.stl"
    for content in damaged:
        path.write_text(content)
        try:
            found = len(read_mesh(path).triangles)
        except BadMesh as error:
            assert "\n" not in str(error)
        else:
            # A name or a normal was damaged.
            assert found == 2 * solids, content


def test_what_is_damaged_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    for content, match in (
        (WHOLE.replace("endsolid\n", "endsoli\n"), r"^has a solid 2 that has no line endsolid; export it again"),
        (
            WHOLE.replace("  endfacet\nendsolid\n", "endsolid\n"),
            r"^is damaged: triangle 12 of its solid 2 is not whole",
        ),
        (WHOLE.replace("endsolid\n", ""), r"^has a solid 2 that has no line endsolid; export it again"),
        (WHOLE.removesuffix("endsolid facet vertex 1 2 3\n"), r"^is cut short: its solid 3 has no line endsolid"),
        (WHOLE.replace("solid\n", "", 1).replace("endendsolid", "endsolid"), r"^has text after its solid 1"),
        (WHOLE.replace("2.500000e", "2,500000e"), r"^cannot be parsed"),
        (WHOLE.replace("5.000000e-01", "nan", 1), r"not finite"),
        (WHOLE.replace("vertex", "vert\0ex", 1), r"NUL bytes"),
    ):
        path.write_text(content)
        with pytest.raises(BadMesh, match=match):
            read_mesh(path)


def line(count: int, due: int, size: int, how: str) -> str:
    return f"the number {count} in its header, which takes {due} bytes, while the file has {size}: it {how}; export"


def test_a_number_that_does_not_fit_the_size_is_said(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    for content, match in (
        (binary(ALL, count=40), line(40, 2084, 1884, "is cut short")),
        (binary(ALL)[:-7], line(36, 1884, 1877, "is cut short")),
        (binary(ALL, count=12), line(12, 684, 1884, "has more than that, or another number")),
        (binary(ALL, b"solid a", count=0), line(0, 84, 1884, "has more than that, or another number")),
        (binary(ALL) + b"end", line(36, 1884, 1887, "has more than that, or another number")),
        (binary(ALL)[:60], r"^is no STL file, or is cut short \(60 bytes\)"),
    ):  # fmt: skip
        path.write_bytes(content)
        with pytest.raises(BadMesh, match=match):
            read_mesh(path)
