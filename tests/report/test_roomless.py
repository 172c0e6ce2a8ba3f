"""Datasets whose rooms nobody can draw, made in Python or imported: `show` and `preview` draw what is stored."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import trimesh

import datagen as dg
from datagen.cli import run
from datagen.config import config_from_mapping
from datagen.errors import InputError
from datagen.formats import export
from datagen.report.contact_sheet import contact_sheet
from datagen.report.pages import show, stored_pages
from datagen.report.preview import preview
from datagen.report.replay import read_scene
from datagen.report.stored import why_roomless
from datagen.report.style import house_style
from datagen.store import read_manifest

pytestmark = pytest.mark.usefixtures("builds_here", "coarse")

WALL = dg.Rectangle.of((0, 0, 0), (0, 1, 0), (0, 0, 1))


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes whose light comes from elsewhere, with labels; the second's objects are two."""

    def scene(x: float, boxes: int) -> dg.Scene:
        wall = trimesh.creation.box((0.1, 4, 3)).apply_translation((-0.05, 0, 0))
        parts = [dg.Part("wall", wall, dg.Lambertian(0.8), "relay_wall")]
        for number in range(boxes):
            box = trimesh.creation.box((0.4, 0.4, 0.4)).apply_translation((x, 0.45 * number, 0))
            parts.append(dg.Part(f"box_{number}", box, dg.Lambertian(0.6), pose=dg.Pose.upright("box")))
        return dg.Scene.from_parts(parts, relay_wall=WALL, hidden_view=WALL, hidden_bounds=[(0, -1, -1), (2, 1, 1)])

    eye, y, z = (3.0, -1.0, 0.0), *np.meshgrid([0.2, 0.0, -0.2], [0.2, 0.0, -0.2])
    laser = dg.Laser(eye, np.stack([0 * y, -y, z], axis=-1).reshape(-1, 3))
    sensor = dg.Sensor(
        eye, laser.targets[:, None] + [[0, -0.05, -0.05], [0, 0.05, -0.05], [0, 0.05, 0.05], [0, -0.05, 0.05]]
    )
    capture = dg.Capture(laser, sensor, dg.TimeAxis(32, 1e-9, origin="wall"), "confocal")
    light = np.zeros(capture.shape)
    light[np.arange(9), 0, np.arange(9) + 5] = 5e-11
    path = tmp_path_factory.mktemp("given") / "set"
    fields = ("histogram", "transient", "depth", "part_id", "occupancy", "objects")
    settings = {"labels": {"rows": 8, "columns": 8, "voxels": [4, 4, 4]}, "detector": {"photons_per_pulse": 1e9}}
    items = [(scene(0.8, 1), capture, light), (scene(1.2, 2), capture, 2 * light)]
    dg.build_from(items, path, fields=fields, settings=settings, progress=False)
    return path


def imported(folder: Path, **variables: Any) -> Path:
    folder.mkdir()
    scipy.io.savemat(folder / "c.mat", variables)
    dg.import_captures(folder / "c.mat", folder / "set", bin_width="100ps", progress=False)
    return folder / "set"


def texts(path: Path, index: int = 0) -> dict[str, str]:
    """Picture → all that is written in it."""
    from matplotlib.text import Text

    stored = read_scene(path, index)
    why = why_roomless(stored.config, stored.missing)
    assert why is not None
    with house_style():
        return {
            name: " ".join(text.get_text().replace("\n", " ") for text in figure.findobj(Text))
            for name, figure in stored_pages(stored, why)
        }


def test_scenes_made_in_python(given: Path, tmp_path: Path) -> None:
    written = texts(given, 1)
    assert list(written) == ["histogram", "transient", "scan", "labels"]
    assert "made in Python" in written["transient"] and "photons per emitted photon" in written["transient"]
    assert "counts per bin" in written["histogram"] and "4 moments" in written["scan"]
    assert all(word in written["labels"] for word in ("box_1", "Depth (m)", "Occupied share", "Objects"))
    page = preview(given, tmp_path / "page.html", scenes=1).read_text()
    assert "There are no rooms to show: these scenes were made in Python" in page
    pictured = re.findall(r'alt="([^"]+)"', page)
    assert [of for of in pictured if of.startswith("scene")] == [
        "scene 0, histogram", "scene 0, transient", "scene 0, scan", "scene 0, labels",
    ]  # fmt: skip


@pytest.mark.parametrize("kind", ["grid", "one", "single", "dark"])
def test_imported_captures(kind: str, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    points = random.normal(size=(7, 3)) * [1, 1, 0]
    lists = {"laser_points": points, "camera_points": 0.9 * points, "trans_data": random.random((7, 20))}
    path = imported(tmp_path / "made", **{
        "grid": {"rect_data": random.poisson(1.0, (3, 4, 20)), "width": 1.0},
        "one": {name: of[:1] for name, of in lists.items()},
        "single": lists | {"laser_points": np.repeat(points[:1], 7, axis=0)},
        "dark": {"rect_data": np.zeros((3, 4, 20)), "width": 1.0},
    }[kind])  # fmt: skip
    measured = "histogram" if kind in ("grid", "dark") else "transient"
    written = texts(path)
    assert list(written) == ([measured] if kind == "one" else [measured, "scan"])
    assert "(file c.mat)" in written[measured] and "imported, and have no room to draw" in written[measured]
    assert ("signal per bin" in written[measured]) == (measured == "transient")
    assert ("number of the pixel" in written.get("scan", "")) == (kind == "single")
    if kind == "grid":
        pictures = show(path, 0, tmp_path / "show")
        assert [of.stem for of in pictures] == [f"scene-000000-{name}" for name in written]
        page = preview(path, tmp_path / "page.html").read_text()
        assert "have no room to draw" in page and 'alt="scene 0, histogram"' in page


def test_what_is_nothing_to_draw_is_told(given: Path, tmp_path: Path) -> None:
    scene = dg.Scene.from_parts([dg.Part("wall", trimesh.creation.box(), dg.Lambertian(0.8), "relay_wall")])
    capture = dg.Capture(
        dg.Laser((3, 0, 0), [(0, 0, 0)]), dg.Sensor.grid((3, 0, 0), (0, 0, 0), (0, 1, 0), (0, 0, 1), 1, 1),
        dg.TimeAxis(4, 1e-9),
    )  # fmt: skip
    item = (scene, capture, np.zeros((1, 1, 4)))
    dg.build_from([item], tmp_path / "set", fields=("transient_stderr",), progress=False)
    with pytest.raises(InputError, match=r"made in Python.*neither histogram, transient nor labels"):
        show(tmp_path / "set", 0, tmp_path / "show")
    for call in (
        lambda: export(given, tmp_path / "glb", "glb"),
        lambda: contact_sheet(read_manifest(given).parsed_config(), 1, tmp_path / "sheet.png"),
        lambda: dg.build(config_from_mapping(read_manifest(given).config), tmp_path / "again", progress=False),
    ):
        with pytest.raises(InputError, match="made in Python, and cannot be drawn again"):
            call()
    assert run(["verify", "--resimulate", "1", str(given)]) == run(["replay", str(given), "0"]) == 2
    assert not (tmp_path / "again").exists() and not (tmp_path / "sheet.png").exists()
