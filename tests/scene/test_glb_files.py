"""GLB files: each kind gives the shape that it means, or is refused by the name of what it needs."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from glb_writer import AREA, BIG, READ, REFUSED, SLAB, TOWER, VOLUME, Z_UP_BOUNDS, Glb, Write, plain
from limits import little_memory

import datagen as dg
from datagen.building.input_check import check_inputs
from datagen.config import config_from_mapping
from datagen.errors import InputWarning
from scene_library import glb_files, gltf_values
from scene_library.mesh_file import BadMesh
from scene_library.meshes import MeshOptions, read_mesh, unit_mesh


def written(path: Path, write: Write) -> Path:
    glb = Glb()
    write(glb)
    return glb.write(path)


@pytest.mark.parametrize("kind", READ)
def test_every_kind_gives_the_solid(tmp_path: Path, kind: str) -> None:
    """Its area, volume (which a triangle wound inwards would change) and place, z up."""
    mesh = read_mesh(written(tmp_path / "a.glb", READ[kind]))
    solid = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    rough = 0.05 if "i1" in kind or "u1" in kind else 1e-3
    assert mesh.doubt == ""
    assert solid.area == pytest.approx(AREA, rel=rough)
    assert solid.volume == pytest.approx(VOLUME, rel=rough)
    np.testing.assert_allclose(solid.bounds, Z_UP_BOUNDS, atol=0.02 if rough > 0.01 else 1e-3)
    unit = unit_mesh(tmp_path / "a.glb", MeshOptions())
    np.testing.assert_allclose(np.ptp(unit.vertices, axis=0), [1, 0.5, 1], atol=0.02 if rough > 0.01 else 1e-3)


@pytest.mark.skipif(sys.platform != "linux", reason="needs /proc")
@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_not_read_is_refused_by_its_name(tmp_path: Path, kind: str) -> None:
    word, write = REFUSED[kind]
    path = written(tmp_path / "a.glb", write)
    with little_memory(10**9), pytest.raises(BadMesh, match=word) as caught:
        read_mesh(path)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 300


@pytest.mark.parametrize("place", ["node", "mesh", "primitive", "accessor", "buffer view"])
def test_an_unknown_extension_that_may_be_left_out_gets_a_line(tmp_path: Path, place: str) -> None:
    glb = Glb()
    plain(glb)
    mesh = glb.tree["meshes"][0]
    places = {
        "node": glb.tree["nodes"][0], "mesh": mesh, "primitive": mesh["primitives"][0],
        "accessor": glb.tree["accessors"][0], "buffer view": glb.tree["bufferViews"][0],
    }  # fmt: skip
    places[place]["extensions"] = {"ACME_bent_space": {}}
    glb.write(tmp_path / "a.glb")
    item = {"kind": "mesh", "path": "a.glb", "height_m": 1.0}
    with pytest.warns(InputWarning, match=rf"path = 'a.glb': has the glTF extension ACME_bent_space \(a? ?{place}"):
        check_inputs(config_from_mapping({"scenes": 1, "scene": {"contents": [item]}}, base_directory=tmp_path))


def test_the_first_of_several_scenes_is_read_with_a_line(tmp_path: Path) -> None:
    glb = Glb()
    glb.show(SLAB, TOWER, BIG)
    glb.tree["scenes"] = [{"nodes": [0, 1]}, {"nodes": [2]}]
    del glb.tree["scene"]
    mesh = read_mesh(glb.write(tmp_path / "a.glb"))
    assert trimesh.Trimesh(mesh.vertices, mesh.triangles).area == pytest.approx(AREA, rel=1e-5)
    assert mesh.doubt == "has 2 scenes and does not say which one is meant: the first is read"


@pytest.mark.parametrize("kind", ["plain", "sparse", "skin", "instances", "morph_weights"])
def test_a_file_cut_anywhere_is_refused(tmp_path: Path, kind: str) -> None:
    content = written(tmp_path / "a.glb", READ[kind]).read_bytes()
    for length in np.linspace(1, len(content) - 1, 40).astype(int):
        (tmp_path / "a.glb").write_bytes(content[:length])
        with pytest.raises(BadMesh):
            read_mesh(tmp_path / "a.glb")
        # With a header that says so.
        (tmp_path / "a.glb").write_bytes(content[:8] + int(length).to_bytes(4, "little") + content[12:length])
        with pytest.raises(BadMesh):
            read_mesh(tmp_path / "a.glb")


def test_numbers_of_the_json_that_are_none_are_refused(tmp_path: Path) -> None:
    """Each number of the JSON in turn becomes another thing; the file is refused, or has a shape still."""
    text = written(tmp_path / "a.glb", READ["instances"]).read_bytes()
    length = int.from_bytes(text[12:16], "little")
    body, rest = text[20 : 20 + length].decode(), text[20 + length :]
    for number in re.finditer(r"(?<=[:\[, ])-?\d+(\.\d+)?(?=[,\]} ])", body):
        for other in ("-1", "1e400", "true", "null", '"x"', "[]", "4294967295"):
            new = (body[: number.start()] + other + body[number.end() :]).encode()
            new += b" " * (-len(new) % 4)
            size = (20 + len(new) + len(rest)).to_bytes(4, "little")
            (tmp_path / "b.glb").write_bytes(text[:8] + size + len(new).to_bytes(4, "little") + b"JSON" + new + rest)
            try:
                read_mesh(tmp_path / "b.glb")
            except BadMesh as error:
                assert "\n" not in str(error)


def test_nodes_and_parts_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(glb_files, "MOST_PARTS", 7)
    glb = Glb()
    glb.show(SLAB, TOWER)
    part = glb.tree["meshes"][0]["primitives"]
    part *= 3
    assert len(read_mesh(glb.write(tmp_path / "a.glb")).triangles) == 48
    part += part[:2]
    with pytest.raises(BadMesh, match=r"^has more than 7 nodes and parts of meshes; join them"):
        read_mesh(glb.write(tmp_path / "a.glb"))
    monkeypatch.setattr(gltf_values, "MOST_JSON_BYTES", 100)
    with pytest.raises(BadMesh, match=r"bytes of JSON, and at most 100 are read"):
        read_mesh(tmp_path / "a.glb")


def test_up_is_y_unless_something_else_is_said(tmp_path: Path) -> None:
    """Of .glb alone; in a folder of files by the format of each. What a dataset stored before stays as it was."""
    written(tmp_path / "a.glb", plain)
    y_up = trimesh.util.concatenate([trimesh.Trimesh(*of, process=False) for of in (SLAB, TOWER)])
    y_up.export(tmp_path / "a.stl")

    def item(**keys: object) -> object:
        config = config_from_mapping(
            {"scene": {"contents": [{"kind": "mesh", "height_m": 1.0} | keys]}}, base_directory=tmp_path
        )
        return config.scene.contents[0]

    assert [item(path=name).up for name in ("a.glb", "a.stl")] == ["y", "z"]  # type: ignore[attr-defined]
    assert item(path="a.glb", up="z").up == "z"  # type: ignore[attr-defined]
    folder = item(kind="mesh_folder", path=str(tmp_path))
    assert folder.up is None  # type: ignore[attr-defined]
    stored = config_from_mapping(
        {"scene": {"contents": [{"kind": "mesh", "path": "a.glb", "up": "z"}]}}, "x", tmp_path, look_for_files=False
    )
    again = config_from_mapping(stored.model_dump(mode="json"), "x", tmp_path, look_for_files=False)
    assert again.scene.contents[0].up == "z"  # type: ignore[union-attr]
    for name, options, size in (
        ("a.glb", MeshOptions(), [1, 0.5, 1]), ("a.glb", MeshOptions(up="y"), [1, 0.5, 1]),
        ("a.glb", MeshOptions(up="z"), [2, 2, 1]), ("a.stl", MeshOptions(), [2, 2, 1]),
        ("a.stl", MeshOptions(up="y"), [1, 0.5, 1]),
    ):  # fmt: skip
        np.testing.assert_allclose(np.ptp(unit_mesh(tmp_path / name, options).vertices, axis=0), size, atol=1e-6)
    with pytest.raises(BadMesh, match=r"^has y as its upward axis, and front = -y must lie across it"):
        unit_mesh(tmp_path / "a.glb", MeshOptions(front="-y"))
    with pytest.raises(dg.InputError, match=r"front = 'y': must lie across up = 'y'"):
        item(path="a.glb", front="y")


def test_a_scene_that_is_written_comes_back(tmp_path: Path) -> None:
    """Part by part the same corners, z up again."""
    parts = [
        dg.Part("ball", trimesh.creation.icosphere(2, 0.3).apply_translation((1, 2, 0.3)), dg.Lambertian(0.6)),
        dg.Part("box", trimesh.creation.box((0.2, 0.3, 0.9)).apply_translation((0, 3, 0.45)), dg.Lambertian(0.2)),
    ]
    scene = dg.Scene.from_parts(parts)
    dg.write_glb(scene, tmp_path / "a.glb")
    mesh = read_mesh(tmp_path / "a.glb")

    def corners(of: np.ndarray) -> np.ndarray:
        rows = of.reshape(-1, 9).round(4)
        return rows[np.lexsort(rows.T)]

    np.testing.assert_allclose(corners(mesh.vertices[mesh.triangles]), corners(scene.corners), atol=2e-4)
