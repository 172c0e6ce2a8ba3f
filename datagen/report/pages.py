"""The pictures of one scene, each a figure with a title, axes with units, and a caption that explains it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datagen.labels.frame import scan_place
from datagen.records import Scene
from datagen.records.arrays import Floats
from datagen.report import scan_plots as scans
from datagen.report import time_plots as times
from datagen.report.label_plots import draw_label, labels_figure
from datagen.report.replay import Replay, StoredScene
from datagen.report.room_plots import LEGEND_COLUMNS, RoomPicture, draw_legend, draw_opened, draw_plan
from datagen.report.style import captioned
from datagen.report.time_plots import busy_window, clear_channel
from datagen.store.summaries import OVER_M

UNDIVIDED = "all light"
"""Name of the only layer where light is not split by part."""


def transient_page(stored: StoredScene, again: Replay) -> Figure:
    """The transient stacked by part: one channel, and the sum over the scan."""
    laser, pixel = clear_channel(again.scene, again.transient)
    text = (
        "Expected light at the aperture before the detector, split by the part of the room that sent it back to the "
        "relay wall. Layers lie on top of each other, objects lowest; the upper edge is the total. On the "
        "logarithmic axis an upper layer looks thinner than it is: read a layer as the difference of its two "
        f"edges. {_provenance(again)}"
    )
    figure, grid = captioned(12, [4.6], text, f"{stored.title}: the transient by part", 2)
    one, whole = figure.add_subplot(grid[0, 0]), figure.add_subplot(grid[0, 1])
    times.draw_stack(one, again.scene, _curves(again, (laser, pixel)), again.capture.time)
    one.set_title(_channel_name(again, laser, pixel))
    times.draw_stack(whole, again.scene, _curves(again, None), again.capture.time)
    whole.set_title(_whole_name(again))
    # Every part with light anywhere is in the sum over the scan.
    handles, labels = whole.get_legend_handles_labels()
    if handles:
        whole.legend(handles[::-1], labels[::-1], loc="center left", bbox_to_anchor=(1.0, 0.5), title="top to bottom")
    return figure


def histogram_page(stored: StoredScene, again: Replay) -> Figure:
    """Counts over their expectation with residuals: one channel, and the sum over the scan."""
    laser, pixel = clear_channel(again.scene, again.transient)
    text = _histogram_caption(stored, again)
    figure, grid = captioned(12, [3.6, 1.8], text, f"{stored.title}: photon counts and their expectation", 2)
    time = again.counted
    for column, (title, counts, expected) in enumerate(
        (
            (_channel_name(again, laser, pixel), again.counts[laser, pixel], again.expected[laser, pixel]),
            (_whole_name(again), again.counts.sum(axis=(0, 1), dtype=np.int64), again.expected.sum(axis=(0, 1))),
        )
    ):
        upper, lower = figure.add_subplot(grid[0, column]), figure.add_subplot(grid[1, column])
        times.draw_counts(upper, counts, expected, time, mean=_mean_name(again))
        upper.set(title=title, xlabel="")
        times.draw_residuals(lower, counts, expected, time, is_poisson=again.is_poisson)
        for axes in (upper, lower):
            axes.set_xlim(*busy_window(expected if expected.any() else counts, time))
    return figure


def _where_the_scan_is(scene: Scene, stored: StoredScene) -> str:
    """A sentence on where the scan lies on the label images, with a space at its end."""
    view = scene.hidden_view
    points = stored.arrays.get("laser_points")
    found = None if view is None or points is None else scan_place(view, points)
    if found is None:
        return ""
    right, up = found
    if max(abs(right), abs(up)) <= OVER_M:
        return "Images lie over the scan. "
    across = f"{abs(right):.2g} m to the {'right' if right > 0 else 'left'}"
    upward = f"{abs(up):.2g} m {'above' if up > 0 else 'below'}"
    return f"The middle of the scan is {across} and {upward} of the images' middle. "


def labels_page(stored: StoredScene, again: Replay, labels: Mapping[str, NDArray[Any]]) -> Figure:
    """The page of all labels, two or three in a row."""
    text = (
        "Ground truth, seen from the plane of the relay wall through the green window of the room picture, "
        "orthographically along the wall's normal; up is up, and right is right as seen from the device facing the "
        f"wall. {_where_the_scan_is(again.scene, stored)}The relay wall itself is taken as a window."
    )
    if "normal" in labels:
        text += " Normals: red grows to the right, green upwards, blue towards the wall."
    if "sdf" in labels:
        text += " Signed distance: seen from above, the black line is the objects' surface."
    if "shaded" in labels:
        text += " Shaded view: lit by the part of the relay wall that the device sees, with shadows."
    absent = [name for name in labels if name not in stored.arrays]
    if absent:
        text += f" Not stored in this dataset, computed for this picture: {', '.join(absent)}."
    return labels_figure(stored, again.scene, labels, text)


def scan_page(stored: StoredScene, again: Replay) -> Figure | None:
    """Slices of the scan, all light above and that of objects below; for laser points without a grid, time against
    laser point; None when there is a single channel."""
    raster = scans.raster_of(again.capture, clear_channel(again.scene, again.transient), again.frame)
    if raster is None:
        wall = again.scene.relay_wall
        if again.capture.shape[0] < 2 or wall is None:
            return None
        total, note = again.transient.total, _provenance(again)
        return scans.listed_page(stored.title, wall, again.capture, total, _objects(again), note, again.frame)
    whole = scans.scan_of(again.transient.total, raster)
    objects = scans.scan_of(_objects(again), raster)
    text = (
        f"The transient of the scan's {raster.what} ({len(raster.z_m)} rows of {len(raster.x_m)}). Left: along the "
        "row that objects reach most; a point of the hidden scene draws a curve that is earliest where the wall is "
        "nearest to it. Right: the whole wall at four moments; wavefronts travel over it (brightness: square root of "
        "the signal, each on its own scale), right and up as in the labels. Above all light, below only what objects "
        "scattered. "
        f"{_provenance(again)}"
    )
    figure, grid = captioned(14, [6.0], text, f"{stored.title}: slices of the scan", 2, [1, 2.4])
    # Subfigures, so that the colour bars of one take no room from the columns of the other.
    left, right = figure.add_subfigure(grid[0, 0]), figure.add_subfigure(grid[0, 1])
    row = scans.clear_row(objects if objects.any() else whole)
    at = scans.moments(objects if objects.any() else whole)
    time = again.capture.time
    limits = scans.time_limits(whole, objects, time)
    for line, (what, scan) in enumerate((("all light", whole), ("objects only", objects))):
        along = left.add_subplot(2, 1, line + 1)
        scans.draw_time_slice(left, along, scan, row, raster, time, limits)
        along.set_title(f"Row {row + 1} from the top, {what}")
        for number, bins in enumerate(at):
            axes = right.add_subplot(2, scans.MOMENTS, line * scans.MOMENTS + number + 1)
            scans.draw_moment(axes, scan, bins, raster, time)
            axes.set_ylabel("" if number else f"{what}: up (m)")
    return figure


def overview_page(
    stored: StoredScene, again: Replay, room: RoomPicture, labels: Mapping[str, NDArray[Any]]
) -> Figure:
    """The overview: room with its legend, transient by part, counts, depth, scan."""
    time, channel = again.capture.time, clear_channel(again.scene, again.transient)
    text = (
        "Above: the room in plan and opened; ceiling and walls in the way are taken off (dashed edges). "
        f"{_light_path(again)} The green rectangle is the window that the label images look through, along the "
        "arrow. Below: the expected light of the whole scan split by part (stacked, logarithmic), photon counts over "
        f"their {_mean_name(again)} in one channel, and the depth label. {_provenance(again)}"
    )
    if room.boxes is not None:
        text += " Black outlines in the plan: the objects' boxes as stored, a tick at the front of each."
    # The legend has all parts and four marks.
    legend_in = 0.2 * float(np.ceil((len(again.scene.part_names) + 4) / LEGEND_COLUMNS)) + 0.1
    figure, grid = captioned(15, [4.9, legend_in, 4.3], text, f"{stored.title}: overview", 6)
    raster = scans.raster_of(again.capture, channel, again.frame)
    plan, opened = figure.add_subplot(grid[0, :2]), figure.add_subplot(grid[0, 2:4] if raster else grid[0, 2:])
    draw_plan(plan, room)
    plan.set_title("Plan, from above")
    draw_opened(opened, room)
    opened.set_title("Opened: ceiling and near walls off")
    if raster is not None:
        scan, objects = scans.scan_of(again.transient.total, raster), scans.scan_of(_objects(again), raster)
        row = scans.clear_row(objects if objects.any() else scan)
        corner = figure.add_subfigure(grid[0, 4:])
        sliced = corner.add_subplot()
        scans.draw_time_slice(corner, sliced, scan, row, raster, time, scans.time_limits(scan, objects, time))
        sliced.set_title(f"Scan: time along row {row + 1} from the top")
    draw_legend(figure, figure.add_subplot(grid[1, :]), room)
    stack, counted, depth = (figure.add_subplot(grid[2, 2 * k : 2 * k + 2]) for k in range(3))
    times.draw_stack(stack, again.scene, _curves(again, None), time)
    stack.set_title(f"Transient, {_whole_name(again).lower()}")
    times.draw_counts(counted, again.counts[channel], again.expected[channel], again.counted, mean=_mean_name(again))
    counted.set_xlim(*busy_window(again.expected[channel], again.counted))
    counted.set_title(f"Counts, {_channel_name(again, *channel).lower()}")
    if "depth" in labels:
        draw_label(figure, depth, again.scene, "depth", labels["depth"])
    else:
        depth.set_axis_off()
    # At the left of the column, which leaves space for the colour bar at the right.
    depth.set_anchor("W")
    return figure


def _curves(again: Replay, channel: tuple[int, int] | None) -> list[tuple[str, Floats]]:
    """(part, (bin,) curve) in stacking order, of one channel or summed over all; parts without light left out."""
    parts = again.transient.parts or {UNDIVIDED: again.transient.total}
    pick = {name: values.sum(axis=(0, 1)) if channel is None else values[channel] for name, values in parts.items()}
    curves = [(name, pick[name]) for name in (*times.stacking_order(again.scene), UNDIVIDED) if name in pick]
    return [(name, curve) for name, curve in curves if parts[name].any()]


def _light_path(again: Replay) -> str:
    """A sentence on the path of the light, and on how laser points and pixels are paired."""
    lasers, pixels, _ = again.capture.shape
    if again.capture.illumination == "flood":
        count = len(again.capture.laser.targets)
        if "direct" in again.transient.components:
            return (
                f"Light goes from the laser as a flood (its {count} quadrature points are shown) to what it meets "
                f"first, and back into the sensor ({_n(pixels, 'pixel')}), straight and by way of other surfaces."
            )
        lit = f"as a flood over the relay wall (its {count} quadrature points are shown)"
    else:
        lit = f"to {_n(lasers, 'laser point')} on the relay wall"
    confocal = again.capture.pairing == "confocal"
    looks = ", where each has its own pixel (confocal)" if confocal else f" ({_n(pixels, 'pixel')})"
    return f"Light goes from the laser {lit}, around the corner to the objects, back and into the sensor{looks}."


def _objects(again: Replay) -> Floats:
    """(laser, pixel, bin) light that objects scattered."""
    total = np.zeros(again.capture.shape)
    for name in again.scene.objects:
        if name in again.transient.parts:
            total = total + again.transient.parts[name]
    return total


def _provenance(again: Replay) -> str:
    """Sentences on where the curves come from, and whether they agree with the stored ones."""
    start = "Parts are not stored; they come from simulating this scene again from its stored configuration and seed"
    if not again.reproduced:
        far = "" if again.difference is None else f" (its transient differs by {again.difference:.2g}, relative L2)"
        return f"{start}. CAUTION: that gave another scene{far}; the dataset was made by another version or machine."
    if again.difference is None:
        return start + "."
    return start + f", which reproduces the stored transient (relative difference {again.difference:.0e})."


def _histogram_caption(stored: StoredScene, again: Replay) -> str:
    source = "Stored photon counts" if "histogram" in stored.arrays else "Photon counts, drawn again (none stored),"
    text = f"{source} over the {_mean_name(again)} of the detector model"
    if not again.mean_is_exact:
        text += (
            " (afterpulses, crosstalk or saturation under a dead time have no exact one in closed form; its error is "
            "of second order in their probabilities)"
        )
    text += ". Below, what is left in units of the square root of the expectation, "
    if not again.is_poisson:
        return text + (
            "which is the spread that Poisson counts would have. These are none: dead time makes counts spread less "
            "and ties bins to each other, afterpulses and crosstalk make them spread more. Hence no band."
        )
    text += (
        "the Poisson spread; the band is ± 2, which holds about 95 % where counts are high (where few are expected, "
        "residuals jump between 0 and 1 counts and are lopsided)."
    )
    found = times.mean_square_residual(again.counts, again.expected)
    if found is not None:
        text += (
            f" Over all {found[2]} bins with any expectation, the mean square residual is {found[0]:.3f}; "
            f"Poisson counts give 1 ± {found[1]:.2g}."
        )
    return text


def _mean_name(again: Replay) -> str:
    return "exact mean" if again.mean_is_exact else "approximate mean"


def _n(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _channel_name(again: Replay, laser: int, pixel: int) -> str:
    lasers, pixels, _ = again.capture.shape
    if again.capture.pairing == "confocal":
        return f"Laser point {laser} of {lasers}, where objects stand out"
    if again.capture.illumination == "flood":
        return f"Flood, pixel {pixel} of {pixels}"
    return f"Laser point {laser} of {lasers}, pixel {pixel} of {pixels}"


def _whole_name(again: Replay) -> str:
    lasers, pixels, _ = again.capture.shape
    if again.capture.illumination == "flood":
        return f"Sum over {_n(pixels, 'pixel')}"
    over = _n(lasers, "laser point") if pixels == 1 else f"{_n(lasers, 'laser point')} × {_n(pixels, 'pixel')}"
    return f"Sum over {over}"
