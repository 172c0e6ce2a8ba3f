"""A scan as pictures: time against place along one row, and the wall at a few moments."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from datagen.records import TimeAxis
from datagen.report.style import empty_note
from datagen.report.transient_plots import Raster, busy_window, time_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import FigureBase
    from matplotlib.image import AxesImage

_COLORS = "magma"
_DECADES = 3.5


def scan_of(values: NDArray[np.float64], raster: Raster) -> NDArray[np.float64]:
    """(laser, pixel, bin) → (row, column, bin)."""
    return np.asarray(values[raster.channels[..., 0], raster.channels[..., 1]], np.float64)


def draw_time_slice(
    figure: FigureBase,
    axes: Axes,
    scan: NDArray[np.float64],
    row: int,
    raster: Raster,
    time: TimeAxis,
    limits: tuple[float, float],
) -> None:
    """One row of the scan: place on the wall across, time down, the logarithm of the signal as brightness."""
    from matplotlib.colors import LogNorm

    edges = time.edges_s * 1e9
    half = _half_step(raster.x_m)
    axes.set(xlabel="place along the row (m to the right)", ylabel=time_label(time))
    highest = float(scan[row].max())
    if highest <= 0:
        axes.set(xlim=(raster.x_m[0] - half, raster.x_m[-1] + half), ylim=limits[::-1])
        empty_note(axes, "no light")
        return
    axes.set_facecolor("black")
    image = axes.imshow(
        np.maximum(scan[row].T, highest * 10.0**-_DECADES),
        extent=(raster.x_m[0] - half, raster.x_m[-1] + half, edges[-1], edges[0]),
        aspect="auto",
        cmap=_COLORS,
        interpolation="nearest",
        norm=LogNorm(highest * 10.0**-_DECADES, highest),
    )
    axes.set_ylim(limits[::-1])
    figure.colorbar(image, ax=axes, pad=0.02, label="photons per emitted photon and bin")


def draw_moment(axes: Axes, scan: NDArray[np.float64], bins: slice, raster: Raster) -> AxesImage:
    """The whole scan summed over a few bins: the wall as a picture, square root of the signal as brightness."""
    across, upward = _half_step(raster.x_m), _half_step(raster.z_m)
    image = axes.imshow(
        np.sqrt(scan[..., bins].sum(axis=-1)),
        extent=(
            raster.x_m[0] - across, raster.x_m[-1] + across, raster.z_m[-1] - upward, raster.z_m[0] + upward,
        ),
        cmap=_COLORS,
        interpolation="nearest",
        vmin=0.0,
    )  # fmt: skip
    axes.set(xlabel="right (m)", ylabel="up (m)")
    return image


def moments(objects: NDArray[np.float64], count: int) -> list[slice]:
    """Groups of bins in which the objects' light moves over the wall, early to late: equal shares of its energy."""
    curve = objects.sum(axis=(0, 1))
    if not curve.any():
        return []
    reached = np.cumsum(curve) / curve.sum()
    centers = [int(np.searchsorted(reached, q)) for q in (np.arange(count) + 0.5) / count]
    first, last = int(np.searchsorted(reached, 0.01)), int(np.searchsorted(reached, 0.99))
    half = max(0, (last - first) // (8 * count))
    return [slice(max(0, c - half), min(len(curve), c + half + 1)) for c in centers]


def clear_row(objects: NDArray[np.float64]) -> int:
    """The row that gets the most of the objects' light."""
    return int(np.argmax(objects.sum(axis=(1, 2))))


def time_limits(scan: NDArray[np.float64], objects: NDArray[np.float64], time: TimeAxis) -> tuple[float, float]:
    """Nanoseconds between which the scan has most of its light and all of the objects'."""
    low, high = busy_window(scan.reshape(-1, scan.shape[-1]), time, 0.98)
    if objects.any():
        high = max(high, busy_window(objects.reshape(-1, scan.shape[-1]), time)[1])
    return low, high


def _half_step(places: NDArray[np.float64]) -> float:
    return abs(float(places[1] - places[0])) / 2 if len(places) > 1 else 0.5
