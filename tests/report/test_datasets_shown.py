"""`show`, `preview` and the contact sheet on a small dataset that is really built, and on everything that is none."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from datagen.building.build import build
from datagen.config import DatasetConfig, config_from_mapping
from datagen.errors import InputError, InputWarning
from datagen.records import Scene
from datagen.report import preview as module
from datagen.report.contact_sheet import contact_sheet, label_sheet
from datagen.report.pages import PAGES, show
from datagen.report.parameter_plots import varying
from datagen.report.preview import preview
from datagen.report.replay import REPRODUCED, read_scene, replay
from datagen.report.rooms import RoomPicture, draw_plan, draw_sight
from datagen.report.style import house_style, new_figure
from datagen.scene import generate_scene
from datagen.store.columns import Columns
from datagen.store.files import sealed_bytes
from datagen.store.record import record_path

pytestmark = pytest.mark.usefixtures("builds_here", "coarse")


@pytest.fixture(scope="module")
def config() -> DatasetConfig:
    return config_from_mapping(
        {
            "name": "small & <odd>",
            "seed": 4,
            "scenes": 10,
            "capture": {"scan": {"rows": 3, "columns": 4}, "time": {"bins": 64, "bin_width_ps": 800}},
            "transport": {"samples": 64},
            "detector": {"photons_per_pulse": 1e6},
            "labels": {"rows": 16, "columns": 16, "voxels": [8, 8, 8]},
            "store": {"fields": ["histogram", "transient", "depth"], "scenes_per_shard": 8},
        }
    )


@pytest.fixture(scope="module")
def dataset(config: DatasetConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten scenes in two shards, the second not built."""
    root = tmp_path_factory.mktemp("shown") / "small.zarr"
    build(config, root, 1, shards="0", progress=False)
    return root


def test_replay_tells_whether_the_scene_is_the_stored_one(dataset: Path) -> None:
    stored = read_scene(dataset, 2)
    again = replay(stored)
    assert again.reproduced and again.moved_m == 0
    assert again.difference is not None and again.difference < REPRODUCED
    np.testing.assert_array_equal(again.counts, stored.arrays["histogram"])
    parts = sum(again.transient.parts.values(), np.zeros(again.capture.shape))
    np.testing.assert_allclose(parts, again.transient.total, rtol=1e-9, atol=1e-25)
    arrays = {**stored.arrays, "laser_points": stored.arrays["laser_points"] + 1e-3}
    del arrays["transient"]
    other = replay(replace(stored, arrays=arrays))
    assert other.difference is None and not other.reproduced
    assert other.moved_m == pytest.approx(1e-3 * 3**0.5)


def test_show_writes_beside_the_dataset_and_leaves_it_alone(dataset: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in dataset.rglob("*")}
    written = show(dataset, 1)
    assert [path.name for path in written] == [f"scene-000001-{name}.png" for name in PAGES]
    assert {path.parent for path in written} == {dataset.with_name("small.zarr.show")}
    assert all(imread(path).std() > 0.02 for path in written)
    assert before == {path: path.stat().st_mtime_ns for path in dataset.rglob("*")}


def test_the_page_opens_at_the_light_of_the_objects_of_a_scan_with_axes(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And it says how many rooms there are, of which it shows some."""
    monkeypatch.setattr(module, "ROOMS", 2)
    page = preview(dataset, tmp_path / "page.html", scenes=1).read_text(encoding="utf-8")
    found = re.search(r"const scenes = (\[.*\]), total = (\d+)", page)
    assert found is not None and found[2] == "8"
    scenes = json.loads(found[1])
    assert len(scenes) == 2
    again, scan = replay(read_scene(dataset, 0)), scenes[0]["scan"]
    objects = np.sum([again.transient.parts[name] for name in again.scene.objects], axis=0)
    assert objects.any() and scan["width_ns"] == pytest.approx(0.8)
    time_ns = again.capture.time.start_s * 1e9 + 0.8 * np.argmax(objects.sum(axis=(0, 1)))
    assert scan["start_ns"] + 0.8 * scan["open"]["bin"] == pytest.approx(time_ns)
    row, column = scan["open"]["place"]
    strongest = objects[..., np.argmax(objects.sum(axis=(0, 1)))]
    assert strongest.reshape(3, 4)[row, column] == strongest.max()
    # Half a step beyond the outermost of 4 × 3 places, which are as far apart as laser points.
    points = again.capture.laser.targets.reshape(3, 4, 3)
    across, up = (np.linalg.norm(points[0, 1] - points[0, 0]), np.linalg.norm(points[1, 0] - points[0, 0]))
    (left, right), (top, bottom) = scan["across"]["ends"], scan["up"]["ends"]
    assert (right - left, top - bottom) == pytest.approx((4 * across, 3 * up))
    assert (scan["across"]["name"], scan["up"]["name"]) == ("right (m)", "up (m)")


def test_bad_requests_failed_scenes_and_missing_shards_have_their_line(dataset: Path, tmp_path: Path) -> None:
    copy, blocked = tmp_path / "copy.zarr", tmp_path / "file"
    shutil.copytree(dataset, copy)
    _fail(copy, 3, "the room is too small")
    blocked.write_text("")
    for path, index, line in (
        (dataset, -1, r"INDEX -1: .* has the scenes 0 … 9"),
        (dataset, 10, r"INDEX 10: .* has the scenes 0 … 9"),
        (dataset, 9, r"shard 1 .* is not there yet"),
        (copy, 3, r"INDEX 3: .* could not be made \(the room is too small\)"),
        (tmp_path / "nothing", 0, "no such dataset"),
        (tmp_path, 0, "is no dataset"),
    ):
        with pytest.raises(InputError, match=line):
            show(path, index, tmp_path / "shown")
    with pytest.raises(InputError, match="cannot be written"):
        contact_sheet(read_scene(dataset, 0).config, 1, blocked / "sheet.png")
    record_path(copy, 0).unlink()
    with pytest.raises(InputError, match="no scene is there yet"):
        preview(copy)


def _fail(dataset: Path, scene: int, reason: str | None) -> None:
    path = record_path(dataset, 0)
    record = json.loads(path.read_text())
    record["scenes"][scene]["failure"] = reason
    del record["checksum"]
    path.write_bytes(sealed_bytes(record))


class _Page(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.sources: list[str] = []
        self.words = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        assert (
            tag not in ("link", "iframe")
            and not (tag == "script" and values)
            and not {"href", "onload", "onclick"} & values.keys()
        )
        if tag == "img":
            self.sources.append(values["src"] or "")
        if tag not in ("img", "meta", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words += data


def test_preview_is_one_well_formed_page_that_needs_nothing(dataset: Path) -> None:
    _fail(dataset, 3, "the room is <too small>")
    try:
        path = preview(dataset, scenes=1)
    finally:
        _fail(dataset, 3, None)
    assert path == dataset.with_name("small.zarr.html")
    page = _Page()
    page.feed(path.read_text(encoding="utf-8"))
    assert page.open == []
    assert "small & <odd>" in page.words and "incomplete" in page.words and "8 of 10" in page.words
    assert "1 scenes could not be made\n  scene 3: the room is <too small>" in page.words
    assert all(field in page.words for field in ("histogram", "transient", "depth", "laser_points"))
    assert "pillar.albedo" in page.words and "layout.height_m" in page.words
    # Overview of the scene, and what was drawn.
    assert len(page.sources) == 3
    assert "σ in the median of" in page.words
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)


def test_sheets_of_several_configurations_share_their_rooms(
    config: DatasetConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of four rooms of two configurations each has two; each beside its labels on request."""
    other = config.model_copy(update={"name": "other", "seed": config.seed + 1})
    drawn = []

    def made(of: DatasetConfig, index: int) -> Scene:
        drawn.append((of.name, index))
        return generate_scene(of.scene, of.seed, index)

    monkeypatch.setattr("datagen.report.contact_sheet.scene_for", made)
    four = imread(contact_sheet([config, other], 4, tmp_path / "4.png"))
    assert drawn == [(config.name, 0), (config.name, 1), ("other", 0), ("other", 1)]
    single = imread(contact_sheet(config, 1, tmp_path / "1.png"))
    assert four.shape[0] > 1.3 * single.shape[0] and four.shape[1] == single.shape[1]
    assert single[..., :3].std() > 0.05 and four[..., :3].std() > 0.05
    one, two = (imread(label_sheet([config, other], n, tmp_path / f"labels{n}.png")) for n in (1, 2))
    assert one.shape[1] == two.shape[1] and one.shape[0] < two.shape[0]
    for sheet, count in ((contact_sheet, 0), (contact_sheet, 401), (label_sheet, 17)):
        with pytest.raises(InputError, match=f"= {count}: a .*sheet.* holds 1 … "):
            sheet(config, count, tmp_path / "none.png")


def test_the_plan_shows_what_the_device_sees(config: DatasetConfig) -> None:
    """Yellow reaches the middle of the visible relay wall, and no object."""
    scene = generate_scene(config.scene, config.seed, 0)
    with house_style():
        axes = new_figure(4, arranged=False).add_axes((0.1, 0.1, 0.8, 0.8))
        draw_plan(axes, RoomPicture(scene, pixels=100))
        draw_sight(axes, scene)
        seen = axes.collections[-1].get_paths()
    wall = 0.99 * scene.relay_wall.center[:2] + 0.01 * scene.device_position[:2]
    assert any(path.contains_point(wall) for path in seen)
    for name in scene.objects:
        corners = scene.corners[scene.faces_of(name)].reshape(-1, 3)[:, :2]
        assert not any(path.contains_points(corners).any() for path in seen)


def test_varying_keeps_numbers_and_few_words() -> None:
    scenes = [{"a": float(k), "b": 1.0, "kind": "xy"[k % 2], "name": f"n{k}", "flag": k > 9} for k in range(20)]
    scenes[3]["only_here"] = 1.0
    assert list(varying(Columns(scenes))) == ["a", "kind", "flag"]


def test_a_dataset_whose_mesh_files_are_gone_is_shown(tmp_path: Path) -> None:
    """What is stored of it, as of a dataset that was imported."""
    (tmp_path / "panel.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nf 1 2 3\nf 1 3 4\n")
    config = config_from_mapping(
        {
            "scenes": 1,
            "scene": {"contents": [{"kind": "mesh", "path": "panel.obj", "height_m": 0.8}, {"kind": "box"}]},
            "capture": {"scan": {"rows": 2, "columns": 3}, "time": {"bins": 32, "bin_width_ps": 1600}},
            "transport": {"samples": 64},
            "store": {"fields": ["histogram"]},
        },
        base_directory=tmp_path,
    )
    build(config, tmp_path / "set.zarr", 1, progress=False)
    (tmp_path / "panel.obj").unlink()
    with pytest.warns(InputWarning, match=r"panel\.obj is missing; put the one of SHA-256 [0-9a-f]{64} there"):
        written = show(tmp_path / "set.zarr", 0)
    assert [path.stem.split("-")[-1] for path in written] == ["histogram", "scan"]
    with pytest.warns(InputWarning, match=r"panel\.obj is missing"):
        page = preview(tmp_path / "set.zarr", scenes=1).read_text()
    assert "mesh files of its objects are gone" in page
