"""The picture of a comparison: the best, a median and the worst histogram, and errors by zone and by effect."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datagen.devices import Comparison
from datagen.report.style import EXPECTED, INK, check_png, new_figure, save_png

MARGIN_BINS = 12
"""Bins shown before and after what is bright. Halved, tails are cut off."""


def draw_comparison(found: Comparison, path: str | Path) -> None:
    """Write the picture as .png. Raises `InputError` where it cannot be written."""
    figure = new_figure(12, 7.5)
    top, below = figure.subplots(2, 3)
    error = found.relative_l2
    order = np.argsort(error, axis=None)
    chosen = (("best", order[0]), ("median", order[len(order) // 2]), ("worst", order[-1]))
    for axes, (name, place) in zip(top, chosen, strict=True):
        frame, zone = np.unravel_index(place, error.shape)
        measured, modelled = found.measured[frame, zone], found.modelled[frame, zone]
        axes.plot(measured, ".", color=INK, ms=4, label="recorded")
        axes.plot(modelled, "-", color=EXPECTED, lw=1, label="simulated")
        bright = np.flatnonzero(measured > 0.02 * measured.max())
        axes.set_xlim(bright[0] - MARGIN_BINS, bright[-1] + MARGIN_BINS)
        axes.set(xlabel="bin", title=f"{name}: frame {frame}, zone {zone}, {100 * error[frame, zone]:.1f} % off")
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
    figure.suptitle(f"{Path(found.source).name}, simulated as {Path(found.simulated_as).name}")
    save_png(figure, check_png(path))
