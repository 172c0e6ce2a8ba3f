"""Curves over time: the transient split by part; counts over their expectation, and their residuals."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from datagen.records import Scene, TimeAxis, Transient
from datagen.records.arrays import Floats
from datagen.report.style import EXPECTED, INK, empty_note, part_colors
from datagen.units import path_from_time

_DECADES = 5.0
_COUNTS = "#9A9A9A"


def time_label(axis: TimeAxis) -> str:
    """The label of a time axis, which names where it starts to count."""
    start = "laser emission" if axis.origin == "source" else "the laser point"
    return f"time since {start} (ns)"


def clear_channel(scene: Scene, transient: Transient) -> tuple[int, int]:
    """(laser, pixel) where objects' light is clearest, by its energy times its share; else the brightest."""
    total = transient.total.sum(axis=2)
    objects = sum(
        (transient.parts[name].sum(axis=2) for name in scene.objects if name in transient.parts), np.zeros_like(total)
    )
    # By the share alone, channels with hardly any light would win.
    clear = objects * objects / np.maximum(total, np.finfo(np.float64).tiny) if objects.any() else total
    laser, pixel = np.unravel_index(int(np.argmax(clear)), clear.shape)
    return int(laser), int(pixel)


def busy_window(curves: Floats, axis: TimeAxis, share: float = 0.9995) -> tuple[float, float]:
    """Nanoseconds from a little before the first light to a little after `share` of all light has come."""
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


def draw_stack(axes: Axes, scene: Scene, parts: Sequence[tuple[str, Floats]], time: TimeAxis) -> None:
    """Stack (part name, (bin,) curve) pairs, objects lowest, on a logarithmic axis."""
    # A name that is no part is light that is not split by part.
    colors = defaultdict(lambda: "#8FA3B5", part_colors(scene))
    total = np.sum([curve for _, curve in parts], axis=0) if parts else np.zeros(time.bins)
    axes.set(
        xlabel=time_label(time),
        ylabel=f"photons at the aperture per emitted\nphoton and bin of {time.width_s * 1e12:g} ps",
    )
    if not total.any():
        empty_note(axes, "no light arrives within the time window")
        return
    edges, bottom = time.edges_s * 1e9, np.zeros(time.bins)
    for name, curve in parts:
        axes.stairs(bottom + curve, edges, baseline=bottom, fill=True, color=colors[name], linewidth=0, label=name)
        bottom = bottom + curve
    axes.stairs(total, edges, color=INK, linewidth=0.7)
    highest = float(total.max())
    # Down to the peak of the weakest part, so that every part is seen, but at most `_DECADES`.
    peaks = [float(curve.max()) for _, curve in parts if curve.any()]
    decades = min(max(2.5, float(np.log10(highest / min(peaks))) + 1.0), _DECADES)
    axes.set_yscale("log")
    axes.set_ylim(highest * 10.0**-decades, highest * 2)
    axes.set_xlim(*busy_window(total, time))
    axes.spines["top"].set_visible(True)
    metre = path_from_time(1e-9)
    both = (lambda time_ns: np.asarray(time_ns) * metre, lambda path_m: np.asarray(path_m) / metre)
    axes.secondary_xaxis("top", functions=both).set_xlabel("path length (m)")


def stacking_order(scene: Scene) -> list[str]:
    """Part names, objects first: the lowest layer of a stack is the one that can be read off a logarithmic axis."""
    rank = {"object": 0, "structure": 1, "relay_wall": 2}
    return [name for _, name in sorted(zip(scene.roles, scene.part_names, strict=True), key=lambda p: rank[p[0]])]


def draw_counts(
    axes: Axes, counts: NDArray[Any], expected: Floats, time: TimeAxis, *, mean: str = "exact mean"
) -> None:
    """(bin,) counts as bars, (bin,) expectation as a line; logarithmic when the peak is 30 times the median bin.

    `mean` says in the legend what kind of expectation it is.
    """
    edges = time.edges_s * 1e9
    axes.stairs(counts, edges, fill=True, color=_COUNTS, linewidth=0, label="counts")
    axes.stairs(expected, edges, color=EXPECTED, linewidth=1.2, label=f"expectation ({mean})")
    axes.set(xlabel=time_label(time), ylabel=f"counts per bin of {time.width_s * 1e12:g} ps")
    highest = max(float(counts.max()), float(expected.max()))
    if highest <= 0:
        axes.set_ylim(0, 1)
        empty_note(axes, "no counts, and none expected")
    elif highest > 30 * max(float(np.median(expected)), 1.0):
        axes.set_yscale("log")
        lowest = float(expected[expected > 0].min(initial=highest))
        axes.set_ylim(max(0.3, 0.5 * lowest, highest * 1e-6), 3 * highest)
    else:
        axes.set_ylim(0, 1.25 * highest)
    axes.legend(loc="upper right")


def draw_residuals(
    axes: Axes, counts: NDArray[Any], expected: Floats, time: TimeAxis, *, is_poisson: bool = True
) -> None:
    """Residuals in units of the Poisson spread, with a band for 95 % of Poisson counts where counts are high."""
    with np.errstate(divide="ignore", invalid="ignore"):
        residuals = (counts - expected) / np.sqrt(expected)
    values = np.where((expected > 0) | (counts > 0), residuals, np.nan)
    if is_poisson:
        axes.axhspan(-2, 2, color=EXPECTED, alpha=0.12, linewidth=0)
    axes.axhline(0, color=EXPECTED, linewidth=0.8)
    axes.plot(time.centers_s * 1e9, values, linestyle="", marker=".", markersize=2.5, color=INK)
    finite = values[np.isfinite(values)]
    reach = max(4.0, 1.1 * float(abs(finite).max())) if len(finite) else 4.0
    axes.set(xlabel=time_label(time), ylabel="(counts − expectation)\n/ √expectation", ylim=(-reach, reach))


def mean_square_residual(counts: NDArray[Any], expected: Floats) -> tuple[float, float, int] | None:
    """Mean of (n − μ)²/μ over all bins with μ > 0, its standard error for Poisson counts, and the number of bins.

    For Poisson counts (n − μ)²/μ has mean 1 and variance 2 + 1/μ. None when nothing is expected.
    """
    mean = expected[expected > 0]
    if len(mean) == 0:
        return None
    square = (counts[expected > 0] - mean) ** 2 / mean
    return float(square.mean()), float(np.sqrt((2 + 1 / mean).sum())) / len(mean), len(mean)
