"""The drawn parameters of a dataset's scenes: one small histogram for each parameter that varies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from datagen.report.style import EXPECTED, SMALLEST_PT, new_figure, short
from datagen.store.columns import Column, Columns

MOST_PARAMETERS = 12
_COLUMNS = 3
_CELL_IN = 1.75
_TITLE_LETTERS = 38


def varying(parameters: Columns) -> dict[str, Column]:
    """Parameter → its values over the scenes that have it, if these differ. Seeds, and texts of many different values
    (lists of names), are left out: their distributions mean nothing.
    """
    return {
        name: column
        for name, column in parameters.items()
        if not name.endswith("seed") and (column.is_number if column.few is None else len(column.words) > 1)
    }


def parameter_page(columns: Mapping[str, Column]) -> Figure | None:
    """Histograms of up to 12 parameters; None when nothing varies. Call it within `house_style()`."""
    shown = list(columns.items())[:MOST_PARAMETERS]
    if not shown:
        return None
    rows = -(-len(shown) // _COLUMNS)
    tall = rows * _CELL_IN
    figure = new_figure(tall, arranged=False)
    figure.subplots_adjust(0.08, 0.3 / tall, 0.98, 1 - 0.3 / tall, wspace=0.28, hspace=0.62)
    for number, (name, column) in enumerate(shown):
        axes = figure.add_subplot(rows, _COLUMNS, number + 1)
        if not column.is_number:
            words = sorted(column.words.items())
            axes.barh([short(word) for word, _ in words], [count for _, count in words], color=EXPECTED)
        else:
            numbers = column.numbers
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
        axes.set_title(short(name, _TITLE_LETTERS), fontsize=SMALLEST_PT, fontweight="normal")
        axes.tick_params(labelsize=SMALLEST_PT)
        if number % _COLUMNS == 0:
            axes.set_ylabel("scenes", fontsize=SMALLEST_PT)
    return figure
