"""The pictures of one scene: everything promised is in them, and no corner case breaks them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from handmade_rooms import l_corridor
from legible import too_small
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch
from matplotlib.text import Text

from datagen.config import config_from_mapping
from datagen.labels import make_labels
from datagen.records import Capture, Laser, Scene, Sensor, TimeAxis, Transient
from datagen.report.pages import PAGES, pages
from datagen.report.replay import Replay, StoredScene
from datagen.report.style import SMALLEST_PT, house_style, new_figure, save_png


def scan(scene: Scene, rows: int = 5, columns: int = 6, bins: int = 200) -> Capture:
    """A confocal grid on the relay wall."""
    wall = scene.relay_wall
    assert wall is not None and scene.device_position is not None
    across, upward = np.linspace(-0.8, 0.8, columns), np.linspace(0.8, -0.8, rows)
    points = (wall.center + across[None, :, None] * wall.right + upward[:, None, None] * wall.up).reshape(-1, 3)
    square = 0.02 * np.array([[0, -1, -1], [0, 1, -1], [0, 1, 1], [0, -1, 1]])
    time = TimeAxis(bins, 2e-10, origin="wall")
    device = scene.device_position
    return Capture(Laser(device, points), Sensor(device, points[:, None] + square), time, "confocal")


def replayed(scene: Scene, capture: Capture, stored: bool = True) -> tuple[StoredScene, Replay]:
    """A simulation in closed form: every part answers after its centroid's distance, without a solver."""
    shape, time = capture.shape, capture.time
    rng = np.random.default_rng(5)
    parts = {}
    for k, name in enumerate(scene.part_names):
        if scene.roles[k] == "relay_wall":
            continue
        distance = np.linalg.norm(
            capture.laser.targets - scene.corners[scene.face_part == k].mean(axis=(0, 1)), axis=1
        )
        delay = time.centers_s - 2 * distance[:, None, None] / 3e8
        parts[name] = np.broadcast_to(1e-11 * np.exp(-((delay / 1e-9) ** 2)), shape).copy()
    total = sum(parts.values(), np.zeros(shape))
    transient = Transient(time, {"primary": total}, parts, 0.01 * total, np.zeros(shape[:2]), capture.laser.targets)
    expected = 1e12 * total + 0.01
    counts = rng.poisson(expected)
    config = config_from_mapping({"name": "handmade", "labels": {"rows": 16, "columns": 16, "voxels": [8, 8, 8]}})
    labels = (
        make_labels(config.labels, scene, ("depth", "normal", "albedo", "part_id", "shaded", "occupancy"))
        if stored
        else {}
    )
    arrays = {"histogram": counts, "transient": total, **labels} if stored else {}
    difference = 0.0 if stored else None
    return StoredScene(config, 3, arrays), Replay(scene, capture, transient, counts, expected, difference)


def drawn(stored: StoredScene, again: Replay, names: Sequence[str], laid_out: bool = True) -> dict[str, Figure]:
    """The figures, painted small; not laid out, axes stand where they were put."""
    with house_style():
        figures = dict(pages(stored, again, names))
        for figure in figures.values():
            figure.set_dpi(40)
            if not laid_out:
                figure.set_layout_engine("none")
            figure.canvas.draw()
    return figures


def words(figure: Figure) -> str:
    return " ".join(text.get_text().replace("\n", " ") for text in figure.findobj(Text))


@pytest.fixture(scope="module")
def usual() -> tuple[StoredScene, Replay]:
    scene = l_corridor()
    return replayed(scene, scan(scene))


@pytest.fixture(scope="module")
def ordinary(usual: tuple[StoredScene, Replay]) -> dict[str, Figure]:
    """All pictures of an ordinary scene; they are painted when they are saved."""
    with house_style():
        return dict(pages(*usual))


def test_pictures_have_titles_and_units(ordinary: dict[str, Figure]) -> None:
    assert set(ordinary) == set(PAGES)
    for figure in ordinary.values():
        text = words(figure)
        assert "handmade, scene 3" in text
        assert any(unit in text for unit in ("(m)", "(ns)"))


def test_captions_say_whether_the_stored_transient_was_reproduced(
    ordinary: dict[str, Figure], usual: tuple[StoredScene, Replay]
) -> None:
    assert "simulated again from the stored seed" in words(ordinary["histogram"])
    stored, again = usual
    with house_style():
        for other in (replace(again, difference=0.3), replace(again, difference=None, moved_m=0.01)):
            (figure,) = dict(pages(stored, other, ["histogram"])).values()
            assert "CAUTION: simulating again gave another scene" in words(figure)
        scene = l_corridor()
        bare = dict(pages(*replayed(scene, scan(scene), stored=False), ["histogram", "labels"]))
    assert "Newly drawn photon counts" in words(bare["histogram"])
    assert "computed for this picture: depth" in words(bare["labels"])


def exhaustive(scene: Scene, lasers: int, side: int, bins: int = 50) -> Capture:
    wall, device = scene.relay_wall, scene.device_position
    assert wall is not None and device is not None
    sensor = Sensor.grid(device, wall.center, 0.9 * wall.right, 0.9 * wall.up, side, side)
    targets = wall.center + np.linspace(-0.5, 0.5, lasers)[:, None] * wall.right
    return Capture(Laser(device + np.array([0, 0.2, 0]), targets), sensor, TimeAxis(bins, 8e-10), "exhaustive")


def test_words_name_points_parts_marks_and_the_classes_of_stored_boxes(usual: tuple[StoredScene, Replay]) -> None:
    stored, again = usual
    sigma = {"evidence.box.significance": 98.0, "evidence.pillar.significance": float("nan")}
    config = config_from_mapping({"scene": {"contents": [{"kind": "pillar"}, {"kind": "box"}]}})
    classes = config.scene.object_classes()
    tables = make_labels(config.labels, again.scene, ("objects", "shaded"), classes, 3)
    arrays = {**stored.arrays, **tables}
    stored = replace(stored, config=config, classes=classes, arrays=arrays, parameters=sigma)
    figures = drawn(stored, again, ["overview", "labels"], laid_out=False)
    overview, labels = words(figures["overview"]), words(figures["labels"])
    assert "30 laser points, each with a pixel of its own" in overview
    assert "box, 98 σ" in overview and "pillar," not in overview
    for label in (*again.scene.part_names, "laser and sensor", "laser points", "field of view of the pixels"):
        assert label in overview
    assert all(word in labels for word in ("Objects", "Shaded", "pillar", "box"))


def test_each_part_has_its_own_light_and_the_line_is_the_sum(
    ordinary: dict[str, Figure], usual: tuple[StoredScene, Replay]
) -> None:
    axes = next(of for of in ordinary["light"].axes if of.get_title(loc="left").startswith("Light by part"))
    steps = {of.get_label(): of.get_data().values for of in axes.patches if isinstance(of, StepPatch)}
    light = usual[1].transient
    for name, curve in (light.parts | {"sum": light.total}).items():
        np.testing.assert_allclose(steps.pop(name), curve.sum(axis=(0, 1)), rtol=1e-12)
    assert not steps


def without_light(again: Replay) -> Replay:
    zeros = np.zeros(again.capture.shape)
    dark = replace(again.transient, components={"primary": zeros}, parts=dict.fromkeys(again.transient.parts, zeros))
    return replace(again, transient=dark, counts=0 * again.counts, expected=0 * again.expected)


@pytest.mark.parametrize("dark", [False, True])
def test_a_scan_without_a_grid_shows_time_against_laser_point(dark: bool) -> None:
    scene = l_corridor()
    capture, chosen = scan(scene), np.array([3, 4, 11, 17, 29])
    few = replace(
        capture,
        laser=Laser(capture.laser.position, capture.laser.targets[chosen]),
        sensor=Sensor(capture.sensor.position, capture.sensor.pixels[chosen]),
    )
    stored, again = replayed(scene, few)
    figure = drawn(stored, without_light(again) if dark else again, ["scan"])["scan"]
    assert words(figure).count("Where each laser point lies") == 1 + (not dark)
    assert [axes.get_xlabel() for axes in figure.axes].count("number of the laser point") == 1 + (not dark)
    if not dark:
        (image,) = next(axes for axes in figure.axes if axes.get_title(loc="left").endswith("all light")).images
        total = again.transient.total.sum(axis=1)
        kept = total > total.max() * 10**-3.5
        np.testing.assert_allclose(np.asarray(image.get_array()).T[kept], total[kept])


def test_noise_below_zero_is_drawn_as_no_light(usual: tuple[StoredScene, Replay]) -> None:
    """Of sequences, whose light is what stands and what moves, blocks included."""
    stored, again = usual
    total = again.transient.total.copy()
    total[0] = -1e-16  # at one laser point
    below = replace(again.transient, components={"primary": total}, parts={})
    (page,) = drawn(stored, replace(again, transient=below), ["scan"], laid_out=False).values()
    shown = [np.asarray(image.get_array()) for axes in page.axes for image in axes.images]
    assert len(shown) > 3 and all(np.isfinite(picture).all() for picture in shown[1:])


@pytest.mark.parametrize(
    ("case", "wanted"),
    [("one bin", ["light", "histogram"]), ("one laser point", ["overview", "light"]),
     ("many pixels", ["overview", "light"]), ("two lasers", ["scan"]), ("no light", ["light", "histogram"]),
     ("bare wall", ["overview", "labels"]),
     ("missed wall", ["overview"])],
)  # fmt: skip
def test_corner_cases_are_drawn(case: str, wanted: list[str]) -> None:
    scene = l_corridor(objects=[] if case == "bare wall" else None, shell=case != "bare wall")
    capture = {
        "one bin": lambda: scan(scene, bins=1),
        "one laser point": lambda: scan(scene, 1, 1),
        "many pixels": lambda: exhaustive(scene, 1, 40),
        "two lasers": lambda: exhaustive(scene, 2, 1),
    }.get(case, lambda: scan(scene))()
    stored, again = replayed(scene, capture)
    if case == "no light":
        again = without_light(again)
    elif case == "missed wall":
        points = np.where(np.arange(len(capture.laser.targets))[:, None] % 2, np.nan, capture.laser.targets)
        again = replace(again, transient=replace(again.transient, laser_points=points))
    # A scan of one laser point is no picture. Every page is laid out above, which takes half of the time.
    figures = drawn(stored, again, [*wanted, "scan"] if case == "one laser point" else wanted, laid_out=False)
    assert set(figures) == set(wanted)
    if case == "many pixels":
        assert "1 laser point, 1600 pixels." in words(figures["overview"])


def test_small_letters_are_found_before_a_picture_is_saved(tmp_path: Path) -> None:
    """`tests/conftest.py` looks at each picture: eight points can be read on a page, a tenth less cannot."""
    figure = new_figure(2)
    for height, size in enumerate((SMALLEST_PT, 0.9 * SMALLEST_PT)):
        figure.text(0.1, 0.3 * height, f"{size:g} points", fontsize=size)
    assert too_small(figure) == [f"{0.9 * SMALLEST_PT:g} points"]
    with pytest.raises(AssertionError, match="letters too small"):
        save_png(figure, tmp_path / "small.png")
