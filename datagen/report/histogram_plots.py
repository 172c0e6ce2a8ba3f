"""Counts over their expectation, and what is left when it is taken away."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from datagen.records import TimeAxis
from datagen.report.style import EXPECTED, INK, empty_note
from datagen.report.transient_plots import time_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COUNTS = "#9A9A9A"


def draw_counts(
    axes: Axes, counts: NDArray[Any], expected: NDArray[np.float64], time: TimeAxis, *, mean: str = "exact mean"
) -> None:
    """(bin,) counts as bars, (bin,) expectation as a line; logarithmic when the peak is 30 times the median bin.

    `mean` says in the legend what kind of expectation it is.
    """
    edges = time.edges_s * 1e9
    axes.stairs(counts, edges, fill=True, color=COUNTS, linewidth=0, label="counts")
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


def residuals(counts: NDArray[Any], expected: NDArray[np.float64]) -> NDArray[np.float64]:
    """(counts − expectation) / √expectation; NaN where nothing is expected and nothing was counted."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where((expected > 0) | (counts > 0), (counts - expected) / np.sqrt(expected), np.nan)


def draw_residuals(
    axes: Axes, counts: NDArray[Any], expected: NDArray[np.float64], time: TimeAxis, *, is_poisson: bool = True
) -> None:
    """Residuals in units of the Poisson spread; for Poisson counts the band that holds 95 % of them where many."""
    values = residuals(counts, expected)
    if is_poisson:
        axes.axhspan(-2, 2, color=EXPECTED, alpha=0.12, linewidth=0)
    axes.axhline(0, color=EXPECTED, linewidth=0.8)
    axes.plot(time.centers_s * 1e9, values, linestyle="", marker=".", markersize=2.5, color=INK)
    finite = values[np.isfinite(values)]
    reach = max(4.0, 1.1 * float(abs(finite).max())) if len(finite) else 4.0
    axes.set(xlabel=time_label(time), ylabel="(counts − expectation)\n/ √expectation", ylim=(-reach, reach))


def mean_square_residual(counts: NDArray[Any], expected: NDArray[np.float64]) -> tuple[float, float, int] | None:
    """Mean of (n − μ)²/μ over all bins with μ > 0, its standard error for Poisson counts, and how many bins.

    For Poisson counts (n − μ)²/μ has mean 1 and variance 2 + 1/μ. None when nothing is expected.
    """
    mean = expected[expected > 0]
    if len(mean) == 0:
        return None
    square = (counts[expected > 0] - mean) ** 2 / mean
    return float(square.mean()), float(np.sqrt((2 + 1 / mean).sum())) / len(mean), len(mean)
