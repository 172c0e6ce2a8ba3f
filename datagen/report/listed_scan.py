"""A scan whose laser points make no grid: where each is, and time against its number."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from datagen.records import Capture, Rectangle
from datagen.report.scan_plots import draw_time_slice, time_limits
from datagen.report.style import LASER, caption, caption_height, new_figure
from datagen.report.transient_plots import Raster

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_NUMBERED = 40
"""Up to so many points carry their number in the picture."""


def listed_page(
    title: str, wall: Rectangle, capture: Capture, whole: NDArray[np.float64], objects: NDArray[np.float64], note: str
) -> Figure:
    """The laser points on the wall, and the transient of each in the scan's order.

    whole, objects : (laser, pixel, bin) all light, and what objects scattered. note : ends the caption.
    """
    count = len(capture.laser.targets)
    text = (
        f"The {count} laser points of this scan make no grid. Left: where they aim on the relay wall (outline: what "
        "the device sees of it), in order. Right: the transient at each, in the same order (pixels summed); a "
        f"point of the hidden scene answers early where a laser point is near it. {note}"
    )
    figure = new_figure(14, 4.6 + caption_height(14, text))
    grid = figure.add_gridspec(2, 3, height_ratios=[4.6, caption_height(14, text)])
    figure.suptitle(f"{title}: the scan", fontweight="bold")
    _draw_places(figure.add_subplot(grid[0, 0]), wall, capture.laser.targets)
    number = np.arange(count)
    raster = Raster(np.zeros((1, count, 2), np.int64), number.astype(np.float64), np.zeros(1), "laser points")
    scans = [values.sum(axis=1)[None] for values in (whole, objects)]
    limits = time_limits(scans[0], scans[1], capture.time)
    for column, (what, scan) in enumerate(zip(("all light", "objects only"), scans, strict=True)):
        axes = figure.add_subplot(grid[0, column + 1])
        draw_time_slice(figure, axes, scan, 0, raster, capture.time, limits)
        axes.set(title=f"Time against laser point, {what}", xlabel="number of the laser point")
    caption(figure, figure.add_subplot(grid[1, :]), text)
    return figure


def _draw_places(axes: Axes, wall: Rectangle, places: NDArray[np.float64]) -> None:
    half = np.linalg.norm([wall.right, wall.up], axis=1)
    offset = places - wall.center
    x, y = offset @ wall.right / half[0], offset @ wall.up / half[1]
    outline = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]) * half
    axes.plot(outline[:, 0], outline[:, 1], color="#777777", linewidth=1.0)
    axes.plot(x, y, color=LASER, linewidth=0.4, alpha=0.5)
    axes.scatter(x, y, s=14, color=LASER, zorder=3)
    if len(x) <= _NUMBERED:
        for k, place in enumerate(zip(x, y, strict=True)):
            axes.annotate(str(k), place, xytext=(3, 3), textcoords="offset points", fontsize=7)
    axes.set(xlabel="right (m)", ylabel="up (m)", title="Laser points on the relay wall")
    axes.set_aspect("equal", adjustable="datalim")
