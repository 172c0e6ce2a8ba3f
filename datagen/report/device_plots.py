"""Pictures of a calibration and of a comparison: histograms as recorded and as simulated, and their errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import EngFormatter, LogLocator, MaxNLocator, NullFormatter

from datagen.devices import Calibration, Comparison
from datagen.records.arrays import Floats
from datagen.report.style import EXPECTED, INK, captioned, check_png, house_style, new_figure, plain, save_png

MARGIN_BINS = 12
"""Bins shown before and after what is bright, for its tails."""


def draw_calibration(found: Calibration, path: str | Path) -> None:
    """Write the picture as .png: top, each zone's histogram in the nearest, middle and farthest tested frame; below,
    errors of brightness, peak and histogram over distance. Raises `InputError` where it cannot be written."""
    order = np.argsort(found.tested_m)
    text = (
        f"{found.tested}. Above: the nearest, a middle and the farthest of them, all zones, a dot a bin. Below: how "
        "far the calibrated device is off in brightness and in the place of the peak (fitted less counted), and in "
        "the whole histogram, over the distance of the plane."
    )
    with house_style():
        title = f"{found.device.name}, calibrated: frames of a plane as counted and as fitted"
        figure, grid = captioned([2.7, 2.7], text, title, 3)
        top, below = ([figure.add_subplot(grid[row, column]) for column in range(3)] for row in range(2))
        for axes, frame in zip(top, order[[0, len(order) // 2, -1]], strict=True):
            _draw_histograms(axes, found.measured[frame] + 1, found.modelled[frame] + 1, "counted", "fitted")
            axes.set(yscale="log", title=f"{found.tested_m[frame]:.3f} m")
        top[0].set_ylabel("counts + 1")
        top[0].legend(loc="upper right", handlelength=1)
        shown = (
            (100 * found.brightness_error, "brightness (%)"),
            (found.peak_shift, "peak (bins)"),
            (100 * found.relative_l2, "relative L2 (%)"),
        )
        for axes, (values, label) in zip(below, shown, strict=True):
            axes.plot(found.tested_m, values, ".", color=INK, ms=2.5, alpha=0.4)
            axes.plot([], [], ".", color=INK, ms=4, label="a zone")
            axes.plot(found.tested_m, np.median(values, axis=1), "_", color=EXPECTED, ms=6, mew=2, label="median")
            axes.set(xlabel="distance (m)", ylabel=label)
        below[2].set_ylim(0, None)
        below[0].legend(loc="best", ncols=2, columnspacing=1, handlelength=1.5)
        save_png(figure, check_png(path))


def draw_comparison(found: Comparison, path: str | Path) -> None:
    """Write the picture as .png: the best, a median and the worst histogram; below, errors by zone and by what was
    fitted, and what would explain the rest. Raises `InputError` where it cannot be written."""
    with house_style():
        figure = new_figure(6.2)
        top, below = figure.subplots(2, 3)
        _draw_some(top, found)
        _draw_zones(below[0], found)
        _draw_steps(below[1], found)
        below[2].barh(list(found.left), [100 * share for share in found.left.values()], color=EXPECTED)
        below[2].invert_yaxis()
        below[2].set(xlabel="share of what is left that\nit would explain (%)", xlim=(0, 100))
        figure.suptitle(plain(f"{Path(found.source).name}, simulated as {Path(found.simulated_as).name}"))
        save_png(figure, check_png(path))


def _draw_some(panels: Sequence[Axes], found: Comparison) -> None:
    """The best, a median and the worst histogram."""
    error = found.relative_l2
    order = np.argsort(error, axis=None)
    chosen = (("best", order[0]), ("median", order[len(order) // 2]), ("worst", order[-1]))
    for axes, (name, place) in zip(panels, chosen, strict=True):
        frame, zone = np.unravel_index(place, error.shape)
        measured = found.measured[frame, zone]
        _draw_histograms(axes, measured[None], found.modelled[frame, zone][None], "recorded", "simulated")
        bright = np.flatnonzero(measured > 0.02 * measured.max())
        axes.set_xlim(bright[0] - MARGIN_BINS, bright[-1] + MARGIN_BINS)
        axes.set_title(f"{name}: {100 * error[frame, zone]:.1f} % off\nframe {frame}, zone {zone}")
        # Thousands as 50k: a peak has some 100 000 counts.
        axes.yaxis.set_major_formatter(EngFormatter(sep=""))
    panels[0].set_ylabel("counts")
    panels[0].legend(loc="upper right", handlelength=1)


def _draw_zones(axes: Axes, found: Comparison) -> None:
    """Errors of all frames by zone."""
    percent = 100 * found.relative_l2
    zones = np.arange(percent.shape[1])
    axes.plot(zones, percent.T, ".", color=INK, ms=2, alpha=0.4)
    axes.plot([], [], ".", color=INK, ms=2, label="a frame")
    axes.plot(zones, np.median(percent, axis=0), "_", color=EXPECTED, ms=10, mew=2.5, label="median")
    axes.set(xlabel="zone", ylabel="relative L2 of the histogram (%)", yscale="log")
    axes.xaxis.set_major_locator(MaxNLocator(9, integer=True))
    # Few powers of ten: 1, 2, 5, 10 … say more than 10⁰ and 10¹.
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.margins(y=0.12)
    axes.legend(loc="lower left", ncols=2, columnspacing=1)


def _draw_steps(axes: Axes, found: Comparison) -> None:
    """Errors by what was fitted."""
    names = list(found.steps)
    medians, tails = (100 * np.array([found.steps[name][k] for name in names]) for k in (0, 1))
    rows = np.arange(len(names))
    axes.barh(rows, medians, color=EXPECTED, label="median")
    axes.plot(tails, rows, "|", color=INK, ms=14, mew=2, label="90th percentile")
    axes.set_yticks(rows, names)
    axes.invert_yaxis()
    axes.set(xlabel="relative L2 after\nfitting this, too (%)", xlim=(0, None))
    axes.legend(loc="lower right", markerscale=0.6)


def _draw_histograms(axes: Axes, measured: Floats, modelled: Floats, *labels: str) -> None:
    """Histograms (n, bins) as dots, and those of the device as lines; `labels` are those of dots and lines."""
    dots = axes.plot(measured.T, ".", color=INK, ms=3)
    lines = axes.plot(modelled.T, "-", color=EXPECTED, lw=0.8)
    # All zones share an entry of the legend.
    dots[0].set_label(labels[0])
    lines[0].set_label(labels[1])
    axes.set_xlabel("bin")
