"""A scan as pictures: time against place along one row and the wall at a few moments, or time against laser point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure, FigureBase

from datagen.labels import ViewFrame
from datagen.records import Capture, Rectangle, TimeAxis
from datagen.records.arrays import Floats, Ints
from datagen.report.style import LASER, captioned, empty_note
from datagen.report.time_plots import busy_window, time_label

_COLORS = "magma"
_DECADES = 3.5
MOMENTS = 4
"""Moments at which the whole wall is shown. Halved, a wavefront's way over it is lost."""
_NUMBERED = 40
"""Largest number of laser points that are numbered in the picture. More numbers would cover one another."""


@dataclass(frozen=True)
class Raster:
    """Channels that lie on a grid on the wall.

    channels : (row, column, 2) laser and pixel number of each channel. x_m, z_m : (column,) and (row,) metres right
    and up in the frame of the labels; without such a frame, from the grid's middle. what : "laser points" or
    "pixels".
    """

    channels: Ints
    x_m: Floats
    z_m: Floats
    what: str


def raster_of(capture: Capture, channel: tuple[int, int], frame: ViewFrame | None = None) -> Raster | None:
    """The grid of the scan's laser points; else that of the pixels, for the laser point of `channel`; else None.

    A grid is recognised by its places: rows of equally many points, at least two, at equal steps.
    """
    lasers, pixels, _ = capture.shape
    for count, places, what in (
        (lasers, capture.laser.targets, "laser points"),
        (pixels, capture.sensor.pixels.mean(axis=1), "pixels"),
    ):
        columns = _columns(places) if count > 1 else None
        if columns is None:
            continue
        number = np.arange(count).reshape(-1, columns)
        fixed = np.full_like(number, channel[1] if what == "laser points" else channel[0])
        pair = (number, fixed) if what == "laser points" else (fixed, number)
        grid = places.reshape(-1, columns, 3)
        x = np.linalg.norm(grid[0] - grid[0, 0], axis=-1)
        z = np.linalg.norm(grid[:, 0] - grid[0, 0], axis=-1)
        right, up = (0.0, 0.0) if frame is None else frame.to_view(places.mean(axis=0))[:2]
        return Raster(np.stack(pair, axis=-1), right + x - x.mean(), up + z.mean() - z, what)
    return None


def numbered_raster(count: int) -> Raster:
    """A row of `count` channels without known places, in the order of their numbers."""
    return Raster(np.zeros((1, count, 2), np.int64), np.arange(count, dtype=np.float64), np.zeros(1), "laser points")


def _columns(places: Floats) -> int | None:
    """Length of the rows of a regular grid that is listed row by row; None for other places."""
    steps = np.diff(places, axis=0)
    if (np.linalg.norm(steps, axis=1) == 0).any():
        return None
    tolerance = 1e-6 * float(np.ptp(places, axis=0).max()) + 1e-12
    along = np.linalg.norm(steps - steps[0], axis=1) <= tolerance
    columns = len(places) if along.all() else int(np.argmin(along)) + 1
    if columns < 2 or len(places) % columns:
        return None
    grid = places.reshape(-1, columns, 3)
    regular = abs(grid - grid[:, :1] - (grid[0] - grid[0, 0])).max() <= tolerance
    down = np.diff(grid[:, 0], axis=0)
    return columns if regular and (len(down) < 2 or abs(down - down[0]).max() <= tolerance) else None


def scan_of(values: Floats, raster: Raster) -> Floats:
    """(laser, pixel, bin) → (row, column, bin)."""
    return np.asarray(values[raster.channels[..., 0], raster.channels[..., 1]], np.float64)


def draw_time_slice(
    figure: FigureBase, axes: Axes, scan: Floats, row: int, raster: Raster, time: TimeAxis,
    limits: tuple[float, float], unit: str = "photons per emitted photon and bin",
) -> None:  # fmt: skip
    """One row of the scan: place on the wall across, time down, the logarithm of the signal as brightness."""
    edges = time.edges_s * 1e9
    across = _reach(raster.x_m)
    axes.set(xlabel="place along the row (m to the right)", ylabel=time_label(time))
    highest = float(scan[row].max())
    if highest <= 0:
        axes.set(xlim=across, ylim=limits[::-1])
        empty_note(axes, "no light")
        return
    axes.set_facecolor("black")
    lowest = highest * 10.0**-_DECADES
    style: dict[str, Any] = {"aspect": "auto", "cmap": _COLORS, "interpolation": "nearest"}
    place, norm = (*across, edges[-1], edges[0]), LogNorm(lowest, highest)
    image = axes.imshow(np.maximum(scan[row].T, lowest), extent=place, norm=norm, **style)
    axes.set_ylim(limits[::-1])
    figure.colorbar(image, ax=axes, pad=0.02, label=unit)


def draw_moment(axes: Axes, scan: Floats, bins: slice, raster: Raster, time: TimeAxis | None = None) -> None:
    """The whole scan summed over a few bins: the wall as a picture, square root of the signal as brightness. With
    `time` the title says when that was."""
    top, bottom = _reach(raster.z_m)
    extent = (*_reach(raster.x_m), bottom, top)
    shown = np.sqrt(scan[..., bins].sum(axis=-1))
    axes.imshow(shown, extent=extent, cmap=_COLORS, interpolation="nearest", vmin=0.0)
    axes.set(xlabel="right (m)", ylabel="up (m)")
    if time is not None:
        edges = time.edges_s * 1e9
        axes.set_title(f"{edges[bins.start]:.4g} – {edges[bins.stop]:.4g} ns")


def moments(objects: Floats) -> list[slice]:
    """`MOMENTS` groups of bins, early to late, about the middles of equal shares of the objects' light."""
    curve = objects.sum(axis=(0, 1))
    if not curve.any():
        return []
    reached = np.cumsum(curve) / curve.sum()
    centers = [int(np.searchsorted(reached, q)) for q in (np.arange(MOMENTS) + 0.5) / MOMENTS]
    first, last = int(np.searchsorted(reached, 0.01)), int(np.searchsorted(reached, 0.99))
    half = max(0, (last - first) // (8 * MOMENTS))
    return [slice(max(0, c - half), min(len(curve), c + half + 1)) for c in centers]


def clear_row(objects: Floats) -> int:
    """The row with most of the objects' light."""
    return int(np.argmax(objects.sum(axis=(1, 2))))


def time_limits(scan: Floats, objects: Floats, time: TimeAxis) -> tuple[float, float]:
    """Nanoseconds between which the scan has most of its light and all of the objects'."""
    low, high = busy_window(scan.reshape(-1, scan.shape[-1]), time, 0.98)
    if objects.any():
        high = max(high, busy_window(objects.reshape(-1, scan.shape[-1]), time)[1])
    return low, high


def _reach(places: Floats) -> tuple[float, float]:
    """From half a step before the first place to half a step after the last."""
    half = float(places[1] - places[0]) / 2 if len(places) > 1 else 0.5
    return float(places[0]) - half, float(places[-1]) + half


def listed_page(
    title: str, wall: Rectangle, capture: Capture, whole: Floats, objects: Floats,
    note: str, frame: ViewFrame | None = None,
) -> Figure:  # fmt: skip
    """The laser points on the wall, and the transient of each in the scan's order.

    whole, objects : (laser, pixel, bin) all light, and light that objects scattered. note : end of the caption.
    frame : of the labels, for places; left out, that of the wall.
    """
    count = len(capture.laser.targets)
    text = (
        f"The {count} laser points of this scan make no grid. Left: where they aim on the relay wall (outline: what "
        "the device sees of it), in order. Right: the transient at each, in the same order (pixels summed); a "
        f"point of the hidden scene answers early where a laser point is near it. {note}"
    )
    figure, grid = captioned(14, [4.6], text, f"{title}: the scan", 3)
    places = figure.add_subplot(grid[0, 0])
    draw_places(places, capture.laser.targets, frame or ViewFrame.about(wall), wall)
    places.set_title("Laser points on the relay wall")
    raster = numbered_raster(count)
    scans = [values.sum(axis=1)[None] for values in (whole, objects)]
    limits = time_limits(scans[0], scans[1], capture.time)
    for column, (what, scan) in enumerate(zip(("all light", "objects only"), scans, strict=True)):
        axes = figure.add_subplot(grid[0, column + 1])
        draw_time_slice(figure, axes, scan, 0, raster, capture.time, limits)
        axes.set(title=f"Time against laser point, {what}", xlabel="number of the laser point")
    return figure


def draw_places(
    axes: Axes, places: Floats, frame: ViewFrame | None, outline: Rectangle | None = None,
    values: Floats | None = None,
) -> None:  # fmt: skip
    """Draw places on the wall, (n, 3), in the frame of the labels or about their middle: coloured by (n,) `values`;
    or, with the `outline` of the wall's visible part, joined in their order and numbered if they are few."""

    def on_wall(points: Floats) -> Floats:
        return (points - places.mean(axis=0) if frame is None else frame.to_view(points))[:, :2].T

    x, y = on_wall(places)
    if outline is not None:
        axes.plot(*on_wall(outline.corners[[0, 1, 2, 3, 0]]), color="#777777", linewidth=1.0)
        axes.plot(x, y, color=LASER, linewidth=0.4, alpha=0.5)
        axes.scatter(x, y, s=14, color=LASER, zorder=3)
        for k, place in enumerate(zip(x, y, strict=True) if len(x) <= _NUMBERED else ()):
            axes.annotate(str(k), place, xytext=(3, 3), textcoords="offset points", fontsize=7)
    else:
        axes.scatter(x, y, s=16, c=values, cmap=None if values is None else _COLORS)
    axes.set(xlabel="right (m)", ylabel="up (m)")
    axes.set_aspect("equal", adjustable="datalim")
