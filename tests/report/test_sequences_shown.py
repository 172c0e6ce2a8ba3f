"""Pictures of sequences: the middle frame as a scene, simulated again, and a strip of all frames."""

from __future__ import annotations

import base64
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from datasets import write_dataset
from matplotlib.patches import Polygon
from numpy.typing import NDArray
from PIL import Image, ImageSequence

import datagen as dg
from datagen.config import config_from_mapping
from datagen.design.scene_for import scene_for
from datagen.labels import ViewFrame
from datagen.report.floor_plans import FloorPlans
from datagen.report.moving import draw_change, draw_marks, draw_movers, durations_ms
from datagen.report.pages import frames_animation, frames_page, show
from datagen.report.preview import preview
from datagen.report.replay import read_scene, replay
from datagen.report.stored import time_of_stored
from datagen.report.style import house_style, in_sigma, new_figure
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
    assert names[0] == "scene-000000-overview.png"
    assert names[-2:] == ["scene-000000-frames.png", "scene-000000-frames.gif"]
    text = preview(walks, tmp_path / "walks.html", 1).read_text()
    assert 'alt="scene 0, frames"' in text
    moving = base64.b64encode((tmp_path / "shown" / "scene-000000-frames.gif").read_bytes()).decode()
    assert text.count("data:image/gif") == 1 and f'light" src="data:image/gif;base64,{moving}"' in text


def frames_of(content: bytes) -> tuple[NDArray[np.uint8], list[int]]:
    """(frame, row, column, 3) pixels of a GIF, and the milliseconds that each is shown."""
    with Image.open(io.BytesIO(content)) as gif:
        assert gif.info["loop"] == 0
        shown = [(np.asarray(one.convert("RGB")), one.info["duration"]) for one in ImageSequence.Iterator(gif)]
    return np.stack([pixels for pixels, _ in shown]), [span for _, span in shown]


def test_the_animation_runs_in_real_time_and_is_small(walks: Path) -> None:
    with house_style():
        first, again = frames_animation(read_scene(walks, 0)), frames_animation(read_scene(walks, 0))
    assert first is not None and first == again
    pixels, spans = frames_of(first)
    assert spans == [250] * 5 and len(first) < 5 * 60_000
    assert pixels.shape[2] <= 830
    # In every frame something has changed: on the left the box, on the right the light.
    for side in np.array_split(pixels[:, 40:-80], 2, axis=2):
        assert (np.abs(np.diff(side.astype(int), axis=0)).sum(axis=-1) > 60).any(axis=(1, 2)).all()


def test_the_box_is_drawn_where_it_is(walks: Path) -> None:
    stored = read_scene(walks, 0)
    room, times_s = scene_for(stored.config, 0), stored.arrays["laser_time"].mean(axis=1)
    with house_style():
        axes = new_figure(5).add_subplot()
        update = draw_movers(axes, room, stored, times_s)
    (drawn,) = [patch for patch in axes.patches if isinstance(patch, Polygon)]
    for frame, time_s in enumerate(times_s):
        update(frame)
        there = room.at(time_s)
        corners = there.vertices[np.unique(there.triangles[there.faces_of("box")]), :2]
        distance = np.linalg.norm(drawn.get_xy()[:4, None] - corners[None], axis=-1)
        assert distance.min(axis=1).max() < 1e-6


def test_the_right_side_is_the_change_of_the_counts(walks: Path) -> None:
    stored = read_scene(walks, 0)
    with house_style():
        figure = new_figure(5)
        axes = figure.add_subplot()
        update = draw_change(figure, axes, stored, "histogram")
    counts = stored.arrays["histogram"].astype(float).reshape(5, 2, 2, 64).sum(axis=1)
    change, (image,) = counts - counts.mean(axis=0), axes.images
    limits, made = image.get_clim(), []
    for frame in range(5):
        update(frame)
        made.append(np.asarray(image.get_array()))
        assert image.get_clim() == limits == (-limits[1], limits[1])
    cells, start = made[0].shape[1], round(image.get_extent()[0] / 0.8)
    assert cells > 8
    np.testing.assert_allclose(made, change[:, :, start : start + cells])


def test_floor_plans_show_where_light_came_from(walks: Path) -> None:
    """Counts at the times at which light from one place arrives: the plan of each frame is largest at that place."""
    stored = read_scene(walks, 0)
    view, far = stored.arrays["hidden_view"], 0.8
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-0.9, 0.9, 8)]), axis=-1).reshape(-1, 2)
    points = view[0] + grid @ view[1:]
    normal = np.cross(*view[1:]) / np.linalg.norm(np.cross(*view[1:]))
    places = view[0] + np.linspace(-0.8, 0.6, 5)[:, None] * view[1] + far * np.linspace(0.5, 2, 5)[:, None] * normal
    time, counts = time_of_stored(stored, "histogram"), np.zeros((5, 64, 1, 64))
    assert time.origin == "wall"
    for frame, place in enumerate(places):
        way = 2 * np.linalg.norm(points - place, axis=1)
        counts[frame, range(64), 0, ((way / 299_792_458 - time.start_s) / time.width_s).astype(int)] = 100
    made_up = {"histogram": counts, "laser_points": points, "sensor_points": points}
    plans = FloorPlans.of(replace(stored, arrays={**stored.arrays, **made_up}))
    assert plans is not None and plans.values.shape[0] == 5
    middles = (plans.corners[:-1, :-1] + plans.corners[1:, 1:]) / 2
    for values, place in zip(plans.values, places, strict=True):
        found = middles[np.unravel_index(values.argmax(), values.shape)]
        # A bin is 0.12 m of distance.
        assert np.linalg.norm(found - place[:2]) < 0.3
    assert FloorPlans.of(replace(stored, arrays={**stored.arrays, "hidden_bounds": np.full((2, 3), np.nan)})) is None
    assert FloorPlans.of(replace(stored, frames=None)) is None


def test_the_legend_says_how_far_what_moves_stands_out(walks: Path) -> None:
    stored = read_scene(walks, 0)
    changes = stored.change()
    assert changes == {"box": stored.parameters["evidence.box.change"]} and changes["box"] > 0
    with house_style():
        axes = new_figure(2).add_subplot()
        draw_marks(axes, scene_for(stored.config, 0), in_sigma(changes), outlined=True)
        labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels[0] == f"box{in_sigma(changes)['box']}" and "σ" in labels[0]
    assert in_sigma({"a": 34.6, "b": 3.456}) == {"a": ", 35 σ", "b": ", 3.5 σ"}


def test_durations_add_up_to_real_time() -> None:
    assert durations_ms(4, 10.0) == [100] * 4
    assert durations_ms(30, 30.0)[:3] == [30, 40, 30] and sum(durations_ms(30, 30.0)) == 1000


def test_scenes_measured_once_have_no_animation(tmp_path: Path) -> None:
    config = config_from_mapping({
        "scenes": 1, "transport": {"target": 0.3}, "store": {"fields": ["histogram"]},
        "capture": {"scan": {"rows": 2, "columns": 2}, "time": {"bins": 64}},
    })  # fmt: skip
    path = write_dataset(config, tmp_path / "still")
    shown = show(path, 0, tmp_path / "shown")
    assert shown and not [file for file in shown if file.suffix != ".png"]
    assert sorted(shown) == sorted((tmp_path / "shown").iterdir())
    assert "image/gif" not in preview(path, tmp_path / "still.html", 1).read_text()


def test_sequences_made_in_python_are_shown_by_what_is_stored(tmp_path: Path) -> None:
    path = dg.Path((0.0, 1.0), [(1.5, 0.3, 1.2), (1.6, -0.5, 1.2)])
    scene = room(dg.Part("box", box(), dg.Lambertian(0.4), path=path),
                 hidden_view=dg.Rectangle.of((0, 0, 1.5), (0, 1, 0), (0, 0, 1.5)))  # fmt: skip
    settings = {"transport": {"target": 0.3}, "detector": {"cycles": 1000}, "labels": {"rows": 8, "columns": 8}}
    given = [(scene, capture(side=2, bins=64, width_s=4e-10), dg.Clock(3, 3))]
    dg.build_from(given, tmp_path / "set", settings=settings, progress=False)
    shown = show(tmp_path / "set", 0, tmp_path / "shown")
    assert shown[-1].name == "scene-000000-frames.gif"
    assert frames_of(shown[-1].read_bytes())[1] == [330, 340, 330]
    names = {file.stem.partition("-")[2].partition("-")[2] for file in shown}
    assert {"histogram", "transient", "labels", "frames"} <= names
