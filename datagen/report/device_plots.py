"""Pictures of a calibration and of a comparison: histograms as recorded and as simulated, and their errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from datagen.devices import Calibration, Comparison
from datagen.records.arrays import Floats
from datagen.report.style import EXPECTED, INK, check_png, new_figure, plain, save_png

MARGIN_BINS = 12
"""Bins shown before and after what is bright, for its tails."""


def draw_calibration(found: Calibration, path: str | Path) -> None:
    """Write the picture as .png: top, each zone's histogram in the nearest, middle and farthest tested frame; below,
    errors of brightness, peak and histogram over distance. Raises `InputError` where it cannot be written."""
    figure = new_figure(12, 8)
    rows = figure.subplots(2, 3)
    order = np.argsort(found.tested_m)
    for axes, frame in zip(rows[0], order[[0, len(order) // 2, -1]], strict=True):
        _draw_histograms(axes, found.measured[frame] + 1, found.modelled[frame] + 1, "counted", "fitted")
        axes.set(yscale="log", title=f"{found.tested_m[frame]:.3f} m, all zones")
    rows[0][0].set_ylabel("counts + 1")
    rows[0][0].legend()
    shown = (
        (100 * found.brightness_error, "brightness, fitted − counted (%)"),
        (found.peak_shift, "peak, fitted − counted (bins)"),
        (100 * found.relative_l2, "relative L2 of the histogram (%)"),
    )
    for axes, (values, label) in zip(rows[1], shown, strict=True):
        axes.plot(found.tested_m, values, ".", ms=4)
        axes.set(xlabel="distance of the plane (m)", ylabel=label)
    figure.suptitle(f"{plain(found.device.name)}: the tested frames, a colour a zone below")
    save_png(figure, check_png(path))


def draw_comparison(found: Comparison, path: str | Path) -> None:
    """Write the picture as .png: the best, a median and the worst histogram; below, errors by zone and by what was
    fitted, and what would explain the rest. Raises `InputError` where it cannot be written."""
    figure = new_figure(12, 7.5)
    top, below = figure.subplots(2, 3)
    error = found.relative_l2
    order = np.argsort(error, axis=None)
    chosen = (("best", order[0]), ("median", order[len(order) // 2]), ("worst", order[-1]))
    for axes, (name, place) in zip(top, chosen, strict=True):
        frame, zone = np.unravel_index(place, error.shape)
        measured = found.measured[frame, zone]
        _draw_histograms(axes, measured[None], found.modelled[frame, zone][None], "recorded", "simulated")
        bright = np.flatnonzero(measured > 0.02 * measured.max())
        axes.set_xlim(bright[0] - MARGIN_BINS, bright[-1] + MARGIN_BINS)
        axes.set_title(f"{name}: frame {frame}, zone {zone}, {100 * error[frame, zone]:.1f} % off")
    top[0].set_ylabel("counts")
    top[0].legend()
    zones = np.arange(error.shape[1])
    below[0].plot(zones, 100 * error.T, ".", color=INK, ms=2, alpha=0.4)
    below[0].plot(zones, 100 * np.median(error, axis=0), "_", color=EXPECTED, ms=14, mew=2.5, label="median")
    below[0].set(xlabel="zone", ylabel="relative L2 of the histogram (%)", yscale="log")
    below[0].legend()
    names = list(found.steps)
    medians, tails = (100 * np.array([found.steps[name][k] for name in names]) for k in (0, 1))
    rows = np.arange(len(names))
    below[1].barh(rows, medians, color=EXPECTED, label="median")
    below[1].plot(tails, rows, "|", color=INK, ms=14, mew=2, label="90th percentile")
    below[1].set_yticks(rows, names)
    below[1].invert_yaxis()
    below[1].set(xlabel="relative L2 after fitting this, too (%)")
    below[1].legend()
    below[2].barh(list(found.left), [100 * share for share in found.left.values()], color=EXPECTED)
    below[2].invert_yaxis()
    below[2].set(xlabel="share of what is left that it would explain (%)", xlim=(0, 100))
    figure.suptitle(plain(f"{Path(found.source).name}, simulated as {Path(found.simulated_as).name}"))
    save_png(figure, check_png(path))


def _draw_histograms(axes: Axes, measured: Floats, modelled: Floats, *labels: str) -> None:
    """Histograms (n, bins) as dots, and those of the device as lines; `labels` are those of dots and lines."""
    dots = axes.plot(measured.T, ".", color=INK, ms=3)
    lines = axes.plot(modelled.T, "-", color=EXPECTED, lw=0.8)
    # All zones share an entry of the legend.
    dots[0].set_label(labels[0])
    lines[0].set_label(labels[1])
    axes.set_xlabel("bin")
