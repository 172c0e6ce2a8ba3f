"""Curves over time: light by part; counts over their expectation."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from numpy.typing import NDArray

from datagen.records import Scene, TimeAxis
from datagen.records.arrays import Floats
from datagen.report.style import EXPECTED, INK, empty_note, part_colors
from datagen.units import path_from_time

_DECADES = 5.0
"""Most powers of ten that an axis of light shows."""
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_LIGHTEST = 0.55
_STRONGER = 4.0
"""Weights of red, green and blue in luminance (ITU-R BT.709), the most luminance that a line has, and how much
farther from grey a paler colour is drawn: walls, floor and ceiling differ by little."""


def time_label(axis: TimeAxis) -> str:
    """The label of a time axis, which names where it starts to count."""
    start = "laser emission" if axis.origin == "source" else "the laser point"
    return f"time since {start} (ns)"


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


def draw_parts(axes: Axes, scene: Scene, parts: Mapping[str, Floats], time: TimeAxis) -> None:
    """Draw each part's own (bin,) light as a line on a logarithmic axis, the faintest in front, and the sum."""
    # A name that is no part is light that is not split by part.
    colors, edges = defaultdict(lambda: "#8FA3B5", part_colors(scene)), time.edges_s * 1e9
    parts = {name: curve for name, curve in parts.items() if curve.any()}
    axes.set(
        xlabel=time_label(time),
        ylabel=f"photons at the aperture per emitted\nphoton and bin of {time.width_s * 1e12:g} ps",
    )
    if not parts:
        empty_note(axes, "no light arrives within the time window")
        return
    total = np.sum([*parts.values()], axis=0)
    highest, faintest = float(total.max()), min(float(curve.max()) for curve in parts.values())
    # The peak of the faintest part is seen, too, if `_DECADES` reach down to it.
    lowest = highest * 10.0 ** -min(max(2.5, np.log10(highest / faintest) + 1.0), _DECADES)
    for name, curve in sorted(parts.items(), key=lambda of: -float(of[1].sum())):
        axes.stairs(curve, edges, baseline=None, color=line_color(colors[name]), linewidth=1.3, label=name)
    axes.stairs(total, edges, baseline=None, color=INK, linewidth=0.9, label="sum")
    axes.set(yscale="log", ylim=(lowest, 2 * highest), xlim=busy_window(total, time))
    axes.spines["top"].set_visible(True)
    metre = path_from_time(1e-9)
    both = (lambda time_ns: np.asarray(time_ns) * metre, lambda path_m: np.asarray(path_m) / metre)
    axes.secondary_xaxis("top", functions=both).set_xlabel("path length (m)")


def line_color(color: str) -> tuple[float, float, float]:
    """The colour of an area as that of a line: a pale one is stronger and darker, to be seen on white."""
    rgb = np.array(to_rgb(color))
    luminance = float(rgb @ _LUMINANCE)
    if luminance > _LIGHTEST:
        rgb = np.clip(luminance + _STRONGER * (rgb - luminance), 0.0, 1.0) * _LIGHTEST / luminance
    red, green, blue = (float(value) for value in rgb)
    return red, green, blue


def draw_counts(
    axes: Axes, counts: NDArray[Any], expected: Floats | None, time: TimeAxis, unit: str = "counts",
    mean: str = "exact mean",
) -> None:  # fmt: skip
    """(bin,) counts as bars, (bin,) expectation as a line; logarithmic when the peak is 30 times the median bin.

    unit : what is counted. mean : what kind of expectation it is.
    """
    edges, typical = time.edges_s * 1e9, counts if expected is None else expected
    axes.stairs(counts, edges, fill=True, color="#9A9A9A", linewidth=0, label=unit)
    if expected is not None:
        axes.stairs(expected, edges, color=EXPECTED, linewidth=1.2, label=f"expectation ({mean})")
        axes.legend(loc="upper right")
    axes.set(xlabel=time_label(time), ylabel=f"{unit} per bin of {time.width_s * 1e12:g} ps")
    axes.set_xlim(*busy_window(typical if typical.any() else counts, time))
    highest = max(float(counts.max()), float(typical.max()))
    if highest <= 0:
        axes.set_ylim(0, 1)
        empty_note(axes, "nothing arrives within the time window")
    elif highest > 30 * max(float(np.median(typical)), 1.0 if unit == "counts" else 0.0):
        lowest = 0.5 * float(typical[typical > 0].min(initial=highest))
        least = 0.3 if unit == "counts" else 0.0
        axes.set(yscale="log", ylim=(max(least, lowest, highest * 1e-6), 3 * highest))
    else:
        axes.set_ylim(0, 1.25 * highest)
