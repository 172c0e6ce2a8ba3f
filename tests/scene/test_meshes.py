"""Mesh files: every format gives the same object, and every bad file one line."""

from __future__ import annotations

import json
import pickle
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from room_laws import assert_room_laws
from scipy.spatial import cKDTree

from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError
from datagen.records import Scene
from datagen.scene import check_scene_config, generate_scene
from scene_library import meshes
from scene_library.mesh_file import BadMesh
from scene_library.meshes import MeshOptions, unit_mesh


def spec_with(path: str, base: Path, **keys: object) -> DatasetConfig:
    item = {"kind": "mesh", "path": path, "height_m": 1.0, **keys}
    return config_from_mapping({"scene": {"contents": [item]}}, base_directory=base)


def object_corners(scene: Scene) -> np.ndarray:
    return scene.corners[scene.faces_of(scene.part_names[-1])]


def lump() -> trimesh.Trimesh:
    """A closed, lopsided shape that shows any wrong axis: a box with a cone to one side."""
    cone = trimesh.creation.cone(radius=0.3, height=1.1)
    cone.apply_translation([0.2, 0.1, 0.9])
    return trimesh.util.concatenate([trimesh.creation.box(extents=[0.5, 0.8, 1.0]), cone])


@pytest.mark.parametrize("scale", [1.0, 1e-300, 1e307])
def test_every_format_and_unit_gives_the_same_object(tmp_path: Path, scale: float) -> None:
    """Not even squares and cubes of coordinates need be numbers."""
    if scale == 1:
        names = [f"lump{suffix}" for suffix in meshes.SUFFIXES]
        for name in names:
            lump().export(tmp_path / name)
    else:
        names = ["lump.obj"]
        _write(tmp_path, "lump.obj", obj_of(lump(), scale))
    lump().export(tmp_path / "reference.ply")
    expected, *found = (
        object_corners(generate_scene(spec_with(file, tmp_path, up="z").scene, 0, 0))
        for file in ("reference.ply", *names)
    )
    for corners in found:
        assert len(corners) == len(expected) == len(lump().faces)
        nearest, _ = cKDTree(corners.mean(axis=1)).query(expected.mean(axis=1))
        assert nearest.max() < 1e-5
        np.testing.assert_allclose(np.ptp(corners[..., 2]), 1.0)


def obj_of(mesh: trimesh.Trimesh, scale: float = 1.0) -> str:
    """An OBJ file with every digit of the coordinates."""
    lines = ["v " + " ".join(map(repr, map(float, vertex * scale))) for vertex in mesh.vertices]
    return "\n".join(lines + ["f " + " ".join(str(k + 1) for k in face) for face in mesh.faces])


def test_scene_graphs_are_flattened_with_their_transforms(tmp_path: Path) -> None:
    box = trimesh.creation.box(extents=[1, 1, 1])
    graph = trimesh.Scene()
    graph.add_geometry(box, node_name="low")
    graph.add_geometry(box, node_name="high", transform=trimesh.transformations.translation_matrix([3, 0, 2]))
    graph.export(tmp_path / "two.glb")
    unit = unit_mesh(tmp_path / "two.glb", MeshOptions(up="z"))
    assert len(unit.triangles) == 24
    np.testing.assert_allclose(np.ptp(unit.vertices, axis=0), [4 / 3, 1 / 3, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("up", "front"), [("x", "z"), ("-x", "y"), ("y", "-z"), ("-y", "x"), ("z", "-x"), ("-z", "y"), ("z", "x")]
)
def test_up_and_front_turn_the_file_and_never_mirror_it(tmp_path: Path, up: str, front: str) -> None:
    """What lies along `up` in the file lies along +z, and along `front` along −y, where the front of objects is."""
    lump().export(tmp_path / "lump.ply")
    unit = unit_mesh(tmp_path / "lump.ply", MeshOptions(up=up, front=front))
    height = np.ptp(lump().vertices[:, "xyz".index(up[-1])])
    # Volume is signed: a reflection would change its sign.
    np.testing.assert_allclose(trimesh.Trimesh(unit.vertices, unit.triangles).volume * height**3, lump().volume)
    for axis, found in ((up, unit.vertices[:, 2]), (front, -unit.vertices[:, 1])):
        along = lump().vertices[:, "xyz".index(axis[-1])] * (-1 if axis.startswith("-") else 1) / height
        offset = (along.max() + along.min()) / 2 - (found.max() + found.min()) / 2
        assert abs(found[:, None] - (along - offset)).min(axis=0).max() < 1e-6
        assert abs(np.ptp(found) - np.ptp(along)) < 1e-6


@pytest.mark.parametrize("front", ["x", "-x", "y", "-y", "z", "-z"])
def test_every_front_is_turned_to_where_fronts_are(tmp_path: Path, front: str) -> None:
    """With either upward axis across it: a cone that points to the front points to −y."""
    along, sign = "xyz".index(front[-1]), -1.0 if front.startswith("-") else 1.0
    for up in (axis for axis in ("x", "-x", "y", "-y", "z", "-z") if axis[-1] != front[-1]):
        block, tip = trimesh.creation.box(extents=[1, 1, 1]), np.zeros(3)
        tip[along] = 2.0 * sign
        corners = block.vertices.copy()
        forward = block.vertices[:, along] * sign > 0
        # The side to the front is drawn together to a tip.
        corners[forward] = tip + 1e-3 * block.vertices[forward]
        trimesh.Trimesh(corners, block.faces, process=False).export(tmp_path / "pointed.ply")
        unit = unit_mesh(tmp_path / "pointed.ply", MeshOptions(up=up, front=front))
        assert unit.vertices[:, 1].argmin() in np.flatnonzero(abs(unit.vertices[:, 0]) < 0.01)
        assert unit.vertices[:, 1].min() == pytest.approx(-1.25, abs=1e-2)


@pytest.mark.parametrize(("up", "about"), [("z", (1, 0, 0)), ("y", (1, 0, 0)), ("x", (0, 1, 0))])
def test_a_file_upside_down_whose_front_is_not_stated_is_the_same_object(
    tmp_path: Path, up: str, about: tuple[int, int, int]
) -> None:
    """A half-turn about an axis across `up` and its front takes the one default to the other."""
    made = []
    for axis, turn in ((up, 0.0), (f"-{up}", np.pi)):
        mesh = lump()
        mesh.apply_transform(trimesh.transformations.rotation_matrix(turn, about))
        mesh.export(tmp_path / f"{axis}.ply")
        made.append(unit_mesh(tmp_path / f"{axis}.ply", MeshOptions(up=axis)).vertices)
    # The file's vertices are merged in another order.
    nearest, _ = cKDTree(made[1]).query(made[0])
    assert len(made[0]) == len(made[1]) and nearest.max() < 1e-5


def test_a_front_along_the_upward_axis_is_refused(tmp_path: Path) -> None:
    lump().export(tmp_path / "lump.ply")
    with pytest.raises(InputError, match=r"contents\[0\].*: front = '-y': must lie across up"):
        spec_with("lump.ply", tmp_path, up="y", front="-y")


def test_seams_duplicates_degenerate_and_inverted_faces_are_repaired(tmp_path: Path) -> None:
    clean = lump()
    soup = trimesh.Trimesh(
        clean.triangles.reshape(-1, 3), np.arange(3 * len(clean.faces)).reshape(-1, 3), process=False
    )
    faces = np.concatenate([soup.faces, soup.faces[:5], soup.faces[:3, ::-1], [[0, 0, 1], [2, 2, 2]]])
    trimesh.Trimesh(soup.vertices, faces, process=False).export(tmp_path / "soup.ply")
    unit = unit_mesh(tmp_path / "soup.ply", MeshOptions())
    assert len(unit.triangles) == len(clean.faces)
    assert len(unit.vertices) == len(np.unique(clean.vertices, axis=0))


def test_simplification_keeps_the_budget_and_the_shape(tmp_path: Path) -> None:
    """Of a ball, and of a plate, which has no volume."""
    trimesh.creation.icosphere(subdivisions=4).export(tmp_path / "ball.ply")
    corners = object_corners(generate_scene(spec_with("ball.ply", tmp_path, max_triangles=400).scene, 0, 0))
    assert 300 <= len(corners) <= 400
    middle = (corners.reshape(-1, 3).min(axis=0) + corners.reshape(-1, 3).max(axis=0)) / 2
    np.testing.assert_allclose(np.linalg.norm(corners.reshape(-1, 3) - middle, axis=1), 0.5, rtol=0.05)
    quad = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]], [[0, 1, 2], [0, 2, 3]])
    quad.subdivide().subdivide().subdivide().export(tmp_path / "flat.ply")
    plate = unit_mesh(tmp_path / "flat.ply", MeshOptions(max_triangles=20))
    assert len(plate.triangles) <= 20
    np.testing.assert_allclose(trimesh.Trimesh(plate.vertices, plate.triangles).area, 1, rtol=1e-5)


@pytest.mark.parametrize(
    ("placement", "x", "y"), [("floor", 1.0, 0.0), ("wall", 0.0, 1.0), ("hanging", 0.28, -0.96), ("wall", 0.6, 0.8)]
)
def test_a_flat_quad_is_an_object_like_any_other(tmp_path: Path, placement: str, x: float, y: float) -> None:
    _write(tmp_path, "quad.obj", f"v 0 0 0\nv {x} {y} 0\nv {x} {y} 1\nv 0 0 1\nf 1 2 3\nf 1 3 4\n")
    scene = generate_scene(spec_with("quad.obj", tmp_path, placement=placement).scene, 0, 0)
    assert_room_laws(scene, np.random.default_rng(0))
    found = [scene.parameters[f"quad.{key}"] for key in ("width_m", "depth_m", "height_m")]
    np.testing.assert_allclose(found, [abs(x), abs(y), 1.0], atol=1e-6)


def test_triangle_strips_are_triangles(tmp_path: Path) -> None:
    """One strip that −1 ends, or one a line; binary or text: the same surface, wound one way."""
    header = (
        "ply\nformat {} 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
        "element tristrips {}\nproperty list int int vertex_indices\nend_header\n"
    )
    points = [[0, 0, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1], [0, 1, 2]]
    text = "".join(f"{x} {y} {z}\n" for x, y, z in points)
    _write(tmp_path, "marked.ply", header.format("ascii", 1) + text + "8 0 1 2 3 -1 2 3 4\n")
    _write(tmp_path, "apart.ply", header.format("ascii", 2) + text + "4 0 1 2 3\n3 2 3 4\n")
    strip = np.array([8, 0, 1, 2, 3, -1, 2, 3, 4], "<i4").tobytes()
    binary = header.format("binary_little_endian", 1).encode() + np.array(points, "<f4").tobytes() + strip
    _write(tmp_path, "binary.ply", binary)
    _write(tmp_path, "plain.obj", "".join(f"v {x} {y} {z}\n" for x, y, z in points) + "f 1 2 3\nf 3 2 4\nf 3 4 5\n")
    plain = unit_mesh(tmp_path / "plain.obj", MeshOptions())
    for name in ("marked.ply", "apart.ply", "binary.ply"):
        found = unit_mesh(tmp_path / name, MeshOptions())
        np.testing.assert_array_equal(found.vertices, plain.vertices)
        assert {_from_least(face) for face in found.triangles} == {_from_least(face) for face in plain.triangles}


def _from_least(face: np.ndarray) -> tuple[int, ...]:
    return tuple(np.roll(face, -int(np.argmin(face))).tolist())


def _write(folder: Path, name: str, content: str | bytes) -> None:
    (folder / name).write_bytes(content.encode() if isinstance(content, str) else content)


BAD_FILES = {
    "empty.obj": ("", "is empty"),
    "no_faces.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\n", "no triangles"),
    "line.obj": ("v 0 0 0\nv 1 0 0\nv 2 0 0\nv 3 0 1\nf 1 2 3\n", "no area"),
    "point.obj": ("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "no area"),
    "nan.obj": ("v 0 0 0\nv nan 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 3 4\n", "NaN"),
    "flat.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "flat along its upward axis"),
    "outside.obj": ("v 0 0 0\nv 1 0 0\nv 0 1 1\nf 1 2 9\n", ""),
    "noise.ply": (b"ply\nformat binary_little_endian 1.0\nelement vertex 9\x00\xff\xfe", "cannot be parsed"),
    "noise.glb": (bytes(range(256)), "cannot be parsed"),
    "noise.stl": (b"\x00" * 84 + b"\x07", ""),
    "text.stl": ("this is no mesh\n", ""),
    "cloud.ply": (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n",
        "point cloud",
    ),
    "mesh.fbx": ("anything", "convert it"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_are_refused_in_one_line(tmp_path: Path, name: str) -> None:
    content, reason = BAD_FILES[name]
    _write(tmp_path, name, content)
    with pytest.raises(InputError) as caught:
        check_scene_config(spec_with(name, tmp_path).scene)
    message = str(caught.value)
    assert message.startswith(f"scene.contents[0].path = '{name}': ")
    assert reason in message
    assert "\n" not in message


def glb(path: Path, nodes: list[dict[str, object]], triangles: int = 1) -> None:
    """A file whose one mesh, which is not there, has so many triangles."""
    tree = {
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"componentType": 5126, "count": 3 * triangles, "type": "VEC3"}],
    }  # fmt: skip
    text = json.dumps(tree).encode()
    lengths = np.array([2, 20 + len(text), len(text), 0x4E4F534A], "<u4")
    path.write_bytes(b"glTF" + lengths.tobytes() + text)


def test_too_many_triangles_are_counted_before_they_are_read(tmp_path: Path) -> None:
    """Of every format; more of them are read to be thinned. The files end where the triangles would begin."""
    many = meshes.MOST_TRIANGLES + 9
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex 3\nelement face {many}\nend_header\n"
    _write(tmp_path, "many.ply", header)
    with (tmp_path / "many.stl").open("wb") as file:
        file.write(bytes(80) + many.to_bytes(4, "little"))
        file.truncate(84 + 50 * many)
    _write(tmp_path, "many.obj", "v 0 0 0\nv 1 0 0\nv 0 1 1\n" + "f 1 2 3\n" * many)
    glb(tmp_path / "many.glb", [{"mesh": 0, "children": [1]}, {"mesh": 0}], many // 2 + 1)
    for suffix in meshes.SUFFIXES:
        with pytest.raises(BadMesh, match=r"^has 40000\d\d triangles, .* set max_triangles, .* or thin it"):
            unit_mesh(tmp_path / f"many{suffix}", MeshOptions())
    glb(tmp_path / "more.glb", [{"mesh": 0}], meshes.MOST_THINNED + 1)
    with pytest.raises(BadMesh, match=r"^has 16000001 triangles, and at most 16000000 are handled; thin it"):
        unit_mesh(tmp_path / "more.glb", MeshOptions(max_triangles=20))


def test_nodes_of_several_parents_are_refused(tmp_path: Path) -> None:
    """Thirty levels of them would be a billion triangles."""
    glb(tmp_path / "tree.glb", [{"children": [k + 1, k + 1]} for k in range(30)] + [{"mesh": 0}])
    with pytest.raises(BadMesh, match=r"^has a node \(1\) with 2 parents, and glTF allows one"):
        unit_mesh(tmp_path / "tree.glb", MeshOptions())


def test_coordinates_far_from_the_origin(tmp_path: Path) -> None:
    """In national coordinates a shape is lost in single precision, half a metre a step, and kept in decimals."""
    far = lump()
    far.apply_translation([4.5e6, 5.1e6, 300.0])
    far.export(tmp_path / "far.stl")
    with pytest.raises(InputError, match=r"path = 'far.stl': lies so far from its origin .* steps of 0\.[2-5]"):
        check_scene_config(spec_with("far.stl", tmp_path).scene)
    _write(tmp_path, "far.obj", obj_of(far))
    lump().export(tmp_path / "near.ply")
    found, expected = (unit_mesh(tmp_path / name, MeshOptions()) for name in ("far.obj", "near.ply"))
    assert len(found.triangles) == len(expected.triangles)
    np.testing.assert_allclose(np.ptp(found.vertices, axis=0), np.ptp(expected.vertices, axis=0), rtol=1e-6)


def test_missing_files_are_refused_when_the_configuration_is_read(tmp_path: Path) -> None:
    (tmp_path / "folder.obj").mkdir()
    for name, reason in (("absent.obj", "no such file"), ("folder.obj", "is a directory")):
        with pytest.raises(InputError, match=rf"scene\.contents\[0\]: path = '{name}': {reason}"):
            spec_with(name, tmp_path)


def test_missing_open3d_names_the_system_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimesh.creation.icosphere(subdivisions=3).export(tmp_path / "ball.ply")
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(InputError, match=r"docker/system-packages\.txt") as caught:
        check_scene_config(spec_with("ball.ply", tmp_path, max_triangles=100).scene)
    packages = (Path(__file__).parents[2] / "docker" / "system-packages.txt").read_text().split()
    assert all(package in str(caught.value) for package in packages)


def test_paths_survive_dumping_and_pickling(tmp_path: Path) -> None:
    (tmp_path / "sub").mkdir()
    lump().export(tmp_path / "sub" / "lump.ply")
    config = spec_with("sub/lump.ply", tmp_path)
    again = DatasetConfig.model_validate_json(config.model_dump_json(), context={"base_directory": str(tmp_path)})
    sent = pickle.loads(pickle.dumps(config))
    expected = object_corners(generate_scene(config.scene, 0, 0))
    for other in (again, sent):
        assert other.fingerprint() == config.fingerprint()
        np.testing.assert_array_equal(object_corners(generate_scene(other.scene, 0, 0)), expected)
    assert config.scene.contents[0].path == "sub/lump.ply"


def test_fingerprint_follows_the_bytes_not_the_place(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        lump().export(tmp_path / name / "lump.ply")
    a, b = (spec_with("lump.ply", tmp_path / n) for n in "ab")
    assert a.fingerprint() == b.fingerprint()
    trimesh.creation.box().export(tmp_path / "b" / "lump.ply")
    assert a.fingerprint() != b.fingerprint()
    (tmp_path / "b" / "lump.ply").unlink()
    with pytest.raises(InputError, match=r"scene\.contents\[0\]\.path = 'lump.ply'"):
        b.fingerprint()
