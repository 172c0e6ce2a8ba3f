"""What `datagen bench accuracy` found: a table, a picture, and what to choose."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from datagen.bench.accuracy_settings import ALL_LOOKINS, Row
from datagen.bench.measuring import markdown, percent
from datagen.report.style import INK, house_style, new_figure, save_png

if TYPE_CHECKING:
    from matplotlib.axes import Axes

GOALS = (0.10, 0.05, 0.02, 0.01)
_LOOKS = {
    "lookins": ("#000000", "o"),
    "FoV points": ("#009E73", "^"),
    "observed points": ("#0072B2", "s"),
    "k strongest paths": ("#CC79A7", "P"),
    "target": ("#D55E00", "v"),
    ALL_LOOKINS: ("#000000", "o"),
    "bounce orders": ("#E69F00", "X"),
}
"""Colour and marker of each swept quantity."""


def table(rows: Sequence[Row]) -> str:
    """Markdown, a row for each setting; the Pareto front is marked by ●."""
    head = ["swept", "value", "processor s", "error", "of it noise", "of it bias", "front"]
    cells = []
    for row in rows:
        errors = percent(row.error), _told(row.noise), _told(row.bias)
        cells.append([row.quantity, row.value, f"{row.seconds:.3g}", *errors, "●" if row.front else ""])
    return markdown(head, cells, words=2)


def _told(error: float) -> str:
    """What is more than the rounding of a way without noise."""
    return percent(error) if error > 1e-9 else "–"


def advice(rows: Sequence[Row]) -> list[str]:
    """What to choose, computed: the cheapest setting for each goal, and where a bias sets the floor."""
    title = f"What to choose for {_light_of(rows)} (processor seconds a scene, error found):"
    return [title, "", *(_for_goal(rows, goal) for goal in GOALS), *_floors(rows)]


def _light_of(rows: Sequence[Row]) -> str:
    """The light that most sweeps have as their truth, in words."""
    orders = {row.configured.rpartition("max_bounces: ")[2] for row in rows if row.quantity == "lookins"}
    return "light of all bounces" if orders in (set(), {"null"}) else f"light of up to {orders.pop()} bounces"


def _for_goal(rows: Sequence[Row], goal: float) -> str:
    enough = [row for row in rows if row.error <= goal and not row.complete]
    fixed = [row for row in enough if row.quantity != "target"]
    targeted = [row for row in enough if row.quantity == "target" and row.value == f"{goal:g}"]
    best = [min(some, key=lambda row: row.seconds) for some in (fixed, targeted) if some]
    choices = [f"`{row.configured}`, {row.seconds:.2g} s ({percent(row.error)})" for row in best]
    if not fixed:
        choices.insert(0, f"no fixed setting of these; {_by_the_trend(rows, goal)}")
    return f"- {percent(goal)}: {'; or leave the choice to it, '.join(choices)}"


def _by_the_trend(rows: Sequence[Row], goal: float) -> str:
    sweep = [row for row in rows if row.quantity == "lookins" and row.error > 0]
    if len(sweep) < 2 or sweep[-1].error >= sweep[-2].error:
        return "more lookins do not lead there"
    low, high = sweep[-2:]
    power = math.log(low.error / high.error) / math.log(float(high.value) / float(low.value))
    times = (high.error / goal) ** (1 / power)
    return f"by the trend about {float(high.value) * times:.2g} lookins, {high.seconds * times:.2g} s"


def _floors(rows: Sequence[Row]) -> Iterator[str]:
    """What no number of samples mends."""
    for quantity, what in (
        ("bounce orders", "Of the light of all bounces is left out, however many samples are taken"),
        ("k strongest paths", "Keeping the k strongest secondary paths of each lookin loses"),
    ):
        biased = [row for row in rows if row.quantity == quantity and row.bias > 0 and row.value != "all"]
        if biased:
            yield f"- {what}: {', '.join(f'{_label(row)} {percent(row.bias)}' for row in biased)}."
    own = {row.value: row.seconds for row in rows if row.quantity == "lookins"}
    ratios = [row.seconds / own[row.value] for row in rows if row.quantity == ALL_LOOKINS and row.value in own]
    if ratios:
        yield f"- All bounces cost {statistics.median(ratios):.2g} times as much time as {_light_of(rows)}."


def _label(row: Row) -> str:
    return f"{row.value} bounces" if row.quantity == "bounce orders" else f"k = {row.value}"


def picture(rows: Sequence[Row], title: str, path: Path) -> Path:
    """Error against seconds, one colour for each swept quantity, the Pareto front as a line."""
    with house_style():
        figure = new_figure(11.0, 5.6)
        left, right = figure.subplots(1, 2, width_ratios=(2.2, 1.3), sharey=True)
        _cost(left, [row for row in rows if not row.complete], f"Error against cost: {_light_of(rows)}")
        _cost(right, [row for row in rows if row.complete], "… of all bounces")
        figure.suptitle(title, fontsize=10, color=INK)
        return save_png(figure, path)


def _cost(axes: Axes, rows: Sequence[Row], title: str) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    shown = [row for row in rows if row.error > 0]
    if not shown:
        # Axes in decades have no place for nothing.
        axes.set_axis_off()
        axes.set_title(f"{title}: the time left room for no run")
        return
    front = sorted((row for row in shown if row.front), key=lambda row: row.seconds)
    broad: dict[str, Any] = {"color": "#F0C000", "lw": 7, "alpha": 0.45, "zorder": 0, "solid_capstyle": "round"}
    axes.plot(*_places(front), label="Pareto front", **broad)
    for quantity in dict.fromkeys(row.quantity for row in shown):
        color, marker = _LOOKS[quantity]
        points = [row for row in shown if row.quantity == quantity]
        axes.plot(*_places(points), color=color, marker=marker, ms=5.5, lw=1.0, alpha=0.9, label=quantity)
        for row in points[:: max(len(points) - 1, 1)]:
            axes.annotate(
                row.value,
                (row.seconds, row.error),
                xytext=(5, 4),
                textcoords="offset points",
                fontsize=6.5,
                color=color,
            )
    for goal in GOALS:
        axes.axhline(goal, color="#BBBBBB", lw=0.6, zorder=0)
    axes.set(xscale="log", yscale="log", xlabel="processor seconds a scene", ylabel="relative L2 error", title=title)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=30))
    axes.yaxis.set_major_formatter(lambda value, _: percent(value))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.margins(0.12)
    axes.legend(loc="lower left", fontsize=7)


def _places(rows: Sequence[Row]) -> tuple[list[float], list[float]]:
    return [row.seconds for row in rows], [row.error for row in rows]
