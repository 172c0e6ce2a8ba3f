"""The transient split by part, and the scan as an image of time against place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from datagen.records import Capture, Scene, TimeAxis, Transient
from datagen.report.style import INK, empty_note, part_colors
from datagen.units import path_from_time

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DECADES = 5.0


def time_label(axis: TimeAxis) -> str:
    """What the horizontal axis counts from."""
    start = "laser emission" if axis.origin == "source" else "the laser point"
    return f"time since {start} (ns)"


def clear_channel(scene: Scene, transient: Transient) -> tuple[int, int]:
    """(laser, pixel) where objects stand out most, by energy times share; without objects the brightest."""
    total = transient.total.sum(axis=2)
    names = [name for name, role in zip(scene.part_names, scene.roles, strict=True) if role == "object"]
    objects = sum(
        (transient.parts[name].sum(axis=2) for name in names if name in transient.parts), np.zeros_like(total)
    )
    # The share alone would favour channels with next to no light.
    clear = objects * objects / np.maximum(total, np.finfo(np.float64).tiny) if objects.any() else total
    laser, pixel = np.unravel_index(int(np.argmax(clear)), clear.shape)
    return int(laser), int(pixel)


def busy_window(curves: NDArray[np.float64], axis: TimeAxis, share: float = 0.9995) -> tuple[float, float]:
    """Nanoseconds from a little before the first light to a little after `share` of all has come."""
    total = np.atleast_2d(curves).sum(axis=0)
    reached = np.cumsum(total)
    edges = axis.edges_s * 1e9
    if reached[-1] <= 0:
        return float(edges[0]), float(edges[-1])
    first = int(np.argmax(total > 0))
    last = int(np.searchsorted(reached, share * reached[-1]))
    margin = 0.04 * (last + 1 - first) + 1
    low, high = max(0, int(first - margin)), min(axis.bins, int(last + 1 + margin))
    return float(edges[low]), float(edges[high])


def draw_stack(axes: Axes, scene: Scene, parts: Sequence[tuple[str, NDArray[np.float64]]], time: TimeAxis) -> None:
    """Stack (part name, (bin,) curve) pairs, objects lowest, on a logarithmic axis."""
    colors = part_colors(scene)
    total = np.sum([curve for _, curve in parts], axis=0) if parts else np.zeros(time.bins)
    axes.set(xlabel=time_label(time), ylabel=f"photons at the aperture per emitted\nphoton and bin of {_width(time)}")
    if not total.any():
        empty_note(axes, "no light arrives within the time window")
        return
    edges, bottom = time.edges_s * 1e9, np.zeros(time.bins)
    for name, curve in parts:
        axes.stairs(bottom + curve, edges, baseline=bottom, fill=True, color=colors[name], linewidth=0, label=name)
        bottom = bottom + curve
    axes.stairs(total, edges, color=INK, linewidth=0.7)
    highest = float(total.max())
    # Down to the weakest part's own peak, so that none drops out of the picture, yet no further than 5 decades.
    peaks = [float(curve.max()) for _, curve in parts if curve.any()]
    decades = min(max(2.5, float(np.log10(highest / min(peaks))) + 1.0), _DECADES)
    axes.set_yscale("log")
    axes.set_ylim(highest * 10.0**-decades, highest * 2)
    axes.set_xlim(*busy_window(total, time))
    add_path_axis(axes)


def stacking_order(scene: Scene) -> list[str]:
    """Part names, objects first: the lowest layer of a stack is the one that can be read off a logarithmic axis."""
    rank = {"object": 0, "structure": 1, "relay_wall": 2}
    return [name for _, name in sorted(zip(scene.roles, scene.part_names, strict=True), key=lambda p: rank[p[0]])]


def add_path_axis(axes: Axes) -> None:
    """The same axis once more along the top, as path length in metres."""

    def to_path(time_ns: Any) -> Any:
        return np.asarray(time_ns) * path_from_time(1e-9)

    def to_time(path_m: Any) -> Any:
        return np.asarray(path_m) / path_from_time(1e-9)

    axes.spines["top"].set_visible(True)
    axes.secondary_xaxis("top", functions=(to_path, to_time)).set_xlabel("path length (m)")


def _width(time: TimeAxis) -> str:
    return f"{time.width_s * 1e12:g} ps"


@dataclass(frozen=True)
class Raster:
    """Channels that lie on a grid on the wall.

    channels : (row, column, 2) laser and pixel number of each. x_m, z_m : (column,) and (row,) metres right and up
    from the grid's middle. what : "laser points" or "pixels".
    """

    channels: NDArray[np.int64]
    x_m: NDArray[np.float64]
    z_m: NDArray[np.float64]
    what: str


def raster_of(capture: Capture, channel: tuple[int, int]) -> Raster | None:
    """The grid that the scan's laser points make; else that of the pixels, for the laser point of `channel`.

    A grid is recognised by its places: rows of equally many points at equal steps. None when there is none with at
    least two points in a row.
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
        return Raster(np.stack(pair, axis=-1), x - x.mean(), z.mean() - z, what)
    return None


def _columns(places: NDArray[np.float64]) -> int | None:
    """Length of the rows of a regular grid listed row by row, or None."""
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
