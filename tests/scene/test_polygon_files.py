"""Faces of any number of corners, in OBJ and PLY: the triangles cover what the outline encloses, and nothing else."""

from __future__ import annotations

import gzip
import re
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from datagen.building.input_check import check_inputs
from datagen.config import config_from_mapping
from datagen.devices import read_parts
from datagen.errors import InputError, InputWarning
from scene_library import polygon_files
from scene_library.mesh_file import BadMesh
from scene_library.meshes import MeshOptions, read_mesh, unit_mesh
from scene_library.polygon_files import Faces, read_obj, read_ply
from scene_library.polygons import signed_area, triangulate

LETTER_C = np.array(
    [(0, 0), (1, 0), (1, 0.25), (0.25, 0.25), (0.25, 1.25), (1, 1.25), (1, 1.5), (0, 1.5)], np.float64
)  # fmt: skip
"""1 × 1.5, its area 0.75; a fan about its first corner covers 1.6875."""


def letter(thick: float = 0.1) -> tuple[np.ndarray, list[list[int]]]:
    """Vertices and faces of a C that stands upright: two caps of eight corners and eight sides of four."""
    n = len(LETTER_C)
    low, high = (np.insert(LETTER_C, 1, y, axis=1) for y in (0.0, thick))
    sides = [[k, k + n, (k + 1) % n + n, (k + 1) % n] for k in range(n)]
    return np.concatenate([low, high]), [list(range(n)), list(range(2 * n - 1, n - 1, -1)), *sides]


def obj(vertices: np.ndarray, faces: list[list[int]]) -> bytes:
    lines = ["v " + " ".join(map(repr, map(float, vertex))) for vertex in vertices]
    return "\n".join(lines + ["f " + " ".join(str(k + 1) for k in face) for face in faces]).encode()


def ply(vertices: np.ndarray, faces: list[list[int]], kind: str) -> bytes:
    """A file whose faces have a flag before their list and a colour after it, as modelling programs write them."""
    header = (
        f"ply\nformat {kind} 1.0\ncomment by hand\nelement vertex {len(vertices)}\nproperty double x\n"
        f"property double y\nproperty double z\nproperty uchar red\nelement face {len(faces)}\n"
        "property short flags\nproperty list uchar uint vertex_indices\nproperty float shade\nend_header\n"
    ).encode()
    if kind == "ascii":
        rows = [f"{x!r} {y!r} {z!r} 7" for x, y, z in vertices.tolist()]
        rows += [f"-1 {len(face)} {' '.join(map(str, face))} 0.5" for face in faces]
        return header + "\n".join(rows).encode()
    order = "<" if "little" in kind else ">"
    body = b"".join(struct.pack(order + "3dB", *vertex, 7) for vertex in vertices)
    return (
        header + body + b"".join(struct.pack(f"{order}hB{len(face)}If", -1, len(face), *face, 0.5) for face in faces)
    )


PLY_KINDS = ("ascii", "binary_little_endian", "binary_big_endian")


def area(vertices: np.ndarray, triangles: np.ndarray) -> float:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())


@pytest.mark.parametrize("kind", ["obj", *PLY_KINDS])
def test_a_notch_stays_open(tmp_path: Path, kind: str) -> None:
    vertices, faces = letter()
    path = tmp_path / ("c.obj" if kind == "obj" else "c.ply")
    path.write_bytes(obj(vertices, faces) if kind == "obj" else ply(vertices, faces, kind))
    mesh = read_mesh(path)
    assert mesh.doubt == ""
    rim = float(np.abs(LETTER_C - np.roll(LETTER_C, 1, axis=0)).sum())
    assert area(mesh.vertices, mesh.triangles) == pytest.approx(2 * 0.75 + 0.1 * rim, rel=1e-12)
    front = mesh.triangles[(mesh.vertices[mesh.triangles][:, :, 1] == 0).all(axis=1)]
    assert area(mesh.vertices, front) == pytest.approx(0.75, rel=1e-12)
    # Closed, and wound one way: the volume is that of the prism.
    assert trimesh.Trimesh(mesh.vertices, mesh.triangles).volume == pytest.approx(0.075, rel=1e-12)


def test_triangles_cover_any_simple_outline_once() -> None:
    """Outlines around a point, at random distances: their area is the sum of the triangles' areas, none of which is
    negative; turned in space and read as faces, too."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        n = int(rng.integers(4, 60))
        angle = 2 * np.pi * (np.arange(n) + 0.8 * rng.random(n)) / n
        outline = (rng.uniform(0.05, 1.0, n) * np.array([np.cos(angle), np.sin(angle)])).T
        triangles = triangulate(outline)
        a, b, c = (outline[triangles[:, k]] for k in range(3))
        areas = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        assert (areas > 0).all() and len(triangles) == n - 2
        assert areas.sum() == pytest.approx(signed_area(outline), rel=1e-12)
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        assert area_of_face(outline @ axes[:2] * 1e3 + 1e5) == pytest.approx(1e6 * signed_area(outline), rel=1e-9)


def area_of_face(vertices: np.ndarray, corners: np.ndarray | None = None) -> float:
    """Area of one face, whose corners are all vertices in order unless given."""
    corners = np.arange(len(vertices)) if corners is None else corners
    found, bent = Faces(vertices, np.array([len(corners)]), corners).triangles()
    assert bent == 0
    return area(vertices, found)


def test_bridges_to_holes_and_needless_corners_change_nothing() -> None:
    """A square ring as one face, whose outline runs along a bridge twice; corners that are straight, repeated or a
    spike."""
    ring = np.array([(0, 0), (3, 0), (3, 3), (0, 3), (1, 1), (1, 2), (2, 2), (2, 1)], np.float64)
    flat, outline = np.pad(ring, ((0, 0), (1, 0))), np.array([0, 1, 2, 3, 0, 4, 5, 6, 7, 4])
    assert area_of_face(flat[outline]) == pytest.approx(8)
    assert area_of_face(flat, outline) == pytest.approx(8)
    square = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (2, 2, 0), (2, 2, 0), (1, 2, 0), (1, 3, 0), (1, 2, 0), (0, 2, 0)]
    for turn in range(len(square)):
        assert area_of_face(np.roll(np.array(square, np.float64), turn, axis=0)) == pytest.approx(4)


def test_obj_lines_as_programs_write_them(tmp_path: Path) -> None:
    """Textures and normals, comments, a line continued, colours after the place, indices counted back from the line,
    faces of two corners: the vertices of three triangles and a quad."""
    (tmp_path / "x.obj").write_bytes(
        b"# x\r\nmtllib none.mtl\r\nv 0 0 0 1 0 0\r\nv 1 0 0\r\n  v 1 0 1 # corner\r\nvn 0 1 0\r\nvt 0 0\r\n"
        b"f -3//1 -2//1 -1//1\r\ng b\r\nv 0 0 1\r\nf 1/1/1 3/1/1 \\\r\n4/1/1\r\nf 1 2\r\nl 1 2\r\n"
        b"v 0 1 0\r\nf\t-1 -2 -5\r\nf 1 2 3 4"
    )
    faces = read_obj(tmp_path / "x.obj")
    assert faces.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1], [0, 1, 0]]
    assert faces.counts.tolist() == [3, 3, 2, 3, 4]
    triangles, _ = faces.triangles()
    assert triangles.tolist() == [[0, 1, 2], [0, 2, 3], [4, 3, 0], [0, 1, 2], [0, 2, 3]]


BOX = trimesh.creation.box((1, 2, 3))
OBJ = obj(BOX.vertices, BOX.faces.tolist()).decode() + "\n"


def with_lines(*lines: str) -> str:
    """A box's file with these lines before each of its faces."""
    return OBJ.replace("\nf ", "\n" + "\n".join(lines) + "\nf ")


OBJ_TEXTS: dict[str, str | bytes] = {
    "a comment that ends in a backslash": with_lines("# C:\\parts\\"),
    "a comment after the numbers": OBJ.replace("\n", " # C:\\\n"),
    "a material": with_lines("usemtl wood\\"),
    "a group": with_lines("g left\\ "),
    "an object": with_lines("o C:\\box\\"),
    "a library": with_lines("mtllib C:\\looks\\"),
    "many of them, with CR LF": with_lines("# a\\", "usemtl b\\", "s off\\").replace("\n", "\r\n"),
    "lines that end in CR": with_lines("o a\\").replace("\n", "\r"),
    "faces on several lines": re.sub(r"f (\S+) (\S+) (\S+)", r"f \\\n\1 \\\n \2\\ \n\3", OBJ),
    "vertices on several lines": re.sub(r"v (\S+) (\S+)", r"v\\\n \1 \\\n\2", OBJ),
    "a backslash at the very end": OBJ.rstrip() + "\\",
    "a byte order mark": b"\xef\xbb\xbf" + OBJ.encode(),
    "tabs and trailing blanks": OBJ.replace(" ", "\t").replace("\n", " \t\n"),
    "exponents and signs": re.sub(r"(-?)(\d)\.(\d)", lambda m: f"{m[1] or '+'}{m[2]}{m[3]}.0E-1", OBJ),
    "textures and normals": with_lines("vt 0 0", "vn 0 0 1").replace(" 1 ", " 1/1/1 "),
}


@pytest.mark.parametrize("name", OBJ_TEXTS)
def test_no_line_of_an_obj_file_swallows_another(tmp_path: Path, name: str) -> None:
    content = OBJ_TEXTS[name]
    (tmp_path / "a.obj").write_bytes(content if isinstance(content, bytes) else content.encode())
    mesh = read_mesh(tmp_path / "a.obj")
    np.testing.assert_array_equal(mesh.vertices, BOX.vertices)
    np.testing.assert_array_equal(mesh.triangles, BOX.faces)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (OBJ.replace("f ", "f 1\\2 ", 1), r"^cannot be parsed \(a backslash or _ within"),
        (OBJ.replace("v 0.5", "v 0_5", 1).replace("v -0.5", "v -0_5", 1), r"^cannot be parsed \(a backslash or _"),
        (OBJ.replace("f ", "v 1 2\nf ", 1), r"^cannot be parsed \(a vertex of fewer than three coordinates"),
        (OBJ.replace("f ", "v\nf ", 1), r"^cannot be parsed \(a vertex of fewer than three coordinates"),
        (OBJ.replace("f ", "f 1 2 x\nf ", 1), r"^cannot be parsed"),
        *((OBJ + f"f 1 2 {n}\n", r"^names vertices that it does not hold \(1 … 8 exist\)") for n in (0, 9, -9)),
        (OBJ + "surf 0 1 0 1 1 2 3\n", r"^has lines 'surf', which bring surfaces that are no polygons"),
        (OBJ + "call more.obj\n", r"^has lines 'call'"),
        (OBJ.replace("\n", "\n\0\0", 1), r"^is text with NUL bytes in it, so it is damaged"),
        (OBJ.encode("utf-16").decode("latin-1"), r"^is text in UTF-16; save it as plain text"),
        (gzip.compress(OBJ.encode()).decode("latin-1"), r"^is packed by gzip; unpack it first"),
    ],
)
def test_obj_files_that_are_refused(tmp_path: Path, content: str, match: str) -> None:
    (tmp_path / "a.obj").write_bytes(content.encode("latin-1"))
    with pytest.raises(BadMesh, match=match):
        read_mesh(tmp_path / "a.obj")


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("kind", PLY_KINDS)
def test_ply_files_by_their_line_ends(tmp_path: Path, kind: str, end: str) -> None:
    """The first number follows the header's last line at once."""
    vertices, faces = letter()
    vertices = vertices + 10
    # In a binary file the first byte looks like an end of line, too.
    vertices[0, 0] = np.frombuffer(b"\n\r\n\r\x00\x00\x24\x40" if "little" in kind else b"@$\n\r\n\r\n\r")[0]
    content = ply(vertices, faces, kind)
    header, mark, body = content.partition(b"end_header\n")
    body = body.replace(b"\n", end.encode()) if kind == "ascii" else body
    header = header.replace(b"vertex_indices", b"vertex_indices\ncomment end_header is not here")
    (tmp_path / "a.ply").write_bytes((header + mark).replace(b"\n", end.encode()) + body)
    found = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(found.vertices, vertices)
    assert found.counts.tolist() == [len(face) for face in faces]


@pytest.mark.parametrize("kind", PLY_KINDS)
def test_a_ply_file_of_more_than_its_header_counts_is_refused(tmp_path: Path, kind: str) -> None:
    vertices, faces = letter()
    content = ply(vertices, faces, kind).replace(b"element face 10", b"element face 8")
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(BadMesh, match=r"the file goes on after the elements that its header counts"):
        read_mesh(tmp_path / "a.ply")


def wave(corners: int) -> np.ndarray:
    """An outline with a notch at every second corner."""
    angle = 2 * np.pi * np.arange(corners) / corners
    reach = 1 + 0.2 * (np.arange(corners) % 2)
    return np.stack([reach * np.cos(angle), 0 * angle, reach * np.sin(angle)], axis=1)


@pytest.mark.parametrize("kind", ["obj", *PLY_KINDS])
def test_corners_of_a_face_are_bounded(tmp_path: Path, kind: str) -> None:
    path = tmp_path / ("a.obj" if kind == "obj" else "a.ply")

    def write(corners: int) -> None:
        outline = wave(min(corners, 250))
        face = [[k % len(outline) for k in range(corners)]]
        path.write_bytes(obj(outline, face) if kind == "obj" else ply(outline, face, kind))

    # The binary files here count corners in a byte.
    if kind in ("obj", "ascii"):
        for corners in (polygon_files.MOST_CORNERS + 1, 300_000):
            write(corners)
            with pytest.raises(
                BadMesh, match=rf"^has a face \(1\) of {corners} corners, and at most 4000 are handled"
            ):
                read_mesh(path)
    write(250)
    assert len(read_mesh(path).triangles) == 248


def test_faces_with_notches_are_bounded_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(polygon_files, "MOST_PAIRS", 2 * 50**2)
    outline = wave(50)
    for faces, is_read in ((2, True), (3, False)):
        (tmp_path / "a.obj").write_bytes(obj(outline, [list(range(50))] * faces))
        if is_read:
            assert len(read_mesh(tmp_path / "a.obj").triangles) == 48 * faces
        else:
            with pytest.raises(BadMesh, match=r"^has too many faces with notches, of up to 50 corners; triangulate"):
                read_mesh(tmp_path / "a.obj")
    # Faces without notches are no work.
    disc = np.stack([np.cos(np.arange(50) * np.pi / 25), np.zeros(50), np.sin(np.arange(50) * np.pi / 25)], axis=1)
    (tmp_path / "b.obj").write_bytes(obj(disc, [list(range(50))] * 20))
    assert len(read_mesh(tmp_path / "b.obj").triangles) == 960


@pytest.mark.parametrize("kind", PLY_KINDS)
def test_a_ply_file_cut_short_is_refused(tmp_path: Path, kind: str) -> None:
    vertices, faces = letter()
    for some in (faces, faces[2:]):
        content = ply(vertices, some, kind)
        (tmp_path / "c.ply").write_bytes(content)
        assert len(read_ply(tmp_path / "c.ply").counts) == len(some)
        (tmp_path / "c.ply").write_bytes(content[: -9 if kind == "ascii" else -3])
        with pytest.raises(BadMesh, match=r"^cannot be parsed"):
            read_mesh(tmp_path / "c.ply")


def test_a_quad_that_is_not_flat_gets_a_line(tmp_path: Path) -> None:
    line = r"1 of 1 faces have more than three corners and lie off a plane by more than 5% of their size"
    for name, bent in (("flat.obj", 0.01), ("bent.obj", 0.2)):
        vertices = np.array([(0, bent, 0), (1, -bent, 0), (1, bent, 1), (0, -bent, 1)])
        (tmp_path / name).write_bytes(obj(vertices, [[0, 1, 2, 3]]))
        assert len(unit_mesh(tmp_path / name, MeshOptions()).triangles) == 2
        item = {"kind": "mesh", "path": name, "height_m": 1.0}
        config = config_from_mapping({"scenes": 1, "scene": {"contents": [item]}}, base_directory=tmp_path)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            check_inputs(config)
        lines = [str(warning.message) for warning in caught if "off a plane" in str(warning.message)]
        assert len(lines) == (name == "bent.obj")
        assert all(text.startswith("scene.contents[0].path = 'bent.obj': 1 of 1") for text in lines)
    with pytest.warns(InputWarning, match=line):
        read_parts([tmp_path / "bent.obj"])


STAR = [(np.cos(a), np.sin(a)) for a in np.arange(5) * 4 * np.pi / 5]


@pytest.mark.parametrize("outline", [[(0, 0), (2, 0), (0.5, 1.5), (1, 1.5)], STAR], ids=("two loops", "star"))
def test_a_face_that_crosses_itself_is_refused_in_one_line(
    tmp_path: Path, outline: list[tuple[float, float]]
) -> None:
    (tmp_path / "x.obj").write_bytes(obj(np.insert(np.array(outline), 1, 0.0, axis=1), [list(range(len(outline)))]))
    config = {"scene": {"contents": [{"kind": "mesh", "path": "x.obj", "height_m": 1.0}]}}
    with pytest.raises(InputError) as caught:
        check_inputs(config_from_mapping(config, base_directory=tmp_path))
    assert f"face 1 of {len(outline)} corners crosses itself); triangulate it" in str(caught.value)
    assert "\n" not in str(caught.value)
