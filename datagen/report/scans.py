"""A scan as pictures: time against place along one row, and the wall at a few moments or its laser points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure, FigureBase

from datagen.records.arrays import Floats, Ints
from datagen.report.curves import busy_window, time_label
from datagen.report.replay import Light
from datagen.report.style import captioned, empty_note

MOMENTS = 4
"""Moments at which the whole wall is shown, two in a row, enough to see how a wavefront travels over it."""
_COLORS = "magma"
_DECADES = 3.5


@dataclass(frozen=True)
class Raster:
    """Channels of a scan, as they lie on the wall.

    channels : (row, column, 2) laser and pixel number of each channel.
    x_m, z_m : (column,) and (row,) metres right and up in the frame of the labels, without such a frame from the
        middle; None where channels lie on no grid and make one row, in the order of their numbers.
    places : (row, column, 3) on the wall.
    what : "laser point" or "pixel".
    """

    channels: Ints
    x_m: Floats | None
    z_m: Floats | None
    places: Floats
    what: str

    @classmethod
    def of(cls, light: Light) -> Raster:
        """The grid of the laser points; else that of the pixels, for the clear channel's laser point; else a row.

        A grid is recognised by its places: rows of equally many points, at least two, at equal steps.
        """
        (lasers, pixels, _), (laser, pixel) = light.total.shape, light.channel
        spots, seen = light.capture.laser.targets, light.capture.sensor.pixels.mean(axis=1)
        by_laser = (np.stack([np.arange(lasers), np.full(lasers, pixel)], axis=1), spots, "laser point")
        by_pixel = (np.stack([np.full(pixels, laser), np.arange(pixels)], axis=1), seen, "pixel")
        for channels, places, what in (by_laser, by_pixel):
            columns = _columns(places) if len(channels) > 1 else None
            if columns is not None:
                grid = places.reshape(-1, columns, 3)
                x = np.linalg.norm(grid[0] - grid[0, 0], axis=-1)
                z = np.linalg.norm(grid[:, 0] - grid[0, 0], axis=-1)
                right, up = (0.0, 0.0) if light.frame is None else light.frame.to_view(places.mean(axis=0))[:2]
                shape = (-1, columns, 2)
                return cls(channels.reshape(shape), right + x - x.mean(), up + z.mean() - z, grid, what)
        channels, places, what = by_laser if lasers > 1 or pixels == 1 else by_pixel
        return cls(channels[None], None, None, places[None], what)

    def scan_of(self, values: Floats) -> Floats:
        """(laser, pixel, bin) → (row, column, bin)."""
        return np.asarray(values[self.channels[..., 0], self.channels[..., 1]], np.float64)


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


def scan_page(title: str, light: Light, source: str = "") -> Figure | None:
    """Slices of the scan, all light above and that of objects below; None when there is a single channel.

    source : a clause on where the light comes from, for the caption.
    """
    if light.total.shape[0] * light.total.shape[1] < 2:
        return None
    raster = Raster.of(light)
    text = f"Left: time against the number of the {raster.what}; right: its place, coloured by its sum over time"
    if raster.x_m is not None:
        most = "objects reach most" if light.objects.any() else "has most light"
        text = f"Left: time along the row that {most}; right: the wall at {MOMENTS} moments, each on its own scale"
    text = f"{text}; {source}." if source else f"{text}."
    layers = {"all light" if light.objects.any() else "": light.total}
    if light.objects.any():
        layers["objects only"] = light.objects
    figure, grid = captioned([3.4 * len(layers)], text, f"{title}: the scan", 2, [1, 1.4])
    # Subfigures, so that the colour bars of one take no room from the columns of the other.
    left, right = figure.add_subfigure(grid[0, 0]), figure.add_subfigure(grid[0, 1])
    at = moments(raster.scan_of(light.clear))
    for line, (what, values) in enumerate(layers.items()):
        scan = raster.scan_of(values)
        draw_time_slice(left, left.add_subplot(len(layers), 1, line + 1), scan, raster, light, what)
        if raster.x_m is None or raster.z_m is None:
            _draw_places(right, right.add_subplot(len(layers), 1, line + 1), scan, raster, light)
            continue
        for number, bins in enumerate(at):
            axes = right.add_subplot(2 * len(layers), MOMENTS // 2, line * MOMENTS + number + 1)
            extent = (*reach(raster.x_m), *reach(raster.z_m)[::-1])
            # Noise leaves a little less than no light where hardly any is.
            shown = np.sqrt(np.maximum(scan[..., bins].sum(axis=-1), 0.0))
            axes.imshow(shown, extent=extent, cmap=_COLORS, interpolation="nearest", vmin=0.0)
            edges = light.time.edges_s * 1e9
            axes.set_xlabel("right (m)" if number > 1 else "")
            axes.set_ylabel("" if number % 2 else f"{what or 'all'}: up (m)")
            axes.set_title(f"{edges[bins.start]:.4g} – {edges[bins.stop]:.4g} ns")
    return figure


def draw_time_slice(
    figure: FigureBase, axes: Axes, scan: Floats, raster: Raster, light: Light, what: str = ""
) -> None:
    """The row of a (row, column, bin) scan that objects reach most, counted from the top: place across, time down,
    brightness by powers."""
    row = int(np.argmax(raster.scan_of(light.clear).sum(axis=(1, 2))))
    edges = light.time.edges_s * 1e9
    across = reach(np.arange(scan.shape[1], dtype=np.float64) if raster.x_m is None else raster.x_m)
    named = f"row {row + 1}" if raster.x_m is not None else f"{raster.what}s"
    axes.set_title(f"Time along {named}" + (f", {what}" if what else ""))
    axes.set(xlabel="right (m)" if raster.x_m is not None else f"number of the {raster.what}")
    low, high = busy_window(light.total.reshape(-1, light.time.bins), light.time, 0.98)
    if light.objects.any():
        high = max(high, busy_window(light.objects.reshape(-1, light.time.bins), light.time)[1])
    axes.set(ylabel=time_label(light.time), xlim=across, ylim=(high, low))
    highest = float(scan[row].max())
    if highest <= 0:
        empty_note(axes, "no light")
        return
    lowest = highest * 10.0**-_DECADES
    style: dict[str, Any] = {"aspect": "auto", "cmap": _COLORS, "interpolation": "nearest"}
    place, norm = (*across, edges[-1], edges[0]), LogNorm(lowest, highest)
    image = axes.imshow(np.maximum(scan[row].T, lowest), extent=place, norm=norm, **style)
    axes.set(facecolor="black", ylim=(high, low))
    figure.colorbar(image, ax=axes, pad=0.02, label=light.unit)


def moments(scan: Floats) -> list[slice]:
    """`MOMENTS` groups of bins, early to late, about the middles of equal shares of a scan's light."""
    curve = scan.sum(axis=(0, 1))
    if not curve.any():
        return []
    reached = np.cumsum(curve) / curve.sum()
    centers = [int(np.searchsorted(reached, q)) for q in (np.arange(MOMENTS) + 0.5) / MOMENTS]
    first, last = int(np.searchsorted(reached, 0.01)), int(np.searchsorted(reached, 0.99))
    half = max(0, (last - first) // (8 * MOMENTS))
    return [slice(max(0, c - half), min(len(curve), c + half + 1)) for c in centers]


def reach(places: Floats) -> tuple[float, float]:
    """From half a step before the first place to half a step after the last."""
    half = float(places[1] - places[0]) / 2 if len(places) > 1 else 0.5
    return float(places[0]) - half, float(places[-1]) + half


def _draw_places(figure: FigureBase, axes: Axes, scan: Floats, raster: Raster, light: Light) -> None:
    """The places of a scan without a grid, joined in their order, coloured by the light of each."""
    places = raster.places[0]
    x, y = (places - places.mean(axis=0) if light.frame is None else light.frame.to_view(places))[:, :2].T
    axes.plot(x, y, color="#999999", linewidth=0.5, zorder=1)
    drawn = axes.scatter(x, y, s=25, c=scan[0].sum(axis=-1), cmap=_COLORS)
    figure.colorbar(drawn, ax=axes, pad=0.02, label="sum over time")
    axes.set(xlabel="right (m)", ylabel="up (m)", title=f"Where each {raster.what} lies")
    axes.set_aspect("equal", adjustable="datalim")
