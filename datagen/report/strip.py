"""The frames of a stored sequence side by side, and what changes from one to the next over time."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from datagen.records import Scene
from datagen.records.arrays import Floats
from datagen.report.curves import busy_window
from datagen.report.labels import DRAWN, LabelImage
from datagen.report.replay import StoredScene
from datagen.report.stored import QUANTITIES, time_of_stored, unit_of
from datagen.report.style import captioned

MOST_FRAMES = 8
"""Frames beside one another; of more these many, spread evenly."""
SHOWN_FIRST = ("shaded", "depth", "part_id", "occupancy")
"""Labels of which the first that is stored is shown."""


def strip_page(stored: StoredScene, scene: Scene | None) -> Figure | None:
    """A label of some frames in a row, and below them, for all frames, the light or counts of the whole scan less
    their mean over the frames, over time: what moves is a ridge in it. None where neither is stored.

    scene : that of the labels; None if it is not known, and labels are not drawn.
    """
    measured = next((name for name in ("transient", *QUANTITIES) if name in stored.arrays), None)
    label = label_of(stored) if scene else None
    assert stored.frames is not None
    if measured is None and label is None:
        return None
    count = min(stored.frames, MOST_FRAMES)
    chosen = np.unique(np.linspace(0, stored.frames - 1, count).round().astype(int))
    times_s = stored.arrays["laser_time"].mean(axis=1)
    heights = [1.3] * (label is not None) + [3.2] * (measured is not None)
    drawn = [f"{label} in the middle of frames' exposures"] * (label is not None)
    drawn += [f"{measured} summed over the scan, less the mean over all frames"] * (measured is not None)
    text = "; below, ".join(drawn).capitalize() + "."
    figure, grid = captioned(heights, text, f"{stored.title}: frames", len(chosen))
    if label is not None and scene is not None:
        _draw_labels([figure.add_subplot(grid[0, k]) for k in range(len(chosen))], scene,
                     stored.arrays[label][chosen], label, times_s[chosen])  # fmt: skip
    if measured is not None:
        axes = figure.add_subplot(grid[len(heights) - 1, :])
        values = np.asarray(stored.arrays[measured], np.float64).sum(axis=(1, 2))
        time = time_of_stored(stored, measured)
        low, high = busy_window(values, time, 0.999)
        change = values - values.mean(axis=0)
        most = float(np.abs(change).max()) or 1.0
        edges = _edges(times_s)
        shown = axes.pcolormesh(
            time.edges_s * 1e9, edges, change, cmap="RdBu_r", vmin=-most, vmax=most, rasterized=True
        )
        axes.set(xlim=(low, high), xlabel="arrival time (ns)", ylabel="time (s)", ylim=(edges[-1], edges[0]))
        axes.set_title(f"Change of the {measured} against its mean")
        figure.colorbar(shown, ax=axes, label=unit_of(stored, measured))
    return figure


def label_of(stored: StoredScene) -> str | None:
    """The label that pictures of a sequence show; None where none is stored."""
    return next((name for name in (*SHOWN_FIRST, *DRAWN) if name in stored.arrays), None)


def label_images(scene: Scene, values: NDArray[np.generic], label: str) -> tuple[list[LabelImage], dict[str, Any]]:
    """One label in several frames, and how `imshow` draws them all: with the colours of all their values together."""
    images = [LabelImage.of(scene, label, one) for one in values]
    if images[0].values.ndim == 3:
        return images, {}
    norm, every = images[0].norm, np.ma.stack([image.values for image in images])
    if np.ma.count(every):
        norm.autoscale(every)
    return images, {"cmap": images[0].look.colors, "norm": norm}


def _draw_labels(cells: list[Axes], scene: Scene, values: NDArray[np.generic], label: str, times_s: Floats) -> None:
    """One label in several frames, side by side."""
    images, style = label_images(scene, values, label)
    for axes, image, time_s in zip(cells, images, times_s, strict=True):
        (left, bottom), (right, top) = image.low, image.high
        axes.imshow(image.values, extent=(left, right, bottom, top), interpolation="nearest", **style)
        axes.set(title=f"{time_s:.2f} s", xticks=[], yticks=[])


def _edges(times_s: Floats) -> Floats:
    """(F + 1,) seconds halfway between the frames, and as far before the first and after the last."""
    half = np.diff(times_s) / 2
    return np.concatenate([[times_s[0] - half[0]], times_s[:-1] + half, [times_s[-1] + half[-1]]])
