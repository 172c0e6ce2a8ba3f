"""Mesh files of a dataset are found from any working directory, and only those that the scenes were made with."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import pytest
import trimesh

import datagen as dg
from datagen.cli import run
from datagen.config import load_config
from datagen.store import read_manifest

pytestmark = pytest.mark.usefixtures("builds_here")

CONFIG = """
scenes: 1
scene: {contents: [ITEM]}
capture: {scan: {rows: 2, columns: 3}, time: {bins: 32, bin_width_ps: 1600}}
transport: {samples: 16}
labels: {rows: 8, columns: 8}
store: {fields: [histogram, transient, depth]}
"""
ITEMS = {
    "mesh beside": ("{kind: mesh, path: ../meshes/x.obj, height_m: 0.8}", "../meshes/x.obj"),
    "mesh_folder": ("{kind: mesh_folder, path: zoo, height_m: 0.8}", "zoo/cat/x.obj"),
}
COMMANDS = {
    "show": ["show", "SET", "0"],
    "verify": ["verify", "SET", "--resimulate", "1"],
    "replay": ["replay", "SET", "0"],
    "export": ["export", "SET", "OUT", "--format", "glb"],
}


def write_mesh(path: Path, width_m: float = 0.5) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box((width_m, 0.4, 0.6)).export(path)


@pytest.fixture(params=ITEMS)
def made(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, Path]:
    """A dataset and its mesh file, named relative to the configuration's folder. The working directory is another
    one, where another mesh has the same name."""
    item, mesh = ITEMS[request.param]
    folder, elsewhere = tmp_path / "configs", tmp_path / "elsewhere" / "deeper"
    write_mesh(folder / mesh)
    write_mesh(elsewhere / mesh, 0.2)
    (folder / "config.yaml").write_text(CONFIG.replace("ITEM", item))
    monkeypatch.chdir(elsewhere)
    dg.build(load_config(folder / "config.yaml"), tmp_path / "set", progress=False)
    return tmp_path / "set", folder / mesh


def command(name: str, root: Path) -> list[str]:
    return [part.replace("SET", str(root)).replace("OUT", str(root.parent / "out")) for part in COMMANDS[name]]


def test_meshes_are_found_from_another_working_directory(made: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """And they are theirs, not the narrower one of the same name here: 0.5 m wide at a height of 0.6 m."""
    root, mesh = made
    manifest = read_manifest(root)
    assert manifest.mesh_folder == str(root.parent / "configs")
    names = ["verify", "replay", "export"]
    if mesh.parent.name != "cat":
        names.append("show")
        assert [*manifest.meshes.values()] == [hashlib.sha256(mesh.read_bytes()).hexdigest()]
    for name in names:
        assert run(command(name, root)) == 0, capsys.readouterr().err
    name = dg.scene_for(manifest.parsed_config(), 0).objects[0]
    written = trimesh.load(root.parent / "out" / "scene-000000.glb").geometry[name]
    assert written.volume == pytest.approx(0.5 * 0.4 * 0.6 * (0.8 / 0.6) ** 3, rel=1e-4)


def test_a_changed_or_missing_mesh_is_refused_in_a_line(made: Any, capsys: pytest.CaptureFixture[str]) -> None:
    root, mesh = made
    due = next(iter(read_manifest(root).meshes.values()))

    def refused(name: str) -> str:
        capsys.readouterr()
        assert run(command(name, root)) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert due in line
        return line

    write_mesh(mesh, 0.3)
    for name in COMMANDS:
        line = refused(name)
        assert "has changed (SHA-256 " in line and "scene.contents[0].path" in line
    write_mesh(mesh)
    assert run(command("export", root)) == 0
    # Of a folder with classes, all of it; then a folder stands where a file was, and a file where a folder was.
    is_folder = mesh.parent.name == "cat"
    place = mesh.parents[1] if is_folder else mesh
    place.rename(root.parent / "gone")
    for stand_in in (None, Path.touch if is_folder else Path.mkdir):
        if stand_in is not None:
            stand_in(place)
        for name in ("verify", "replay", "export"):
            assert "is missing; put the one of SHA-256 " in refused(name)
