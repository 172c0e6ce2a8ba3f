"""Pictures of sequences: the middle frame as a scene, simulated again, and a strip of all frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from datasets import write_dataset

import datagen as dg
from datagen.config import config_from_mapping
from datagen.labels import ViewFrame
from datagen.report.pages import frames_page, show
from datagen.report.preview import preview
from datagen.report.replay import read_scene, replay
from datagen.report.style import house_style
from tests.sequences.rooms_that_move import box, capture, room

pytestmark = pytest.mark.usefixtures("builds_here")


@pytest.fixture(scope="module")
def walks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = config_from_mapping({
        "scenes": 2, "seed": 4, "name": "walks", "transport": {"target": 0.2},
        "sequence": {"frames": 5, "rate_hz": 4},
        "scene": {"contents": [{"kind": "box", "motion": {"kind": "walk", "speed_m_s": 1.0}}]},
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64, "bin_width_ps": 800}},
        "detector": {"cycles": 10_000}, "labels": {"rows": 6, "columns": 6},
        "store": {"fields": ["histogram", "transient", "depth", "objects"]},
    })  # fmt: skip
    return write_dataset(config, tmp_path_factory.mktemp("walks") / "set")


def test_the_middle_frame_is_simulated_again_as_it_is_stored(walks: Path) -> None:
    whole = read_scene(walks, 1)
    stored = whole.at_frame()
    assert (whole.frames, stored.frame, stored.title) == (5, 2, "walks, scene 1, frame 2 of 5")
    for name in ("histogram", "transient", "depth", "object_box_center"):
        np.testing.assert_array_equal(stored.arrays[name], whole.arrays[name][2])
    assert stored.arrays["laser_points"] is whole.arrays["laser_points"]
    found = replay(stored)
    assert found.reproduced and found.counts.shape == (4, 1, 64) and not found.scene.moving
    middle = found.scene.vertices[np.unique(found.scene.triangles[found.scene.faces_of("box")])].mean(axis=0)
    due = ViewFrame.of(found.scene).to_world(stored.arrays["object_box_center"][0].astype(float))
    np.testing.assert_allclose(middle, due, atol=1e-5)


def test_the_strip_shows_what_moves(walks: Path) -> None:
    with house_style():
        figure = frames_page(read_scene(walks, 0))
        assert figure is not None
        images = [axes.get_title(loc="left") for axes in figure.axes]
        assert [f"{0.25 * f + 0.002:.2f} s" in images for f in range(5)] == [True] * 5
        assert "Change of the transient against its mean" in images
        mesh = next(of for axes in figure.axes for of in axes.collections if of.get_array() is not None)
        change = np.asarray(mesh.get_array()).reshape(5, 64)
    transient = read_scene(walks, 0).arrays["transient"].sum(axis=(1, 2), dtype=np.float64)
    np.testing.assert_allclose(change, transient - transient.mean(axis=0))
    assert np.abs(change).max() > 0


def test_show_and_preview_have_it(walks: Path, tmp_path: Path) -> None:
    names = [path.name for path in show(walks, 0, tmp_path / "shown")]
    assert names[0] == "scene-000000-overview.png" and names[-1] == "scene-000000-frames.png"
    text = preview(walks, tmp_path / "walks.html", 1).read_text()
    assert 'alt="scene 0, frames"' in text


def test_sequences_made_in_python_are_shown_by_what_is_stored(tmp_path: Path) -> None:
    path = dg.Path((0.0, 1.0), [(1.5, 0.3, 1.2), (1.6, -0.5, 1.2)])
    scene = room(dg.Part("box", box(), dg.Lambertian(0.4), path=path),
                 hidden_view=dg.Rectangle.of((0, 0, 1.5), (0, 1, 0), (0, 0, 1.5)))  # fmt: skip
    settings = {"transport": {"target": 0.3}, "detector": {"cycles": 1000}, "labels": {"rows": 8, "columns": 8}}
    given = [(scene, capture(side=2, bins=64, width_s=4e-10), dg.Clock(3, 3))]
    dg.build_from(given, tmp_path / "set", settings=settings, progress=False)
    names = {file.stem.partition("-")[2].partition("-")[2] for file in show(tmp_path / "set", 0, tmp_path / "shown")}
    assert {"histogram", "transient", "labels", "frames"} <= names
