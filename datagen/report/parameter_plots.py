"""The drawn parameters of a dataset's scenes: one small histogram for each parameter that varies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from datagen.records import Scalar
from datagen.report.style import EXPECTED, new_figure, short

MOST_PARAMETERS = 12
_MOST_WORDS = 12
_COLUMNS = 4
_CELL_IN = (3.2, 1.75)
_TITLE_LETTERS = 48


def varying(parameters: Sequence[Mapping[str, Scalar]]) -> dict[str, list[Scalar]]:
    """Parameter → its values over the scenes that have it, if these differ. Seeds, and texts of many different values
    (lists of names), are left out: their distributions mean nothing.
    """
    names = dict.fromkeys(name for scene in parameters for name in scene)
    columns = {name: [scene[name] for scene in parameters if name in scene] for name in names}
    chosen = {}
    for name, values in columns.items():
        different = len(set(values))
        if different > 1 and not name.endswith("seed") and (_is_number(values) or different <= _MOST_WORDS):
            chosen[name] = values
    return chosen


def parameter_page(columns: Mapping[str, Sequence[Scalar]]) -> Figure | None:
    """Histograms of up to 12 parameters; None when nothing varies. Call it within `house_style()`."""
    shown = list(columns.items())[:MOST_PARAMETERS]
    if not shown:
        return None
    rows = -(-len(shown) // _COLUMNS)
    tall = rows * _CELL_IN[1]
    figure = new_figure(_COLUMNS * _CELL_IN[0], tall, arranged=False)
    figure.subplots_adjust(0.05, 0.3 / tall, 0.99, 1 - 0.3 / tall, wspace=0.28, hspace=0.62)
    for number, (name, values) in enumerate(shown):
        axes = figure.add_subplot(rows, _COLUMNS, number + 1)
        if not _is_number(values):
            words, counts = np.unique([str(value) for value in values], return_counts=True)
            axes.barh([short(word) for word in words], counts, color=EXPECTED)
        else:
            numbers = np.array([float(value) for value in values])
            numbers = numbers[np.isfinite(numbers)]
            low, high = (float(numbers.min()), float(numbers.max())) if len(numbers) else (0.0, 1.0)
            # Numbers over more than two decades, such as significances.
            wide = low > 0 and high > 300 * low
            edges = np.geomspace(low, high, 21) if wide else np.linspace(low, high if high > low else low + 1, 21)
            axes.hist(numbers, edges.tolist(), color=EXPECTED, edgecolor="white", linewidth=0.5)
            axes.set_xscale("log" if wide else "linear")
            # Without a common factor at the end of the axis, which the next picture would cover.
            axes.xaxis.set_major_formatter(lambda value, _: f"{value:.4g}")
            if not wide:
                axes.locator_params(axis="x", nbins=5)
        axes.set_title(short(name, _TITLE_LETTERS), fontsize=8, fontweight="normal")
        axes.tick_params(labelsize=7)
        if number % _COLUMNS == 0:
            axes.set_ylabel("scenes", fontsize=7)
    return figure


def _is_number(values: Sequence[Scalar]) -> bool:
    return all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in values)
