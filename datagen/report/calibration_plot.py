"""The picture of a calibration: histograms near and far as counted and as fitted, and errors over distance."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from datagen.devices import Calibration
from datagen.report.style import EXPECTED, INK, check_png, new_figure, save_png


def draw_calibration(found: Calibration, path: str | Path) -> None:
    """Write the picture as .png: top, each zone's histogram in the nearest, middle and farthest tested frame; below,
    errors of brightness, peak and histogram over distance. Raises `InputError` where it cannot be written."""
    figure = new_figure(12, 8)
    rows = figure.subplots(2, 3)
    order = np.argsort(found.tested_m)
    for axes, frame in zip(rows[0], order[[0, len(order) // 2, -1]], strict=True):
        measured, modelled = found.measured[frame], found.modelled[frame]
        for zone in range(len(measured)):
            first = zone == 0
            axes.plot(measured[zone] + 1, ".", color=INK, ms=3, label="counted" if first else None)
            axes.plot(modelled[zone] + 1, "-", color=EXPECTED, lw=0.8, label="fitted" if first else None)
        axes.set(yscale="log", xlabel="bin", title=f"{found.tested_m[frame]:.3f} m, all zones")
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
    figure.suptitle(f"{found.device.name}: the tested frames, a colour a zone below")
    save_png(figure, check_png(path))
