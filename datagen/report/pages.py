"""`datagen show`: the pictures of one stored scene, each with axes with units and a caption of a sentence."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any
from warnings import warn

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datagen.design.scene_for import scene_for
from datagen.errors import InputError, InputWarning
from datagen.labels import OBJECT_TABLES, make_labels
from datagen.labels.frame import scan_place
from datagen.records import Capture, Scene, TimeAxis
from datagen.records.arrays import Floats
from datagen.records.checks import option
from datagen.report.curves import draw_counts, draw_parts
from datagen.report.labels import DRAWN, draw_label, labels_page
from datagen.report.moving import animation
from datagen.report.replay import Light, Replay, StoredScene, read_scene, replay
from datagen.report.rooms import LEGEND_COLUMNS, RoomPicture, draw_legend, draw_opened, draw_plan
from datagen.report.scans import Raster, draw_time_slice, scan_page
from datagen.report.stored import QUANTITIES, light_of_stored, scene_of_stored, time_of_stored, unit_of, why_roomless
from datagen.report.strip import strip_page
from datagen.report.style import captioned, house_style, in_sigma, save_gif, save_png, short
from datagen.store.files import check_writable
from datagen.store.summaries import OVER_M

PAGES = ("overview", "light", "histogram", "labels", "scan")
"""The pictures of a scene, in the order in which they are made."""


def show(dataset: str | Path, index: int, out: str | Path | None = None) -> list[Path]:
    """Draw scene `index` of a dataset as PNGs, of a sequence a GIF too, and return their paths, the overview first.

    An overview with the room in plan, the room opened and its depth; light by part and counts; counts over their
    expectation; the labels; and slices of the scan where it has several channels. For geometry and light by part,
    which a dataset does not hold, the scene is simulated again from the stored configuration and seed; counts and
    labels are the stored ones. Of a sequence these show the middle frame, another picture all frames, and an
    animation in real time (GIF) what moves in the room, what changes in the counts, and what backprojection makes of
    that.
    Where a room cannot be drawn (scenes made in Python, imported captures, mesh files that are gone) only stored
    measurements and labels are drawn.

    out : folder for the pictures; default `DATASET.show` beside the dataset, never inside it.

    Raises
    ------
    InputError : no dataset, no such scene, a shard not committed, a scene that failed, a mesh file that has changed,
        an output that cannot be written.
    """
    whole = read_scene(dataset, index)
    stored = whole.at_frame()
    if stored.missing:
        warn(f"{stored.missing}; only what is stored is drawn", InputWarning, stacklevel=2)
    root = Path(dataset).resolve()
    folder = root.with_name(f"{root.name}.show") if out is None else Path(out)
    # Found before the scene is simulated, which may take minutes.
    check_writable(folder, f" with {option('out')}")
    with house_style():
        why = why_roomless(stored.config, stored.missing)
        made = pages(stored, replay(stored)) if why is None else stored_pages(stored, why)
        saved = [save_png(figure, folder / f"scene-{index:06d}-{name}.png") for name, figure in made]
        strip, moving = frames_page(whole), frames_animation(whole)
        if strip is not None:
            saved.append(save_png(strip, folder / f"scene-{index:06d}-frames.png"))
        if moving is not None:
            saved.append(save_gif(moving, folder / f"scene-{index:06d}-frames.gif"))
        return saved


def frames_page(stored: StoredScene) -> Figure | None:
    """The frames of a stored sequence side by side; None of a scene that is measured once, or of which nothing is
    stored that could be shown. To be used within `house_style()`."""
    return None if stored.frames is None else strip_page(stored, scene_of_stored(stored.at_frame()))


def frames_animation(stored: StoredScene) -> bytes | None:
    """A GIF of a stored sequence; None of a scene that is measured once, or of which no counts and no light are
    stored. To be used within `house_style()`."""
    if stored.frames is None:
        return None
    roomless = why_roomless(stored.config, stored.missing)
    return animation(stored, scene_for(stored.config, stored.index) if roomless is None else None)


def pages(stored: StoredScene, replayed: Replay, names: Sequence[str] = PAGES) -> Iterator[tuple[str, Figure]]:
    """(name, figure) of the pictures in `names`, made one at a time; `scan` only where there are several channels.

    To be used within `house_style()`.
    """
    # Depth is drawn in any case.
    wanted = [name for name in DRAWN if name in stored.arrays or name == "depth"]
    missing = [name for name in wanted if name not in stored.arrays]
    made = make_labels(stored.config.labels, replayed.scene, missing) | dict(stored.arrays)
    labels = {name: made[name] for name in wanted}
    makers: dict[str, Callable[[], Figure | None]] = {
        "overview": lambda: _overview_page(stored, replayed, labels["depth"]),
        "light": lambda: _light_page(stored, replayed),
        "histogram": lambda: _counts_page(stored, replayed),
        "labels": lambda: labels_page(stored, replayed.scene, labels, _labels_text(stored, replayed.scene, missing)),
        "scan": lambda: scan_page(stored.title, replayed.light, _provenance(replayed)),
    }
    for name in names:
        figure = makers[name]()
        if figure is not None:
            yield name, figure


def stored_pages(stored: StoredScene, why: str) -> Iterator[tuple[str, Figure]]:
    """(name, figure) of each stored measurement, `histogram` and `transient`, of the scan, and of the stored labels;
    nothing else is known of a scene that cannot be made again. `why` : the reason, as a whole clause.

    To be used within `house_style()`. Raises `InputError` where nothing of it is stored.
    """
    light, scene = light_of_stored(stored), scene_of_stored(stored)
    labels = {name: stored.arrays[name] for name in DRAWN if name in stored.arrays}
    if light is None and (scene is None or not labels):
        raise InputError(f"{stored.title}: {why}, and neither histogram, transient nor labels are stored")
    source = f" (file {stored.parameters['capture.file']})" if "capture.file" in stored.parameters else ""
    for name in (name for name in QUANTITIES if name in stored.arrays):
        text = f"The stored {name}{source} where it is brightest and in sum, and nothing beyond it: {why}."
        values = np.asarray(stored.arrays[name], np.float64)
        unit, time = unit_of(stored, name), time_of_stored(stored, name)
        assert light is not None
        yield name, _curves_page(f"{stored.title}: {name}", light, values, None, time, unit, "", text)
    if light is not None:
        figure = scan_page(stored.title, light)
        if figure is not None:
            yield "scan", figure
    if scene is not None and (labels or OBJECT_TABLES[0] in stored.arrays):
        text = (
            "Stored ground truth, seen from the plane of the relay wall, right and up as for somebody who faces it."
        )
        yield "labels", labels_page(stored, scene, labels, text)


def _overview_page(stored: StoredScene, replayed: Replay, depth: NDArray[Any]) -> Figure:
    """Room in plan and opened, depth, and a legend."""
    room = RoomPicture(replayed.scene, replayed.capture, replayed.transient.laser_points)
    text = (
        f"{_scan_text(replayed.capture)}. Ceiling and walls in the way are taken off; σ is an object's detectability "
        "in the data. Right: depth behind the window of the labels, along the arrow."
    )
    # The legend has all parts and up to six marks.
    legend_in = 0.19 * float(np.ceil((len(replayed.scene.part_names) + 6) / LEGEND_COLUMNS)) + 0.1
    figure, grid = captioned([2.9, legend_in], text, f"{stored.title}: overview", 3)
    plan, opened, behind = (figure.add_subplot(grid[0, k]) for k in range(3))
    draw_plan(plan, room)
    plan.set_title("From above")
    draw_opened(opened, room)
    opened.set_title("Opened")
    draw_legend(figure.add_subplot(grid[1, :]), room, in_sigma(stored.significance()))
    draw_label(figure, behind, replayed.scene, "depth", depth)
    return figure


def _light_page(stored: StoredScene, replayed: Replay) -> Figure:
    """Time along the scan, light by part, and counts, with a legend of the curves."""
    light = replayed.light
    several = light.total.shape[0] * light.total.shape[1] > 1
    parts = replayed.transient.parts or {"all light": replayed.transient.total}
    sums = {name: values.sum(axis=(0, 1)) for name, values in parts.items()}
    text = (
        f"Light by part is summed over the scan, counts are those of {_light_text(light)}, where objects stand out; "
        f"{_provenance(replayed)}."
    )
    legend_in = 0.19 * float(np.ceil((len(sums) + 3) / LEGEND_COLUMNS)) + 0.1
    figure, grid = captioned([3.2, legend_in], text, f"{stored.title}: light and counts")
    # In a subfigure, so that room for a colour bar beside one panel is not left free beside all.
    above = figure.add_subfigure(grid[0, 0])
    *first, split, counted = above.subplots(1, 2 + several)
    if first:
        raster = Raster.of(light)
        draw_time_slice(above, first[0], raster.scan_of(light.total), raster, light)
    draw_parts(split, replayed.scene, sums, replayed.capture.time)
    split.set_title("Light by part")
    channel = light.channel
    counts, expected = replayed.counts[channel], replayed.expected[channel]
    draw_counts(counted, counts, expected, replayed.counted, mean=_mean_name(replayed))
    counted.set_title("Counts")
    for axes in (split, counted):
        # In a panel as narrow as this one line would be wider than the axes.
        axes.set_xlabel(axes.get_xlabel().replace(" since ", " since\n"))
    if (own := counted.get_legend()) is not None:
        own.remove()
    handles, labels = (
        [*one, *other]
        for one, other in zip(*(of.get_legend_handles_labels() for of in (split, counted)), strict=True)
    )
    key = figure.add_subplot(grid[1, 0])
    key.set_axis_off()
    names = [short(label) for label in labels]
    key.legend(handles, names, loc="upper left", ncols=LEGEND_COLUMNS, borderaxespad=0).set_in_layout(False)
    return figure


def _counts_page(stored: StoredScene, replayed: Replay) -> Figure:
    """Counts over their expectation."""
    title, mean = f"{stored.title}: photon counts", _mean_name(replayed)
    text = (
        f"{'Stored' if 'histogram' in stored.arrays else 'Newly drawn'} photon counts over the {mean} of the "
        f"detector model, where objects stand out and in sum; {_provenance(replayed)}."
    )
    counts, expected, time = replayed.counts, replayed.expected, replayed.counted
    return _curves_page(title, replayed.light, counts, expected, time, "counts", mean, text)


def _labels_text(stored: StoredScene, scene: Scene, missing: Sequence[str]) -> str:
    """Caption of the labels: how they are seen, where the middle of the scan lies on them, and what is not stored."""
    text = (
        "Ground truth behind the window in the plane of the relay wall, seen along its normal, right and up as for "
        "somebody who faces the wall"
    )
    points = stored.arrays.get("laser_points")
    found = None if scene.hidden_view is None or points is None else scan_place(scene.hidden_view, points)
    if found is not None:
        right, up = found
        offsets = (right, "to the right" if right > 0 else "to the left"), (up, "above" if up > 0 else "below")
        there = " and ".join(f"{abs(offset):.2g} m {side}" for offset, side in offsets if abs(offset) > OVER_M)
        text += f", with the middle of the scan {there or 'in the middle'}"
    return text + (f"; computed for this picture: {', '.join(missing)}." if missing else ".")


def _curves_page(
    title: str, light: Light, values: NDArray[Any], expected: Floats | None, time: TimeAxis, unit: str, mean: str,
    text: str,
) -> Figure:  # fmt: skip
    """Counts or light over time: the channel where objects stand out, and the sum over the scan."""
    figure, grid = captioned([3.2], text, title, 2)
    channel = light.channel
    one, whole = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    draw_counts(one, values[channel], None if expected is None else expected[channel], time, unit, mean)
    one.set_title(_light_text(light).capitalize())
    over = None if expected is None else expected.sum(axis=(0, 1))
    draw_counts(whole, values.sum(axis=(0, 1)), over, time, unit, mean)
    whole.set_title("Sum over the scan")
    return figure


def _light_text(light: Light) -> str:
    """The clear channel in words."""
    (lasers, pixels, _), (laser, pixel) = light.total.shape, light.channel
    if light.capture.pairing == "confocal":
        return f"laser point {laser} of {lasers}"
    if light.capture.illumination == "flood":
        return f"pixel {pixel} of {pixels}, flood"
    return f"laser point {laser} of {lasers}, pixel {pixel} of {pixels}"


def _scan_text(capture: Capture) -> str:
    """Laser points and pixels in words."""
    lasers, pixels, _ = capture.shape
    if capture.illumination == "flood":
        return f"Flood light and {_n(pixels, 'pixel')} (dots: the light's quadrature points)"
    looks = "each with a pixel of its own" if capture.pairing == "confocal" else _n(pixels, "pixel")
    return f"{_n(lasers, 'laser point')}, {looks}"


def _n(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _provenance(replayed: Replay) -> str:
    """Where light by part comes from, and whether it agrees with what is stored, as a clause."""
    if replayed.reproduced:
        return "light is simulated again from the stored seed"
    far = "" if replayed.difference is None else f" (its transient differs by {replayed.difference:.2g}, relative L2)"
    return f"CAUTION: simulating again gave another scene{far}, as another version or machine may"


def _mean_name(replayed: Replay) -> str:
    return "exact mean" if replayed.mean_is_exact else "approximate mean"
