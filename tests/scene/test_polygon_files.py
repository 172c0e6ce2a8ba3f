"""Faces of any number of corners, in OBJ and PLY: the triangles cover what the outline encloses, and nothing else."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from datagen.building.input_check import check_inputs
from datagen.config import config_from_mapping
from datagen.devices.compare import read_parts
from datagen.errors import InputError, InputWarning
from scene_library.meshes import BadMesh, MeshOptions, read_mesh, unit_mesh
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
